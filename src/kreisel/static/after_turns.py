"""Standstills that begin with a rest of the turn before: the device relaxes, or its gyros settle, for seconds.

Rubber, foam and a stop under tension give way after every turn, and always in the same sense; what gyros and gravity
measure between the middles of standstills is then not the same turn, and scale factors take up the difference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kreisel.geometry.rotation import Array, Mask
from kreisel.recording.recording import ImuSamples
from kreisel.static.rest_search import without_beginning
from kreisel.static.rests import Rests
from kreisel.units import MRAD

_CLEAR = 6.0
"""Deviations of the mean from which standstills are found to begin with a rest of the turn. Chosen: noise shows as many
once in a billion recordings; of 147 simulated ones, clean or with other faults, none had as many."""

_FEWEST, _TURN = 10, 0.2
"""Turns by which that is judged, and rad, the least of one."""

_KEPT = 0.4
"""Share of a standstill that is kept, its end. Chosen: of a relaxation with a time constant of a quarter of it a tenth
is left, which is taken out."""

_BY_GRAVITY = 0.5
"""Share of what gyros show that gravity must show, too, for it to be a motion of the device."""

_BLOCK, _SHORTEST, _TRIED, _LONGEST = 0.1, 20.0, 60, 4.0
"""s of a mean of rates, percentile of durations up to which they are compared, and number of time constants that are
tried, and the largest one, over that duration."""

_RELAXES = (
    "the device goes on turning for a while at standstills, by {size:.2g} mrad, {way} the turn before: only the last "
    "{share:.0f} % of each is used, as if it stood still there; a firm stop or longer standstills show more"
)
_STILL_RELAXES = (
    "the device goes on turning to the end of standstills, by {size:.2g} mrad, {way} the turn before: use a firm stop, "
    "or longer standstills"
)
_SETTLES = (
    "the gyros read the turn before for a while at standstills, {size:.2g} mrad {way} it, where gravity shows that the "
    "device stands still: it zeroes them by itself, or a filter takes seconds; switch that off"
)
"""What is said of such a device."""


@dataclass(frozen=True)
class AfterTurn:
    """What standstills have of the turn before them: rad on average, and the share of it that gravity shows."""

    angle: float
    by_gravity: float

    @property
    def moves(self) -> bool:
        """Whether the device itself turns."""
        return self.by_gravity > _BY_GRAVITY

    def said(self, text: str) -> str:
        """Return a text with size and sense."""
        way = "on in the sense of" if self.angle > 0.0 else "back against"
        return text.format(size=abs(self.angle) / MRAD, way=way, share=100.0 * _KEPT)


def settled(imu: ImuSamples, rests: Rests) -> tuple[ImuSamples, Rests, str, str]:
    """Return readings and standstills as if the device stood still in the mean attitude of the end of each.

    Also what is said of that, and why the gyros' result may not be used; empty where there is nothing.
    """
    found = after_turn(imu, rests)
    if found is None:
        return imu, rests, "", ""
    if not found.moves:
        return imu, rests, "", found.said(_SETTLES)
    late = without_beginning(imu, rests, _KEPT)
    moved = _Relaxation.of(imu, rests).taken_from(imu, rests, late)
    late = without_beginning(moved, late, 1.0)
    left = after_turn(moved, late)
    return (moved, late, found.said(_RELAXES), "") if left is None else (moved, late, "", left.said(_STILL_RELAXES))


@dataclass(frozen=True)
class _Relaxation:
    """The usual rate along the turn before, rate * exp(-t / tau) at a time t after the beginning of a standstill."""

    rate: float
    tau: float

    @classmethod
    def of(cls, imu: ImuSamples, rests: Rests) -> _Relaxation:
        """Return the one that is nearest to the mean over all turns, in the least squares sense."""
        step = max(1, round(_BLOCK / imu.interval))
        used, along = _turned(imu, rests)
        count = int(np.percentile((rests.last - rests.first)[used], _SHORTEST)) // step
        rows = [
            imu.rates[first : first + count * step].reshape(count, step, 3).mean(axis=1) @ n
            for first, last, n in zip(rests.first[used], rests.last[used], along[used], strict=True)
            if last - first >= count * step
        ]
        usual, t = np.mean(rows, axis=0), (np.arange(count) + 0.5) * step * imu.interval
        best = (np.inf, 0.0, 1.0)
        for tau in np.geomspace(0.5 * t[0], _LONGEST * t[-1], _TRIED):
            A = np.column_stack([np.exp(-t / tau), np.ones(count)])
            x = np.linalg.lstsq(A, usual, rcond=None)[0]
            best = min(best, (float(np.sum((usual - A @ x) ** 2)), float(x[0]), float(tau)))
        return cls(*best[1:])

    def taken_from(self, imu: ImuSamples, rests: Rests, late: Rests) -> ImuSamples:
        """Return readings in which it happens just before and after the ends of standstills, up to their mean attitude.

        late: the ends of them.
        """
        used, along = _turned(imu, rests)
        rates, step = imu.rates.copy(), max(1, round(_BLOCK / imu.interval))
        which = np.searchsorted(rests.last, late.last)
        for k, a, b in zip(which.tolist(), late.first.tolist(), late.last.tolist(), strict=True):
            if not used[k]:
                continue
            begin = int(rests.first[k])
            t0, length = (a - begin) * imu.interval, (b - a) * imu.interval
            gone = self.rate * self.tau * np.exp(-t0 / self.tau)
            share = self.tau / length * (1.0 - np.exp(-length / self.tau))
            before, after = gone * (1.0 - share), gone * (share - np.exp(-length / self.tau))
            t = (np.arange(a, b) - begin) * imu.interval
            rates[a:b] -= self.rate * np.exp(-t / self.tau)[:, None] * along[k]
            rates[max(a - step, 0) : a] += before * along[k] / (step * imu.interval)
            rates[b : b + step] += after * along[k] / (step * imu.interval)
        return replace(imu, rates=rates)


def _turned(imu: ImuSamples, rests: Rests) -> tuple[Mask, Array]:
    """Return at which standstills a turn ended (M,), and its direction (M, 3) by uncalibrated gyros."""
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(imu.rates, axis=0)]) * imu.interval
    first, last = rests.first, rests.last
    between = 0.5 * (rests.rates[1:] + rests.rates[:-1]) * ((first[1:] - last[:-1])[:, None] * imu.interval)
    way = np.vstack([np.zeros((1, 3)), sums[first[1:]] - sums[last[:-1]] - between])
    size = np.linalg.norm(way, axis=1)
    return size > _TURN, way / np.maximum(size, 1e-9)[:, None]


def after_turn(imu: ImuSamples, rests: Rests) -> AfterTurn | None:
    """Return what standstills have of the turns before, if the data show it.

    It is the rate of their first half beyond that of the second, along the turn: offsets have no share in it.
    """
    if rests.silent or rests.count <= _FEWEST:
        return None
    used, along = _turned(imu, rests)
    if int(used.sum()) < _FEWEST:
        return None
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(imu.rates, axis=0)])
    first, last = rests.first, rests.last
    middle = first + (last - first) // 2
    halves = [(sums[b] - sums[a]) / (b - a)[:, None] for a, b in ((first, middle), (middle, last))]
    along, seconds = along[used], rests.durations[used]
    angles = 0.25 * seconds * np.einsum("ki,ki->k", (halves[0] - halves[1])[used], along)
    mean, deviation = float(angles.mean()), float(angles.std(ddof=1)) / np.sqrt(angles.size)
    if not abs(mean) > _CLEAR * deviation:
        return None
    return AfterTurn(mean, _seen_by_gravity(rests, along, seconds, used) / mean)


def _seen_by_gravity(rests: Rests, along: Array, seconds: Array, used: Mask) -> float:
    """Return the mean angle, rad, by which gravity turns against the turns, from the first half to the second."""
    up = rests.forces[used] / np.linalg.norm(rests.forces[used], axis=1, keepdims=True)
    shown = 1.0 - np.einsum("ki,ki->k", along, up) ** 2
    turned = 0.5 * seconds * np.einsum("ki,ki->k", rests.turning[used], along)
    return float(turned.sum() / max(float(shown.sum()), 1e-9))
