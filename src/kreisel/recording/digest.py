"""A fingerprint of a recording's data, whatever file format holds them."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from kreisel.recording.recording import Recording


def digest(recording: Recording) -> str:
    """Return the SHA-256 of a recording's data, as hexadecimal digits.

    Notes
    -----
    Of these arrays, row by row, little-endian, stamps as int64 (ns) and all else as float64, with what is missing left
    out: IMU stamps, rates, accelerations, temperature; reference stamps, positions, quaternions; joint stamps, angles;
    stamps and angles of a turntable.
    """
    imu, reference, joints = recording.imu, recording.reference, recording.joints
    arrays = [imu.stamps_ns, imu.rates, imu.accelerations, imu.temperature]
    if reference is not None:
        arrays += [reference.stamps_ns, reference.positions, reference.quaternions]
    if joints is not None:
        arrays += [joints.stamps_ns, joints.angles]
    if recording.table is not None:
        arrays += [recording.table.stamps_ns, recording.table.angles]
    out = hashlib.sha256()
    for array in arrays:
        if array is not None:
            kind = "<i8" if array.dtype.kind == "i" else "<f8"
            out.update(np.ascontiguousarray(array, dtype=kind).data)
    return out.hexdigest()
