"""Parameters of the inverse filter: those of the problem, earlier values of what walks, errors of standstills."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kreisel.fitting.stored_state import first_belief, parameters_of, stored_state
from kreisel.geometry.rotation import Array, Indices
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem

MAX_INTERVALS = 12
"""Intervals between the moments at which what walks has values of its own. Chosen: straight lines over a twelfth of a
recording miss a seventy-second of the variance of a walk over the whole: its bridges have a sixth of theirs."""


@dataclass(frozen=True)
class Unknowns:
    """Parameters about which a problem is linearised.

    Columns are the problem's parameters in the order of the state, with what walks at the last moment; then what walks
    at each moment before; then the errors of the poses of each standstill, which are the same all the time.

    Attributes
    ----------
    known
        Parameters, with what walks at the last moment.
    moments : (N + 1,)
        Seconds at which what walks has values; between them it changes evenly.
    walking : (w,)
        Which degrees of freedom walk.
    values : (N + 1, w)
        Theirs at the moments.
    still : (s, 6)
        Errors of position and orientation of the poses of each standstill, m and rad.
    """

    problem: Problem
    known: CellParameters
    moments: Array
    walking: Indices
    values: Array
    still: Array

    @property
    def count(self) -> int:
        """The number of columns."""
        return self._lasting + self.still.size

    @property
    def _lasting(self) -> int:
        """The number of columns before the errors of standstills."""
        return len(self.problem.parameter_names) + (len(self.moments) - 1) * self.walking.size

    def columns_of_standstill(self, number: int) -> Indices:
        """Return the columns of the errors of a standstill, (6,)."""
        return self._lasting + 6 * number + np.arange(6)

    def column_of(self, moment: int) -> Indices:
        """Return the columns of what walks at a moment."""
        last = len(self.moments) - 1
        if moment == last:
            return self.walking
        n, w = len(self.problem.parameter_names), self.walking.size
        return n + moment * w + np.arange(w)

    def interval_of(self, seconds: float) -> int:
        """Return the interval between moments that a time lies in."""
        return int(np.clip(np.searchsorted(self.moments, seconds, side="right") - 1, 0, max(len(self.moments) - 2, 0)))

    def local(self, interval: int, standstill: int | None = None) -> Array:
        """Return how local columns follow from all, (n + 2 w, count), with a standstill (n + 2 w + 6, count).

        Local ones are the problem's, of which those of what walks are not used; then what walks at the two moments
        around an interval; then the errors of the standstill.
        """
        n, w = len(self.problem.parameter_names), self.walking.size
        out = np.zeros((n + 2 * w + (0 if standstill is None else 6), self.count))
        if standstill is not None:
            out[n + 2 * w + np.arange(6), self.columns_of_standstill(standstill)] = 1.0
        constant = np.setdiff1d(np.arange(n), self.walking)
        out[constant, constant] = 1.0
        if w:
            for i in range(2):
                at = min(interval + i, len(self.moments) - 1)
                out[n + i * w + np.arange(w), self.column_of(at)] = 1.0
        return out

    def share(self, interval: int, seconds: Array) -> Array:
        """Return the shares (m,) of the later of the two moments around an interval at times (m,)."""
        if len(self.moments) < 2:
            return np.zeros(seconds.size)
        begin, end = self.moments[interval : interval + 2]
        return np.clip((seconds - begin) / (end - begin), 0.0, 1.0)

    def walked(self, interval: int, seconds: Array) -> Array:
        """Return by how much what walks differs from its last value at times within an interval, (m, n)."""
        out = np.zeros((seconds.size, len(self.problem.parameter_names)))
        if self.walking.size and len(self.moments) > 1:
            later = self.share(interval, seconds)[:, None]
            own = (1.0 - later) * self.values[interval] + later * self.values[interval + 1]
            out[:, self.walking] = own - self.values[-1]
        return out

    def walked_clock(self, seconds: Array) -> Array:
        """Return by how much the time offset differs from its last value at times (m,), s."""
        layout = self.problem.layout
        if "time_offset" not in layout or layout["time_offset"].start not in self.walking:
            return np.zeros(seconds.size)
        own = int(np.searchsorted(self.walking, layout["time_offset"].start))
        return np.interp(seconds, self.moments, self.values[:, own]) - self.values[-1, own]

    def spread(self, by_parameters: Array, interval: int, seconds: Array) -> Array:
        """Return derivatives (m, r, n + 2 w) by local columns from those by the problem's parameters, (m, r, n)."""
        later = self.share(interval, seconds)[:, None, None]
        own = by_parameters[:, :, self.walking]
        return np.concatenate([by_parameters, (1.0 - later) * own, later * own], axis=2)

    def moved(self, step: Array) -> Unknowns:
        """Return the unknowns after a step, (count,)."""
        problem, n = self.problem, len(self.problem.parameter_names)
        change = np.zeros((problem.layout.degrees, 1))
        change[:n, 0] = step[:n]
        state = problem.layout.plus(stored_state(problem, self.known), change)[:, 0]
        moves = np.array([step[self.column_of(i)] for i in range(len(self.moments))])
        still = self.still + step[self._lasting :].reshape(self.still.shape)
        return replace(self, known=parameters_of(problem, self.known, state), values=self.values + moves, still=still)

    def prior(self) -> tuple[Array, Array]:
        """Return information and pull of the stated prior, and of how little what walks may change."""
        problem, n = self.problem, len(self.problem.parameter_names)
        belief = first_belief(problem, problem.prior.value, problem.prior.covariance)
        state = stored_state(problem, self.known)
        away = problem.layout.minus(belief.mean[:, None], state)[:n, 0]
        first = np.arange(n)
        first[self.walking] = self.column_of(0)
        away[self.walking] += self.values[-1] - self.values[0]
        covariance = (belief.factor @ belief.factor.T)[:n, :n]
        scale = 1.0 / np.sqrt(np.diag(covariance))
        known = np.linalg.inv(covariance * np.outer(scale, scale)) * np.outer(scale, scale)
        information, pull = np.zeros((self.count, self.count)), np.zeros(self.count)
        information[np.ix_(first, first)] += known
        pull[first] += known @ away
        for i, length in enumerate(np.diff(self.moments)):
            kept, variance = self._walk(float(length))
            before, after = self.column_of(i), self.column_of(i + 1)
            left = kept * self.values[i] - self.values[i + 1]
            np.add.at(information, (after, after), 1.0 / variance)
            np.add.at(information, (before, before), kept**2 / variance)
            np.add.at(information, (after, before), -kept / variance)
            np.add.at(information, (before, after), -kept / variance)
            np.add.at(pull, after, left / variance)
            np.add.at(pull, before, -kept * left / variance)
        own = np.arange(self._lasting, self.count)
        known_still = np.tile(np.repeat(np.array(problem.noise.standstill_error) ** -2.0, 3), len(self.still))
        information[own, own] += known_still
        pull[own] -= known_still * self.still.ravel()
        return information, pull

    def _walk(self, seconds: float) -> tuple[Array, Array]:
        """Return the share that is left of what walks after some seconds, and the variance of what is new, (w,)."""
        noise, layout = self.problem.noise, self.problem.layout
        kept, variance = np.ones(layout.degrees), np.zeros(layout.degrees)
        for group, density in noise.offset_walk.items():
            if group in layout:
                variance[layout[group]] = density**2 * seconds
        for group, process in noise.gauss_markov.items():
            if group in layout:
                kept[layout[group]] = np.exp(-seconds / process.time)
                variance[layout[group]] = process.size**2 * -np.expm1(-2.0 * seconds / process.time)
        return kept[self.walking], variance[self.walking]


def unknowns_of(problem: Problem, known: CellParameters, begin: float, end: float) -> Unknowns:
    """Return the unknowns of a problem between two times, with parameters that have not walked."""
    layout, noise = problem.layout, problem.noise
    groups = [g for g, density in noise.offset_walk.items() if density > 0.0 and g in layout]
    groups += [g for g in noise.gauss_markov if g in layout]
    parts = [np.arange(layout[g].start, layout[g].stop) for g in groups]
    walking = np.sort(np.concatenate([np.zeros(0, dtype=np.int64), *parts]))
    count = MAX_INTERVALS if walking.size else 0
    moments = np.linspace(begin, end, count + 1)
    stored = stored_state(problem, known)
    places = [
        layout.stored(g).start + i
        for g in problem.groups
        if g in groups
        for i in range(layout[g].stop - layout[g].start)
    ]
    values = np.tile(stored[np.array(places, dtype=np.int64)], (count + 1, 1))
    still = np.zeros((len({update.standstill for update in problem.schedule.updates} - {None}), 6))
    return Unknowns(problem, known, moments, walking, values, still)
