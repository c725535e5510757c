"""Functions of what sensors and reference go through: generic terms are made of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np

from kreisel._kernels.recursions import gauss_markov
from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.refinement.sample_groups import STEP

WAVES = 8
"""Half waves of a function of time over the recording."""

_SLOW = 4
"""Half waves of a scale factor that changes over the recording."""

MEMORY = 15.0
"""s; time constant of a sensor that depends on what happened before."""

_CLIP = 3.0
"""Spreads of a quantity beyond which a function no longer grows as a polynomial."""

_END = 0.05
"""Share of a range within which a reading is near its end. Chosen: filters or matrices of factories round by less what
is cut off."""

_ENOUGH = 6000
"""Values by which a function is separated from the usual model."""

_SURE = 5.0
"""Standard deviations of its noise from which the sign of a reading is that of the motion: one in a million is not."""

_LEAST = 1e-3
"""Rms of a function, as a share, below which the usual model has all of it."""


@dataclass(frozen=True)
class Basis:
    """Functions of some quantities.

    Attributes
    ----------
    of
        From indices of samples to values (n, k).
    degree : (k,)
        Their degrees, which say how large they may be.
    last : (k,)
        Those that the next degree of their kind would follow, if series had no end; the highest degree if None.
    apart
        Whether they are no error of axes or offsets, though over a recording they may look like one: nothing is taken
        out of them.
    alike
        Whether amplitudes are expected to be alike as the functions are, instead of each over its rms.
    """

    of: Callable[[Indices], Array]
    degree: Array
    last: Mask | None = None
    apart: bool = False
    alike: bool = False

    @property
    def ends(self) -> Mask:
        """See `last`."""
        return self.degree == self.degree.max() if self.last is None else self.last


@dataclass(frozen=True)
class Functions:
    """Functions of some quantities, without what the usual model has.

    Attributes
    ----------
    raw
        From indices of samples to values (n, k), before anything is taken out.
    usual
        From indices of samples to what the usual model has (n, j).
    share : (j, k)
        How much of each is in the functions.
    scale : (k,)
        By what the functions are divided: the rms of each, or of all.
    degree, ends : (k,)
        As of their basis.
    kept : (k,)
        Their places in the basis.
    """

    raw: Callable[[Indices], Array]
    usual: Callable[[Indices], Array]
    share: Array
    scale: Array
    degree: Array
    ends: Mask
    kept: Indices

    def __call__(self, which: Indices) -> Array:
        """Return the functions at samples, (n, k)."""
        return self.without_usual(self.raw(which), self.usual(which))

    def without_usual(self, raw: Array, usual: Array) -> Array:
        """Return the functions from what they are made of, both (n, …) at the same samples or averaged alike."""
        return np.asarray((raw - usual @ self.share)[:, self.kept] / self.scale)


@dataclass(frozen=True)
class Usual:
    """What the usual model has, to be taken out of functions.

    Attributes
    ----------
    of
        From indices of samples to its columns (n, j).
    count
        Number of samples.
    slow
        Slow waves at `some` samples, orthonormal, (m, k), with which functions have something in common by chance
        alone: of them a constant is taken out, and what they share with faster changes.
    """

    of: Callable[[Indices], Array]
    count: int
    slow: Array | None = None

    @cached_property
    def _columns(self) -> Array:
        return self.of(some(self.count))

    @cached_property
    def _inverse(self) -> Array:
        columns = self._columns
        if self.slow is not None:
            columns = columns - self.slow @ (self.slow.T @ columns)
            columns[:, 0] = self._columns[:, 0]
        return np.asarray(np.linalg.pinv(columns, rcond=1e-9))

    def without(self, basis: Basis, values: Array | None = None) -> Functions:
        """Return functions without what the usual model has; values: theirs at `some` samples, if they are known."""
        values = basis.of(some(self.count)) if values is None else values
        share = np.zeros((self._columns.shape[1], values.shape[1])) if basis.apart else self._inverse @ values
        rms = np.sqrt(np.mean((values - self._columns @ share) ** 2, axis=0))
        kept = np.flatnonzero(rms > _LEAST * np.maximum(np.sqrt(np.mean(values**2, axis=0)), 1e-300))
        scale = np.full(kept.size, float(np.sqrt(np.mean(rms**2)))) if basis.alike else rms[kept]
        return Functions(basis.of, self.of, share, scale, basis.degree[kept], basis.ends[kept], kept)


def some(count: int) -> Indices:
    """Return evenly spread numbers below `count`, enough for a mean."""
    chosen = min(count, _ENOUGH)
    return np.arange(chosen) * (count - 1) // max(chosen - 1, 1)


def polynomials(of: Callable[[Indices], Array], count: int, degree: int, alone: int = 0) -> Basis:
    """Return products of quantities (n, k) up to a degree, and powers of each up to another.

    of: from indices of `count` samples to the quantities.
    """
    x = of(some(count))
    mean, spread = x.mean(axis=0), x.std(axis=0)
    chosen = [c for d in range(1, degree + 1) for c in combinations_with_replacement(range(x.shape[1]), d)]
    chosen += [(i,) * d for d in range(degree + 1, alone + 1) for i in range(x.shape[1])]
    place = {c: i for i, c in enumerate(chosen)}  # a product follows from one of a degree less, which stands before it

    def values(which: Indices) -> Array:
        z = _CLIP * np.tanh((of(which) - mean) / np.where(spread > 0.0, _CLIP * spread, 1.0)).T
        out = np.empty((len(chosen), which.size))
        for row, c in zip(out, chosen, strict=True):
            before = place.get(c[:-1])
            np.multiply(z[c[-1]], 1.0 if before is None else out[before], out=row)
        return out.T

    degrees = np.array([len(c) for c in chosen])
    powers = np.array([len(set(c)) == 1 for c in chosen])
    return Basis(values, degrees.astype(float), degrees == np.where(powers, max(degree, alone), degree))


def ends_of_range(own: Array) -> Basis:
    """Return functions of the ends of own readings (n, 3), axis by axis, where a range may be exceeded."""
    largest, least = own.max(axis=0), own.min(axis=0)
    margin = _END * (largest - least)

    def values(which: Indices) -> Array:
        x = own[which]
        beyond = (np.maximum(x - largest + margin, 0.0), np.minimum(x - least - margin, 0.0))
        return np.stack(beyond, axis=2).reshape(which.size, -1)

    return Basis(values, np.ones(2 * own.shape[1]), apart=True)


def signs(own: Array, noise: Array) -> Basis:
    """Return the signs of own readings (n, 3), axis by axis: truncated ones lack half a step, converters have one.

    Readings that noise (3,) may have given their sign have none: at rest it would be that of their own noise.
    """
    least = _SURE * noise

    def values(which: Indices) -> Array:
        x = own[which]
        return np.asarray(np.where(np.abs(x) > least, np.sign(x), 0.0))

    return Basis(values, np.ones(own.shape[1]), apart=True)


def changes(first: Array, second: Array) -> Basis:
    """Return products of two of the first derivatives (n, 3) of readings, and both derivatives as they are.

    Delays and smoothings of other axes than the readings' own are proportional to these.
    """
    products = polynomials(first.__getitem__, len(first), 2)
    linear = np.hstack([_unit(first), _unit(second)])
    degree = np.concatenate([np.ones(linear.shape[1]), products.degree])
    return Basis(lambda which: np.hstack([linear[which], products.of(which)]), degree)


def _unit(values: Array) -> Array:
    """Return columns (n, k) over their rms."""
    return np.asarray(values / np.maximum(np.sqrt(np.mean(values**2, axis=0)), 1e-300))


def waves(t: Array) -> Basis:
    """Return half waves over times t (n,), and their orders as degrees."""
    orders = np.arange(1, WAVES + 1)
    return Basis(cosines(t, orders), np.maximum(orders / 2.0, 1.0))


def cosines(t: Array, orders: Indices) -> Callable[[Indices], Array]:
    """Return half waves of some orders over times t (n,), (m, k), as a function of m indices of samples."""
    z = np.pi * (t - t[0]) / max(float(t[-1] - t[0]), 1e-9)
    return lambda which: np.cos(z[which, None] * orders)


def scales(own: Array, t: Array) -> Basis:
    """Return own readings (n, 3) times slow half waves over times t (n,), axis by axis."""
    over_time, slow = waves(t), slice(0, _SLOW)

    def values(which: Indices) -> Array:
        products = own[which, :, None] * over_time.of(which)[:, None, slow]
        return np.asarray(products.reshape(which.size, -1))

    return Basis(values, np.tile(over_time.degree[slow], own.shape[1]))


def remembered(values: Array) -> Array:
    """Return what is left of values (n, k), one every `STEP`, that fade with a time constant."""
    keep, out = np.exp(-STEP / MEMORY), np.empty_like(values)
    white = (1.0 - keep) / np.sqrt(1.0 - keep**2) * values
    white[0] = values[: max(1, round(MEMORY / STEP))].mean(axis=0)
    gauss_markov(np.full(len(values) - 1, keep), np.ascontiguousarray(white), out)
    return out


def of_angles(angles: Array) -> Basis:
    """Return sines and cosines of all joint angles (n, j)."""
    return Basis(lambda which: np.hstack([np.sin(angles[which]), np.cos(angles[which])]), np.ones(2 * angles.shape[1]))


def of_own_angle(angles: Array) -> Basis:
    """Return functions of each joint's own angle and sense of rotation, joint after joint."""
    speed = np.gradient(angles, axis=0)
    spread = np.maximum(speed.std(axis=0), 1e-300)

    def values(which: Indices) -> Array:
        q, sense = angles[which], np.tanh(_CLIP * speed[which] / spread)
        own = np.stack([np.sin(2.0 * q), np.cos(2.0 * q), np.sin(3.0 * q), np.cos(3.0 * q), sense], axis=2)
        return own.reshape(len(own), -1)

    return Basis(values, np.tile([1.0, 1.0, 1.5, 1.5, 1.0], angles.shape[1]))
