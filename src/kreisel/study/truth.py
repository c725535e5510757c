"""The truth of a simulated cell in the terms of a problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import Array, Indices, apply, conjugate, from_two_vectors, multiply, nearest_rotation
from kreisel.inertial.effects import OF_TEMPERATURE
from kreisel.model.parameters import CellParameters, RobotParameters
from kreisel.model.problem import Problem
from kreisel.recording.recording import Recording
from kreisel.simulation.cell import Truth
from kreisel.simulation.device_errors import DeviceEffects
from kreisel.synchronization.clock import Clock

JUDGED = ("gyroscope", "accelerometer", "timing", "alignment.tilt")
"""Parameters whose names begin so are judged; north and the robot's errors depend on their priors."""


def judged(problem: Problem) -> tuple[Indices, tuple[str, ...]]:
    """Return which degrees of freedom are judged, and the names of their parameters."""
    chosen = [(i, name) for i, name in enumerate(problem.parameter_names) if name.startswith(JUDGED)]
    return np.array([i for i, _ in chosen], dtype=np.int64), tuple(name for _, name in chosen)


def true_parameters(truth: Truth, recording: Recording, problem: Problem, found: CellParameters) -> CellParameters:
    """Return the truth in the terms of a problem: its layout, its clock, and north as estimated."""
    sensors = truth.sensors
    if problem.reference.quaternions is None:
        # Positions do not determine the orientation of b: its axes are the gyros' axes, made orthogonal.
        C = nearest_rotation(sensors.K_omega).T
        sensors = replace(
            sensors, K_omega=C @ sensors.K_omega, K_a=C @ sensors.K_a, lever_arms=sensors.lever_arms @ C.T
        )
    order = problem.settings.polynomial_order
    k_w, k_a = (np.vstack([k, np.zeros((order, 3))])[:order] for k in (sensors.k_w, sensors.k_a))
    q_rn, north = _alignment(truth, found)
    apart = Clock(0.0).offset(int(recording.imu.stamps_ns[0]), int(problem.reference.stamps_ns[0]))
    start = truth.time_offset - apart
    robot = RobotParameters.none(problem.joints)
    if problem.joints:
        size, phase = truth.arm.eccentricity, truth.arm.phase
        gears = np.column_stack([size * np.cos(phase), size * np.sin(phase)])
        robot = RobotParameters(truth.arm.placement, gears, truth.arm.compliance, truth.arm.zeros)
    down = truth.gravity_r / np.linalg.norm(truth.gravity_r)
    earth_down = float(truth.earth_rate_r @ down) / problem.site.earth_rate_units[1]
    return CellParameters(
        type(sensors)(sensors.K_omega, k_w, sensors.K_a, k_a, sensors.lever_arms, _effects(truth.effects)),
        q_rn, north, float(np.linalg.norm(truth.gravity_r)), start, truth.time_skew, robot,
        earth_down,
    )  # fmt: skip


def further_terms(truth: Truth) -> dict[str, Array]:
    """Return the device's terms beyond offset and matrix, flat, by their groups."""
    return {**truth.sensors.effects, **_effects(truth.effects)}


def _effects(effects: DeviceEffects) -> dict[str, Array]:
    """Return those of the terms that the sensor model does not hold by itself."""
    return {
        "gyro_g_sensitivity": effects.g_sensitivity.ravel(),
        "gyro_g_squared": effects.g_squared.ravel(),
        "gyro_asymmetry": effects.gyro_asymmetry,
        "accel_asymmetry": effects.accel_asymmetry,
        "gyro_axis_delay": effects.axis_delay,
        "gyro_axis_smoothing": effects.axis_smoothing,
        "accel_delay": np.array([effects.accel_delay]),
        "accel_smoothing": effects.axis_smoothing.mean(keepdims=True),
        "accel_axis_delay": effects.axis_delay,
        "accel_axis_smoothing": effects.axis_smoothing - effects.axis_smoothing.mean(),
        **dict(zip(OF_TEMPERATURE, effects.temperature, strict=True)),
    }


def _alignment(truth: Truth, found: CellParameters) -> tuple[Array, Array]:
    """Return q_rn with the true down, by a rotation of the estimate without a part about down, and north."""
    down = apply(conjugate(found.q_rn), truth.gravity_r)
    turn = from_two_vectors(np.array([0.0, 0.0, 1.0]), down)
    return multiply(found.q_rn, turn), found.north
