"""Normal equations of a spline's control points and of parameters that all rows may depend on."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from kreisel.geometry.pose_spline import ORDER
from kreisel.geometry.rotation import Array, Indices

POINT = 6
"""Unknowns of a control point."""

WIDTH = ORDER * POINT
"""Unknowns of a span."""


@dataclass(frozen=True)
class Rows:
    """Weighted rows: residuals, and by how much they fall with small changes of the unknowns.

    Attributes
    ----------
    span : (m,)
        Spans they lie in, ascending.
    by_points : (m, r, WIDTH)
    by_parameters : (m, r, t)
    residual : (m, r)
    columns : (t, parameters)
        How local parameters follow from all.
    """

    span: Indices
    by_points: Array
    by_parameters: Array
    residual: Array
    columns: Array


@dataclass
class NormalEquations:
    """Sums over weighted rows; the matrix of the control points is banded, the parameters stand beside it.

    Attributes
    ----------
    points, parameters
        Numbers of control points and of parameters.
    band : (WIDTH, POINT points)
        Matrix of the control points, lower band.
    mixed : (POINT points, parameters)
    own : (parameters, parameters)
    of_points, of_parameters
        Right-hand sides.
    squares
        Sum of squared residuals.
    """

    points: int
    parameters: int
    band: Array = field(init=False)
    mixed: Array = field(init=False)
    own: Array = field(init=False)
    of_points: Array = field(init=False)
    of_parameters: Array = field(init=False)
    squares: float = 0.0

    def __post_init__(self) -> None:
        """Begin with zeros."""
        self.band = np.zeros((WIDTH, POINT * self.points))
        self.mixed = np.zeros((POINT * self.points, self.parameters))
        self.own = np.zeros((self.parameters, self.parameters))
        self.of_points = np.zeros(POINT * self.points)
        self.of_parameters = np.zeros(self.parameters)

    def add(self, of: Rows) -> None:
        """Add rows."""
        spans, first, place = np.unique(of.span, return_index=True, return_inverse=True)
        t, r = of.by_parameters.shape[2], of.residual.shape[1]
        rows = np.zeros((spans.size, int(np.diff([*first, of.span.size]).max()), r, WIDTH + t + 1))
        rows[place, np.arange(of.span.size) - first[place]] = np.concatenate(
            [of.by_points, of.by_parameters, of.residual[:, :, None]], axis=2
        )
        rows = rows.reshape(spans.size, -1, WIDTH + t + 1)
        products = np.swapaxes(rows, 1, 2) @ rows
        for b in range(WIDTH):
            for a in range(b, WIDTH):
                self.band[a - b, POINT * spans + b] += products[:, a, b]
        for product, own in zip(products, spans, strict=True):
            part = slice(POINT * own, POINT * own + WIDTH)
            self.mixed[part] += product[:WIDTH, WIDTH:-1] @ of.columns
            self.of_points[part] += product[:WIDTH, -1]
        whole = products.sum(axis=0)
        self.own += of.columns.T @ whole[WIDTH:-1, WIDTH:-1] @ of.columns
        self.of_parameters += of.columns.T @ whole[WIDTH:-1, -1]
        self.squares += float(whole[-1, -1])

    def steady(self, weight: float) -> None:
        """Let the steps of control points be parabolas where no row says anything; weight: of third differences."""
        difference = np.array([1.0, -3.0, 3.0, -1.0])
        first = POINT * np.arange(self.points - 3)[:, None] + np.arange(POINT)
        for b in range(4):
            for a in range(b, 4):
                np.add.at(self.band[POINT * (a - b)], first + POINT * b, weight * difference[a] * difference[b])

    def solve(self, information: Array, pull: Array) -> tuple[Array, Array, Array]:
        """Return the steps of the control points (points, POINT) and parameters, and the covariance of the latter.

        information, pull: what a prior adds to the equations of the parameters.

        Raises
        ------
        LinAlgError
            If the equations have no single solution.
        """
        from scipy.linalg import cho_solve_banded, cholesky_banded

        factor = cholesky_banded(self.band, lower=True)
        known = cho_solve_banded((factor, True), np.column_stack([self.mixed, self.of_points]))
        reduced = self.own + information - self.mixed.T @ known[:, :-1]
        scale = 1.0 / np.sqrt(np.diag(reduced))
        covariance = np.linalg.inv(reduced * np.outer(scale, scale)) * np.outer(scale, scale)
        step = covariance @ (self.of_parameters + pull - self.mixed.T @ known[:, -1])
        moved = known[:, -1] - known[:, :-1] @ step
        return moved.reshape(self.points, POINT), step, 0.5 * (covariance + covariance.T)
