"""Readings of an IMU smoothed for a lower sample rate, so that samples that are not taken lower the noise, too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import Array, Mask
from kreisel.recording.recording import ImuSamples

_FASTER = 1.5
"""Ratio of sample rates from which readings are smoothed. Chosen: cubics through four samples smooth as much."""

_EVEN = 0.05
"""Share by which the length of a window may differ from that of even samples; others are not smoothed."""


def window_for(imu: ImuSamples, interval: float) -> int:
    """Return the samples of a window for one sample each `interval` (s), an odd number; 1 for no window.

    Notes
    -----
    White noise of the value at the middle of a quadratic through m samples has a variance of 9 / (4 m): with m = 2.25
    times the ratio of rates its density stays as it is.
    """
    ratio = interval / imu.interval
    return 1 if ratio < _FASTER else 2 * round(0.5 * (2.25 * ratio - 1.0)) + 1


def smoothed(imu: ImuSamples, window: int) -> tuple[ImuSamples, Mask]:
    """Return readings smoothed by quadratics through windows of samples, and which samples (n,) are.

    Stamps are smoothed, too: of readings that change steadily the result is exact also where samples are uneven.
    """
    if window < 3 or imu.stamps_ns.size < window:
        return imu, np.zeros(imu.stamps_ns.size, dtype=bool)
    j, half = np.arange(window) - window // 2, window // 2
    weights = 0.75 * (3.0 * window**2 - 7.0 - 20.0 * j**2) / (window * (window**2 - 4.0))
    seconds = imu.seconds
    length = np.zeros(seconds.size)
    length[half:-half] = seconds[window - 1 :] - seconds[: 1 - window]
    done = np.abs(length / ((window - 1) * imu.interval) - 1.0) < _EVEN

    def of(values: Array) -> Array:
        out = values.copy()
        columns = [np.convolve(column, weights, "same") for column in values.T]
        out[done] = np.column_stack(columns)[done]
        return out

    stamps = imu.stamps_ns[0] + np.round(1e9 * of(seconds[:, None])[:, 0]).astype(np.int64)
    if not (np.diff(stamps) > 0).all():
        return imu, np.zeros(seconds.size, dtype=bool)
    return replace(imu, stamps_ns=stamps, rates=of(imu.rates), accelerations=of(imu.accelerations)), done
