"""What is known of the parameters before the filter runs: the start values, and the prior.

The two differ. The filter starts near the least squares fits, so that the model is nearly linear between start and
result. The information of the start is removed from the result again (`kalman.prior_exchange`), because the fits
use the same data. The prior describes an unknown IMU on an unknown mount, and what the user states.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import Array, nearest_rotation, skew
from kreisel.inertial.noise_figures import GRADES
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.groups import USUAL_SKEW
from kreisel.model.parameters import ROBOT_GROUPS, CellParameters, RobotParameters
from kreisel.model.robot_model import RobotModel
from kreisel.model.site import EARTH_SD
from kreisel.preparation.attitude import alignment_from_gravity
from kreisel.preparation.preparation import ImuNoise, Preparation
from kreisel.units import DEG

START_INFLATION = 20.0
"""Start deviations of the filter over those of the least squares fits, which neglect correlation in time."""

_CROSS_COUPLING_SD = 0.05
"""Relative; deviation of the scale factors of an unknown IMU, and the largest of a start value. Chosen: 2.5 times that
of the cheapest grade, 0.02."""

_NON_ORTHOGONALITY = 0.015
"""rad; deviation of the mean coupling of two axes. Chosen: above `misalignment_sd` of all grades, 10 mrad at most;
decision 21 in docs/decisions takes 15 mrad, too."""

_TURN = 0.2
"""rad; standard deviation of the mount found from the rates."""

_NORTH_SD = 0.7  # of each component of a level vector of unit length and unknown direction: the root of 1/2
_POLYNOMIAL_SD = (0.02, 0.005)  # SI, gyros and accelerometers; chosen: `usual_sd` of these groups in `model.groups`

_BENT_GYRO, _BENT_ACCEL, _BENT_CROSS_COUPLING = 0.01, 0.3, 0.02
"""rad/s, m/s^2 and relative: least start deviations if polynomials are estimated, which the fits do not have. Chosen:
polynomials of `_POLYNOMIAL_SD` add as much to readings of 0.7 rad/s and 0.8 g."""

_UNKNOWN_GYRO, _UNKNOWN_ACCEL = 0.3, 2.0
"""rad/s and m/s^2; standard deviations of the offsets of an unknown IMU."""

_VOLUME = 20.0
"""m: extent of a motion from which on cameras do not see all of it. Chosen: halls with cameras have ten; in a public
recording within one, errors of another kind looked like a heading of 3 degrees."""

_MEMS = 1e-5
"""rad/s/sqrt(Hz): gyros with more noise are micromechanical."""

_UNKNOWN_G_SENSITIVITY, _MIN_G_SENSITIVITY = 2e-4, 1e-6
"""rad/s per m/s^2; deviation for gyros without a grade, and least one by grade."""

_LEVER_ARM_SD, _TILT_SD, _CLOCK_SD = 0.2, 0.3, 1.0
"""m, rad and s; lever arms, tilt of the reference against the fit, offset of the clocks against the fit."""


def starting_point(preparation: Preparation, order: int) -> tuple[CellParameters, dict[str, Array]]:
    """Return the parameters the filter starts from, and a covariance for each group.

    The deviations of the least squares fits are multiplied by `START_INFLATION`.
    """
    fit, force, noise, site = (
        preparation.rate_fit,
        preparation.accelerometer_fit,
        preparation.imu_noise,
        preparation.site,
    )
    gyro_offset, gyro_offset_sd = _with_stated(fit.k_w0, fit.k_w0_sd, noise.gyro_offset_sd, 0.02)
    if preparation.outside_standstill is not None:
        standstill_sd = preparation.outside_standstill.deviation(noise.gyro)
        better = standstill_sd < gyro_offset_sd
        gyro_offset = np.where(better, -preparation.outside_standstill.rate, gyro_offset)
        gyro_offset_sd = np.where(better, standstill_sd, gyro_offset_sd)
    accel_offset, accel_offset_sd = _with_stated(force.k_a0, force.k_a0_sd, noise.accel_offset_sd, 0.6)
    # Accelerometers that are hardly observable start with the gyros' mounting.
    mount = nominal_parameters(preparation, order).sensors.K_a
    K_a_sd = START_INFLATION * force.K_a_sd
    K_a = np.where(K_a_sd < _CROSS_COUPLING_SD, force.K_a, mount)
    k_w, k_a = np.zeros((order, 3)), np.zeros((order, 3))
    k_w[0], k_a[0] = gyro_offset, accel_offset
    if order > 1:
        # the fits have no polynomials: what these add to the readings is an error of the fits
        gyro_offset_sd = np.maximum(gyro_offset_sd, np.minimum(noise.gyro_offset_sd or np.inf, _BENT_GYRO))
        accel_offset_sd = np.maximum(accel_offset_sd, np.minimum(noise.accel_offset_sd or np.inf, _BENT_ACCEL))
    least = 1e-3 if order == 1 else _BENT_CROSS_COUPLING
    turned = _turned_by_robot(preparation.robot)
    least = max(least, turned)
    K_omega, K_omega_covariance = _nearly_orthogonal(
        fit.K_omega, np.clip(START_INFLATION * fit.K_omega_sd, least, _CROSS_COUPLING_SD)
    )
    if preparation.reference.quaternions is None:
        K_omega_covariance = _without_turn(K_omega_covariance)
    K_a, K_a_covariance = _nearly_orthogonal(K_a, np.clip(K_a_sd, least, _CROSS_COUPLING_SD))
    # without positions, a lever arm common to all three accelerometers is not observable
    arm = force.lever_arm if preparation.reference.positions is not None else np.zeros(3)
    start = CellParameters(
        SensorParameters(K_omega, k_w, K_a, k_a, np.tile(arm, (3, 1))),
        alignment_from_gravity(force.gravity), np.zeros(2), site.gravity, fit.clock.start, fit.clock.skew,
        RobotParameters.none(preparation.joints), site.known_earth_down,
    )  # fmt: skip
    deviation = {
        "gyro_offset": gyro_offset_sd,
        "accel_offset": accel_offset_sd,
        "lever_arms": np.full(9, 0.1),
        "alignment": np.full(2, np.clip(START_INFLATION * force.tilt_sd, max(1e-4, turned), 0.05)),
        "time_offset": np.array([max(START_INFLATION * fit.clock.start_sd, 1e-3)]),
        "time_skew": np.array([max(START_INFLATION * fit.clock.skew_sd, 1e-6)]),
        **_deviations_without_fit(preparation, order),
    }
    covariance = {group: np.diag(sd**2) for group, sd in deviation.items()}
    covariance |= {"gyro_cross_coupling": K_omega_covariance, "accel_cross_coupling": K_a_covariance}
    return start, covariance | _of_robot(preparation)


def stated_prior(preparation: Preparation, order: int) -> tuple[CellParameters, dict[str, Array]]:
    """Return what is known of the parameters before any look at the data, and its covariance for each group.

    The mount, the direction of gravity and the clocks are unknown: their prior is wide, with the fits as its centre.
    """
    fit, noise, site = preparation.rate_fit, preparation.imu_noise, preparation.site
    R = nearest_rotation(fit.K_omega)
    k_w, k_a = np.zeros((order, 3)), np.zeros((order, 3))
    gyro_sd = np.full(3, noise.gyro_offset_sd or _UNKNOWN_GYRO)
    if preparation.outside_standstill is not None:
        standstill_sd = preparation.outside_standstill.deviation(noise.gyro)
        better = standstill_sd < gyro_sd
        k_w[0] = np.where(better, -preparation.outside_standstill.rate, 0.0)
        gyro_sd = np.where(better, standstill_sd, gyro_sd)
    prior = CellParameters(
        SensorParameters(R, k_w, R, k_a, np.zeros((3, 3))),
        alignment_from_gravity(preparation.accelerometer_fit.gravity), np.zeros(2), site.gravity, fit.clock.start,
        0.0, RobotParameters.none(preparation.joints), site.known_earth_down,
    )  # fmt: skip
    deviation = {
        "gyro_offset": gyro_sd,
        "accel_offset": np.full(3, noise.accel_offset_sd or _UNKNOWN_ACCEL),
        "lever_arms": np.full(9, _LEVER_ARM_SD),
        "alignment": np.full(2, _TILT_SD),
        "time_offset": np.array([_CLOCK_SD]),
        "time_skew": np.array([USUAL_SKEW]),
        **_deviations_without_fit(preparation, order),
    }
    covariance = {group: np.diag(sd**2) for group, sd in deviation.items()}
    turn = _TURN if preparation.reference.quaternions is not None else 1e-6
    covariance["gyro_cross_coupling"] = _cross_coupling_prior(R, turn)
    covariance["accel_cross_coupling"] = _cross_coupling_prior(R, _TURN)
    return prior, covariance | _of_robot(preparation)


def nominal_parameters(preparation: Preparation, order: int) -> CellParameters:
    """Return the parameters of a faultless IMU on the mount found.

    A mount within three degrees of one along the axes is assumed to be along the axes, because brackets are built so.
    """
    R = nearest_rotation(preparation.rate_fit.K_omega)
    along = np.round(R)
    if (
        abs(np.linalg.det(along)) == 1.0
        and np.arccos(np.clip((np.trace(R.T @ along) - 1.0) / 2.0, -1.0, 1.0)) < 3.0 * DEG
    ):
        R = along
    ideal = SensorParameters.ideal(order)
    return CellParameters(
        replace(ideal, K_omega=R, K_a=R),
        alignment_from_gravity(preparation.accelerometer_fit.gravity),
        np.zeros(2),
        preparation.site.gravity,
        preparation.rate_fit.clock.start,
        preparation.rate_fit.clock.skew,
        RobotParameters.none(preparation.joints),
        preparation.site.known_earth_down,
    )


def _deviations_without_fit(preparation: Preparation, order: int) -> dict[str, Array]:
    """Return deviations of groups that no fit estimates."""
    site = preparation.site
    gyro_bend, accel_bend = _POLYNOMIAL_SD
    return {
        "gyro_polynomial": np.full(3 * (order - 1), gyro_bend),
        "accel_polynomial": np.full(3 * (order - 1), accel_bend),
        "north": np.full(2, _NORTH_SD if site.earth_rate_n is not None else EARTH_SD),
        "earth_down": np.array([EARTH_SD]),
        "gravity": np.array([max(site.gravity_sd, 1e-9)]),
        "gyro_g_sensitivity": np.full(9, _g_sensitivity(preparation)),
        **{group: np.full(3, size) for group, size in gauss_markov_sizes(preparation.imu_noise).items() if size > 0.0},
    }


def gauss_markov_sizes(noise: ImuNoise) -> dict[str, float]:
    """Return the deviations of the offsets' passing changes, by their groups."""
    return {"gyro_gauss_markov": noise.gyro_gauss_markov, "accel_gauss_markov": noise.accel_gauss_markov}


