"""Preparation of a recording for the filter: clocks, noise, standstill, start values, the robot."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from kreisel.errors import RecordingError, SynchronizationError
from kreisel.inertial.readings import Readings
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.robot_model import RobotModel
from kreisel.model.standstill import ImuStillness, OutsideStandstill, Standstill
from kreisel.preparation.accelerometer_fit import acceleration_windows, fit_accelerometers, joined
from kreisel.preparation.attitude import with_attitude
from kreisel.preparation.clock_stages import repaired
from kreisel.preparation.comparison import Comparison, compare
from kreisel.preparation.gravity import site_of
from kreisel.preparation.preparation import AccelerometerFit, Preparation
from kreisel.preparation.reference_noise import assumed_noise, with_measured_jitter
from kreisel.preparation.restarts import with_parts_in_place
from kreisel.preparation.robot_errors import robot_model
from kreisel.preparation.standstill_search import find_standstills, imu_stillness, may_be_held, standstill_outside
from kreisel.preparation.time_base import time_base_deviation, time_base_warning
from kreisel.preparation.warnings import (
    misstated_warnings,
    noisy_stamps_warning,
    overlap_warning,
    reference_warnings,
    repeated_warning,
    rounded_warning,
    standstill_warning,
    turning_warning,
)
from kreisel.recording.recording import NO_REFERENCE, DataWarning, Recording, ReferencePoses
from kreisel.synchronization.fits import RateFit
from kreisel.synchronization.stamp_errors import stamp_errors
from kreisel.tasks import Executor, sequential
from kreisel.validation.imu_checks import check_quantities

_TURNING = 5.0
"""Deviations by which the gyros at a standstill without poses may differ from their offset by the poses. Chosen: at 22
rests it was 3.1 at most, where the device turned by half a degree per second 36 or more."""

_ROUNDS_WITHOUT_ATTITUDE = 4
"""Rounds in which attitude and accelerometers are found in turn, from positions alone. Chosen: the lever arm of a round
improves the attitude of the next; these are start values, and a round takes up to eight chunks of the readings."""


def prepare_recording(
    recording: Recording, settings: CalibrationSettings, executor: Executor = sequential
) -> Preparation:
    """Return clocks, start values and noise of a recording; `executor` runs what does not depend on each other.

    Raises
    ------
    SynchronizationError, RecordingError
        If reference and IMU do not belong together, or there is no reference.
    """
    reference = recording.reference
    if reference is None:
        known = "".join(f"; {one.message}" for one in recording.warnings if one.subject == NO_REFERENCE)
        raise RecordingError(
            "has no reference poses; `kreisel calibrate` needs pose0/data.csv or another reference next to imu0; "
            f"`kreisel static` does without, by standstills in many attitudes{known}",
            file=recording.path,
        )
    check_quantities(recording.imu)
    recording, of_restarts = with_parts_in_place(recording, reference)
    compared = repaired(compare(recording, reference, executor))
    recording, reference, fit = compared.recording, compared.reference, compared.fit
    site, of_site = site_of(recording.settings.site)
    stillness, stamps = executor(
        [
            partial(imu_stillness, recording.imu, held=may_be_held(recording)),
            partial(stamp_errors, compared.readings, reference, fit),
        ]
    )
    assumed = assumed_noise(recording.settings.reference, recording.reference_kind, reference)
    assumed = replace(assumed, stamp=max(assumed.stamp, stamps.deviation))
    standstills = find_standstills(stillness, reference, fit.clock, assumed)
    outside, of_outside = _outside(compared, stillness)
    robot, of_robot = _robot(recording, reference, settings)
    return Preparation(
        recording=recording,
        reference=reference,
        site=site,
        imu_noise=compared.imu_noise,
        noise=with_measured_jitter(assumed, reference, standstills, fit.clock),
        readings=compared.readings,
        correlation=compared.correlation,
        rate_fit=fit,
        accelerometer_fit=_accelerometers(compared.readings, fit, reference, site.gravity, standstills),
        stillness=stillness,
        standstills=standstills,
        outside_standstill=outside,
        robot=robot,
        wrong_stamps=stamps.wrong,
        warnings=(
            *of_restarts,
            *compared.warnings,
            *repeated_warning(compared.correlation.periods),
            *time_base_warning(recording, fit.clock),
            *reference_warnings(reference),
            *overlap_warning(float(recording.imu.seconds[-1]), reference, fit.clock),
            *of_site,
            *of_outside,
            *rounded_warning(reference),
            *noisy_stamps_warning(stamps),
            *misstated_warnings(compared.imu_noise),
            *of_robot,
        ),
        time_base_sd=time_base_deviation(recording, fit.clock),
    )


def _outside(compared: Comparison, stillness: ImuStillness) -> tuple[OutsideStandstill | None, list[DataWarning]]:
    """Return the standstill outside the reference's time, and the warning about it.

    Whoever turns steadily is as still as at rest by the IMU alone; the poses show the difference.
    """
    imu, fit = compared.recording.imu, compared.fit
    outside = standstill_outside(imu, stillness, compared.reference, fit.clock)
    if outside is None:
        return None, []
    if compared.reference.quaternions is None:
        return outside, [standstill_warning(outside)]
    away = outside.rate + fit.k_w0
    if np.max(np.abs(away) / np.hypot(fit.k_w0_sd, outside.deviation(compared.imu_noise.gyro))) < _TURNING:
        return outside, [standstill_warning(outside)]
    return None, [turning_warning(outside, away)]


def _robot(
    recording: Recording, reference: ReferencePoses, settings: CalibrationSettings
) -> tuple[RobotModel | None, list[DataWarning]]:
    """Return the arm whose errors are estimated, and the warnings about it."""
    if "robot_placement" in settings.fixed:
        return None, []
    by_arm = recording.reference_kind == "robot"
    return robot_model(recording.settings.robot, recording.urdf, recording.joints, reference, arm=by_arm)


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
