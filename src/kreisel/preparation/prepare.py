"""Preparation of a recording for the filter: clocks, noise, standstill, start values, the robot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from kreisel.errors import RecordingError, SynchronizationError
from kreisel.geometry.rotation import Mask
from kreisel.inertial.readings import Readings
from kreisel.model.noise import ReferenceNoise
from kreisel.model.settings import CalibrationSettings
from kreisel.model.standstill import OutsideStandstill, Standstill
from kreisel.preparation.accelerometer_fit import acceleration_windows, fit_accelerometers, joined
from kreisel.preparation.attitude import with_attitude
from kreisel.preparation.gravity import site_of
from kreisel.preparation.imu_noise import imu_noise_of, readings_of
from kreisel.preparation.preparation import AccelerometerFit, ImuNoise, Preparation
from kreisel.preparation.reference_noise import assumed_noise, with_measured_jitter
from kreisel.preparation.restarts import with_parts_in_place
from kreisel.preparation.robot import robot_model
from kreisel.preparation.standstill import find_standstills, imu_stillness, standstill_outside
from kreisel.preparation.time_base import on_reference_clock, time_base_deviation, time_base_warning
from kreisel.progress import Together, one_by_one
from kreisel.recording.recording import DataWarning, ImuSamples, Recording, ReferencePoses
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.clock_jump import ClockJump, find_clock_jump
from kreisel.synchronization.conventions import check_conventions
from kreisel.synchronization.correlation import correlate, quietest_second
from kreisel.synchronization.lost_samples import find_lost_samples
from kreisel.synchronization.rate_fit import fit_rates
from kreisel.synchronization.results import Correlation, RateFit

_MIN_COMMON_SHARE = 0.7
_ROUNDS_WITHOUT_ATTITUDE = 4
_ROUNDS_OF_LOSSES = 3

_LEAST_SURE = 0.3
"""Share of the poses that must not depend on where samples were lost."""

_BURST, _MOST_IN_BURST = 0.5, 6
"""s, and samples lost in that time: of more of them it is not known how they lie."""

_MOST_LOST = 0.007
"""Share of the samples that may be put back: more of them explain a clock of any rate."""

_EQUAL_RATES = 3e-4
"""Difference of two clocks that a crystal may have."""


def prepare_recording(
    recording: Recording, settings: CalibrationSettings, together: Together = one_by_one
) -> Preparation:
    """Return clocks, start values and noise of a recording; `together` does what does not depend on each other.

    Raises
    ------
    SynchronizationError, RecordingError
        If reference and IMU do not belong together, or there is no reference.
    """
    imu, reference = recording.imu, recording.reference
    if reference is None:
        raise RecordingError(
            "has no reference poses; `kreisel calibrate` needs pose0/data.csv or another reference next to imu0",
            file=recording.path,
        )
    set_clock: list[DataWarning] = []
    if imu.restarts_ns.size:
        recording, set_clock = with_parts_in_place(recording, reference, imu_noise_of(recording))
        imu = recording.imu
    imu_noise, correlation = together([partial(imu_noise_of, recording), partial(correlate, imu, reference)])
    readings, fit = _fitted(recording, reference, imu_noise, correlation, together)
    mended = _without_losses(recording, reference, imu_noise, readings, fit, together)
    if mended is not None:
        recording, correlation, readings, fit = mended.recording, mended.correlation, mended.readings, mended.fit
        imu, reference = recording.imu, mended.reference
    jump: ClockJump | None = None
    while mended is None and (further := find_clock_jump(readings, reference, fit)) is not None:
        if jump is not None and not jump.is_near(further):
            break  # more than one
        jump = further if jump is None else jump.and_further(further)
        recording, reference = _without_jump(recording, reference, further, fit)
        imu = recording.imu
        correlation, readings, fit = _compared(recording, reference, imu_noise, together)
    if recording.settings.imu.time_base == "reference" and fit.skewed:
        recording = on_reference_clock(recording, fit.clock)
        imu = recording.imu
        correlation, readings, fit = _compared(recording, reference, imu_noise, together)
    site, of_site = site_of(recording)
    noise, stillness = assumed_noise(recording, reference), imu_stillness(imu)
    standstills = find_standstills(stillness, reference, fit.clock, noise)
    accelerometers = _accelerometers(readings, fit, reference, site.gravity, standstills)
    noise = with_measured_jitter(noise, reference, standstills, fit.clock)
    outside = standstill_outside(imu, stillness, reference, fit.clock)
    robot, of_robot = (None, []) if "robot_placement" in settings.fixed else robot_model(recording, reference)
    warnings = (
        *set_clock,
        *(mended.warnings if mended is not None else ()),
        *([] if jump is None else [jump.warning()]),
        *time_base_warning(recording, fit.clock),
        *_reference_warnings(reference),
        *_overlap_warning(imu, reference, fit.clock),
        *of_site,
        *_standstill_warning(outside),
        *_stamp_warning(noise),
        *_misstated_warnings(imu_noise),
        *of_robot,
    )
    return Preparation(
        recording, reference, site, imu_noise, noise, readings, correlation, fit, accelerometers, stillness,
        standstills, outside, robot, warnings, time_base_deviation(recording, fit.clock),
    )  # fmt: skip


def _fitted(
    recording: Recording, reference: ReferencePoses, noise: ImuNoise, correlation: Correlation, together: Together
) -> tuple[Readings, RateFit]:
    """Return the readings, and the fit of the gyros and clocks to the reference."""
    readings = readings_of(recording, noise)
    _, fit = together(
        [
            partial(check_conventions, readings, reference, correlation.clock),
            partial(_rates, readings, recording.imu, reference, correlation.clock),
        ]
    )
    return readings, fit


def _compared(
    recording: Recording, reference: ReferencePoses, noise: ImuNoise, together: Together
) -> tuple[Correlation, Readings, RateFit]:
    """Return correlation, readings and fit of a recording whose stamps have changed."""
    correlation = correlate(recording.imu, reference)
    return correlation, *_fitted(recording, reference, noise, correlation, together)


@dataclass(frozen=True)
class _Mended:
    """A recording with lost samples put back, and what follows from it."""

    recording: Recording
    reference: ReferencePoses
    correlation: Correlation
    readings: Readings
    fit: RateFit
    warnings: tuple[DataWarning, ...]


def _without_losses(
    recording: Recording, reference: ReferencePoses, noise: ImuNoise, readings: Readings, fit: RateFit,
    together: Together,
) -> _Mended | None:  # fmt: skip
    """Return the recording with later stamps after samples that were lost without a gap; None if there are none.

    If the clocks do not run at equal rates afterwards, something else is wrong with them.
    """
    imu, found = recording.imu, None
    sure = np.ones(reference.stamps_ns.size, dtype=bool)
    for _ in range(_ROUNDS_OF_LOSSES):
        missing = find_lost_samples(imu, readings, reference, fit)
        if missing is None:
            break
        if missing.most_within(_BURST) > _MOST_IN_BURST:
            return None
        warnings = (missing.warning(imu),) if found is None else found.warnings
        imu = missing.put_back(imu)
        sure &= missing.sure_poses(reference)
        correlation, readings, fit = _compared(replace(recording, imu=imu), reference, noise, together)
        found = _Mended(replace(recording, imu=imu), reference, correlation, readings, fit, warnings)
    if found is None or abs(found.fit.clock.skew) > _EQUAL_RATES + 3.0 * found.fit.clock.skew_sd:
        return None
    share = 1.0 - recording.imu.stamps_ns.size / (1.0 + float(imu.seconds[-1]) / imu.interval)
    if np.mean(sure) < _LEAST_SURE or share > _MOST_LOST:
        return None
    broken = replace(recording, imu=_broken_behind(imu, reference, found.fit.clock, ~sure))
    reference = replace(reference, doubtful=~sure)
    return replace(found, recording=broken, reference=reference, readings=readings_of(broken, noise))


def _without_jump(
    recording: Recording, reference: ReferencePoses, jump: ClockJump, fit: RateFit
) -> tuple[Recording, ReferencePoses]:
    """Return recording and reference without a jump of the clocks."""
    moved, joints = jump.taken_out(reference), recording.joints
    imu = _broken_behind(recording.imu, moved, fit.clock, jump.is_beside(moved))
    return replace(
        recording,
        imu=replace(imu, placed_sd=jump.size_sd),
        joints=None if joints is None else jump.taken_out_of_joints(joints, int(reference.stamps_ns[0])),
    ), moved


def _broken_behind(imu: ImuSamples, reference: ReferencePoses, clock: Clock, doubtful: Mask) -> ImuSamples:
    """Return the readings with a new start of navigation after doubtful poses.

    The rotation in between depends on when samples were lost, or a clock jumped: it must not be compared with the
    reference's.
    """
    ends = np.flatnonzero(doubtful & ~np.append(doubtful[1:], False))
    after = imu.stamps_ns[0] + np.round(1e9 * clock.imu_time(reference.seconds[ends])).astype(np.int64)
    return replace(imu, broken_ns=np.unique(np.concatenate([imu.broken_ns, after])))


def _reference_warnings(reference: ReferencePoses) -> list[DataWarning]:
    if reference.quaternions is None:
        return [DataWarning("reference", "positions only: the axes of b are the gyros' axes, made orthogonal")]
    if reference.positions is None:
        message = "orientations only: the accelerometers are calibrated by standstills and the motion between them"
        return [DataWarning("reference", message)]
    return []


def _overlap_warning(imu: ImuSamples, reference: ReferencePoses, clock: Clock) -> list[DataWarning]:
    """Return the warning that the two have little time in common, e.g. if one started late or its clock jumped."""
    first, last = clock.imu_time(reference.seconds[[0, -1]])
    end = float(imu.seconds[-1])
    common, shorter = min(float(last), end) - max(float(first), 0.0), min(float(last - first), end)
    if common > _MIN_COMMON_SHARE * shorter:
        return []
    message = (
        f"IMU and reference have {common:.1f} s in common, of {end:.1f} s and {last - first:.1f} s; "
        "only this time is used"
    )
    return [DataWarning("overlap", message)]


def _standstill_warning(outside: OutsideStandstill | None) -> list[DataWarning]:
    if outside is None:
        return []
    message = f"{outside.seconds:.1f} s of standstill without reference used for the gyro offset's start value"
    return [DataWarning("standstill", message)]


def _misstated_warnings(noise: ImuNoise) -> list[DataWarning]:
    return [
        DataWarning(
            "noise",
            f"at rest the {sensors} are {ratio:.1f} times as noisy as stated: this is not the device that "
            "recording.toml describes, and nothing it states of them is used (imu.grade, imu.…_noise_density, "
            "imu.…_offset_sd)",
        )
        for sensors, ratio in noise.misstated.items()
    ] + [
        DataWarning(
            "noise",
            f"at rest the {sensors} are {ratio:.1f} times as noisy as stated, and their noise at rest is used: if "
            "imu.grade or imu.…_noise_density are not of this device, leave them out; a grade also states how large "
            "its offsets are",
        )
        for sensors, ratio in noise.doubtful.items()
    ]


def _stamp_warning(noise: ReferenceNoise) -> list[DataWarning]:
    if noise.stamp == 0.0:
        return []
    step = noise.stamp * 12**0.5 * 1e3
    message = f"the reference's stamps are rounded to {step:.0f} ms; this is treated as noise along the motion"
    return [DataWarning("stamps", message)]


def _accelerometers(
    readings: Readings, fit: RateFit, reference: ReferencePoses, gravity: float, standstills: tuple[Standstill, ...]
) -> AccelerometerFit:
    """Return the start values of the accelerometers."""
    positions = reference.positions is not None
    if not positions and reference.quaternions is None:
        raise RecordingError("holds neither positions nor orientations", file=reference.source)
    within = fit.clock.imu_time(reference.seconds[[0, -1]])
    intervals = [(standstill.start, standstill.stop) for standstill in standstills]
    found = None
    # without orientations, attitude and accelerometers depend on each other
    for _ in range(_ROUNDS_WITHOUT_ATTITUDE if reference.quaternions is None else 1):
        windows = [
            acceleration_windows(signal, fit, tau, q, p, intervals)
            for signal, tau, p, q in with_attitude(readings.excerpt(*within), fit, reference, found)
        ]
        if not windows:
            raise SynchronizationError(
                f"{reference.source}: too few poses where IMU and reference overlap; record both all the time"
            )
        found = fit_accelerometers(joined(windows), fit, gravity, positions=positions)
    assert found is not None  # noqa: S101 - for the type checker; the loop runs at least once
    return found


def _rates(readings: Readings, imu: ImuSamples, reference: ReferencePoses, clock: Clock) -> RateFit:
    if reference.quaternions is None:
        return _rates_without_attitude(imu, reference, clock)
    return fit_rates(readings, reference.seconds, reference.quaternions, clock)


def _rates_without_attitude(imu: ImuSamples, reference: ReferencePoses, clock: Clock) -> RateFit:
    """Return what is known of the gyros without attitudes: their mean in the quietest second."""
    still = quietest_second(imu)
    return RateFit(
        K_omega=np.eye(3),
        k_w0=-imu.rates[still].mean(axis=0),
        clock=clock,
        skewed=abs(clock.skew) > 4.0 * clock.skew_sd or clock.skew_sd * float(reference.seconds[-1]) > 5e-3,
        explained=float("nan"),
        residual_sd=float("nan"),
        K_omega_sd=np.full((3, 3), 0.0025),
        k_w0_sd=np.full(3, 1e-3),
    )
