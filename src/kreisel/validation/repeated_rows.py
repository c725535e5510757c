"""Rows that are written twice: the same stamp and the same values as the row before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import Mask
from kreisel.recording.location import at, rows
from kreisel.recording.recording import DataWarning, ImuSamples, Recording, Stamps
from kreisel.validation.masking import part_of
from kreisel.validation.stamp_checks import Rows


def without_repeated(recording: Recording) -> Recording:
    """Return the recording without rows that say nothing new, with one warning for each stream that has some.

    Of rows with the same stamp and other values nobody knows which is right: they stay.
    """
    imu, reference, joints = recording.imu, recording.reference, recording.joints
    warnings: list[DataWarning] = []
    if (kept := new_samples(imu)) is not None:
        warnings.append(_warning(imu, kept, "samples"))
        imu = part_of(imu, kept)
    if reference is not None:
        values = [one for one in (reference.positions, reference.quaternions) if one is not None]
        if (kept := _new(reference.stamps_ns, *values)) is not None:
            warnings.append(_warning(reference, kept, "poses"))
            reference = reference.part(kept)
    if joints is not None and (kept := _new(joints.stamps_ns, joints.angles)) is not None:
        warnings.append(_warning(joints, kept, "rows of joint angles"))
        joints = joints.part(kept)
    if not warnings:
        return recording
    return replace(recording, imu=imu, reference=reference, joints=joints).with_warnings(*warnings)


def new_samples(imu: ImuSamples) -> Mask | None:
    """Return which samples (n,) are not those before them once more; None if all are."""
    return _new(imu.stamps_ns, imu.rates, imu.accelerations)


def _new(stamps: Stamps, *values: np.ndarray) -> Mask | None:
    """Return which rows (n,) are not those before them once more; None if all are."""
    same = np.diff(stamps) == 0
    if not same.any():
        return None
    for one in values:
        same &= (one[1:] == one[:-1]).all(axis=1)
    return np.concatenate([[True], ~same]) if same.any() else None


def _warning(stream: Rows, kept: Mask, what: str) -> DataWarning:
    first = at(stream.source, stream.row_of(int(np.argmin(kept))))
    text = (
        f"{stream.source.parent.name}: {int((~kept).sum())} of {kept.size} {what} are written twice, the first at "
        f"{first}; the second of these {rows(stream.source)} was left out"
    )
    return DataWarning("repeated", text)
