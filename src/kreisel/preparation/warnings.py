"""Warnings about a prepared recording: what of it is not as a user would expect."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.model.standstill import OutsideStandstill
from kreisel.preparation.preparation import ImuNoise
from kreisel.preparation.reference_noise import stamp_resolution
from kreisel.recording.recording import DataWarning, ReferencePoses
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.stamp_errors import StampErrors
from kreisel.units import DEG

_MIN_COMMON_SHARE = 0.7
"""Share of the shorter of the two that IMU and reference have in common usually."""


def reference_warnings(reference: ReferencePoses) -> list[DataWarning]:
    """Return the warning that the reference has no orientations, or no positions."""
    if reference.quaternions is None:
        return [DataWarning("reference", "positions only: the axes of b are the gyros' axes, made orthogonal")]
    if reference.positions is None:
        message = "orientations only: the accelerometers are calibrated by standstills and the motion between them"
        return [DataWarning("reference", message)]
    return []


def overlap_warning(end: float, reference: ReferencePoses, clock: Clock) -> list[DataWarning]:
    """Return the warning that the two have little time in common, e.g. if one started late or its clock jumped.

    end: duration of the IMU's recording, s.
    """
    first, last = clock.imu_time(reference.seconds[[0, -1]])
    common, shorter = min(float(last), end) - max(float(first), 0.0), min(float(last - first), end)
    if common > _MIN_COMMON_SHARE * shorter:
        return []
    message = (
        f"IMU and reference have {common:.1f} s in common, of {end:.1f} s and {last - first:.1f} s; "
        "only this time is used"
    )
    return [DataWarning("overlap", message)]


def repeated_warning(periods: tuple[float, ...]) -> list[DataWarning]:
    """Return the warning that the clocks' offset is one of several. periods: shifts that fit as well, s."""
    if not periods:
        return []
    message = (
        f"the motion repeats itself, and the two clocks fit as well {abs(periods[0]):.4g} s earlier or later "
        f"({len(periods)} other offsets, up to {max(map(abs, periods)):.4g} s away): the deviation of the time offset "
        "contains them; sensors do not depend on it. Record both with stamps of one clock, or make a move once that is "
        "not repeated"
    )
    return [DataWarning("clocks", message)]


def standstill_warning(outside: OutsideStandstill) -> DataWarning:
    """Return the warning that a standstill without reference was used."""
    message = f"{outside.seconds:.1f} s of standstill without reference used for the gyro offset's start value"
    return DataWarning("standstill", message)


def turning_warning(outside: OutsideStandstill, away: Array) -> DataWarning:
    """Return the warning that gyros contradict a standstill. away: from their offset by the poses, rad/s (3,)."""
    message = (
        f"for {outside.seconds:.1f} s without poses the IMU seems to stand still, but its gyros read up to "
        f"{float(np.max(np.abs(away))) / DEG:.2g} deg/s more or less than at rest by the poses: it turned steadily, "
        "or their offsets changed, and this time is not used"
    )
    return DataWarning("standstill", message)


def misstated_warnings(noise: ImuNoise) -> list[DataWarning]:
    """Return the warnings that the IMU is noisier at rest than stated."""
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


def rounded_warning(reference: ReferencePoses) -> list[DataWarning]:
    """Return the warning that the reference's stamps are rounded."""
    step = stamp_resolution(reference)
    if step == 0.0:
        return []
    message = f"the reference's stamps are rounded to {1e3 * step:.0f} ms; this is treated as noise along the motion"
    return [DataWarning("stamps", message)]


def noisy_stamps_warning(found: StampErrors) -> list[DataWarning]:
    """Return the warning that the reference's stamps differ at random from when its poses were taken."""
    if found.deviation == 0.0:
        return []
    message = (
        f"by the gyros the reference's stamps are wrong by {1e3 * found.deviation:.2g} ms at random; this is treated "
        "as noise along the motion"
    )
    return [DataWarning("stamps", message)]
