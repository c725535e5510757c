"""Faults that are visible in the start values: wrong units, mirrored triads, clocks that drift, a motion too poor."""

from __future__ import annotations

import numpy as np

from kreisel.errors import ExcitationError, RecordingError, SynchronizationError
from kreisel.geometry.rotation import Array, lengths
from kreisel.preparation.acceleration_check import AccelerationFit, fit_accelerations
from kreisel.preparation.axis_order import LEFT_HANDED_GYROS, disorder, turn_between
from kreisel.preparation.preparation import Preparation
from kreisel.preparation.reference_noise import stamp_resolution
from kreisel.preparation.turning_axes import turns
from kreisel.recording.location import header_fault, wrong_unit
from kreisel.recording.recording import ReferencePoses
from kreisel.synchronization.clock import MAX_SKEW
from kreisel.synchronization.conventions import better_reading

MAX_SENSITIVITY_SD = 0.15
"""Standard deviation of a gyro's sensitivity above which the motion is too poor."""

MIN_SENSITIVITY = 0.02
"""Minimum singular value of the gyros' cross-coupling matrix; zero means an axis without rotation."""

LITTLE_ROTATION = 0.1
"""Rotation about one axis, in that about the others, at which noise may hide the sensitivity of a gyro."""

MIN_AGREEMENT = 0.6
"""Agreement of the predicted accelerations and those of the positions; 0 for unrelated ones."""

MIN_ACCELERATION = 0.08
"""m/s^2; standard deviation of accelerations below which the agreement has no meaning."""

_FULL, _REMOVED = 0.8, 0.3
"""g; median length of readings up to which gravity may be missing, and least length of their mean in the reference's
frame. Chosen: with gravity the mean was 0.99 to 1.13 in nine recordings, without it 0.01 in one."""

MAX_CLOCK_DRIFT = 0.02
"""Seconds by which the clocks of a part of a recording may depart from their common relation, beyond uncertainty.
Chosen: clocks that drift or jump by up to 50 ms were calibrated right in three cells; more is lost samples."""

MAX_SCALE = 1.06
"""Largest accepted factor between the motion by the positions and by the accelerometers, scaled by gravity."""

_LENGTHS = {"mm": 1e3, "cm": 100.0, "in": 39.37, "ft": 3.281, "km": 1e-3}
"""Numbers of a metre in other units, by definition: an inch is 25.4 mm, a foot 304.8 mm. A unit is named that fits
within 25 %, so that four digits are enough."""

_RATES = {"deg s^-1": 57.2958, "mdps": 57295.8, "deg/h": 206265.0, "rad s^-1": 1.0 / 57.2958}
"""Numbers of a rate in other units, over those in the unit assumed: 180 / pi; the last is of rates in rad/s that are
stated to be in deg/s. A unit is named that fits within 40 %."""


def check_start_values(preparation: Preparation) -> None:
    """Raise an error if the start values show wrong units, a mirrored triad or a motion that is too poor.

    Raises
    ------
    RecordingError, SynchronizationError, ExcitationError
        With the evidence and the remedy.
    """
    reference = preparation.reference
    if reference.quaternions is None:
        return
    _check_gyros(preparation)
    _check_clocks(preparation)
    if reference.positions is not None:
        _check_gravity(preparation)
        _check_accelerometers(preparation, fit_accelerations(preparation))


def _check_gravity(preparation: Preparation) -> None:
    """Raise an error if gravity was taken out of the readings: in the reference's frame their mean is then zero.

    Of other axes, or another attitude, the mean is small, too, but not the readings.
    """
    imu, windows = preparation.recording.imu, preparation.accelerometer_fit.windows
    if not len(windows.regressor):
        return
    mean = (windows.regressor[:, :, :9] @ preparation.rate_fit.K_omega.ravel()).mean(axis=0)
    share = float(np.linalg.norm(mean)) / preparation.site.gravity
    if share < _REMOVED and np.median(lengths(imu.accelerations)) < _FULL * preparation.site.gravity:
        raise header_fault(
            imu.source,
            f"rotated by the orientations, the accelerometers' readings have a mean of {share:.2g} g, expected 1: was "
            "gravity removed (linear acceleration)? Raw readings are needed",
        )


