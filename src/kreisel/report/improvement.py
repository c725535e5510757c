"""What would make a result better: how far deviations fall if moves are repeated, or else what limits them.

Every part of the recording has an information matrix; one that is repeated adds it again. What is predicted is the
deviation with that information, to first order, as the estimator itself would state it; what does not come from the
data of the moves (site, frames, clocks, lack of fit) stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kreisel.calibration.outcome import Outcome
from kreisel.estimation.uncertainty_budget import Budget, Source
from kreisel.geometry.rotation import Array, Indices
from kreisel.model.groups import group_named
from kreisel.report.budget_figure import BudgetPart, parts_of
from kreisel.report.cells import NOTHING, Row, Table
from kreisel.units import DEG

_AIM = 0.5
"""Share of the deviation that repeated moves are to reach."""

_LONGEST = 4.0
"""Lengths of the recording that moves are repeated for, at most."""

_WORTH = 0.9
"""Share of the deviation that another recording must reach to be worth its time."""

_TURNS, _ALONG, _STANDING = 5.0, 0.5, 0.3
"""Deg: a smaller angle is no turn. Share of gravity from which on an axis is named. Seconds over which gravity is
averaged."""

_OTHERWISE = {
    Source.PRIOR: "state site.gravity and site.gravity_sd, measured, or other known values, in recording.toml",
    Source.ROBOT: "know base and tool frames better, and state robot.length_sd and robot.angle_sd in recording.toml",
    Source.CLOCKS: "state whose clock is right: imu.time_base in recording.toml",
    Source.EFFECTS: "settle the error terms that section 4 lists: --estimate or --fix",
    Source.MISFIT: "find what contradicts the model: sections 2 and 5",
}
"""What helps against uncertainty that does not come from the data of the moves."""


@dataclass(frozen=True)
class Block:
    """A part of the recording.

    Attributes
    ----------
    start, stop
        IMU seconds.
    turned : (3,)
        By which angles it turns about the IMU's axes, deg.
    up : (3,)
        Which direction is up, in axes of the IMU, where it begins at a standstill; else NaN.
    """

    start: float
    stop: float
    turned: Array
    up: Array

    @property
    def words(self) -> str:
        """Which part it is: how it stands at first, and about which axis it mostly turns."""
        most = int(np.argmax(self.turned))
        turn = f"mostly about {'xyz'[most]}, {self.turned[most]:.0f} deg" if self.turned[most] >= _TURNS else "no turn"
        along = [f"{'−' if self.up[k] < 0.0 else ''}{'xyz'[k]}" for k in range(3) if abs(self.up[k]) > _ALONG]
        stands = f"standing with {' and '.join(along)} upward, then " if along else ""
        return f"from {self.start:.0f} s to {self.stop:.0f} s ({stands}{turn})"


@dataclass(frozen=True)
class Repetition:
    """Variances of parameters if parts of a recording are repeated.

    Attributes
    ----------
    places
        Of the parameters that the parts say something of.
    total, moving
        Variance of each (n,), and the part of it that comes from the data.
    loads, gain : (k, n, n), (k, n)
        For each part: squared loads of the parameters on independent directions, and what the part adds to the
        information along each of these, relative.
    """

    places: Indices
    total: Array
    moving: Array
    loads: Array
    gain: Array

    @classmethod
    def of(cls, outcome: Outcome, budget: Budget) -> Repetition | None:
        """Return the repetition of each part of a recording, and of all together as the last; None without parts."""
        lack, problem, estimate = outcome.lack, outcome.problem, outcome.estimate
        if lack is None:
            return None
        names = list(problem.parameter_names)
        places = np.array([names.index(name) for name in lack.names])
        factor = estimate.run.belief.factor[places]
        P = factor @ factor.T
        size = np.sqrt(np.diag(P))
        L = np.linalg.cholesky(P / np.outer(size, size))
        information = lack.blocks.information * np.outer(size, size)
        information = np.concatenate([information, information.sum(axis=0)[None]])
        gain, vectors = np.linalg.eigh(L.T @ (0.5 * (information + np.swapaxes(information, 1, 2))) @ L)
        total = budget.deviation[places] ** 2
        moving = np.minimum(np.diag(P) * estimate.correlation_factor**2, total)
        return cls(places, total, moving, (size[:, None] * (L @ vectors)) ** 2, np.maximum(gain, 0.0))

    def deviation(self, part: int, times: float, places: Indices) -> float:
        """Return the rms deviation of some parameters if a part is repeated; -1 is all parts."""
        return float(self._deviations(np.array([part]), np.array([times]), places)[0])

    def with_each(self, times: Array, places: Indices) -> Array:
        """Return the rms deviations (k,) of some parameters, if each part alone is repeated some times (k,)."""
        return self._deviations(np.arange(times.size), times, places)

    def _deviations(self, parts: Indices, times: Array, places: Indices) -> Array:
        own = np.flatnonzero(np.isin(self.places, places))
        loads = self.loads[parts[:, None], own]
        then = (loads / (1.0 + times[:, None] * self.gain[parts])[:, None, :]).sum(axis=2) / loads.sum(axis=2)
        return np.asarray(np.sqrt(np.mean(self.total[own] - self.moving[own] * (1.0 - then), axis=1)))


def improvement_table(outcome: Outcome) -> Table | None:
    """Return what limits each quantity of the sensors and what makes it better; None without a budget."""
    budget = outcome.calibration.budget
    if budget is None:
        return None
    repeated, blocks = Repetition.of(outcome, budget), _blocks(outcome)
    rows = []
    for part in parts_of(outcome):
        known = group_named(part.group)
        if known.is_sensor or part.group == "time_offset":
            source, share = _largest(budget, part)
            advice, then = _advice(repeated, blocks, part, source, share)
            rows.append(Row((part.words, part.text(part.deviation), f"{source}, {100.0 * share:.0f} %", advice, then)))
    columns = ("Quantity", "Deviation now", "Most of it from", "What helps", "Deviation then")
    return Table("What makes the result better", columns, tuple(rows), 5, prose=True) if rows else None


def _largest(budget: Budget, part: BudgetPart) -> tuple[Source, float]:
    """Return the source of most of the variance of some parameters together, and its share."""
    variance = budget.deviation[part.places] ** 2
    shares = {source: float(np.sum(own[part.places] * variance)) for source, own in budget.by_source.items()}
    source = max(shares, key=lambda one: shares[one])
    return source, shares[source] / float(variance.sum())


def _advice(
    repeated: Repetition | None, blocks: list[Block], part: BudgetPart, source: Source, share: float
) -> tuple[str, str]:
    """Return what makes a deviation smaller, and how large it is then."""
    if repeated is not None and np.isin(part.places, repeated.places).all():
        best = _fewest(repeated, blocks, part)
        if best is not None:
            k, times = best
            lasts = times * (blocks[k].stop - blocks[k].start)
            moves = f"{'one more move' if times == 1 else f'{times} more moves'} ({lasts:.0f} s) like that"
            return f"{moves} {blocks[k].words}", part.text(repeated.deviation(k, times, part.places))
        twice = repeated.deviation(-1, 1.0, part.places)
        if twice < _WORTH * part.deviation and source not in _OTHERWISE:
            return "a recording twice as long, with the same moves", part.text(twice)
    if source in _OTHERWISE:
        return _OTHERWISE[source], f"at best {part.text(part.deviation * float(np.sqrt(max(1.0 - share, 0.0))))}"
    return "not predicted: it changes during the recording", NOTHING


def _fewest(repeated: Repetition, blocks: list[Block], part: BudgetPart) -> tuple[int, int] | None:
    """Return the part of the recording that halves a deviation in the least time, and how often; None if none does."""
    lengths = np.array([max(block.stop - block.start, 1e-3) for block in blocks])
    limits = np.floor(_LONGEST * (blocks[-1].stop - blocks[0].start) / lengths)
    enough = repeated.with_each(limits, part.places) <= _AIM * part.deviation
    best: tuple[float, int, int] | None = None
    for k in np.flatnonzero(enough).tolist():
        lasts = float(lengths[k])
        most = int(limits[k]) if best is None else int(best[0] / lasts)
        if most < 1 or repeated.deviation(k, most, part.places) > _AIM * part.deviation:
            continue
        low, high = 0, most
        while high - low > 1:
            middle = (low + high) // 2
            reached = repeated.deviation(k, middle, part.places) <= _AIM * part.deviation
            low, high = (low, middle) if reached else (middle, high)
        if best is None or high * lasts < best[0]:
            best = (high * lasts, k, high)
    return None if best is None else (best[1], best[2])


def _blocks(outcome: Outcome) -> list[Block]:
    """Return the parts of a recording whose information is known."""
    lack, problem = outcome.lack, outcome.problem
    if lack is None:
        return []
    updates, readings = problem.schedule.updates, problem.sensor.readings
    ends = [updates[0].last, *(updates[end - 1].last for end in lack.blocks.ends.tolist())]
    out = []
    for first, last in pairwise(ends):
        seconds = readings.stamps[first : last + 1]
        turned = np.abs(readings.rates[first:last]).T @ np.diff(seconds) / DEG
        begins = float(seconds[0])
        still = any(one.start - _STANDING <= begins <= one.stop - _STANDING for one in problem.schedule.standstills)
        force = readings.accelerations[first : first + max(1, int(np.searchsorted(seconds, begins + _STANDING)))]
        up = force.mean(axis=0) / np.linalg.norm(force.mean(axis=0)) if still else np.full(3, np.nan)
        out.append(Block(begins, float(seconds[-1]), turned, up))
    return out
