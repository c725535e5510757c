"""Rows of several sensors that alternate in one file, as multi-sensor loggers write them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import ImuSamples
from kreisel.validation.masking import CHANNELS

_MOST = 6
"""Sensors that are looked for. Chosen: as many as a hand can wear; stamps that repeat show more."""

_BLOCK, _FEW, _MANY = 240, 8, 40
"""Rows that are compared, a multiple of all numbers of sensors, and blocks of them at least and at most. Chosen:
differences are known to an eighth of the noise, and a row that is lost costs one block."""

_CLEAR = 3.0
"""Differences of sensors over the noise of a row from which they are some. Chosen: offsets of two sensors of the same
make differ by ten times as much, and sums over even and odd rows of one sensor by none."""

_ALIKE, _MOSTLY = 0.25, 0.6
"""Share by which differences of blocks lie beside the usual one, and share of the blocks. Chosen: a hum at half the
sample rate comes and goes, so that a third of them does; offsets stay."""


def check_alternating(imu: ImuSamples) -> None:
    """Raise an error if rows of several sensors alternate.

    Notes
    -----
    What a row has more than its neighbours is, for one sensor, noise and the curvature of the motion, whatever the
    number of the row is.
    """
    n = imu.stamps_ns.size
    if n < _FEW * (_BLOCK + 2):
        return
    first = np.unique(np.linspace(0, n - _BLOCK - 2, min(_MANY, n // (_BLOCK + 2))).astype(int))
    rows = first[:, None] + np.arange(_BLOCK + 2)
    for name, column in zip(CHANNELS, [*imu.rates.T, *imu.accelerations.T], strict=True):
        values = column[rows]
        beyond = values[:, 1:-1] - 0.5 * (values[:, :-2] + values[:, 2:])
        if (found := next(_alternating(beyond), None)) is not None:
            count, size = found
            unit = "rad/s" if name.startswith("w") else "m/s^2"
            every = {2: "second", 3: "third"}.get(count, f"{count}th")
            raise RecordingError(
                f"every {every} row differs by {size:.2g} {unit} in {name}, all the time: rows of {count} sensors seem "
                "to alternate; write those of each sensor into a file of its own (imu0/data.csv, imu1/data.csv)",
                file=imu.source,
            )


def _alternating(beyond: Array) -> Iterator[tuple[int, float]]:
    """Yield numbers of sensors whose rows alternate in blocks (blocks, rows), and by how much they differ."""
    for count in range(2, _MOST + 1):
        folded = beyond.reshape(len(beyond), -1, count)
        means = folded.mean(axis=1)
        noise = np.median(np.abs(folded - means[:, None]), axis=(1, 2)) / 0.6745
        size = np.ptp(means, axis=1)
        usual = float(np.median(size))
        alike = np.abs(size - usual) < _ALIKE * usual
        if usual > _CLEAR * float(np.median(noise)) and alike.mean() > _MOSTLY:
            yield count, 0.5 * usual
