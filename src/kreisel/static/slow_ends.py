"""Turns of a device that sets its rates to zero while they are small: what their slow ends lack is restored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import Array, lengths
from kreisel.recording.recording import ImuSamples
from kreisel.validation.stamp_checks import runs

_SHORTEST = 0.3
"""s of a turn, and of the zeros on both sides of it."""

_SLOPE = 0.04
"""s at an end of a turn over which the change of its rate is taken."""

_LACKING = 0.6
"""Angle that an end lacks, by the square of its first rate over the change of the rate. Chosen: it is 1/2 where the
rate changes evenly, and 2/3 where it grows as the square of time."""

UNSURE = 0.3
"""Share of what is restored that is not known. Chosen: by the same two courses, and noise in the change of the rate."""


def with_slow_ends(imu: ImuSamples) -> tuple[ImuSamples, float]:
    """Return the readings with rates of turns larger by what their ends lack, and the usual share of that.

    The axis of a turn by hand hardly changes, so that what is lacking is along the rates of the turn.
    """
    zero = (imu.rates == 0.0).all(axis=1)
    size, interval = lengths(imu.rates), imu.interval
    shortest, steps = round(_SHORTEST / interval), max(2, round(_SLOPE / interval))
    rates, shares = imu.rates.copy(), []
    for first, last in zip(*runs(~zero), strict=True):
        within = first >= shortest and last + shortest <= zero.size and last - first >= max(shortest, 2 * steps)
        if not within or not (zero[first - shortest : first].all() and zero[last : last + shortest].all()):
            continue
        turn = size[first:last]
        ends = [_lacking(part, interval) for part in (turn[: steps + 1], turn[::-1][: steps + 1])]
        share = sum(ends) / (float(turn.sum()) * interval)
        rates[first:last] *= 1.0 + share
        shares.append(share)
    return replace(imu, rates=rates), float(np.median(shares)) if shares else 0.0


def _lacking(rates: Array, interval: float) -> float:
    """Return the angle, rad, before the first of some rates that grow from it on; zero where they do not."""
    slope, first = float(np.polyfit(interval * np.arange(rates.size), rates, 1)[0]), float(rates[0])
    # half an interval of the first rate is that of the turn
    return max(_LACKING * first**2 / slope - 0.5 * interval * first, 0.0) if slope > 0.0 else 0.0
