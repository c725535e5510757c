"""What can be wrong with a recording's streams by themselves; each fault has its message, with file and line.

What shows only when reference and IMU are compared (units, conventions, another run's poses) is judged
in `synchronization` and in `calibration.plausibility`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.recording.imu_checks import check_finite, check_imu
from kreisel.recording.pose_checks import check_poses
from kreisel.recording.recording import Finding, JointAngles, Recording, ReferencePoses
from kreisel.recording.sampling import regularly_sampled
from kreisel.recording.stamp_checks import (
    LONG_GAP,
    SHORTEST,
    check_duration,
    check_rate,
    check_stamps,
    gap_findings,
    gaps,
)

__all__ = ["LONG_GAP", "SHORTEST", "check_streams", "gaps"]


def check_streams(recording: Recording) -> Recording:
    """Return the recording with findings added, quaternions of unit length, and repeated rows left out.

    Raises
    ------
    RecordingError
        For the first fault that would make results wrong.
    """
    imu, sampling = regularly_sampled(recording.imu)
    reference = recording.reference
    check_stamps(imu.stamps_ns, imu.source, "IMU")
    check_rate(imu.stamps_ns, imu.source, "samples", 20.0, 20e3)
    check_duration(imu.stamps_ns, imu.source)
    findings = sampling + gap_findings(imu.stamps_ns, imu.source, LONG_GAP)
    imu, told = check_imu(imu, moved=reference is not None)
    findings += told
    if recording.joints is not None:
        findings += _check_joints(recording.joints, reference)
    if reference is not None:
        reference, told = check_poses(reference, (imu.source.parent.name, float(imu.seconds[-1])))
        findings += told
    return replace(recording, imu=imu, reference=reference).with_findings(*findings)


def _check_joints(joints: JointAngles, reference: ReferencePoses | None) -> list[Finding]:
    check_stamps(joints.stamps_ns, joints.source, "joint angle")
    names = tuple(f"q_{k + 1}" for k in range(joints.angles.shape[1]))
    check_finite(joints.angles, names, joints.source)
    if reference is None:
        return []
    missing = int(np.sum(~np.isin(reference.stamps_ns, joints.stamps_ns)))
    if not missing:
        return []
    said = f"{missing} of {reference.stamps_ns.size} poses have no joint angles of the same stamp"
    return [Finding("joints", f"{joints.source.parent.name}: {said}")]
