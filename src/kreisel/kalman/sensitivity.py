"""What terms outside the state do to a run of the filter: derivatives of its estimate and innovations.

A constant that is left out of the state moves estimates and innovations in proportion (Friedland 1969). The factors
follow the filter's own recursion, so hundreds of terms cost as much as a few runs, not as the cube of their number.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kreisel.fitting.terms import ACCEL_ROWS, POSE_ROWS, Terms
from kreisel.geometry.rotation import Array
from kreisel.kalman.run_slopes import Slope, Slopes, offsets
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
        m = terms.count
        self._terms, self._along = terms, slopes
        self.state, self.part_scores = np.zeros((slopes.degrees, m)), np.zeros((PARTS, m))
        self.information = np.zeros((m, m))
        self.part_information: NDArray[np.float32] = np.zeros((PARTS, m, m), np.float32)
        self.misfit, self.degrees = 0.0, 0.0
        self._of_sensor = np.flatnonzero(terms.row < POSE_ROWS.start)
        self._of_pose = np.flatnonzero(terms.row >= POSE_ROWS.start)
        self._of_force = np.flatnonzero((terms.row >= ACCEL_ROWS.start) & (terms.row < ACCEL_ROWS.stop))
        places = dict(zip(*(one.tolist() for one in offsets(problem)), strict=True))
        self._offset = np.array([places[int(row)] for row in terms.row[self._of_sensor]], dtype=np.int64)
        self._direction = terms.row[self._of_pose] - POSE_ROWS.start
        self._axis = terms.row[self._of_force] - ACCEL_ROWS.start
        self.innovations: NDArray[np.float32] = np.zeros((slopes.count if kept else 0, 9, m), np.float32)
        self._run()

    @property
    def score(self) -> Array:
        """Sum over all parts of their products with the innovations, (m,)."""
        return np.asarray(self.part_scores.sum(axis=0))

    def _run(self) -> None:
        ends = np.linspace(0, self._along.count, PARTS + 1).astype(np.int64)[1:]
        part, rows = 0, []
        for slope in self._along:
            self._along.between(slope.number, self.state)
            innovation = self._step(slope)
            if slope.used:
                self.state -= slope.gain.T @ innovation
                self.part_scores[part] += slope.innovation @ innovation
                self.misfit += float(slope.innovation @ slope.innovation)
                self.degrees += float(np.count_nonzero(slope.measured))
                rows.append(innovation[slope.measured])
                if self.innovations.size:
                    self.innovations[slope.number] = innovation
            while part < PARTS and slope.number + 1 >= ends[part]:
                products = self._products(rows)
                self.information += products
                self.part_information[part] = products
                part, rows = part + 1, []

    def _products(self, rows: list[Array]) -> Array:
        whole = np.concatenate([np.zeros((0, self._terms.count)), *rows])
        return np.asarray(whole.T @ whole)

    def _step(self, slope: Slope) -> Array:
        """Predict over an update; return the derivatives of its whitened prediction, (9, m)."""
        i, terms = slope.number, self._terms
        value = terms.functions[i, terms.function]
        sensor, pose = value[self._of_sensor], value[self._of_pose]
        # equation (28): a term of the readings is a change of the offset for as long as the update lasts
        self.state[self._offset, self._of_sensor] += sensor
        predicted = slope.slopes @ self.state
        self.state[self._offset, self._of_sensor] -= sensor
        moving = self._along.moving
        self.state[moving] = predicted[: moving.stop - moving.start]
        innovation = predicted[moving.stop - moving.start :]
        if terms.moments is not None:
            moved = terms.axes[i][:, self._axis] * terms.moments[i, terms.function[self._of_force]]
            at = self._along.position
            self.state[at : at + 3, self._of_force] += moved
            innovation[:, self._of_force] += slope.whitening[:, :3] @ moved
        directions = slope.whitening[:, : len(POSE_ROWS)] @ terms.directions[i]
        innovation[:, self._of_pose] -= directions[:, self._direction] * pose
        return innovation
