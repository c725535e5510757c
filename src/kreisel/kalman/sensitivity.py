"""What terms outside the state do to a run of the filter: derivatives of its estimate and innovations.

A constant that is left out of the state moves estimates and innovations in proportion (Friedland 1969). The factors
follow the filter's own recursion, so hundreds of terms cost as much as a few runs, not as the cube of their number.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from kreisel._kernels.slope_recursions import SlopeTerms, carry_terms
from kreisel.fitting.terms import ACCEL_ROWS, POSE_ROWS, Terms
from kreisel.geometry.rotation import Array
from kreisel.kalman.run_slopes import Slopes, Stretch, offsets
from kreisel.model.problem import Problem

PARTS = 20
"""Parts of a recording, of equal numbers of updates, whose sums are kept."""


class Sensitivity:
    """Derivatives by the terms' amplitudes, carried along the slopes of a run.

    Attributes
    ----------
    state : (n, m)
        Of the estimate after all updates.
    information : (m, m)
        Sum of products of the derivatives of whitened innovations.
    part_information : (p, m, m)
        The same by parts of the recording, of single precision.
    part_scores : (p, m)
        By parts, the sum of their products with the innovations.
    misfit, degrees
        Sum of normalised innovations squared of the updates that were used, and their number.
    innovations : (u, 9, m)
        The derivatives, of single precision, if they are to be kept; else without updates.
    """

    def __init__(self, problem: Problem, terms: Terms, slopes: Slopes, *, kept: bool = False) -> None:
        m, row = terms.count, terms.row
        self._terms, self._position = terms, slopes.position
        of_force = (row >= ACCEL_ROWS.start) & (row < ACCEL_ROWS.stop)
        places = dict(zip(*(one.tolist() for one in offsets(problem)), strict=True))
        self._place = np.array([places[one] if one < POSE_ROWS.start else -1 for one in row.tolist()], dtype=np.int64)
        self._direction = np.where(row >= POSE_ROWS.start, row - POSE_ROWS.start, -1)
        self._axis = np.where(of_force, row - ACCEL_ROWS.start, -1)
        self.state, self.part_scores = np.zeros((slopes.degrees, m)), np.zeros((PARTS, m))
        self.information = np.zeros((m, m))
        self.part_information: NDArray[np.float32] = np.zeros((PARTS, m, m), np.float32)
        self.misfit, self.degrees = 0.0, 0.0
        self.innovations: NDArray[np.float32] = np.zeros((slopes.count if kept else 0, 9, m), np.float32)
        ends = np.linspace(0, slopes.count, PARTS + 1).astype(int).tolist()
        for part, (begin, end) in enumerate(pairwise(ends)):
            for stretch in slopes.stretches(begin, end):
                self._add(part, stretch)

    @property
    def score(self) -> Array:
        """Sum over all parts of their products with the innovations, (m,)."""
        return np.asarray(self.part_scores.sum(axis=0))

    def _add(self, part: int, stretch: Stretch) -> None:
        derivatives = carry_terms(stretch.tables, self._over(stretch), self.state)
        derivatives[~stretch.used] = 0.0
        if self.innovations.size:
            self.innovations[stretch.numbers] = derivatives
        rows, innovations = derivatives.reshape(-1, self._terms.count), stretch.innovations.ravel()
        products = rows.T @ rows
        self.information += products
        self.part_information[part] += products
        self.part_scores[part] += innovations @ rows
        self.misfit += float(innovations @ innovations)
        self.degrees += float(np.count_nonzero(stretch.counted))

    def _over(self, stretch: Stretch) -> SlopeTerms:
        """Return the terms over a stretch; what they add to readings is a change of offsets: equation (28)."""
        terms, own, W = self._terms, stretch.numbers, stretch.whitening
        moments = np.zeros((0, terms.functions.shape[1])) if terms.moments is None else terms.moments[own]
        axes = terms.axes[own]
        return SlopeTerms(
            np.ascontiguousarray(terms.functions[own]), np.ascontiguousarray(moments), terms.function, self._place,
            self._direction, self._axis, -(W[:, :, : len(POSE_ROWS)] @ terms.directions[own]),
            np.ascontiguousarray(axes), W[: len(axes), :, :3] @ axes, self._position,
        )  # fmt: skip
