"""What small changes of a filter's state do, update by update: recorded in a run, used again without another one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kreisel._kernels.filter_arguments import Record
from kreisel.fitting.terms import OFFSET_ROWS
from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.model.layout import NAVIGATION, STANDSTILL_ERROR
from kreisel.model.problem import Problem


@dataclass(frozen=True)
class Slope:
    """One update; see `filter_arguments.Record`.

    Attributes
    ----------
    number
        Of the update.
    slopes : (c + 9, n)
        Transition of the c degrees of freedom that move, above the design.
    gain : (9, n)
        Transposed, what the whitened innovation adds to the state.
    whitening : (9, 9)
    innovation : (9,)
        Whitened; zero for what is not measured, and where it was not used.
    measured : (9,)
        Which numbers of the innovation are.
    used
    """

    number: int
    slopes: Array
    gain: Array
    whitening: Array
    innovation: Array
    measured: Mask
    used: bool


class Slopes:
    """The slopes of all updates of a run, and what happens to a change of the state between them."""

    def __init__(self, problem: Problem, varying: Indices | None = None) -> None:
        """Begin empty; varying: degrees of freedom whose covariance before each update is recorded too."""
        self.varying = np.zeros(0, dtype=np.int64) if varying is None else varying
        layout, updates, stamps = problem.layout, problem.schedule.updates, problem.sensor.readings.stamps
        self.degrees, self.count = layout.degrees, len(updates)
        self.moving = slice(layout.degrees - problem.changing, layout.degrees)
        self.position = layout["position"].start
        places = {part.name: layout[part.name] for part in layout}
        self._navigation = [places[part.name] for part in NAVIGATION]
        self._standstill = [places[part.name] for part in STANDSTILL_ERROR if part.name in layout]
        fading = problem.noise.gauss_markov
        self._fading = [(places[group], 1.0 / process.time) for group, process in fading.items() if group in layout]
        self.seconds = np.array([float(stamps[update.last] - stamps[update.first]) for update in updates])
        self.new_standstill = [update.new_standstill for update in updates]
        self._records: list[Record] = []
        self._begin: list[int] = []
        self._restarts: set[int] = set()

    def add(self, record: Record, begin: int) -> None:
        """Add the record of updates from number `begin` on."""
        self._records.append(record)
        self._begin.append(begin)

    def restart(self, at: int) -> None:
        """Note that navigation began anew before update `at`."""
        self._restarts.add(at)

    @property
    def starts(self) -> set[int]:
        """Updates before which navigation began anew, and the first."""
        return {0, *self._restarts}

    def __iter__(self) -> Iterator[Slope]:
        for record, begin in zip(self._records, self._begin, strict=True):
            for k in range(record.nis.size):
                yield _slope(record, begin, k)

    def __reversed__(self) -> Iterator[Slope]:
        for record, begin in zip(reversed(self._records), reversed(self._begin), strict=True):
            for k in reversed(range(record.nis.size)):
                yield _slope(record, begin, k)

    def measured(self) -> Array:
        """Return which whitened innovations there are, as ones and zeros, (u, 9)."""
        return np.concatenate([np.isfinite(r.whitened) * r.used[:, None] for r in self._records]).astype(float)

    def before(self) -> Iterator[tuple[Array, Array]]:
        """Yield mean (size,), and covariance (s, n) of what varies with all, before each update, from the last on."""
        for record in reversed(self._records):
            for k in reversed(range(record.nis.size)):
                yield record.before[k], record.covariance[k]

    def between(self, number: int, changes: Array) -> None:
        """Let changes of the state (n, k) after the update before `number` become those before its motion; or back.

        All that happens there keeps a part of each degree of freedom, so that the transposed is the same.
        """
        if number in self._restarts:
            for part in self._navigation:
                changes[part] = 0.0
        for part, rate in self._fading:
            changes[part] *= np.exp(-rate * self.seconds[number])
        if self.new_standstill[number]:
            for part in self._standstill:
                changes[part] = 0.0


def _slope(record: Record, begin: int, k: int) -> Slope:
    measured, used = np.isfinite(record.whitened[k]), bool(record.used[k])
    innovation = np.where(measured, record.whitened[k], 0.0) if used else np.zeros(measured.size)
    slopes = np.concatenate([record.transition[k], record.design[k]])
    return Slope(begin + k, slopes, record.gain[k], record.whitening[k], innovation, measured, used)


def offsets(problem: Problem) -> tuple[Indices, Indices]:
    """Return which rows of terms are readings with an offset in the state, and the offsets' degrees of freedom."""
    layout = problem.layout
    found = [
        (own[axis], layout[group].start + i)
        for group, own in OFFSET_ROWS.items()
        if group in layout
        for i, axis in enumerate(layout.present(group).tolist())
    ]
    return np.array([row for row, _ in found], dtype=np.int64), np.array([place for _, place in found], dtype=np.int64)
