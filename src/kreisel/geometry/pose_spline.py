"""Smooth motions: B-splines of positions and of unit quaternions, and their derivatives by the control points.

The attitude is the normalised spline of unit quaternions. It is as smooth as a cumulative spline on the rotations, and
its rate and angular acceleration are rational functions of the control points, whose derivatives are short.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from kreisel.geometry.rotation import Array, Indices, conjugate, exp, multiply, skew

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

ORDER = 6
"""Control points of a span: polynomials of the fifth degree, so that accelerations are smooth. Chosen: that of Furgale,
Rehder and Siegwart (2013)."""


@cache
def _pieces() -> tuple[BSpline, ...]:
    from scipy.interpolate import BSpline

    element = BSpline.basis_element(np.arange(ORDER + 1), extrapolate=False)
    return element, element.derivative(), element.derivative(2)


def weights(u: Array, spacing: float) -> Array:
    """Return the weights (3, m, ORDER) of the control points of a span: of the value and of two derivatives.

    u (m,): places within the span, from 0 to 1. spacing: of the control points, s.
    """
    at = u[:, None] + (ORDER - 1 - np.arange(ORDER))
    own = [np.nan_to_num(piece(at)) / spacing**i for i, piece in enumerate(_pieces())]
    return np.asarray(own, dtype=float)


@dataclass(frozen=True)
class PoseSpline:
    """A motion.

    Attributes
    ----------
    begin, spacing
        Second at which the first span begins, and length of a span.
    positions : (c, 3)
        Control points, m; c is the number of spans plus `ORDER` - 1.
    quaternions : (c, 4)
        Control points, of unit length, neighbours of the same sign.
    """

    begin: float
    spacing: float
    positions: Array
    quaternions: Array

    @property
    def spans(self) -> int:
        """How many spans there are."""
        return len(self.positions) - ORDER + 1

    @property
    def centres(self) -> Array:
        """Seconds at which the weights of the control points are largest, (c,)."""
        return centres(self.begin, self.spacing, len(self.positions))

    def span_of(self, seconds: Array) -> tuple[Indices, Array]:
        """Return in which span times (m,) lie, and the places within."""
        at = (seconds - self.begin) / self.spacing
        span = np.clip(at.astype(np.int64), 0, self.spans - 1)
        return span, at - span

    def reaches(self, begin: float, end: float) -> bool:
        """Return whether its spans are those of a motion between two times."""
        return self.begin == begin and len(self.positions) == count_of(end - begin, self.spacing)

    def moved(self, step: Array) -> PoseSpline:
        """Return the spline with its control points moved, (c, 6): turned on the right, then shifted."""
        turned = multiply(self.quaternions, exp(step[:, :3]))
        return PoseSpline(self.begin, self.spacing, self.positions + step[:, 3:], turned)


def centres(begin: float, spacing: float, count: int) -> Array:
    """Return the seconds at which the weights of control points are largest, (count,)."""
    return np.asarray(begin + spacing * (np.arange(count, dtype=float) + 1.0 - 0.5 * ORDER), dtype=float)


def count_of(length: float, spacing: float) -> int:
    """Return the number of control points of a spline of some seconds."""
    return max(1, int(np.ceil(length / spacing))) + ORDER - 1


@dataclass(frozen=True)
class Motion:
    """A motion at m times, with derivatives by the ORDER control points of each time's span.

    Attributes
    ----------
    q : (m, 4)
        Attitude.
    omega, alpha : (m, 3)
        Angular rate and acceleration, along the body's axes.
    p, v, a : (m, 3)
        Position, velocity and acceleration.
    turn, of_omega, of_alpha : (m, ORDER, 3, 3)
        Derivatives of the attitude (a turn on its right), rate and acceleration by turns of the control points.
    weights : (3, m, ORDER)
        Derivatives of p, v and a by shifts of the control points.
    """

    q: Array
    omega: Array
    alpha: Array
    p: Array
    v: Array
    a: Array
    turn: Array
    of_omega: Array
    of_alpha: Array
    weights: Array


def motion_at(spline: PoseSpline, seconds: Array) -> Motion:
    """Return the motion of a spline at times (m,) within it.

    Notes
    -----
    With s the sum of weighted quaternions and N = |s|^2, omega = 2 Im(s* s') / N, and alpha is its derivative. A turn d
    of control point k changes s by w_k q_k (0, d / 2).
    """
    span, u = spline.span_of(seconds)
    w = weights(u, spline.spacing)
    own = span[:, None] + np.arange(ORDER)
    q, p = spline.quaternions[own], spline.positions[own]
    s = np.einsum("dmk,mki->dmi", w, q)
    N = np.einsum("mi,mi->m", s[0], s[0])[:, None]
    N1 = 2.0 * np.einsum("mi,mi->m", s[0], s[1])[:, None]
    first, second = (2.0 * multiply(conjugate(s[0]), s[i])[:, 1:] / N for i in (1, 2))
    omega, alpha = first, second - first * N1 / N
    seen = [multiply(conjugate(s[i])[:, None], q) for i in range(3)]
    G = [part[..., :1, None] * np.eye(3) + skew(part[..., 1:]) for part in seen]
    w0, w1, w2 = (part[:, :, None, None] for part in w)
    N_, N1_ = N[:, :, None, None], N1[:, :, None, None]
    of_N = -(w[0][:, :, None] * seen[0][..., 1:])
    of_N1 = -(w[0][:, :, None] * seen[1][..., 1:] + w[1][:, :, None] * seen[0][..., 1:])
    turn = w0 * G[0] / N_
    of_omega = (w1 * G[0] - w0 * G[1]) / N_ - _outer(first, of_N) / N_
    of_second = (w2 * G[0] - w0 * G[2]) / N_ - _outer(second, of_N) / N_
    of_alpha = of_second - of_omega * N1_ / N_ - _outer(first, of_N1) / N_ + _outer(first, of_N) * N1_ / N_**2
    along = np.einsum("dmk,mki->dmi", w, p)
    attitude = s[0] / np.sqrt(N)
    return Motion(attitude, omega, alpha, along[0], along[1], along[2], turn, of_omega, of_alpha, w)


def _outer(a: Array, b: Array) -> Array:
    """Return the products (m, k, 3, 3) of vectors (m, 3) with rows (m, k, 3)."""
    return a[:, None, :, None] * b[:, :, None, :]
