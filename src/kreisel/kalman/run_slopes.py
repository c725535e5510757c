"""What small changes of a filter's state do, update by update: recorded in a run, used again without another one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kreisel._kernels.filter_arguments import Record
from kreisel._kernels.slope_recursions import SlopeTables
from kreisel.fitting.terms import OFFSET_ROWS
from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.model.layout import NAVIGATION, STANDSTILL_ERROR
from kreisel.model.problem import Problem


@dataclass(frozen=True)
class Stretch:
    """Updates one after another, with their slopes.

    Attributes
    ----------
    numbers
        Of the updates in the run.
    tables
        Their slopes; see `slope_recursions.SlopeTables`.
    whitening : (k, 9, 9)
    innovations : (k, 9)
        Whitened; zero for what is not measured, and where it was not used.
    counted : (k, 9)
        Which numbers of the innovations were measured and used.
    mean : (k, size), covariance : (k, s, n)
        Before each update, the mean and the covariance of what varies with all; without rows if they are not recorded.
    """

    numbers: slice
    tables: SlopeTables
    whitening: Array
    innovations: Array
    counted: Mask
    mean: Array
    covariance: Array

    @property
    def used(self) -> Mask:
        """Which updates were used."""
        return np.asarray(self.counted.any(axis=1))


class Slopes:
    """The slopes of all updates of a run, and what happens to a change of the state between them."""

    def __init__(self, problem: Problem, varying: Indices | None = None) -> None:
        """Begin empty; varying: degrees of freedom whose covariance before each update is recorded too."""
        self.varying = np.zeros(0, dtype=np.int64) if varying is None else varying
        layout, updates, stamps = problem.layout, problem.schedule.updates, problem.sensor.readings.stamps
        self.degrees, self.count = layout.degrees, len(updates)
        self.position = layout["position"].start
        places = {part.name: layout[part.name] for part in layout}
        self._navigation = [places[part.name] for part in NAVIGATION]
        self._standstill = [places[part.name] for part in STANDSTILL_ERROR if part.name in layout]
        fading = problem.noise.gauss_markov
        self._fading = [(places[group], 1.0 / process.time) for group, process in fading.items() if group in layout]
        self.seconds = np.array([float(stamps[update.last] - stamps[update.first]) for update in updates])
        self.new_standstill = np.array([update.new_standstill for update in updates], dtype=bool)
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
    def starts(self) -> Mask:
        """Before which updates navigation began anew, and the first, (u,)."""
        out = np.zeros(self.count, dtype=bool)
        out[[0, *self._restarts]] = True
        return out

    @cached_property
    def keep(self) -> Array:
        """The part of each degree of freedom after an update that is kept before the motion of the next, (u, n)."""
        out = np.ones((self.count, self.degrees))
        for part, rate in self._fading:
            out[:, part] *= np.exp(-rate * self.seconds)[:, None]
        for part in self._standstill:
            out[self.new_standstill, part] = 0.0
        for part in self._navigation:
            out[sorted(self._restarts), part] = 0.0
        return out

    def stretches(self, begin: int = 0, end: int | None = None) -> Iterator[Stretch]:
        """Yield the updates from number `begin` to before `end`, in pieces."""
        end = self.count if end is None else end
        for record, first in zip(self._records, self._begin, strict=True):
            own = slice(max(begin - first, 0), max(min(end - first, record.nis.size), 0))
            if own.start < own.stop:
                yield self._stretch(record, first, own)

    def _stretch(self, record: Record, first: int, own: slice) -> Stretch:
        numbers = slice(first + own.start, first + own.stop)
        counted = np.isfinite(record.whitened[own]) & record.used[own, None]
        return Stretch(
            numbers,
            SlopeTables(record.transition[own], record.design[own], record.gain[own], self.keep[numbers]),
            record.whitening[own],
            np.where(counted, record.whitened[own], 0.0),
            counted,
            record.before[own],
            record.covariance[own],
        )


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
