"""Choices of sigma points: where they lie and how they are combined."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from kreisel.errors import SettingsError, unknown_name


@dataclass(frozen=True)
class SigmaWeights:
    """Spread and weights of symmetric sigma points x_0, x_0 [+] spread S_i, x_0 [-] spread S_i.

    With d the distances of the propagated points from the propagated centre, s_i = d_i+ + d_i- and
    m = mean * sum(s_i), the propagated mean lies m from the centre, and its covariance is the sum of the
    outer products of

    - ``(d_i+ - d_i-) / (2 spread)``,
    - ``second * (s_i - 2 shift m)``,
    - ``centre * m``.

    All choices here keep these weights real: the covariance is a sum of squares.
    """

    spread: float
    mean: float
    second: float
    shift: float
    centre: float


def central_difference(degrees: int) -> SigmaWeights:
    """Return the weights of Stirling's interpolation with h = sqrt(3), best for normal variables.

    Notes
    -----
    Norgaard, Poulsen and Ravn (2000); van der Merwe (2004), section 3.3.
    """
    del degrees  # the spread does not depend on it
    h2 = 3.0
    return SigmaWeights(math.sqrt(h2), 1.0 / (2.0 * h2), math.sqrt(h2 - 1.0) / (2.0 * h2), 0.0, 0.0)


def unscented(degrees: int) -> SigmaWeights:
    """Return the weights of the scaled unscented transform with alpha = 1, beta = 2, kappa = 0.

    Notes
    -----
    Julier and Uhlmann (1997); van der Merwe (2004), section 3.2. The centre's weight in the covariance is
    then 1 - alpha^2 + beta = 2 and its weight in the mean 0.
    """
    spread = math.sqrt(degrees)
    return SigmaWeights(spread, 1.0 / (2.0 * degrees), 1.0 / (2.0 * spread), 1.0, math.sqrt(2.0))


def cubature(degrees: int) -> SigmaWeights:
    """Return the weights of the spherical-radial rule of the third degree.

    Notes
    -----
    Arasaratnam and Haykin (2009): 2 n points of equal weight at a distance of sqrt(n).
    """
    spread = math.sqrt(degrees)
    return SigmaWeights(spread, 1.0 / (2.0 * degrees), 1.0 / (2.0 * spread), 1.0, 0.0)


def linear(degrees: int) -> SigmaWeights:
    """Return the weights of a linearisation, Jacobians by tiny differences: for bounds about the truth."""
    del degrees
    return SigmaWeights(1e-2, 0.0, 0.0, 0.0, 0.0)


WEIGHTS: dict[str, Callable[[int], SigmaWeights]] = {
    "central-difference": central_difference,
    "unscented": unscented,
    "cubature": cubature,
    "linear": linear,
}

USUAL = "central-difference"
"""The choice that nobody stated: best for normal variables."""

DERIVATIVES, ITERATED = "derivatives", "iterated derivatives"
"""In the place of a choice of sigma points: the models' derivatives, and no points at all; about the state before an
update, or again about what the update makes of it."""

LINEARISATIONS = {DERIVATIVES: 1, ITERATED: 5}
"""How often an update is linearised, at most. Chosen: from 10 deg away the second and third are enough."""


def weights(name: str, degrees: int) -> SigmaWeights:
    """Return the weights of that name for a state of so many degrees of freedom."""
    if name in LINEARISATIONS:
        return SigmaWeights(1.0, 0.0, 0.0, 0.0, 0.0)
    if name not in WEIGHTS:
        raise SettingsError(unknown_name("choice of sigma points", name, WEIGHTS))
    return WEIGHTS[name](degrees)
