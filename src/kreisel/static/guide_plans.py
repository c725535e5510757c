"""Which attitude is to follow: by the method, and by what the readings so far leave open."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, Mask
from kreisel.recording.recording import ImuSamples
from kreisel.static.rests import Rests

APART, SAME = np.radians(20.0), np.radians(12.0)
"""Angles between attitudes that count as different, and as the same one again."""

FACES, FLAT = 6, 0.26
"""Of the candidates, those that come first are the faces; rad, largest tilt of a standstill on one, as in
`static_methods`."""

_ROUND = 0.15
"""Share by which a whole turn by uncalibrated gyros may differ from one. Chosen: no device errs by more."""

_LEAST, _ATTEMPTS = 0.02, 3
"""Revolutions that count as a turn, and turns on one face after which another one is next."""

_QUARTERS, _MOUNTINGS = 4, 3
"""Turns in one mounting on a hinge, by a quarter each, there and back; axes of the device that it is to turn about."""

CANDIDATES: Array = np.array(
    sorted((v for v in itertools.product((1.0, 0.0, -1.0), repeat=3) if any(v)), key=lambda v: sum(map(abs, v)))
)
CANDIDATES /= np.linalg.norm(CANDIDATES, axis=1, keepdims=True)
"""Directions in the device that may be up, (26, 3): its faces, edges and corners, in this order."""


@dataclass(frozen=True)
class Seen:
    """What the standstills so far were.

    Attributes
    ----------
    had : (M, 3)
        What was up, of unit length.
    about : (M - 1,)
        Revolutions about the vertical from each to the next, of those that leave the same side up; zero of others.
    axes : (M - 1, 3)
        Axis of the device that it mostly turned about from each to the next, of either sign, of unit length.
    """

    had: Array
    about: Array
    axes: Array

    @property
    def rounds(self) -> Mask:
        """Which turns were whole ones about the vertical, (M - 1,)."""
        number = np.round(self.about)
        return np.asarray((number >= 1.0) & (np.abs(self.about - number) < _ROUND * number))

    @property
    def attitudes(self) -> int:
        """Number of attitudes that differ."""
        kept: list[Array] = []
        for up in self.had:
            if not kept or angles(np.array(kept), up).min() > SAME:
                kept.append(up)
        return len(kept)

    @property
    def faces(self) -> Array:
        """How often each face was up, (6,)."""
        return np.array([np.count_nonzero(angles(self.had, face) < FLAT) for face in CANDIDATES[:FACES]])

    @property
    def turned_round(self) -> set[int]:
        """Axes about which there was a whole turn."""
        return {int(np.argmax(np.abs(up))) for up in self.had[:-1][self.rounds]}


def seen(imu: ImuSamples, rests: Rests) -> Seen:
    """Return what the standstills were, and which turns between them were whole ones."""
    had = directions(rests.forces)
    if rests.count < 2:
        return Seen(had, np.zeros(0), np.zeros((0, 3)))
    offset = np.median(rests.rates, axis=0)
    step = np.diff(imu.seconds, prepend=imu.seconds[0])[:, None]
    rates = imu.rates - offset
    angle = np.cumsum(rates * step, axis=0)
    way = angle[rests.first[1:]] - angle[rests.last[:-1] - 1]
    squares = [rates[a:b].T @ rates[a:b] for a, b in zip(rests.last[:-1], rests.first[1:], strict=True)]
    axes = np.linalg.eigh(np.array(squares))[1][:, :, -1]
    about = np.abs(np.einsum("mi,mi->m", way, had[:-1])) / (2.0 * np.pi)
    same = np.einsum("mi,mi->m", had[:-1], had[1:]) > np.cos(SAME)
    return Seen(had, np.where(same, about, 0.0), np.asarray(axes))


Worth = Callable[[Array, Array], Array]
"""What each of some directions (k, 3) would say, (k,), if up (3,) is up now."""


@dataclass(frozen=True)
class Plan:
    """What a method asks for.

    Attributes
    ----------
    method
        One of `static_methods.METHODS`, or none.
    standstills, attitudes
        With which an accepted result is enough where no accuracy is asked for.
    """

    method: str | None
    standstills: int
    attitudes: int

    def complete(self, so_far: Seen) -> bool:
        """Return whether the method has what it needs for an estimate."""
        if self.method == "six-position":
            return bool(so_far.faces.all())
        return self.method != "ferraris" or bool(so_far.faces.all() and len(so_far.turned_round) == 3)

    def enough(self, so_far: Seen) -> bool:
        """Return whether there were as many standstills and attitudes as a result needs by experience."""
        return len(so_far.had) >= self.standstills and so_far.attitudes >= self.attitudes

    def next(self, so_far: Seen, up: Array, worth: Worth) -> tuple[Array | None, str]:
        """Return what is to be up next, (3,), if that is known, and what to do, one sentence."""
        if self.method == "hinge":
            return None, _about_the_hinge(so_far.axes)
        if self.method == "ferraris" and self._to_be_turned_round(so_far, up):
            last = float(so_far.about[-1]) if so_far.about.size else 0.0
            was = f" (that was about {10 * round(36.0 * last)} deg)" if _LEAST < last < 1.0 - _ROUND else ""
            return up, f"Leave it on this face, and turn it once round on the table, by 360 deg{was}. Then hold still."
        if self.method in ("six-position", "ferraris"):
            wanted = _rarest_face(so_far, up)
        else:
            wanted = _most_telling(so_far.had, up, worth)
        return wanted, _ask(wanted)

    def _to_be_turned_round(self, so_far: Seen, up: Array) -> bool:
        """Return whether a whole turn is to follow: one about each axis first, and none that fails again and again."""
        near = float(angles(CANDIDATES[:FACES], up).min()) < SAME
        laid = int(np.max(np.flatnonzero(so_far.about == 0.0) + 1, initial=0))
        if not near or np.count_nonzero(so_far.about[laid:] > _LEAST) >= _ATTEMPTS:
            return False
        if int(np.argmax(np.abs(up))) not in so_far.turned_round:
            return True
        return self.complete(so_far) and not so_far.rounds[-1]


PLANS = {
    None: Plan(None, 18, 12), "multi-position": Plan("multi-position", 18, 12),
    "six-position": Plan("six-position", 12, 6), "ferraris": Plan("ferraris", 12, 6), "hinge": Plan("hinge", 18, 3),
}  # fmt: skip
"""Plans by the stated method. Chosen: with these numbers simulated devices are accepted."""


def _about_the_hinge(axes: Array) -> str:
    """Return what to do after turns about these axes (n, 3): enough about one of them, and then about another."""
    alike = np.abs(axes @ axes.T) > np.cos(APART)
    now = alike[-1] if len(axes) else np.zeros(0, dtype=bool)
    run = int(np.argmin(np.append(now[::-1], False)))
    many = alike.sum(axis=1) >= _QUARTERS
    mountings = int(np.linalg.matrix_rank(axes[many].T @ axes[many], tol=np.sin(APART) ** 2)) if many.any() else 0
    if run < _QUARTERS and mountings < _MOUNTINGS and np.count_nonzero(now) - run >= _QUARTERS:
        return "The hinge turns it about the same of its axes as before. Fix it with another one along the hinge's."
    if run and run % _QUARTERS == 0:
        return "Fix it to the hinge with another of its axes along the hinge's, then hold still."
    return "Turn it about the hinge by about 90 deg, then hold still."


def _rarest_face(so_far: Seen, up: Array) -> Array:
    count = np.where(angles(CANDIDATES[:FACES], up) < APART, np.inf, so_far.faces)
    return np.asarray(CANDIDATES[int(np.argmin(count))])


def _most_telling(had: Array, up: Array, worth: Worth) -> Array:
    """Return the direction that says most, one that nobody has had before others."""
    free = np.array([not len(had) or float(angles(had, c).min()) > APART for c in CANDIDATES])
    if not free.any():
        free = angles(CANDIDATES, up) > APART
    candidates = CANDIDATES[free]
    return np.asarray(candidates[int(np.argmax(worth(candidates, up)))])


def _ask(wanted: Array) -> str:
    words = [f"{axis} {'up' if v > 0.0 else 'down'}" for axis, v in zip("xyz", wanted, strict=True) if abs(v) > 1e-3]
    how = ("", " on its face", " on an edge, at 45 deg", " on a corner")[len(words)]
    return f"Turn it gently{how}: {' and '.join(words)}. Then hold still."


def directions(forces: Array) -> Array:
    """Return vectors (n, 3) with unit length."""
    return np.asarray(forces / np.maximum(np.linalg.norm(forces, axis=1, keepdims=True), 1e-9))


def angles(vectors: Array, one: Array) -> Array:
    """Return the angles between unit vectors (n, 3) and one of them, (n,)."""
    return np.asarray(np.arccos(np.clip(vectors @ one, -1.0, 1.0)))
