"""Samples in groups of some hundredths of a second, of which functions are formed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, Indices

STEP = 0.02
"""s; readings are averaged over so long before functions are formed of them."""

_TOGETHER = 1 << 13
"""Values of functions that are computed together."""


def blocks(count: int) -> Iterator[Indices]:
    """Yield all numbers below `count`, some thousands at a time."""
    for begin in range(0, count, _TOGETHER):
        yield np.arange(begin, min(begin + _TOGETHER, count))


@dataclass(frozen=True)
class SampleGroups:
    """Samples in groups of about `STEP`.

    Attributes
    ----------
    begin : (g,)
        First sample of each group.
    samples
        Number of samples.
    """

    begin: Indices
    samples: int

    @classmethod
    def of(cls, stamps: Array) -> SampleGroups:
        """Return the groups of samples."""
        width = max(1, round(STEP / float(np.median(np.diff(stamps)))))
        return cls(np.arange(0, stamps.size, width), stamps.size)

    @property
    def count(self) -> int:
        """Number of groups."""
        return int(self.begin.size)

    @property
    def _ends(self) -> Indices:
        return np.append(self.begin[1:], self.samples)

    def average(self, values: Array) -> Array:
        """Return the means of values (n, k) over the groups, (g, k)."""
        return np.asarray(np.add.reduceat(values, self.begin, axis=0) / (self._ends - self.begin)[:, None])

    def mean(self, functions: Callable[[Indices], Array], first: Indices, last: Indices) -> Array:
        """Return the means of functions from samples `first` to `last`, (u, k)."""
        edges = np.append(self.begin, self.samples)
        widths = np.diff(edges)[:, None]
        groups = [np.minimum(np.searchsorted(edges, at, side="right") - 1, self.count - 1) for at in (first, last)]
        marks = np.union1d(*groups)
        at_marks = functions(marks)
        sums = np.zeros((marks.size + 1, at_marks.shape[1]))  # over the groups before each mark, from the mark before
        for block in blocks(self.count):
            begin, end = np.searchsorted(marks, (block[0] + 1, block[-1] + 1))
            starts = np.append(0, marks[begin:end] - block[0])
            sums[begin : end + 1] += np.add.reduceat(functions(block) * widths[block], starts, axis=0)
        sums = np.cumsum(sums, axis=0)

        def until(sample: Indices, group: Indices) -> Array:
            mark = np.searchsorted(marks, group)
            return np.asarray(sums[mark] + (sample - edges[group])[:, None] * at_marks[mark])

        before, after = until(first, groups[0]), until(last, groups[1])
        return np.asarray((after - before) / np.maximum(last - first, 1)[:, None])

    def at_samples(self, values: Array) -> Array:
        """Return values (g, k) of the groups between their middles, (n, k)."""
        middle = 0.5 * (self.begin + self._ends - 1)
        every = np.arange(self.samples)
        return np.stack([np.interp(every, middle, column) for column in values.T], axis=1)
