"""What can be wrong with an IMU's readings by themselves.

Every check looks for something no sensor in motion does: the same number twice in six noisy channels, a
peak cut flat, a step thirty times the usual there and back.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.recording.place import and_more, fault, is_table, rows, wrong_unit
from kreisel.recording.recording import Finding, ImuSamples
from kreisel.recording.stamp_checks import runs
from kreisel.units import STANDARD_GRAVITY

CHANNELS = ("w_x", "w_y", "w_z", "a_x", "a_y", "a_z")

IMPOSSIBLE = 1e9
"""Size from which a number is no reading in any unit."""

_LONG_FREEZE = 8
_STUCK = 20
_SPIKE = 30.0


def check_imu(imu: ImuSamples, *, calibrated: bool) -> tuple[ImuSamples, list[Finding]]:
    """Return the samples without repeated ones, and what to say of them.

    Parameters
    ----------
    calibrated
        Whether a reference was recorded beside them. Without one the sensor may rest, and a silent
        channel or a knock is only told.

    Raises
    ------
    RecordingError
        For the first fault that would make results wrong.
    """
    values = np.hstack([imu.rates, imu.accelerations])
    check_finite(values, CHANNELS, imu)
    _check_lost_rows(imu)
    _check_gravity(imu)
    findings = []
    for check in (_check_dead, _check_saturation, _check_spikes):
        try:
            check(imu, values)
        except RecordingError as error:
            if calibrated:
                raise
            findings.append(Finding("imu", error.message))
    _check_frozen(imu, values)
    _check_stuck(imu, values)
    imu, repeated = _without_repeats(imu, values)
    return imu, [*findings, *repeated]


def check_finite(values: Array, names: tuple[str, ...], stream: ImuSamples | ReferenceLike) -> None:
    """Raise an error for the first number that is none, or that is of impossible size."""
    source = stream.source
    bad = ~np.isfinite(values)
    lines = np.flatnonzero(bad.any(axis=1))
    if lines.size:
        k = int(lines[0])
        name = names[int(np.argmax(bad[k]))]
        raise fault(
            source,
            f"{name} is {values[k][bad[k]][0]} here{and_more(lines.size - 1, 'rows')}, expected a finite number; "
            f"delete these {rows(source)} (a gap is bridged)",
            k,
        )
    large = np.flatnonzero((np.abs(values) > IMPOSSIBLE).any(axis=1))
    if large.size:
        k = int(large[0])
        channel = int(np.argmax(np.abs(values[k])))
        raise fault(
            source,
            f"{names[channel]} = {values[k, channel]:.4g} here{and_more(large.size - 1, 'rows')} is no possible "
            f"reading; delete these {rows(source)} (a gap is bridged)",
            k,
        )
