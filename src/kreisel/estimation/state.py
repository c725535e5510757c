"""One named layout for the state: where each part lies, and how small changes are added to it.

The state is stored as a column of numbers. Vectors are stored as they are; rotations as unit
quaternions, changed by right perturbations. A change of the state (an error, a sigma point's distance)
has one number for each degree of freedom: three for a rotation, not four.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kreisel._kernels import manifold
from kreisel.geometry.rotation import Array, Indices


@dataclass(frozen=True)
class Part:
    """A named part of the state.

    Attributes
    ----------
    name
        Name of the part.
    degrees
        Degrees of freedom. A rotation may have fewer than three; the others are held.
    rotation
        Whether it is a rotation.
    absent
        Which of its numbers are known and not in the state.
    """

    name: str
    degrees: int
    rotation: bool = False
    absent: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """Numbers it is stored in."""
        return 4 if self.rotation else self.degrees

    @property
    def whole(self) -> int:
        """Degrees of freedom with those that are not in the state."""
        return self.degrees + len(self.absent)


class StateLayout:
    """Parts of a state in their order.

    ``layout["velocity"]`` is the slice of that part in a change of the state, ``layout.stored("velocity")``
    that in the stored state. ``table`` (parts, 4) is the same for `_kernels.manifold`.
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = tuple(parts)
        self._degrees: dict[str, slice] = {}
        self._stored: dict[str, slice] = {}
        degree = place = 0
        for part in self.parts:
            self._degrees[part.name] = slice(degree, degree + part.degrees)
            self._stored[part.name] = slice(place, place + part.size)
            degree += part.degrees
            place += part.size
        self.degrees = degree
        self.size = place
        rows = [(self[p.name].start, p.degrees, self.stored(p.name).start, int(p.rotation)) for p in self.parts]
        self.table = np.array(rows, dtype=np.int64).reshape(-1, 4)
        self._whole = {p.name: p.whole for p in self.parts}
        self._present = {p.name: np.setdiff1d(np.arange(p.whole), p.absent) for p in self.parts}
        self._tails: dict[int, StateLayout] = {}

    def __contains__(self, name: str) -> bool:
        return name in self._degrees

    def __getitem__(self, name: str) -> slice:
        return self._degrees[name]

    def __iter__(self) -> Iterator[Part]:
        return iter(self.parts)

    def stored(self, name: str) -> slice:
        """Return the slice of a part in the stored state."""
        return self._stored[name]

    def present(self, name: str) -> Indices:
        """Return which of a part's degrees of freedom are in the state, (degrees,): all but those that are known."""
        return self._present[name]

    def whole(self, name: str) -> int:
        """Return a part's degrees of freedom with those that are not in the state."""
        return self._whole[name]

    def tail(self, degrees: int) -> StateLayout:
        """Return the layout of the last parts alone, which have so many degrees of freedom together."""
        if degrees not in self._tails:
            parts = [part for part in self.parts if self[part.name].start >= self.degrees - degrees]
            self._tails[degrees] = StateLayout(parts)
        return self._tails[degrees]

    def plus(self, x: Array, change: Array) -> Array:
        """Return the states (size, m) that lie changes (degrees, m) away from the state x (size,)."""
        return manifold.plus(self.table, x, change)

    def minus(self, states: Array, x: Array) -> Array:
        """Return the changes (degrees, m) that lead from the state x (size,) to states (size, m)."""
        return manifold.minus(self.table, states, x, self.degrees)
