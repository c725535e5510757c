"""Parameters of a run, eliminated from what its data say of terms outside the state."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kreisel.geometry.rotation import Array


class Elimination(NamedTuple):
    """Covariance of a run's parameters, information matrices (n, n), and distances (n,), in units of `scale` (n,).

    Informations of the run, of the belief it started with, and of the problem's prior; distances to the latter two.
    """

    scale: Array
    P: Array
    run: Array
    begun: Array
    prior: Array
    to_begun: Array
    to_prior: Array

    @property
    def information(self) -> Array:
        """Of the parameters, by data and prior."""
        return np.asarray(self.run - self.begun + self.prior)

    def step(self, to_begun: Array, to_prior: Array) -> Array:
        """Return the way (n, k) from the run's result to that with the problem's prior, for distances (n, k)."""
        return np.asarray(np.linalg.solve(self.information, self.prior @ to_prior - self.begun @ to_begun))

    def drawn(self, to_begun: Array, rng: np.random.Generator) -> Array:
        """Return steps (n, k) as they are by chance, for distances (n, k) of the begun belief that innovations made."""
        true = np.linalg.cholesky(self.P) @ rng.standard_normal(to_begun.shape)
        error = np.linalg.solve(np.linalg.cholesky(self.prior).T, rng.standard_normal(to_begun.shape))
        return self.step(to_begun, true + error)
