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
        edges = np.append(self.begin, self.samples).astype(float)
        sums = np.zeros((self.count + 1, functions(np.zeros(1, dtype=np.int64)).shape[1]))
        for block in blocks(self.count):
            added = functions(block) * np.diff(edges)[block, None]
            sums[block + 1] = sums[block[0]] + np.cumsum(added, axis=0)

        def until(sample: Indices) -> Array:
            at = np.minimum(np.searchsorted(edges, sample, side="right") - 1, self.count - 1)
            share = (sample - edges[at]) / (edges[at + 1] - edges[at])
            return sums[at] + share[:, None] * (sums[at + 1] - sums[at])

        return np.asarray((until(last) - until(first)) / np.maximum(last - first, 1)[:, None])

    def at_samples(self, values: Array) -> Array:
        """Return values (g, k) of the groups between their middles, (n, k)."""
        middle = 0.5 * (self.begin + self._ends - 1)
        every = np.arange(self.samples)
        return np.stack([np.interp(every, middle, column) for column in values.T], axis=1)
