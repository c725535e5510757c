"""A simulated controller: the reports about an arm that differs from the controller's model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kreisel._kernels import recursions
from kreisel.geometry.rotation import Array, exp, lengths, multiply
from kreisel.robot import kinematics
from kreisel.robot.description import Arm
from kreisel.robot.motion import Plan, Timeline
from kreisel.simulation.cell_settings import Errors
from kreisel.simulation.device_errors import envelope, smooth_step

Report = tuple[Array, Array, Array]
"""Positions (n, 3), quaternions (n, 4) and joint angles (n, joints)."""

_SLOW = 0.01
"""rad/s of a joint below which its play is not taken up."""

_FADE = 0.01
"""m/s of the tool at which the path error has half of its size."""


@dataclass(frozen=True)
class ArmErrors:
    """Errors of one arm, drawn once.

    Attributes
    ----------
    placement : (joints + 1, 6)
        Of joints and tool; see `kinematics.regressor`.
    eccentricity, phase : (joints,)
        Of the gears, rad: a joint is amplitude * sin(angle + phase) beyond its motor's angle.
    compliance, lag : (joints,)
        rad/(N m), and s.
    backlash : (joints,)
        Play of the gears, rad.
    zeros : (max(joints - 2, 0),)
        Angles of the joints between the first and the last beyond the motors', rad (m if they slide).
    """

    placement: Array
    eccentricity: Array
    phase: Array
    compliance: Array
    lag: Array
    backlash: Array
    zeros: Array


@dataclass(frozen=True)
class Sway:
    """How the base sways while the arm moves: its size (m), frequency (Hz), and phases (2,) along x and y of r."""

    size: float
    frequency: float
    phases: Array

    def at(self, planned: Timeline, t: Array) -> tuple[Array, Array, Array]:
        """Return displacement, velocity and acceleration (n, 3) of the base at times (n,)."""
        omega = 2.0 * np.pi * self.frequency
        share, slope, bend = (part[:, None] for part in envelope(planned, t))
        angle = omega * t[:, None] + np.append(self.phases, 0.0)
        amplitude = self.size * np.array([1.0, 1.0, 0.0])
        sine, cosine = amplitude * np.sin(angle), amplitude * np.cos(angle)
        return (
            share * sine,
            slope * sine + share * omega * cosine,
            (bend - share * omega**2) * sine + 2.0 * slope * omega * cosine,
        )


def draw_sway(rng: np.random.Generator, errors: Errors) -> Sway:
    """Return how the base sways."""
    return Sway(errors.sway, errors.sway_frequency, rng.uniform(0.0, 2.0 * np.pi, 2))


def draw_errors(rng: np.random.Generator, arm: Arm, errors: Errors) -> ArmErrors:
    """Return the errors of one arm."""
    n = len(arm.joints)
    sd = np.repeat([errors.geometry_length_sd, errors.geometry_angle_sd], 3)
    placement = rng.normal(size=(n + 1, 6)) * sd
    eccentricity, phase = rng.normal(size=n) * errors.gear_eccentricity_sd, rng.uniform(0.0, 2.0 * np.pi, n)
    size = np.abs(rng.normal(size=n)) * errors.sag_sd
    drawn = rng.uniform(np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi), size=(200, n))
    largest = np.abs(kinematics.gravity_torques(arm, drawn)).max(axis=0)
    size = np.where(largest > 1.0, size / np.maximum(largest, 1.0), 0.0)
    lag = errors.servo_lag * rng.uniform(0.7, 1.3, n)
    backlash = errors.backlash_sd * np.abs(rng.spawn(1)[0].normal(size=n))
    zeros = errors.zero_sd * rng.spawn(1)[0].normal(size=n)[1:-1]
    return ArmErrors(placement, eccentricity, phase, size, lag, backlash, zeros)


def swing(plan: Plan, t: Array, errors: Errors) -> tuple[Array, Array, Array]:
    """Return the deflection of elastic joints from their motors: angle, rate and acceleration, (n, joints).

    Each joint is a damped spring driven by its motor's acceleration. The solution is exact for an acceleration that is
    linear between the moments t.
    """
    q, _, ddq = plan.at(t)
    if errors.oscillation_frequency <= 0.0:
        zero = np.zeros_like(q)
        return zero, zero, zero
    omega, damping = 2.0 * np.pi * errors.oscillation_frequency, errors.oscillation_damping
    h = float(t[1] - t[0])
    # x' = A x - B (u_k + s (u_k+1 - u_k)), the input a ramp: a matrix exponential of the augmented system
    A = np.array([[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]])
    M = np.zeros((4, 4))
    M[:2, :2], M[1, 2], M[2, 3] = A * h, -h, 1.0
    E = _exponential(M)
    now, later = E[:2, 2] - E[:2, 3], E[:2, 3]
    x = np.zeros((2, *q.shape))
    recursions.drive_oscillators(np.ascontiguousarray(E[:2, :2]), now.copy(), later.copy(), ddq, x)
    return x[0], x[1], -ddq - 2.0 * damping * omega * x[1] - omega**2 * x[0]


def _exponential(M: Array) -> Array:
    """Return the exponential of a matrix: that of a small part of it by its series, squared again and again."""
    halvings = max(0, int(np.ceil(np.log2(max(float(np.abs(M).sum(axis=1).max()), 1e-300)))) + 1)
    small = M / 2.0**halvings
    out = term = np.eye(len(M))
    for k in range(1, 19):
        term = term @ small / k
        out = out + term
    for _ in range(halvings):
        out = out @ out
    return out


def measured(nominal: Arm, plan: Plan, t: Array, own: ArmErrors, errors: Errors) -> Report:
    """Return the controller's poses and joint angles at times t (n,): the *nominal* arm at the motors' angles."""
    motor, rate = motor_angles(nominal, plan, t, own)
    motor = motor + own.lag * rate
    if errors.encoder_step > 0.0:
        motor = np.round(motor / errors.encoder_step) * errors.encoder_step
    return *kinematics.poses(nominal, motor), motor


def reported(
    rng: np.random.Generator,
    measure: Callable[[Array], Report],
    plan: Timeline,
    t: Array,
    jitter: Array,
    errors: Errors,
) -> Report:
    """Return reported positions, quaternions and joint angles at times t (n,), measured `jitter` later.

    To the measured poses are added the errors that do not depend on the joints' angles: repeatability and path error.
    """
    p, q, motor = measure(t + jitter)
    moved = _repeatability(rng, plan, t, errors) + _path(rng, plan, t, p, errors)
    return p + moved[:, :3], multiply(q, exp(moved[:, 3:])), motor


def motor_angles(nominal: Arm, plan: Plan, t: Array, own: ArmErrors) -> tuple[Array, Array]:
    """Return the angles and rates of the motors, (n, joints), for joints that follow the plan."""
    angle, rate, _ = plan.at(t)
    motor = angle - own.eccentricity * np.sin(angle + own.phase)  # a new array
    if np.any(own.compliance != 0.0):
        motor = motor + own.compliance * kinematics.gravity_torques(nominal, angle)
    if np.any(own.backlash != 0.0):  # the motor is ahead of its joint, in the direction of motion
        motor = motor + 0.5 * own.backlash * np.tanh(rate / _SLOW)
    motor[:, 1:-1] -= own.zeros
    return motor, rate


def _repeatability(rng: np.random.Generator, plan: Timeline, t: Array, errors: Errors) -> Array:
    """Return one draw for each rest, and a smooth transition from one to the next, (n, 6)."""
    sd = np.repeat([errors.repeatability_position_sd, errors.repeatability_orientation_sd], 3)
    draws = rng.normal(size=(len(plan.standstills), 6)) * sd
    k = np.clip(np.searchsorted(plan.standstills[:, 0], t, side="right") - 1, 0, len(draws) - 1)
    after = np.minimum(k + 1, len(draws) - 1)
    begin, end = plan.standstills[k, 1], plan.standstills[after, 0]
    share = smooth_step((t - begin) / np.where(end > begin, end - begin, 1.0))[0][:, None]
    return np.asarray((1.0 - share) * draws[k] + share * draws[after])


def _path(rng: np.random.Generator, plan: Timeline, t: Array, p: Array, errors: Errors) -> Array:
    """Return the path's error, (n, 6): a Gauss-Markov process that fades out at standstill."""
    sd = np.repeat([errors.path_position_sd, errors.path_orientation_sd], 3)
    white = rng.normal(size=(len(t), 6))
    if errors.path_correlation_time > 0.0:
        keep = np.exp(-np.diff(t) / errors.path_correlation_time)
        process = np.empty_like(white)
        recursions.gauss_markov(keep, white, process)
    else:
        process = white
    speed = lengths(np.gradient(p, t, axis=0))
    moving = np.where(plan.at_rest(t), 0.0, speed / (speed + _FADE))
    return process * sd * moving[:, None]
