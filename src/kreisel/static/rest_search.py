"""Where an IMU that is turned by hand stands still, by its own readings, and what it reads there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.recording.recording import ImuSamples
from kreisel.static.rests import Rests
from kreisel.static.rounding import motion_noise_if_silent, rounding_variance
from kreisel.validation.stamp_checks import LONG_GAP, gaps, runs

BLOCK, WINDOW = 0.1, 8
"""Seconds of readings whose mean is taken, and number of such means that are judged together. Chosen: noise of single
readings does not matter then, and a hand does not hold still for 0.8 s by chance."""

MIN_SECONDS, MARGIN = 1.0, 0.1
"""Least duration of a standstill, and what is left out at either end, s. Chosen: shorter ones are pauses of a motion,
in which the hand still swings."""

_QUIET, _FACTOR = 3.0, 4.0
"""Percentile of the scatters of windows that is taken for that of standstills, and factor on it below which a window is
one. Chosen: a recording with as little as a tenth of standstill is still read right."""

_ALWAYS_STILL = (2e-3, 0.02)
_NEVER_STILL = (0.06, 0.5)
"""rad/s and m/s^2: scatter of the means of blocks that always counts as standstill, and that never does."""

_TURNING = 4.0
"""Deviations of a block's mean rate from which on the device turns at either end of a standstill."""

_NOTHING = 1e-9
"""rad/s; rates that count as the same, where there is no noise."""

_MOVED = 0.05
"""m/s^2; change of the force within a standstill, from its first half to its second, beyond the noise, with which it is
none: 5 mrad. Smaller changes count as an error of this standstill."""

_AT_END, _REPEATED, _SELDOM = 0.05, 3.0, 10.0
"""Share of a standstill's samples at the end of a range from which it is clipped, and factor on the share of the most
frequent value, of which this percentile over all standstills is taken. Chosen: the mean is then moved by more than a
fiftieth of the noise."""

_ANY_RATE = 0.2
"""rad/s; deviation of the rates at standstill that a device sets to zero. Chosen: no gyro's offset is larger."""

MAX_RESTS = 2000
"""Most standstills that are used. Chosen: memory and time stay small; nobody turns a device so often."""


def find_rests(imu: ImuSamples) -> Rests:
    """Return the standstills.

    Raises
    ------
    RecordingError
        If there are none, or more than anybody made.
    """
    step = max(1, round(BLOCK / imu.interval))
    blocks = len(imu.stamps_ns) // step
    if blocks < 2 * WINDOW:
        raise RecordingError(
            f"lasts {imu.seconds[-1]:.3g} s, expected some standstills of {MIN_SECONDS:g} s or more", file=imu.source
        )
    means = [values[: blocks * step].reshape(blocks, step, 3).mean(axis=1) for values in (imu.rates, imu.accelerations)]
    still = _still(means, _broken(imu, step, blocks))
    starts, stops = runs(still)
    long = (stops - starts) * step * imu.interval >= MIN_SECONDS + 2.0 * MARGIN
    margin = max(1, round(MARGIN / imu.interval))
    first, last = starts[long] * step + margin, stops[long] * step - margin
    if first.size > MAX_RESTS:
        raise RecordingError(
            f"{first.size} standstills, expected {MAX_RESTS} at most: cut the recording into parts", file=imu.source
        )
    return _measured(imu, first, last, step)


def without_beginning(imu: ImuSamples, rests: Rests, share: float) -> Rests:
    """Return the ends of standstills: a share of each, of `MIN_SECONDS` at least."""
    least = round(MIN_SECONDS / imu.interval)
    length = np.maximum(np.round(share * (rests.last - rests.first)).astype(int), least)
    first = np.maximum(rests.last - length, rests.first)
    return _measured(imu, first, rests.last, max(1, round(BLOCK / imu.interval)))


def held_still(imu: ImuSamples) -> float:
    """Return for how long the device has stood still at the end of its readings, s."""
    step = max(1, round(BLOCK / imu.interval))
    blocks = len(imu.stamps_ns) // step
    if blocks < 2 * WINDOW:
        return 0.0
    begin = len(imu.stamps_ns) - blocks * step
    means = [v[begin:].reshape(blocks, step, 3).mean(axis=1) for v in (imu.rates, imu.accelerations)]
    moving = np.flatnonzero(~_still(means, _broken(imu, step, blocks)))
    return float(blocks - 1 - (moving[-1] if moving.size else -1)) * step * imu.interval


def _still(means: list[Array], broken: Mask) -> Mask:
    """Return which blocks lie in a quiet window, (blocks,): of the whole window, so that no end is lost."""
    quiet: Mask = np.all(np.lib.stride_tricks.sliding_window_view(~broken, WINDOW), axis=1)
    for values, least, most in zip(means, _ALWAYS_STILL, _NEVER_STILL, strict=True):
        scatter = np.sqrt(np.lib.stride_tricks.sliding_window_view(values, WINDOW, axis=0).var(axis=-1).sum(axis=1))
        limit = np.clip(_FACTOR * np.percentile(scatter, _QUIET), least, most)
        quiet &= scatter < limit
    still = np.zeros(len(means[0]), dtype=bool)
    for i in range(WINDOW):
        still[i : i + quiet.size] |= quiet
    return still