def _check_gyros(preparation: Preparation) -> None:
    imu, fit = preparation.recording.imu, preparation.rate_fit
    source = imu.source
    size = float(np.cbrt(abs(np.linalg.det(fit.K_omega))))
    for unit, factor in _RATES.items():
        if 0.7 < size * factor < 1.4 and (factor > 1.0 or imu.units.rate is not None):
            evidence = f"the gyros read {1.0 / size:.3g} times the reference's rates"
            raise wrong_unit(imu, evidence, "rate", 1.0 / factor, unit)
    interval = imu.interval
    if 0.7 < size * interval < 1.4:
        raise header_fault(
            source,
            f"the gyros read {1.0 / size:.3g} times the reference's rates: they look like angles per sample; "
            f"divide them by the interval of {interval:.4g} s",
        )
    _check_units_of_axes(preparation)
    uncertainty = fit.K_omega_sd.max(axis=0)
    _, singular, axes = np.linalg.svd(fit.K_omega)
    if uncertainty.max() > MAX_SENSITIVITY_SD or singular[-1] < MIN_SENSITIVITY < singular[0] < 2.5:
        axis = "xyz"[int(np.argmax(uncertainty if uncertainty.max() > MAX_SENSITIVITY_SD else np.abs(axes[-1])))]
        raise ExcitationError(
            f"{preparation.reference.source}: the motion is too poor: it determines the sensitivity of the gyro "
            f"w_{axis} to {100 * max(uncertainty.max(), 1.0 - singular[-1]):.0f} % only, expected "
            f"{100 * MAX_SENSITIVITY_SD:.0f} % or better. Turn about all three axes"
        )
    if not 0.4 < singular[-1] <= singular[0] < 2.5:
        _check_turned(preparation.reference, fit.K_omega)
        raise header_fault(
            source,
            f"gyro readings and the reference's rates differ by factors of {1 / singular[0]:.3g} to "
            f"{1 / max(singular[-1], 1e-9):.3g}, expected near 1: check the unit of the gyros; different "
            "factors indicate poses of another run, or a gyro that does not work",
        )
    if np.linalg.det(fit.K_omega) < 0.0:
        raise header_fault(source, LEFT_HANDED_GYROS)


def _check_units_of_axes(preparation: Preparation) -> None:
    """Raise an error if one or two gyros are in another unit than the others."""
    fit, source = preparation.rate_fit, preparation.recording.imu.source
    size, sd = lengths(fit.K_omega.T), lengths(fit.K_omega_sd.T)
    right = (size > 0.7) & (size < 1.4)
    for unit, factor in _RATES.items():
        other = (size * factor > 0.7) & (size * factor < 1.4) & (sd * factor < MAX_SENSITIVITY_SD)
        if right.any() and other.any() and (right | other).all() and not (right & other).any():
            names = " and ".join(f"w_{axis}" for axis in np.array(list("xyz"))[other])
            raise header_fault(
                source,
                f"the gyros {names} read {factor:.3g} times the reference's rates, the others do not: they look like "
                f"{unit}; convert all to one unit",
            )


def _check_turned(reference: ReferencePoses, K_omega: Array) -> None:
    """Raise an error if the body hardly turned about the axis that the gyros show least: noise then decides."""
    across, _, axes = np.linalg.svd(K_omega)
    size = np.sqrt(np.mean((turns(reference) @ across) ** 2, axis=0))
    if size[2] < LITTLE_ROTATION * size.max():
        axis = "xyz"[int(np.argmax(np.abs(axes[-1])))]
        raise ExcitationError(
            f"{reference.source}: the motion is too poor: about the axis of the gyro w_{axis} the body rotated by "
            f"{100 * size[2] / size.max():.1f} % of what it rotated about others, which does not show its sensitivity. "
            "Turn about all three axes"
        )