def expected_effects(preparation: Preparation) -> tuple[str, ...]:
    """Return the effects that a device of the stated grade has."""
    grade = GRADES.get(preparation.recording.settings.imu.grade or "")
    if grade is None:
        return ()
    sizes = {"gyro_g_sensitivity": grade.g_sensitivity, "gyro_g_squared": grade.g_squared}
    return tuple(group for group, size in sizes.items() if size > 0.0)


def likely_effects(preparation: Preparation) -> tuple[str, ...]:
    """Return the effects that are there as likely as not.

    Most inexpensive gyros of no stated grade respond to acceleration. Positions by satellites and attitudes by antennas
    or another IMU have frames that differ.
    """
    recording = preparation.recording
    inexpensive = recording.settings.imu.grade is None and float(np.max(preparation.imu_noise.observed[0])) > _MEMS
    outdoors = preparation.reference.extent > _VOLUME
    return (
        *(("gyro_g_sensitivity",) if inexpensive else ()),
        *(("position_heading",) if outdoors and recording.reference_kind == "mocap" else ()),
    )


def _g_sensitivity(preparation: Preparation) -> float:
    """Return the deviation of the gyros' sensitivity to acceleration, rad/s per m/s^2, by grade."""
    grade = GRADES.get(preparation.recording.settings.imu.grade or "")
    return _UNKNOWN_G_SENSITIVITY if grade is None else max(grade.g_sensitivity, _MIN_G_SENSITIVITY)


