"""Readings of an IMU as its sensors took them: each sample once, over its own interval, at the moment of sampling."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kreisel.geometry.rotation import Indices
from kreisel.recording.recording import DataWarning, ImuSamples, Stamps
from kreisel.validation.accumulated_readings import with_lost_samples, with_steps_of_one
from kreisel.validation.interval_readings import squares_left, with_own_intervals
from kreisel.validation.masking import part_of, without_repeats
from kreisel.validation.repeated_rows import new_samples
from kreisel.validation.sampling import regularly_sampled

_LAG = 16
"""Samples over which the interval is measured, for they may come in bursts."""

_SCATTER = 0.05
"""Scatter of stamps about whole intervals, in intervals, from which derivatives scatter too much."""

_LONG, _LONG_NS = 5.0, 50e6
"""Intervals, and ns, from which a step is a gap, which derivatives do not cross."""

_TRUE = 0.8
"""Squares that neighbours leave with stamps, of those with even samples, below which samples follow the stamps. Chosen:
at rest they are the same."""


@dataclass(frozen=True)
class SampledRows:
    """Samples as a calibration takes them, which of them (n,) each row holds, and the warnings about it."""

    samples: ImuSamples
    of_row: Indices
    warnings: list[DataWarning]


def as_sampled(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples with increments over their own intervals and stamps of sampling, and the warnings about it."""
    imu, divided = with_own_intervals(imu)
    imu, sampling = regularly_sampled(imu)
    return imu, divided + sampling


def after_repeats(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return samples, of which some that repeat the one before were left out, with stamps of sampling; and warnings."""
    imu, sampling = regularly_sampled(imu, repeats=True)
    if sampling:
        return imu, sampling
    return with_steps_of_one(imu)


def sampled_rows(imu: ImuSamples) -> SampledRows:
    """Return the samples as a calibration takes them, for each row of a file.

    A row that is the sum over lost samples holds the last of them, and a row that repeats one before holds that. The
    samples of packets that have one stamp are taken at their own moments, if it shows these. Stamps that run backwards,
    or show none, stay.
    """
    n = imu.stamps_ns.size
    if n < 2 or np.any(np.diff(imu.stamps_ns) < 0):
        return SampledRows(imu, np.arange(n), [])
    new = new_samples(imu)
    found, warnings = as_sampled(imu if new is None else part_of(imu, new))
    if np.any(np.diff(found.stamps_ns) <= 0):
        return SampledRows(imu, np.arange(n), [])
    found, lost = with_lost_samples(found)
    found, repeated = without_repeats(found)
    warnings = warnings + lost + repeated
    if repeated:
        found, sampling = after_repeats(found)
        warnings += sampling
    found, scattering = _with_even_steps(found)
    rows = np.arange(n) if found.rows is None else found.rows
    of_row = np.searchsorted(rows, np.arange(n), side="right") - 1
    return SampledRows(found, of_row, warnings + scattering)


def usual_step(stamps: Stamps) -> float:
    """Return the interval of two or more stamps, which may come in packets, ns."""
    lag = min(_LAG, stamps.size - 1)
    return float(np.median(stamps[lag:] - stamps[:-lag])) / lag


def scatter_of(stamps: Stamps) -> tuple[float, float] | None:
    """Return the interval of stamps, and how far their steps are from whole intervals on average, ns.

    None where that is so little that derivatives do not scatter.
    """
    steps = np.diff(stamps).astype(np.float64)
    if not steps.size or (interval := usual_step(stamps)) <= 0.0:
        return None
    off = np.abs(steps - np.maximum(np.round(steps / interval), 1.0) * interval)
    scatter = float(off[steps <= max(_LONG * interval, _LONG_NS)].mean())
    return (interval, scatter) if scatter > _SCATTER * interval else None


def _with_even_steps(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples with even steps between gaps where stamps scatter about no line, and the warning about it.

    The steps are right but for single ones, where a sample is missing. Samples that follow their stamps are left.
    """
    found = scatter_of(imu.stamps_ns)
    if found is None:
        return imu, []
    interval, scatter = found
    t = (imu.stamps_ns - imu.stamps_ns[0]) / interval
    if squares_left(imu.rates, t) < _TRUE * squares_left(imu.rates, np.arange(t.size, dtype=np.float64)):
        return imu, []
    steps = np.diff(imu.stamps_ns)
    even = np.where(steps > max(_LONG * interval, _LONG_NS), steps, round(interval))
    text = (
        f"{imu.source.parent.name}: stamps scatter by {1e-6 * scatter:.2g} ms about sampling every "
        f"{1e-6 * interval:.4g} ms, and are on no line; derivatives are those of even sampling"
    )
    stamps = imu.stamps_ns[0] + np.concatenate([[0], np.cumsum(even)])
    return replace(imu, stamps_ns=stamps), [DataWarning("stamps", text)]