def _check_clocks(preparation: Preparation) -> None:
    fit, source = preparation.rate_fit, preparation.reference.source
    # stamps rounded to a unit have errors of that size, and these are not random
    limit = max(MAX_CLOCK_DRIFT, 2.0 * stamp_resolution(preparation.reference))
    tau, shift, sd = fit.clock_drift.T
    known = (sd < 0.5 * limit) & np.isfinite(shift)
    off = shift - float(np.median(shift[known])) if known.sum() > 2 else np.zeros(shift.size)
    bad = np.isfinite(off) & (np.abs(off) > limit) & (np.abs(off) > 10.0 * sd)
    if bad.any():
        k = int(np.argmax(np.where(bad, np.abs(off), 0.0)))
        raise SynchronizationError(
            f"{source}: the clocks do not run evenly: {tau[k]:.0f} s after the first pose they are "
            f"{1e3 * off[k]:+.0f} ms (± {1e3 * sd[k]:.1f}) off the straight line through the whole recording. Samples "
            "were lost without a gap in their stamps, or a clock was set; split the recording there"
        )
    if abs(fit.clock.skew) > MAX_SKEW + 5.0 * fit.clock.skew_sd:
        raise SynchronizationError(
            f"{source}: the clocks of reference and IMU differ by {100 * fit.clock.skew:+.2f} %, expected 2 % at the "
            "most: look for lost samples, or stamps counted up at a wrong rate"
        )


def _check_accelerometers(preparation: Preparation, fit: AccelerationFit) -> None:
    reference = preparation.reference
    known = fit.K_a_sd.max() < 0.1 and fit.explained > 0.3 and fit.separable
    signs = (1.0,) if fit.signed else (1.0, -1.0)
    disorders = [_reversed(turn_between(preparation.rate_fit.K_omega, sign * fit.K_a)) for sign in signs]
    wrong = disorders[0] if known and None not in disorders else None
    about_a_point = not fit.separable
    agreed = fit.agreement > MIN_AGREEMENT or fit.size < MIN_ACCELERATION or about_a_point
    if wrong is not None or not agreed:
        reading = better_reading(preparation.readings, reference, preparation.rate_fit.clock)
        if reading is not None:
            raise RecordingError(
                "accelerations of the positions and of the IMU agree only if the quaternions are read "
                f"{reading}; correct the file; where its columns are mapped, the mapping",
                file=reference.source,
            )
    if wrong is not None:
        source = preparation.recording.imu.source
        raise header_fault(source, wrong)
    _check_lengths(reference, fit, arm=preparation.recording.joints is not None)
    if not agreed:
        raise RecordingError(
            "accelerations of the positions and of the IMU, rotated by the orientations, agree by "
            f"{100 * max(fit.agreement, 0.0):.0f} %, expected {100 * MIN_AGREEMENT:.0f} % or more: check that "
            "positions and orientations are of the same body, run and frame, and that all three accelerometers work",
            file=reference.source,
        )


def _reversed(F: Array) -> str | None:
    """Return what is wrong where all accelerometers have the opposite sign, otherwise what `disorder` says."""
    if np.trace(F) > -2.6:
        return disorder(F)
    return (
        "the accelerometers have the opposite sign of the reference. Where an axis that points upward reads -9.8 at "
        "standstill, they give gravity instead of specific force: change the sign of all three. Where it reads +9.8, "
        "the reference's frames are left-handed, as those of game engines are: change the signs of z, qx and qy"
    )


def _check_lengths(reference: ReferencePoses, fit: AccelerationFit, *, arm: bool) -> None:
    """Raise an error if the positions are in another unit than metres, by comparison with gravity.

    arm: whether the poses are of an arm with known joint angles.
    """
    low, high = fit.scale
    if (low < MAX_SCALE and high > 1.0 / MAX_SCALE) or fit.size < MIN_ACCELERATION:
        return
    scale = low if low >= MAX_SCALE else high
    evidence = f"the positions move {scale:.4g} times as far as the accelerometers measure"
    for unit, factor in _LENGTHS.items():
        if 0.8 < scale / factor < 1.25:
            raise wrong_unit(reference, evidence, "length", 1.0 / factor, unit)
    if arm:
        more = ", and the zeros of the arm's joints: one that is degrees off moves the tool so"
    else:
        more = (
            ", and whether a filter of the tracker is on: one that predicts from frame to frame exaggerates fast moves"
        )
    raise RecordingError(f"{evidence}, expected 1; check their unit and scale{more}", file=reference.source)