def _trimmed(rates: Array, first: int, step: int) -> tuple[int, int]:
    """Return the first sample and the number of blocks of a standstill without the ends at which it already turns.

    A turn about the vertical that begins gently shows in nothing but the rates.

    rates: means of its blocks, (k, 3).
    """
    middle = rates[len(rates) // 4 : -(len(rates) // 4)]
    noise = np.sqrt(np.mean(np.diff(middle, axis=0) ** 2, axis=0) / 2.0)
    away = np.abs(rates - np.median(middle, axis=0))
    at = np.flatnonzero((away <= _TURNING * noise + _NOTHING).all(axis=1))
    if not at.size:
        return first, 0
    return first + int(at[0]) * step, int(at[-1] - at[0]) + 1


def _broken(imu: ImuSamples, step: int, blocks: int) -> Mask:
    """Return which blocks contain a gap."""
    out = np.zeros(blocks, dtype=bool)
    for start in gaps(imu.stamps_ns, LONG_GAP):
        out[min(int(start) // step, blocks - 1)] = True
    return out


def _measured(imu: ImuSamples, first: Indices, last: Indices, step: int) -> Rests:
    """Return the standstills with their readings, without those within which the device moves."""
    t, kept, rows, scatters = imu.seconds, [], [], []
    for a, b in zip(first.tolist(), last.tolist(), strict=True):
        parts = (b - a) // step
        if parts < 4:
            continue
        a, parts = _trimmed(imu.rates[a : a + parts * step].reshape(parts, step, 3).mean(axis=1), a, step)
        b = min(b, a + parts * step)
        if parts < 4:
            continue
        forces = imu.accelerations[a : a + parts * step].reshape(parts, step, 3).mean(axis=1)
        rates = imu.rates[a : a + parts * step].reshape(parts, step, 3).mean(axis=1)
        noise = [np.diff(x, axis=0) for x in (rates, forces)]  # of which a slow change is no part
        half = parts // 2
        change = forces[-half:].mean(axis=0) - forces[:half].mean(axis=0)
        chance = np.sqrt(noise[1].var(axis=0) / half)
        beyond = np.sqrt(np.sum(np.maximum(change**2 - chance**2, 0.0)))
        if beyond > _MOVED + 4.0 * np.linalg.norm(chance):
            continue
        kept.append((a, b))
        scatters.append([(x**2).mean(axis=0) / 2.0 for x in noise])
        mean = [x[a:b].mean(axis=0) for x in (imu.rates, imu.accelerations)]
        up = mean[1] / np.linalg.norm(mean[1])
        turning = np.cross(change, up) / (np.linalg.norm(mean[1]) * (parts - half) * step * imu.interval)
        rows.append([*mean[0], *mean[1], beyond / np.sqrt(3.0), *turning])
    if not kept:
        raise RecordingError(
            "no standstill is found: lay the device down, or hold it firmly, for two seconds or more in each attitude",
            file=imu.source,
        )
    table, (a, b) = np.array(rows), np.array(kept).T
    white = np.sqrt(np.median(np.array(scatters), axis=0) * step * imu.interval)
    found = Rests(
        a, b, 0.5 * (t[a] + t[b - 1]), t[b - 1] - t[a], table[:, :3], table[:, 3:6], table[:, 6],
        table[:, 7:],
        np.maximum(white[0], 1e-9), np.maximum(white[1], 1e-8),
        rounding_variance(imu.rates, kept, table[:, :3]), rounding_variance(imu.accelerations, kept, table[:, 3:6]),
    )  # fmt: skip
    motion = motion_noise_if_silent(imu.rates, kept)
    if motion is not None:
        unknown = np.full_like(found.rates, _ANY_RATE**2)
        first, last = _whole_silence(imu.rates, found)
        found = replace(
            found, silent=True, density_w=motion * np.sqrt(imu.interval), rounding_w=unknown, first=first, last=last
        )
    clipped = _clipped(imu, found)
    return replace(found.part(~clipped), clipped=int(clipped.sum()))


def _whole_silence(rates: Array, rests: Rests) -> tuple[Indices, Indices]:
    """Return the first zero of each standstill and the sample after its last one, (M,), which has no offset either."""
    starts, stops = runs((rates == 0.0).all(axis=1))
    middle = (rests.first + rests.last) // 2
    at = np.searchsorted(starts, middle, side="right") - 1
    inside = (at >= 0) & (stops[at] > middle)
    return np.where(inside, starts[at], rests.first), np.where(inside, stops[at], rests.last)


def _clipped(imu: ImuSamples, rests: Rests) -> Mask:
    """Return at which standstills a reading is at the end of its range, (M,).

    It is, if one in twenty samples is the largest or smallest of the recording, and if a value is repeated there far
    more often than at others: readings with few digits repeat at all standstills.
    """
    out = np.zeros(rests.count, dtype=bool)
    for values in (*imu.rates.T, *imu.accelerations.T):
        ends = np.array([values.max(), values.min()])
        parts = [values[a:b] for a, b in zip(rests.first, rests.last, strict=True)]
        at_end = np.array([(part[:, None] == ends).mean(axis=0).max() for part in parts])
        if not (at_end > _AT_END).any():
            continue
        often = np.array([np.unique(part, return_counts=True)[1].max() / part.size for part in parts])
        out |= at_end > max(_AT_END, _REPEATED * float(np.percentile(often, _SELDOM)))
    return out
