"""Comparison of the assumed noise figures with the innovations, and their correction."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

import numpy as np

from kreisel.estimation.consistency import mean_normalised
from kreisel.fitting.fit import Fit
from kreisel.geometry.rotation import Array
from kreisel.model.problem import Problem, with_readings
from kreisel.recording.recording import DataWarning
from kreisel.refinement.pose_noise import pose_factors

CONTRADICTION = 2.0
"""Factor on a given standard deviation above which the data contradict it."""

FEW_REJECTED = 0.02
"""Share of rejected updates up to which given noise figures count as confirmed."""

_AGREEMENT = 1.2
"""Factor up to which noise agrees. Chosen: of 200 updates noise is known to 5 %, 1 / sqrt(400), so that chance alone
does not cause a further pass; deviations are then right to 20 %. It was 1.15 at first."""

_FEWEST = 15
"""Updates from which noise is found."""


@dataclass(frozen=True)
class StatedFigures:
    """Whose noise figures the user gave; they are changed only if the data contradict them."""

    reference: bool
    imu: bool


@dataclass(frozen=True)
class NoiseFactors:
    """Factors between the standard deviations by the innovations and the assumed ones.

    position, orientation and standstill are the reference's, gyro and accel the IMU's.
    """

    position: float = 1.0
    orientation: float = 1.0
    standstill: float = 1.0
    gyro: float = 1.0
    accel: float = 1.0

    def agree(self) -> bool:
        """Whether all lie within 20 % of one."""
        return all(1.0 / _AGREEMENT < f < _AGREEMENT for f in astuple(self))

    def contradicted(self, *, reference: bool, imu: bool, rejected: float = 0.0) -> NoiseFactors:
        """Return the factors, 1 for figures that were given and are not clearly too small.

        rejected: share of rejected updates; if it is large, a given figure need not be twice too small.
        """
        least = CONTRADICTION if rejected < FEW_REJECTED else _AGREEMENT

        def keep(f: float, *, given: bool) -> float:
            return f if not given or f > least else 1.0

        return NoiseFactors(
            keep(self.position, given=reference),
            keep(self.orientation, given=reference),
            keep(self.standstill, given=reference),
            keep(self.gyro, given=imu),
            keep(self.accel, given=imu),
        )


def noise_factors(problem: Problem, run: Fit) -> NoiseFactors:
    """Return the factors between observed noise and that assumed in a run over a problem.

    With coloured noise, innovations and residuals no longer show its size. The mean NIS is then used for both
    position and orientation.

    Notes
    -----
    Reference: the product of the innovation and the residual after the update has the variance of the measurement
    noise as its expectation (Desroziers, Berre, Chapnik and Poli 2005). Rejected updates count too: without them noise
    that is stated too small would confirm itself. IMU: the updates' corrections of attitude and velocity are compared
    with the variance the filter expected of them. The largest and smallest two per cent are left out.
    """
    history, excess, assumed = run.history, run.excess**0.5, problem.noise
    settled = np.arange(history.nis.size) >= history.nis.size // 10
    path = settled & ~history.at_standstill

    def reference(rows: slice) -> float:
        product = np.sum(history.innovation[path, rows] * history.residual[path, rows], axis=1)
        return excess * _trimmed_ratio(product, np.sum(history.noise_variance[path, rows], axis=1))

    def imu(rows: slice) -> float:
        used = path & history.used
        size = np.sum(history.correction[used, rows] ** 2, axis=1)
        return excess * _trimmed_ratio(size, np.sum(history.correction_variance[used, rows], axis=1))

    at_standstill = settled & history.at_standstill
    standstill = 1.0
    if at_standstill.sum() >= 6:
        ratio = run.excess * float(np.median(history.nis[at_standstill] / history.degrees[at_standstill]))
        standstill = float(np.sqrt(np.clip(ratio, 1.0, 1e3)))
    if assumed.correlation_time > 0.0 and (path & history.used).any():
        used = path & history.used
        position = orientation = excess * float(np.sqrt(mean_normalised(history.nis[used], history.degrees[used])))
    elif assumed.reference.stamp > 0.0 and path.sum() >= _FEWEST:
        stamps = assumed.stamp_deviations(problem.schedule.poses)
        found = pose_factors(history, path, (assumed.reference.position, assumed.reference.orientation), stamps)
        position, orientation = (excess * factor for factor in found)
    else:
        position, orientation = reference(slice(0, 3)), reference(slice(3, 6))
    return NoiseFactors(
        position=position,
        orientation=orientation,
        standstill=standstill,
        gyro=imu(slice(3, 6)),
        accel=imu(slice(0, 3)),
    )


def within_bounds(problem: Problem, factors: NoiseFactors) -> NoiseFactors:
    """Return the factors limited: densities within the problem's bounds, the reference's noise above its least."""
    limited = []
    for density, factor, (low, high) in zip(
        imu_density(problem), (factors.gyro, factors.accel), problem.noise.imu_bounds, strict=True
    ):
        limited.append(float(np.clip(density * factor, low, high)) / density)
    return replace(
        factors,
        gyro=limited[0],
        accel=limited[1],
        position=max(factors.position, problem.noise.min_reference[0] / problem.noise.reference.position),
        orientation=max(factors.orientation, problem.noise.min_reference[1] / problem.noise.reference.orientation),
    )


def _trimmed_ratio(observed: Array, assumed: Array) -> float:
    """Return the root of the mean ratio, without its largest and smallest two per cent; 1 where too few have one.

    A variance is zero where nothing was measured, or nothing is estimated.
    """
    known = np.isfinite(assumed) & (assumed > 0.0)
    if known.sum() < _FEWEST or not np.isfinite(observed).all():
        return 1.0
    ratio = np.sort(observed[known] / assumed[known])
    cut = max(1, ratio.size // 50)
    return float(np.sqrt(np.clip(np.mean(ratio[cut:-cut]), 1e-2, 1e4)))


def with_factors(problem: Problem, factors: NoiseFactors) -> Problem:
    """Return the problem with its noise figures multiplied by factors."""
    noise = problem.noise
    reference = noise.reference.scaled(
        position=factors.position, orientation=factors.orientation, standstill=factors.standstill
    )
    readings = problem.sensor.readings.with_noise(factors.gyro, factors.accel)
    return with_readings(replace(problem, noise=replace(noise, reference=reference)), readings)


def imu_density(problem: Problem) -> tuple[float, float]:
    """Return the assumed noise densities, gyro and accelerometer, rms over the axes, SI."""
    gyro, accel = np.sqrt(problem.sensor.readings.noise[:2].mean(axis=1))
    return float(gyro), float(accel)


def noise_ratios(before: Problem, after: Problem) -> list[float]:
    """Return the ratios between noise in two problems: reference in position and orientation, gyros, accelerometers."""
    found, stated = after.noise.reference, before.noise.reference
    densities = zip(imu_density(after), imu_density(before), strict=True)
    return [found.position / stated.position, found.orientation / stated.orientation, *(a / b for a, b in densities)]


def with_noise_of(first: Problem, problem: Problem) -> Problem:
    """Return a problem with the noise that was assumed at first; the very same if it has that."""
    same = problem.noise.reference == first.noise.reference
    if same and np.array_equal(problem.sensor.readings.noise, first.sensor.readings.noise):
        return problem
    noise = replace(problem.noise, reference=first.noise.reference)
    readings = replace(problem.sensor.readings, noise=first.sensor.readings.noise)
    return with_readings(replace(problem, noise=noise), readings)


def noise_warning(problem: Problem, *, given: bool) -> DataWarning:
    """Return the warning about noise figures that were found, or that replaced given ones."""
    noise = problem.noise.reference
    gyro, accel = imu_density(problem)
    figures = (
        f"reference {noise.position * 1e3:.3g} mm and {noise.orientation * 1e3:.3g} mrad on the path, "
        f"{noise.standstill_position * 1e3:.3g} mm and {noise.standstill_orientation * 1e3:.3g} mrad at standstill; "
        f"gyro {gyro:.3g} rad/s/sqrt(Hz), accelerometer {accel:.3g} m/s^2/sqrt(Hz)"
    )
    if given:
        return DataWarning("noise", f"given noise figures contradict the data; used instead: {figures}")
    return DataWarning("noise", f"found from the data: {figures}")
