"""Rows put into the order of their stamps, where packets next to each other were swapped on their way.

A clock that was set back is something else: then more samples lie in an interval than the sensor takes in it.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from kreisel.geometry.rotation import Indices
from kreisel.recording.location import at, rows
from kreisel.recording.recording import DataWarning, Recording, Stamps
from kreisel.validation.masking import part_of
from kreisel.validation.stamp_checks import Rows, runs

_FARTHEST = 64
"""Rows by which a row may be displaced; packets hold several samples."""

_MAX = 0.1
"""Share of rows that may be displaced."""

_RESTART = 100.0
"""Steps back, in usual steps, by which a clock was set."""


def in_order(recording: Recording) -> Recording:
    """Return the recording with the rows of each stream in the order of their stamps, where few were displaced.

    Other stamps that run backwards are left as they are.
    """
    imu, reference, joints = recording.imu, recording.reference, recording.joints
    warnings: list[DataWarning] = []
    if (order := order_of(imu.stamps_ns)) is not None:
        warnings.append(_warning(imu, order, "samples"))
        imu = part_of(imu, order)
    if reference is not None and (order := order_of(reference.stamps_ns)) is not None:
        warnings.append(_warning(reference, order, "poses"))
        reference = reference.part(order)
    if joints is not None and (order := order_of(joints.stamps_ns)) is not None:
        warnings.append(_warning(joints, order, "rows of joint angles"))
        joints = joints.part(order)
    return (
        replace(recording, imu=imu, reference=reference, joints=joints).with_warnings(*warnings)
        if warnings
        else recording
    )


def _warning(stream: Rows, order: Indices, what: str) -> DataWarning:
    """Return the warning about rows of a stream that are sorted."""
    displaced = order != np.arange(order.size)
    places = runs(displaced)[0].size
    first = at(stream.source, stream.row_of(int(np.argmax(displaced))))
    text = (
        f"{stream.source.parent.name}: {int(displaced.sum())} of {order.size} {what} were not in the order of their "
        f"stamps, in {places} place{'s' if places > 1 else ''}, the first at {first}; these {rows(stream.source)} were "
        "sorted"
    )
    return DataWarning("order", text)


def order_of(stamps: Stamps) -> Indices | None:
    """Return the indices (n,) that sort stamps of which a few are displaced; None where nothing is to be sorted.

    Nor where sorting does not explain stamps that run backwards: they would repeat, or lie too densely.
    """
    if stamps.size < 3:
        return None
    steps = np.diff(stamps)
    if not (steps < 0).any():
        return None
    usual = float(np.median(steps))
    if usual <= 0.0:
        return None
    edges = [0, *(np.flatnonzero(steps < -_RESTART * usual) + 1).tolist(), stamps.size]
    order = np.concatenate([begin + np.argsort(stamps[begin:end], kind="stable") for begin, end in pairwise(edges)])
    shift = np.abs(order - np.arange(order.size))
    if not shift.any() or shift.max() > _FARTHEST or np.mean(shift > 0) > _MAX:
        return None
    ascending = stamps[order]
    for first, last in zip(*runs(shift > 0), strict=True):
        low, high = max(first - 1, 0), min(last, stamps.size - 1)
        part = ascending[low : high + 1]
        if (np.diff(part) <= 0).any() or float(part[-1] - part[0]) < (part.size - 1.5) * usual:
            return None
    return np.asarray(order, dtype=np.int64)
