"""What parts of a recording say about the parameters, each by itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kreisel.geometry.rotation import Array, Indices


@dataclass(frozen=True)
class Blocks:
    """What blocks of updates say about constant parameters; navigation and all that changes are eliminated.

    Under the model scores are independent of each other and of mean zero at the true parameters, and each has its
    information as covariance.

    Attributes
    ----------
    parameters : (n,)
        Degrees of freedom of the state that are constant: `Problem.constant`.
    ends : (B,)
        Number of the update before which each block ends.
    information : (B, n, n)
        Information matrix that a block adds to those before it.
    score : (B, n)
        Gradient of its log-likelihood at the fit. A Newton step from the fit by a block alone is information^-1 score.
    """

    parameters: Indices
    ends: Indices
    information: Array
    score: Array

    def about(self, step: Array) -> Blocks:
        """Return the blocks linearised about another fit, a step (degrees,) of the state away."""
        return replace(self, score=self.score - self.information @ step[self.parameters])


def increments(parameters: Indices, ends: Indices, distance: Array, covariance: Array) -> Blocks:
    """Return the blocks between moments at which estimate and covariance of the parameters are known.

    Parameters
    ----------
    parameters : (n,)
        Their places in the state.
    ends : (B,)
        Of the blocks.
    distance : (B + 1, n)
        Of the estimate from the fit, before the first block and after each.
    covariance : (B + 1, n, n)
        Of the parameters then, all else eliminated.
    """
    size = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[-1])
    scaled = covariance / np.outer(size, size)
    information = np.linalg.inv(0.5 * (scaled + np.swapaxes(scaled, 1, 2))) / np.outer(size, size)
    gradient = np.einsum("bij,bj->bi", information, distance)
    return Blocks(parameters, ends, np.diff(information, axis=0), np.diff(gradient, axis=0))
