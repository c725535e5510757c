"""Functions that are polynomials piece by piece: joint angles over time, their derivatives and integrals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array


@dataclass(frozen=True)
class Piecewise:
    """A function of time; before and after its pieces the first and the last one go on.

    Attributes
    ----------
    breaks : (k + 1,)
        Where the pieces begin, and where the last one ends; ascending.
    coefficients : (k, m)
        Of each piece, in the time since its beginning; the highest power first.
    """

    breaks: Array
    coefficients: Array

    def __call__(self, t: Array) -> Array:
        """Return the values (n,) at times (n,)."""
        piece = np.clip(np.searchsorted(self.breaks, t, side="right") - 1, 0, len(self.coefficients) - 1)
        since = t - self.breaks[piece]
        out = np.zeros_like(since)
        for column in self.coefficients.T:
            out = out * since + column[piece]
        return out

    def derivative(self) -> Piecewise:
        """Return the derivative."""
        powers = np.arange(self.coefficients.shape[1] - 1, 0, -1)
        return Piecewise(self.breaks, self.coefficients[:, :-1] * powers)

    def antiderivative(self) -> Piecewise:
        """Return the integral from the first break on."""
        own = self.coefficients / np.arange(self.coefficients.shape[1], 0, -1)
        whole = Piecewise(self.breaks, np.column_stack([own, np.zeros(len(own))]))
        lengths = np.diff(self.breaks)
        steps = np.zeros(len(own))
        for column in whole.coefficients.T:
            steps = steps * lengths + column
        before = np.concatenate([[0.0], np.cumsum(steps[:-1])])
        return Piecewise(self.breaks, np.column_stack([own, before]))
