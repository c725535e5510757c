"""Checks of each stream of a recording by itself; each fault has its message, with file and line.

Faults that only a comparison of reference and IMU shows (units, conventions, poses of another run) are checked
in `synchronization` and in `preparation.plausibility`.
"""

from __future__ import annotations

from dataclasses import replace

from kreisel.recording.digest import digest
from kreisel.recording.imu_checks import check_imu
from kreisel.recording.joint_checks import check_joints, joint_stamp_warnings, joints_in_radians
from kreisel.recording.pose_checks import check_poses, stamped_poses
from kreisel.recording.recording import Recording
from kreisel.recording.sampling import regularly_sampled, with_lateness, with_restarts
from kreisel.recording.stamp_checks import (
    LONG_GAP,
    MIN_SECONDS,
    Stamped,
    check_duration,
    check_rate,
    check_stamps,
    gap_warnings,
    gaps,
)

__all__ = ["LONG_GAP", "MIN_SECONDS", "check_streams", "gaps"]


def check_streams(recording: Recording) -> Recording:
    """Return the recording with warnings added, quaternions of unit length, and without repeated rows.

    Raises
    ------
    RecordingError
        For the first fault that would make results wrong.
    """
    recording = recording if recording.sha256 else replace(recording, sha256=digest(recording))
    imu, sampling = regularly_sampled(with_restarts(recording.imu, moved=recording.reference is not None))
    reference, joints = recording.reference, recording.joints
    check_stamps(imu.stamps_ns, imu.source, "IMU")
    stamped = Stamped(imu.stamps_ns, imu.source, "samples", 20.0, 20e3, imu.units.time)
    check_rate(stamped, None if reference is None else stamped_poses(reference))
    check_duration(stamped)
    warnings = sampling + gap_warnings(imu.stamps_ns, imu.source, LONG_GAP, imu.restarts_ns)
    imu, found = check_imu(imu, moved=reference is not None)
    warnings += found
    if joints is not None:
        check_joints(joints)
    if reference is not None:
        reference, found = check_poses(reference, replace(stamped, stamps=imu.stamps_ns))
        reference, rounded = with_lateness(reference)
        warnings += found + rounded
    if joints is not None:
        joints, found = joints_in_radians(replace(recording, reference=reference))
        warnings += found
        if reference is not None:
            warnings += joint_stamp_warnings(joints, reference)
    return replace(recording, imu=imu, reference=reference, joints=joints).with_warnings(*warnings)
