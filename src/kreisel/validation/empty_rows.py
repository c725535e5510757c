"""Rows that hold nothing, left out: without a stamp, without numbers, or filled with zeros where something was lost.

What is left out is a gap like that of any lost row. A recording that holds too little besides is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kreisel.geometry.rotation import Array, Mask, lengths
from kreisel.recording.location import at, fault, rows
from kreisel.recording.recording import (
    NO_STAMP,
    DataWarning,
    ImuSamples,
    Recording,
    ReferencePoses,
)
from kreisel.validation.finite_values import IMPOSSIBLE
from kreisel.validation.masking import CHANNELS, part_of
from kreisel.validation.stamp_checks import Rows, runs

MAX_SAMPLES, MAX_POSES = 0.2, 0.5
"""Shares of the IMU's samples, and of poses or joint angles, that may be missing."""

POSITION, QUATERNION = ("p_x", "p_y", "p_z"), ("q_w", "q_x", "q_y", "q_z")
"""Names of the numbers of a pose, for messages."""

_ZERO_LENGTH = 1e-3
"""Size of all four numbers of a quaternion that is none. Chosen: one of a unit quaternion is 0.5 at least."""

_JUMP = 4.0
"""Steps at the ends of a run of zeros, in steps that nine of ten do not exceed, that no motion makes."""


@dataclass(frozen=True)
class _Lost:
    """Rows of a stream that hold nothing, (n,), and what they look like."""

    mask: Mask
    looks: str


def without_missing(recording: Recording) -> Recording:
    """Return the recording without rows that hold nothing, with one warning for each stream that has some.

    Raises
    ------
    RecordingError
        If a stream holds too little besides them.
    """
    imu, found = _imu_without(recording.imu)
    poses, joints = recording.reference, recording.joints
    if poses is not None:
        poses, more = _poses_without(poses)
        found += more
    if joints is not None:
        names = tuple(f"q_{k + 1}" for k in range(joints.angles.shape[1]))
        lost = _unreadable(joints, [(joints.angles, names)])
        keep = _kept(joints, lost, "rows of joint angles", MAX_POSES)
        found += _warnings(joints, lost, "rows of joint angles")
        joints = joints if keep is None else joints.part(keep)
    return replace(recording, imu=imu, reference=poses, joints=joints).with_warnings(*found) if found else recording