def _of_robot(preparation: Preparation) -> dict[str, Array]:
    """Return the covariances of the robot's errors."""
    covariance = {} if preparation.robot is None else preparation.robot.covariance
    return {group: covariance[group] for group in ROBOT_GROUPS if group in covariance}


def _turned_by_robot(robot: RobotModel | None) -> float:
    """Return how far a robot's errors may turn its tool, rad: the least squares fits treat them as noise."""
    if robot is None:
        return 0.0
    angles = np.diag(robot.covariance["robot_placement"]).reshape(-1, 6)[:, 3:]
    return 2.0 * float(np.sqrt(angles.sum() / 3.0))


def _cross_coupling_prior(R: Array, turn: float) -> Array:
    """Return the covariance (9, 9) of the entries of K = R (1 + E) about R.

    Scale errors are on the diagonal of E; the mean of a pair of couplings is non-orthogonality, half their
    difference a turn of standard deviation `turn`, rad.
    """
    P = np.zeros((9, 9))
    for i in range(3):
        P[4 * i, 4 * i] = _CROSS_COUPLING_SD**2
    for i, j in ((0, 1), (0, 2), (1, 2)):
        a, b = 3 * i + j, 3 * j + i
        P[a, a] = P[b, b] = _NON_ORTHOGONALITY**2 + turn**2
        P[a, b] = P[b, a] = _NON_ORTHOGONALITY**2 - turn**2
    rotated = np.kron(R, np.eye(3))
    return np.asarray(rotated @ P @ rotated.T)


