"""Lines in the spectrum of readings at rest: vibrations of fans and motors, which are no noise, and look like some.

The Allan deviation of a line falls with the averaging time as that of quantisation does, and covers white noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.inertial.noise_figures import summed_power

_LONGEST, _SEGMENTS, _SHORTEST = 8192, 16, 256
"""Samples of a segment of the spectrum, segments without overlap at least, and samples below which there is none."""

_FIRST, _BESIDE = 20, 50
"""First bin that is looked at, for slow noise is steep below, and bins on either side that show the noise of one."""

_CLEAR = 4.0
"""Density over that of the noise beside it from which on it is a line. Chosen: of 960 drawn axes of white noise, and of
walks in it, the largest is 2.03; a filter that averages readings makes lobes of 2."""

_MOST = 20
"""Lines of one axis."""

_NUMBERS = 4
"""That describe a line in a part: amplitude and phase, and how both change."""

_PART, _PERIODS = 2.0, 4.0
"""s, and periods: lines are taken out of parts as long as both, each with its own amplitude, phase and frequency.
Chosen: speeds of fans change by less than a period in it; it takes four of 400 numbers at 200 Hz."""


@dataclass(frozen=True)
class Line:
    """A vibration of one axis: its frequency, Hz, and rms, in the readings' unit."""

    axis: int
    frequency: float
    size: float


def without_lines(values: Array, interval: float) -> tuple[Array, tuple[Line, ...]]:
    """Return readings (n, 3) without lines, and these."""
    out, found = np.array(values, dtype=np.float64), []
    for axis in np.flatnonzero(np.ptp(out, axis=0) > 0.0).tolist():
        for _ in range(_MOST):
            frequency = _clearest(out[:, axis], interval)
            if frequency is None:
                break
            part = round(max(_PART, _PERIODS / frequency) / interval)
            vibration = _vibration(out[:, axis], frequency * interval, part)
            out[:, axis] -= vibration
            variance = float(np.mean(vibration**2)) - _NUMBERS / part * float(np.var(out[:, axis]))
            found.append(Line(axis, frequency, max(variance, 0.0) ** 0.5))
    return out, tuple(found)


def _clearest(values: Array, interval: float) -> float | None:
    """Return the frequency of the line that stands out most, Hz; None if none does."""
    length = 2 ** int(np.log2(min(values.size / _SEGMENTS, _LONGEST) or 1.0))
    if length < _SHORTEST:
        return None
    density = summed_power(values, np.hanning(length + 1)[:-1])  # a factor does not count
    beside = np.lib.stride_tricks.sliding_window_view(np.pad(density, _BESIDE, mode="reflect"), 2 * _BESIDE + 1)
    usual = np.median(beside, axis=1)
    over = np.where(usual > 0.0, density / np.where(usual > 0.0, usual, 1.0), 0.0)
    over[:_FIRST] = over[-1] = 0.0
    k = int(np.argmax(over))
    if over[k] < _CLEAR:
        return None
    low, middle, high = np.log(np.maximum(density[k - 1 : k + 2], 1e-12 * density[k]))
    offset = 0.5 * (low - high) / min(low - 2.0 * middle + high, -1e-12)
    return (k + float(np.clip(offset, -0.5, 0.5))) / (length * interval)


def _vibration(values: Array, turns: float, length: int) -> Array:
    """Return the part (n,) of readings that swings with a frequency, in turns per sample, by parts of a length."""
    out = np.zeros(values.size)
    for first in range(0, values.size, length):
        part = slice(first, first + length)
        own = values[part] - values[part].mean()
        k = np.arange(own.size)
        slow = (k - 0.5 * own.size) / length
        wave = np.exp(2j * np.pi * turns * k)
        A = np.column_stack([wave.real, wave.imag, slow * wave.real, slow * wave.imag])
        out[part] = A @ np.linalg.lstsq(A, own, rcond=None)[0]
    return out