def _imu_without(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    lost = _unreadable(imu, [(imu.rates, CHANNELS[:3]), (imu.accelerations, CHANNELS[3:])])
    zeros = (imu.accelerations == 0.0).all(axis=1)
    known = ~_any(lost, zeros.size)
    # gravity is always measured; where no sample shows it, the check of units says so
    if zeros.any() and not zeros[known].all():
        lost.append(_Lost(zeros & known, "of which all accelerations are exactly zero"))
    keep = _kept(imu, lost, "samples", MAX_SAMPLES)
    found = _warnings(imu, lost, "samples")
    imu, warm = _with_temperatures(imu if keep is None else part_of(imu, keep))
    return imu, found + warm


def _with_temperatures(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples with temperatures interpolated where there is none: they change slowly, and come rarely."""
    if imu.temperature is None:
        return imu, []
    known = np.isfinite(imu.temperature)
    if known.all() or known.sum() < 2:
        return imu, []
    filled = np.interp(imu.stamps_ns, imu.stamps_ns[known], imu.temperature[known])
    text = f"{imu.source.parent.name}: {int(np.sum(~known))} of {known.size} temperatures are missing; interpolated"
    return replace(imu, temperature=filled), [DataWarning("temperature", text)]


def _poses_without(poses: ReferencePoses) -> tuple[ReferencePoses, list[DataWarning]]:
    p, q = poses.positions, poses.quaternions
    parts = [(part, names) for part, names in ((p, POSITION), (q, QUATERNION)) if part is not None]
    lost = _unreadable(poses, parts)
    gone = _any(lost, poses.stamps_ns.size)
    if q is not None:
        zeros = (np.abs(q) < _ZERO_LENGTH).all(axis=1) & ~gone
        if zeros.any():
            lost.append(_Lost(zeros, "with a quaternion of zeros, as is written where tracking was lost"))
            gone |= zeros
        marks = all_alike(q) & (np.abs(q[:, 0]) > 1.0) & ~gone
        if marks.any():
            lost.append(_Lost(marks, f"with a quaternion of four times {q[marks][0, 0]:g}, a mark of lost tracking"))
            gone |= marks
    filled = _filled(poses, gone)
    if filled.any():
        lost.append(_Lost(filled, "with a position of zeros without rotation, to which the pose jumps"))
    keep = _kept(poses, lost, "poses", MAX_POSES)
    return poses if keep is None else poses.part(keep), _warnings(poses, lost, "poses")


def all_alike(values: Array) -> Mask:
    """Return which rows (n, k) hold one number k times, as zeros or -9999 for a rotation that was not tracked."""
    return np.asarray((values == values[:, :1]).all(axis=1))


def _filled(poses: ReferencePoses, gone: Mask) -> Mask:
    """Return the poses at the origin, not turned, that no motion leads to or from: nothing was tracked there.

    Parameters
    ----------
    gone : (m,)
        Poses that are left out anyway.
    """
    p, q = poses.positions, poses.quaternions
    out = np.zeros(gone.size, dtype=bool)
    if p is None or not (np.abs(p[~gone]) < IMPOSSIBLE).all():  # may begin not turned; sizes are checked later
        return out
    zero = (p == 0.0).all(axis=1) & ~gone
    if q is not None:
        zero &= (np.abs(q[:, 0]) == 1.0) & (q[:, 1:] == 0.0).all(axis=1)
    left = np.flatnonzero(~gone)
    zero = zero[left]
    if not zero.any() or zero.all():
        return out
    steps = lengths(np.diff(p[left], axis=0))
    inside = steps[~(zero[1:] | zero[:-1])]
    usual = float(np.percentile(inside[inside > 0.0], 90)) if (inside > 0.0).any() else np.inf
    for first, last in zip(*runs(zero), strict=True):
        ends = [steps[k] for k in (first - 1, last - 1) if 0 <= k < steps.size]
        if min(ends) > _JUMP * usual:
            out[left[first:last]] = True
    return out


def _unreadable(stream: Rows, parts: Sequence[tuple[Array, tuple[str, ...]]]) -> list[_Lost]:
    """Return the rows without a stamp, and those of which one number is none; `parts` are arrays (n, k) with names."""
    unstamped = stream.stamps_ns == NO_STAMP
    finite = np.logical_and.reduce([np.isfinite(values).all(axis=1) for values, _ in parts])
    out = [_Lost(unstamped, "without a stamp")] if unstamped.any() else []
    bad = ~finite & ~unstamped
    if bad.any():
        k = int(np.argmax(bad))
        cells = [(name, x) for values, names in parts for name, x in zip(names, values[k].tolist(), strict=True)]
        name, value = next((name, x) for name, x in cells if not np.isfinite(x))
        out.append(_Lost(bad, f"without a number ({name} = {value})"))
    return out


def _any(lost: list[_Lost], size: int) -> Mask:
    """Return which rows are lost for any reason, (size,)."""
    out = np.zeros(size, dtype=bool)
    for one in lost:
        out |= one.mask
    return out


def _kept(stream: Rows, lost: list[_Lost], what: str, most: float) -> Mask | None:
    """Return which rows are kept, None for all of them.

    Raises
    ------
    RecordingError
        If more than a share `most` is missing.
    """
    if not lost:
        return None
    gone = _any(lost, stream.stamps_ns.size)
    if gone.mean() > most:
        raise fault(
            stream.source,
            f"{_said(stream, lost, what)}; {100.0 * gone.mean():.3g} % are missing, at most {100.0 * most:g} % may be: "
            "check how the file was made, or record again",
            stream.row_of(int(np.argmax(gone))),
        )
    return ~gone


def _said(stream: Rows, lost: list[_Lost], what: str) -> str:
    """Return what is lost of a stream, with counts and first places."""
    kinds = ", ".join(
        f"{int(one.mask.sum())} {one.looks} (first: {at(stream.source, stream.row_of(int(np.argmax(one.mask))))})"
        for one in lost
    )
    return f"of {stream.stamps_ns.size} {what}, {kinds}"


def _warnings(stream: Rows, lost: list[_Lost], what: str) -> list[DataWarning]:
    if not lost:
        return []
    text = f"{_said(stream, lost, what)}; these {rows(stream.source)} were left out"
    return [DataWarning("missing", f"{stream.source.parent.name}: {text}")]
