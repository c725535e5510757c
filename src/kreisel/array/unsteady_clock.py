"""Whether the clock of an IMU of an array departs from a straight line, as where lost samples leave no gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.array.sudden_change import PARTS, RICH, in_parts, lasting_difference
from kreisel.estimation.robust import normal_scale
from kreisel.geometry.rotation import Array, Indices

_DELAY = 2e-3
"""s; departure that counts, rms. Chosen: delays of units of a public board that nothing touched differed by 0.9 ms from
part to part."""

_ALONE = 3.0
"""By how much it must exceed that of any other unit."""


_GROSS = 6.0
"""Deviations of what is left beyond which a sample is a spike. Chosen: a clock that is off moves all of them."""


@dataclass(frozen=True)
class UnsteadyClock:
    """The IMU whose clock departs from a straight line, and by how much, rms, s."""

    number: int
    departure: float

    @property
    def text(self) -> str:
        """What is said of it."""
        return (
            f"its clock departs from a straight line by {1e3 * self.departure:.2g} ms: samples are lost that leave no "
            "gap in its stamps, or its clock is not steady"
        )


def unsteady_clock(seconds: Array, rates: Array, slope: Array) -> UnsteadyClock | None:
    """Return the IMU whose clock departs most, if it stands out; of two, the second one.

    Parameters
    ----------
    seconds : (n,)
    rates : (N, n, 3)
        In common axes.
    slope : (n, 3)
        Derivative of their mean.
    """
    count = len(rates)
    late, part = in_parts(seconds)
    usual = rates[0] if count == 2 else np.median(rates, axis=0)
    found = [_departure(own, usual, slope, late, part) for own in (rates[1:] if count == 2 else rates)]
    order = np.argsort(found)
    largest = int(order[-1])
    second = found[int(order[-2])] if count > 2 else 0.0
    if found[largest] < max(_DELAY, _ALONE * second):
        return None
    return UnsteadyClock(largest + (1 if count == 2 else 0), found[largest])


def _departure(own: Array, usual: Array, slope: Array, late: Array, part: Indices) -> float:
    """Return the rms of delays of parts (0 without noise, s), beside a constant one and what it gains."""
    left = lasting_difference(own, usual, slope, late)
    noise = normal_scale(left)
    used = np.where(np.all(np.abs(left) < _GROSS * noise, axis=1, keepdims=True), slope, 0.0)
    info, score = (np.bincount(part, np.sum(used * values, axis=1), PARTS) for values in (slope, left))
    rich = info > RICH * info.mean()
    variance = noise**2 / info[rich]
    return float(max(np.mean((score[rich] / info[rich]) ** 2 - variance), 0.0) ** 0.5)