def _nearly_orthogonal(K: Array, deviation: Array) -> tuple[Array, Array]:
    """Return a cross-coupling matrix and its covariance (9, 9), given that triads are nearly orthogonal.

    The mean of the two couplings between a pair of axes, seen along the mount, is their non-orthogonality:
    three observations of zero with the deviation `_NON_ORTHOGONALITY`. They matter only where the motion
    determines it less well.

    Parameters
    ----------
    K, deviation : (3, 3)
        The matrix, and the standard deviations of its entries.
    """
    R = nearest_rotation(K)
    P = np.diag(deviation.ravel() ** 2)
    H = np.zeros((3, 9))
    for row, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        shear = 0.5 * (np.outer(R[:, i], np.eye(3)[j]) + np.outer(R[:, j], np.eye(3)[i]))
        H[row] = shear.ravel()
    S = H @ P @ H.T + _NON_ORTHOGONALITY**2 * np.eye(3)
    gain = np.linalg.solve(S, H @ P).T
    mean = K.ravel() - gain @ (H @ K.ravel())
    P = P - gain @ S @ gain.T
    return mean.reshape(3, 3), 0.5 * (P + P.T)


def _without_turn(P: Array) -> Array:
    """Return the covariance (9, 9) of a cross-coupling matrix near one, given that it does not turn b."""
    H = np.array([skew(e).ravel() for e in np.eye(3)]) / 2.0
    S = H @ P @ H.T + 1e-6**2 * np.eye(3)
    gain = np.linalg.solve(S, H @ P).T
    P = P - gain @ S @ gain.T
    return np.asarray(0.5 * (P + P.T) + 1e-18 * np.eye(9))


def _with_stated(value: Array, value_sd: Array, stated_sd: float | None, largest: float) -> tuple[Array, Array]:
    """Return an offset and its deviation: the stated ones, centred at zero, or the fit's where they are smaller."""
    inflated = np.minimum(START_INFLATION * value_sd, largest)
    if stated_sd is None:
        return value, inflated
    better = inflated < stated_sd
    return np.where(better, value, 0.0), np.where(better, inflated, stated_sd)
