"""Where the IMUs of an array lie against each other, from a recording without a reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kreisel.array.array_fit import ArrayFit, fit_array
from kreisel.array.array_outcome import ArrayMember, ArrayOutcome
from kreisel.array.contrary_forces import CONTRARY, contrary_forces
from kreisel.array.hand_motion import HandMotion, hand_motion, matrix_deviation
from kreisel.array.left_out import check_copy, in_words, reason_of
from kreisel.array.mean_imu import MIN_EXPLAINED
from kreisel.array.relative_pose import RelativePose
from kreisel.array.resampled import clipped_samples, resampled
from kreisel.array.sudden_slide import sudden_slide
from kreisel.array.unit_clock import BASES, clock_of
from kreisel.calibration.result import Calibration
from kreisel.errors import KreiselError, RecordingError, SynchronizationError
from kreisel.geometry.rotation import Array, lengths, nearest_rotation
from kreisel.inertial.noise_figures import high_frequency_density
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.progress import Progress
from kreisel.recording.recording import ImuSamples, Recording
from kreisel.static.rest_search import find_rests
from kreisel.static.static_result import calibrate_static
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.correlation import quietest_second
from kreisel.validation.imu_checks import check_dead

_UNKNOWN_MATRIX = 1e-2
"""Deviation of the entries of a gyro matrix that nothing was found of: that of usual devices."""

_NOT_LINEAR, _INEXPENSIVE = 1e-3, 1e-5
"""Share by which quick rates of inexpensive gyros err in common, against the slow turns that calibrate them, and the
noise density, rad/s/sqrt(Hz), from which gyros count as such. Chosen: data sheets of consumer gyros state a largest
deviation from a line of 0.1 to 0.2 % of the range; its rms is about half of that."""

_FEWEST_RESTS = 4
"""Standstills by which axes are compared. Chosen: three would leave no scatter to judge by."""

_CLIPPED_SHARE = 0.9995
"""Share of the largest reading from which a sample counts as clipped, where some are."""


_AHEAD = 2e-3
"""s; delays of accelerometers that differ by more are taken out of the readings. Chosen: 20 ms bent positions by a
millimetre, with its square."""


def locate(
    read: Callable[[str], Recording], names: Sequence[str], progress: Progress | None = None
) -> ArrayOutcome:  # fmt: skip
    """Return where the IMUs of a recording lie against the first one with which another one moves.

    Parameters
    ----------
    read
        Returns the recording with the readings of one IMU; see `unit_readings.unit_reader`.

    Raises
    ------
    KreiselError
        If there are no two IMUs that move together, or too little motion.
    """
    found, left_out = _together(read, names)
    members, sensors = [], []
    for k, (name, (recording, _)) in enumerate(found.items()):
        if progress is not None:
            progress("calibrate by standstills", k / len(found))
        members.append(_member(name, recording))
        sensors.append(_sensors(members[-1], recording.imu))
    recordings, clocks = zip(*found.values(), strict=True)
    imus = [recording.imu for recording in recordings]
    if progress is not None:
        progress("estimate positions", 0.5)
    motion = hand_motion(imus, sensors, clocks, [~_clipped(imu) for imu in imus])
    faulty = _faulty(motion, [member.name for member in members], recordings[0])
    if faulty:
        left_out |= faulty
        rest = locate(read, [name for name in names if name not in left_out], progress)
        return replace(rest, left_out=(*left_out.items(), *rest.left_out))
    fit = _fitted(members, imus, motion)
    ahead = np.where(np.abs(fit.ahead) > _AHEAD, fit.ahead, 0.0)
    if ahead.any():  # readings are linear in small delays alone
        imus = [_at_once(imu, own) for imu, own in zip(imus, ahead, strict=True)]
        motion = hand_motion(imus, sensors, clocks, [~_clipped(imu) for imu in imus])
        fit = _fitted(members, imus, motion)
        fit = replace(fit, ahead=fit.ahead + ahead)
    return _concluded(recordings[0], members, imus, motion, fit, tuple(left_out.items()))


def _faulty(motion: HandMotion, names: Sequence[str], recording: Recording) -> dict[str, str]:
    """Return the IMUs that are no part of one body, and why; the first ones that are found.

    Raises
    ------
    RecordingError
        If it is not clear which of them are.
    """
    if motion.change is not None:
        found = {names[motion.change.number]: motion.change.text}
    else:
        contrary = contrary_forces(motion)
        if contrary is None:
            raise RecordingError(f"{' and '.join(names)}: of one of them, {CONTRARY}", file=recording.path)
        found = {names[k]: CONTRARY for k in contrary}
        slide = None if found else sudden_slide(motion)
        found |= {} if slide is None else {names[slide.number]: slide.text}
    if found and len(names) - len(found) < 2:
        raise RecordingError(in_words(found), file=recording.path)
    return found


def _at_once(imu: ImuSamples, ahead: float) -> ImuSamples:
    """Return readings whose accelerometers are no longer ahead of the gyros by a time, s."""
    seen = resampled(imu, Clock(ahead), imu.seconds)
    return replace(imu, accelerations=np.where(seen.known[:, None], seen.forces, imu.accelerations))


def _together(
    read: Callable[[str], Recording], names: Sequence[str]
) -> tuple[dict[str, tuple[Recording, Clock]], dict[str, str]]:
    """Return the recordings of IMUs that move together, with their clocks against the first, and why others do not.

    Raises
    ------
    KreiselError
        If no other IMU moves with one of the first few.
    """
    errors: list[KreiselError] = []
    for k, first in enumerate(names[: max(1, min(BASES, len(names) - 1))]):
        left_out: dict[str, str] = {}
        try:
            base = read(first)
            check_dead(base.imu)
        except KreiselError as error:
            errors.append(error)
            continue
        found = {first: (base, Clock(0.0))}
        for name in (*names[k + 1 :], *names[:k]):
            try:
                recording = read(name)
                check_copy(recording.imu, {other: of.imu for other, (of, _) in found.items()})
                clock = clock_of(recording.imu, base.imu, first)
                _check_turn(recording.imu, clock, base.imu, first)
                check_dead(recording.imu)
                found[name] = (recording, clock)
            except KreiselError as error:
                left_out[name] = reason_of(error)
        if len(found) > 1:
            return found, left_out
        reasons = in_words(left_out) or "there is one IMU only"
        errors.append(RecordingError(f"no two IMUs that move together: {reasons}", file=base.path))
    raise errors[0]


def _check_turn(imu: ImuSamples, clock: Clock, base: ImuSamples, name: str) -> None:
    """Check that an IMU's rates are those of the base, turned.

    Raises
    ------
    SynchronizationError
        If they are not: its columns are not those of a triad.
    """
    seen = resampled(imu, clock, base.seconds)
    own, other = (rates[seen.known] - rates[seen.known].mean(axis=0) for rates in (seen.rates, base.rates))
    left = other - own @ nearest_rotation(other.T @ own).T
    share = 1.0 - float(np.sum(left**2)) / max(float(np.sum(other**2)), 1e-300)
    if not share >= MIN_EXPLAINED:
        raise SynchronizationError(
            f"its rates are not those of {name}, turned: of one of the two a column is in another place, has another "
            "sign, or reads wrong"
        )


def _fitted(members: Sequence[ArrayMember], imus: Sequence[ImuSamples], motion: HandMotion) -> ArrayFit:
    """Return where the IMUs lie."""
    noise = high_frequency_density(imus[0].rates, imus[0].interval)
    common = _NOT_LINEAR if float(np.sqrt(np.mean(noise**2))) > _INEXPENSIVE else 0.0
    calibrations = [member.calibration for member in members]
    deviation = matrix_deviation(calibrations, _UNKNOWN_MATRIX, common)
    return fit_array(motion, deviation, [calibration is not None for calibration in calibrations])


def _concluded(
    base: Recording, members: Sequence[ArrayMember], imus: Sequence[ImuSamples], motion: HandMotion, fit: ArrayFit,
    left_out: tuple[tuple[str, str], ...],
) -> ArrayOutcome:  # fmt: skip
    poses, clocks = {}, {}
    turned = rest_rotations(members, imus, motion.clocks)
    for k, member in enumerate(members):
        if k:
            axes, covariance = fit.axes[k], fit.covariance[k]
            if k in turned:
                axes = turned[k][0]
                covariance = np.block([[covariance[:3, :3], np.zeros((3, 3))], [np.zeros((3, 3)), turned[k][1]]])
            poses[member.name] = RelativePose(fit.positions[k], axes, covariance)
            late = float(np.hypot(imus[0].lateness, imus[k].lateness))
            clocks[member.name] = replace(motion.clocks[k], start_sd=float(np.hypot(motion.clocks[k].start_sd, late)))
    begin = {member.name: int(imu.stamps_ns[0]) for member, imu in zip(members, imus, strict=True)}
    return ArrayOutcome(base, tuple(members), fit, motion.seconds.size, poses, clocks, begin, left_out)


def rest_rotations(
    members: Sequence[ArrayMember], imus: Sequence[ImuSamples], clocks: Sequence[Clock]
) -> dict[int, tuple[Array, Array]]:  # fmt: skip
    """Return rotations (3, 3) to the first IMU by forces at the standstills, with covariances (3, 3), rad^2.

    Of IMUs that were calibrated by them, by their number.
    """
    if members[0].calibration is None:
        return {}
    rests = find_rests(imus[0])
    spans = imus[0].seconds[rests.first], imus[0].seconds[rests.last - 1]
    of_base, out = _means(members[0].calibration, imus[0], *spans), {}
    for k, (member, imu, clock) in enumerate(zip(members, imus, clocks, strict=True)):
        if k == 0 or member.calibration is None:
            continue
        begin, end = (clock.reference_time(span) for span in spans)
        there = (begin >= imu.seconds[0]) & (end <= imu.seconds[-1])
        if int(there.sum()) < _FEWEST_RESTS:
            continue
        base, own = of_base[there], _means(member.calibration, imu, begin[there], end[there])
        C = nearest_rotation(base.T @ own)
        u = base / lengths(base)[:, None]
        left = (base - own @ C.T) / lengths(base)[:, None]
        variance = float(np.sum(left**2)) / (2.0 * len(u) - 3.0)
        information = len(u) * np.eye(3) - u.T @ u
        out[k] = (
            C,
            variance * np.linalg.inv(information) + _skewed(members[0].calibration) + _skewed(member.calibration),
        )
    return out


def _means(calibration: Calibration, imu: ImuSamples, begin: Array, end: Array) -> Array:
    """Return mean forces (M, 3) over intervals, corrected."""
    first, last = np.searchsorted(imu.seconds, begin), np.searchsorted(imu.seconds, end, side="right")
    raw = np.array([imu.accelerations[a:b].mean(axis=0) for a, b in zip(first, last, strict=True)])
    p = calibration.sensors
    return np.asarray((raw + p.k_a[0]) @ p.K_a.T)


def _skewed(calibration: Calibration) -> Array:
    """Return the covariance (3, 3) of a frame by the deviations of the angles between its accelerometers."""
    sd = calibration.sensor_sd.K_a
    return np.diag(np.square([sd[1, 2], sd[0, 2], sd[0, 1]]))


def _member(name: str, recording: Recording) -> ArrayMember:
    """Return an IMU with its calibration by standstills, if there are enough."""
    clipped = float(np.mean(_clipped(recording.imu)))
    try:
        outcome = calibrate_static(recording)
    except KreiselError as error:
        return ArrayMember(name, None, str(error), clipped, ())
    warm = tuple(str(warning) for warning in outcome.warnings if "warm" in str(warning))
    return ArrayMember(name, outcome.calibration, "", clipped, warm)


def _sensors(member: ArrayMember, imu: ImuSamples) -> SensorParameters:
    """Return the parameters that an IMU's readings are corrected by."""
    if member.calibration is not None:
        return member.calibration.sensors
    offset = np.zeros((1, 3))
    offset[0] = -np.median(imu.rates[quietest_second(imu)], axis=0)
    return SensorParameters(np.eye(3), offset, np.eye(3), np.zeros((1, 3)), np.zeros((3, 3)))


def _clipped(imu: ImuSamples) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return which samples (n,) of an IMU have an axis at the end of its range, where some are."""
    out = np.zeros(imu.stamps_ns.size, dtype=bool)
    for column in np.hstack([imu.rates, imu.accelerations]).T:
        if clipped_samples(column[:, None]).any():
            out |= np.abs(column) >= _CLIPPED_SHARE * np.abs(column).max()
    return out
