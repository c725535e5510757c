"""Checks of each stream of a recording by itself; each fault has its message, with file and line.

Faults that only a comparison of reference and IMU shows (units, conventions, poses of another run) are checked
in `synchronization` and in `preparation.plausibility`.
"""

from __future__ import annotations

from dataclasses import replace

from kreisel.recording.digest import digest
from kreisel.recording.recording import Recording
from kreisel.validation.accumulated_readings import with_lost_samples
from kreisel.validation.alternating_rows import check_alternating
from kreisel.validation.as_sampled import after_repeats, as_sampled
from kreisel.validation.empty_rows import without_missing
from kreisel.validation.filled_rows import without_filled
from kreisel.validation.imu_checks import check_imu, check_readings
from kreisel.validation.joint_checks import check_joints, joint_stamp_warnings, joints_in_radians
from kreisel.validation.ordering import in_order
from kreisel.validation.pose_checks import check_poses, stamped_poses
from kreisel.validation.repeated_rows import without_repeated
from kreisel.validation.sampling import evenly_stamped, with_lateness, with_restarts
from kreisel.validation.stamp_checks import (
    LONG_GAP,
    MIN_SECONDS,
    Stamped,
    check_duration,
    check_rate,
    check_stamps,
    gap_warnings,
    gaps,
)
from kreisel.validation.written_numbers import check_written

__all__ = ["LONG_GAP", "MIN_SECONDS", "check_streams", "gaps"]


def check_streams(recording: Recording, *, moved: bool | None = None) -> Recording:
    """Return the recording with warnings added, in order, quaternions of unit length, without empty and repeated rows.

    Parameters
    ----------
    moved
        Whether the IMU was moved; None if that is known by a reference alone.

    Raises
    ------
    RecordingError
        For the first fault that would make results wrong.
    """
    recording = recording if recording.sha256 else replace(recording, sha256=digest(recording))
    recording = in_order(without_repeated(without_missing(recording)))
    moved = recording.reference is not None if moved is None else moved
    check_readings(recording.imu)
    imu, filled = without_filled(with_restarts(recording.imu, moved=moved))
    imu, sampling = as_sampled(imu)
    reference, joints = recording.reference, recording.joints
    check_stamps(imu, "IMU")
    stamped = Stamped(imu.stamps_ns, imu.source, "samples", 5.0, 20e3, imu.units.time)
    check_rate(stamped, None if reference is None else stamped_poses(reference))
    check_duration(stamped)
    imu, accumulated = with_lost_samples(imu)
    warnings = filled + sampling + accumulated + gap_warnings(imu, LONG_GAP)
    check_written(imu)
    check_alternating(imu)
    imu, found = check_imu(imu, moved=moved)
    warnings += found
    if any(warning.subject == "repeats" for warning in found):
        imu, sampling = after_repeats(imu)
        warnings += sampling
    if joints is not None:
        check_joints(joints)
    if reference is not None and joints is None:  # joint angles have the stamps of the poses
        reference, found = evenly_stamped(reference, by_arm=recording.reference_kind == "robot")
        warnings += found
    if reference is not None:
        reference, found = check_poses(reference, replace(stamped, stamps=imu.stamps_ns))
        reference, rounded = with_lateness(reference)
        warnings += found + rounded
    if joints is not None:
        joints, found = joints_in_radians(joints, recording.urdf, recording.settings.robot.tcp, reference)
        warnings += found
        if reference is not None:
            warnings += joint_stamp_warnings(joints, reference)
    # rows of the files are named by the checks alone
    imu = replace(imu, rows=None)
    reference = None if reference is None else replace(reference, rows=None)
    joints = None if joints is None else replace(joints, rows=None)
    return replace(recording, imu=imu, reference=reference, joints=joints).with_warnings(*warnings)
