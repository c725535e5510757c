"""What can be wrong with an IMU's readings by themselves.

Every check looks for something that no sensor in motion does: six noisy channels that repeat themselves,
a peak cut flat, a step thirty times the usual, there and back.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

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


def check_imu(imu: ImuSamples, *, moved: bool) -> tuple[ImuSamples, list[Finding]]:
    """Return the samples without repeated ones, and what to say of them.

    Parameters
    ----------
    moved
        Whether a reference was recorded beside them. Without one the sensor may rest, and a silent
        channel or a knock is only told.

    Raises
    ------
    RecordingError
        For the first fault that would make results wrong.
    """
    values = np.hstack([imu.rates, imu.accelerations])
    check_finite(values, CHANNELS, imu.source)
    _check_filled(imu)
    _check_gravity(imu)
    findings = []
    for check in (_check_dead, _check_copies, _check_saturation, _check_steps, _check_frozen, _check_stuck):
        try:
            check(imu, values)
        except RecordingError as error:
            if moved:
                raise
            findings.append(Finding("imu", error.message))
    imu, repeated = _without_repeats(imu, values)
    return imu, [*findings, *repeated]


def check_finite(values: Array, names: tuple[str, ...], source: Path) -> None:
    """Raise an error for the first number that is none, or that is of impossible size.

    Raises
    ------
    RecordingError
        With its place.
    """
    bad = ~(np.abs(values) < IMPOSSIBLE)
    where = np.flatnonzero(bad.any(axis=1))
    if where.size:
        k = int(where[0])
        channel = int(np.argmax(bad[k]))
        raise fault(
            source,
            f"{names[channel]} = {values[k, channel]:.4g} is no possible reading, here"
            f"{and_more(where.size - 1, rows(source))}; delete these {rows(source)} (a gap is bridged)",
            k,
        )


def _check_filled(imu: ImuSamples) -> None:
    """Raise an error for samples that are zero in all channels, where gravity alone is felt always."""
    empty = np.flatnonzero((imu.accelerations == 0.0).all(axis=1))
    if empty.size == imu.stamps_ns.size:
        raise RecordingError("all accelerations are zero: record the accelerometers too", file=imu.source)
    if empty.size:
        raise fault(
            imu.source,
            f"all accelerations are exactly zero here{and_more(empty.size - 1, rows(imu.source))}, where gravity is "
            f"always felt: lost samples were filled with zeros; delete these {rows(imu.source)} (a gap is bridged)",
            int(empty[0]),
        )


def _check_gravity(imu: ImuSamples) -> None:
    """Raise an error if the accelerometers do not feel about one g, naming the unit that would fit."""
    length = float(np.median(np.linalg.norm(imu.accelerations, axis=1)))
    if 4.0 < length < 25.0:
        return
    got = f"accelerations have a median length of {length:.4g}, expected {STANDARD_GRAVITY:.4g} m/s^2 and a little"
    for unit, size in (("g", 1.0), ("mg", 1e3)):
        if 0.6 * size < length < 1.6 * size:
            raise wrong_unit(imu.source, got, unit, "m/s^2")
    if 4.0 < float(np.median(np.linalg.norm(imu.rates, axis=1))) < 25.0:
        advice = "the rates seem to stand in their place: put rates first, accelerations behind them"
    elif length < 4.0:
        advice = "was gravity removed, or are the columns in another order? Raw readings are needed"
    else:
        advice = "are they raw counts? Convert them to m/s^2"
    raise RecordingError(f"{got}; {advice}", file=imu.source, line=1 if is_table(imu.source) else None)


def _check_dead(imu: ImuSamples, values: Array) -> None:
    dead = np.flatnonzero(np.ptp(values, axis=0) == 0.0)
    if dead.size:
        names = ", ".join(f"{CHANNELS[c]} (always {values[0, c]:.4g})" for c in dead)
        raise RecordingError(
            f"dead channel: {names} never changes; check the sensor and the columns, and record again",
            file=imu.source,
        )


def _check_copies(imu: ImuSamples, values: Array) -> None:
    for a, b in combinations(range(len(CHANNELS)), 2):
        if np.array_equal(values[:, a], values[:, b]):
            raise RecordingError(
                f"{CHANNELS[a]} and {CHANNELS[b]} hold the same numbers throughout; one column was written twice: "
                "look how the file was made, and record again",
                file=imu.source,
                line=1 if is_table(imu.source) else None,
            )


def resolution(steps: Array) -> Array:
    """Return the least step every channel makes, (channels,): that of its digits, if it has few.

    Parameters
    ----------
    steps : (n, channels)
        Sizes of the steps from sample to sample.
    """
    least = []
    for channel in steps.T:
        real = channel[channel > 1e-9 * channel.max()]
        least.append(float(np.percentile(real, 1)) if real.size else 0.0)
    return np.array(least)


def _usual(steps: Array, share: float) -> Array:
    """Return a percentile of the steps that are none of zero, (channels,)."""
    return np.array([float(np.percentile(x[x > 0.0], share)) if (x > 0.0).any() else 0.0 for x in steps.T])


def _check_saturation(imu: ImuSamples, values: Array) -> None:
    """Raise an error for a channel that stays at its extreme while it should go on.

    A natural peak is approached ever more gently: before a plateau of n samples, with digits of size d, the
    slope is at most about 6 d / n. A clipped one is entered steeply.
    """
    steps = np.abs(np.diff(values, axis=0))
    digits = resolution(steps)
    resting = np.concatenate([[False], (steps == 0.0).all(axis=1)])
    for channel, name in enumerate(CHANNELS):
        x = values[:, channel]
        for extreme, word in ((x.max(), "largest"), (x.min(), "smallest")):
            flat = (x == extreme) & ~resting
            starts, stops = runs(flat)
            longest = int((stops - starts).max(initial=0))
            before = max(1, min(longest // 2, 20))
            plateau = (stops - starts >= 3) & (starts > before)
            if int(flat.sum()) < 5 or not plateau.any():
                continue
            edge = starts[plateau] - 1
            slope = float(np.median(np.abs(x[edge] - x[edge - before]))) / before
            if slope > max(12.0 * digits[channel] / longest, 2e-4 * float(np.std(x))):
                raise fault(
                    imu.source,
                    f"{name} is saturated: it stays at its {word} value {extreme:.6g} for up to {longest} samples, "
                    f"{int(flat.sum())} in all; move more gently, or choose a larger range",
                    int(starts[plateau][0]),
                )


def _check_steps(imu: ImuSamples, values: Array) -> None:
    """Raise an error for spikes of one sample, and for channels that run over their range and wrap round."""
    source = imu.source
    steps = np.diff(values, axis=0)
    limit = _SPIKE * _usual(np.abs(steps), 99.0)
    dt = np.diff(imu.stamps_ns)
    large = (np.abs(steps) > limit) & (limit > 0.0) & (dt < 1.6 * float(np.median(dt)))[:, None]
    back = np.abs(values[2:] - values[:-2]) < 0.3 * np.minimum(np.abs(steps[1:]), np.abs(steps[:-1]))
    spikes = large[1:] & large[:-1] & back
    wraps = large & (np.abs(steps) > 0.9 * np.ptp(values, axis=0))
    wraps[:-1] &= ~spikes
    wraps[1:] &= ~spikes
    for found, kind, advice in (
        (spikes, "a spike", f"delete these {rows(source)} (a gap is bridged)"),
        (wraps, "a step over the whole range", "the reading ran over its range and wrapped round: choose a larger one"),
    ):
        where = np.flatnonzero(found.any(axis=1))
        if where.size:
            k = int(where[0])
            channel = int(np.argmax(found[k]))
            raise fault(
                source,
                f"{kind} in {CHANNELS[channel]}: from {values[k, channel]:.4g} to {values[k + 1, channel]:.4g} in one "
                f"sample{and_more(where.size - 1, rows(source))}; steps are usually below "
                f"{limit[channel] / _SPIKE:.3g}; {advice}",
                k + 1,
            )


def _stalls(values: Array) -> tuple[Indices, Indices, Array]:
    """Return first and last samples of stretches in which all channels repeat, and the steps that end them."""
    same = (np.diff(values, axis=0) == 0.0).all(axis=1)
    starts, stops = runs(same)
    ended = stops < len(same)
    starts, stops = starts[ended], stops[ended]
    return starts, stops, np.abs(values[stops + 1] - values[stops])


def _check_frozen(imu: ImuSamples, values: Array) -> None:
    """Raise an error where all channels freeze and then leap: a sensor at rest starts gently."""
    source = imu.source
    starts, stops, leaps = _stalls(values)
    usual = np.percentile(np.abs(np.diff(values, axis=0)), 90, axis=0) + 1e-12
    frozen = (stops - starts >= _LONG_FREEZE) & ((leaps / usual).max(axis=1, initial=0.0) > 4.0)
    if frozen.any():
        k = int(np.flatnonzero(frozen)[0])
        raise fault(
            source,
            f"all readings are frozen for {stops[k] - starts[k] + 1} samples, then leap"
            f"{and_more(int(frozen.sum()) - 1, 'places')}; delete these {rows(source)} (a gap is bridged), "
            "and look for a stalled driver",
            int(starts[k]) + 1,
        )


def _check_stuck(imu: ImuSamples, values: Array) -> None:
    """Raise an error for one channel that stays the same while the others go on.

    Natural is that only where it hardly changes: at rest, or at the top of a peak, where after as many
    samples again it has changed by nine digits at the most.
    """
    steps = np.abs(np.diff(values, axis=0))
    digits, usual = resolution(steps), _usual(steps, 90.0)
    still = (steps == 0.0).all(axis=1)
    for channel, name in enumerate(CHANNELS):
        x = values[:, channel]
        same = (steps[:, channel] == 0.0) & ~still
        starts, stops = runs(same)
        long = (stops - starts >= _STUCK) & (stops - starts < 0.99 * same.size)
        natural = float(np.mean(same)) - float(np.sum((stops - starts)[long])) / same.size
        for start, stop in zip(starts[long], stops[long], strict=True):
            leap = float(steps[stop, channel]) if stop < len(steps) else 0.0
            leaps = leap > max(4.0 * usual[channel], 5.0 * digits[channel])
            around = int(min(stop - start, 200))
            moved = max(
                float(np.ptp(x[max(start - around, 0) : start + 1])), float(np.ptp(x[stop : stop + around + 1]))
            )
            # a channel that hardly ever repeats itself does not do so twenty times in a row
            if leaps or (natural < 0.2 and moved > 20.0 * digits[channel]):
                ending = "then leaps" if leaps else "while the others go on"
                raise fault(
                    imu.source,
                    f"{name} stays at {x[start]:.4g} for {stop - start + 1} samples, {ending}: a stuck or dead "
                    f"channel; delete these {rows(imu.source)}, and check the sensor",
                    int(start) + 1,
                )


def _without_repeats(imu: ImuSamples, values: Array) -> tuple[ImuSamples, list[Finding]]:
    """Drop samples that only repeat the one before, as where a log runs faster than its sensor.

    In all six channels at once that happens to a sensor at rest with few digits, whose next change is small,
    and to one without any noise; neither is touched.
    """
    digits = resolution(np.abs(np.diff(values, axis=0)))
    starts, stops, leaps = _stalls(values)
    stale = (stops - starts < _LONG_FREEZE) & (leaps > 3.0 * digits).any(axis=1)
    keep = first_of_each(len(values), starts[stale], stops[stale])
    dropped = int(np.sum(~keep))
    if not dropped:
        return imu, []
    finding = Finding(
        "repeats",
        f"{imu.source.parent.name}: {dropped} of {len(values)} samples only repeat the one before and were left out"
        f"{'; log the sensor at its own rate' if dropped > 0.1 * len(values) else ''}",
    )
    fresh = replace(imu, stamps_ns=imu.stamps_ns[keep], rates=imu.rates[keep], accelerations=imu.accelerations[keep])
    return fresh, [finding]


def first_of_each(size: int, starts: Indices, stops: Indices) -> Mask:
    """Return the mask that leaves out all but the first of every stretch.

    Parameters
    ----------
    starts, stops
        First and last index of the stretches.
    """
    change = np.zeros(size + 1, dtype=np.int64)
    np.add.at(change, starts + 1, 1)
    np.add.at(change, stops + 1, -1)
    return np.asarray(np.cumsum(change)[:size] == 0)
