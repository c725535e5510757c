"""What terms outside the state do to a run of the filter: derivatives of its estimate and innovations.

A constant that is left out of the state moves estimates and innovations in proportion (Friedland 1969). The factors
follow the filter's own recursion, so hundreds of terms cost as much as a few runs, not as the cube of their number.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kreisel._kernels.filter_arguments import Record
from kreisel.fitting.terms import ACCEL_ROWS, GYRO_ROWS, POSE_ROWS, Terms
from kreisel.geometry.rotation import Array
from kreisel.model.layout import NAVIGATION, PATH_ERROR, STANDSTILL_ERROR
from kreisel.model.problem import Problem
from kreisel.model.schedule import Update

_PARTS = 20
"""Parts of a recording, of equal numbers of updates, whose sums are kept."""


class Sensitivity:
    """Derivatives by the terms' amplitudes, carried along with a run.

    Attributes
    ----------
    state : (n, m)
        Of the estimate after the updates so far.
    information : (m, m)
        Sum of products of the derivatives of whitened innovations.
    part_information : (p, m, m)
        The same by parts of the recording, of single precision.
    part_scores : (p, m)
        By parts, the sum of their products with the innovations.
    misfit, degrees
        Sum of normalised innovations squared of the updates that were used, and their number.
    """

    def __init__(self, problem: Problem, terms: Terms) -> None:
        layout, m = problem.layout, terms.count
        self._terms, self._stamps = terms, problem.sensor.readings.stamps
        self.state, self.part_scores = np.zeros((layout.degrees, m)), np.zeros((_PARTS, m))
        self.information = np.zeros((m, m))
        self.part_information: NDArray[np.float32] = np.zeros((_PARTS, m, m), np.float32)
        self.misfit, self.degrees = 0.0, 0.0
        self._ends = np.linspace(0, len(problem.schedule.updates), _PARTS + 1).astype(np.int64)[1:]
        self._part = 0
        self._moving = slice(layout.degrees - problem.changing, layout.degrees)
        places = {part.name: layout[part.name] for part in layout}
        self._navigation = [places[part.name] for part in (*PATH_ERROR, *NAVIGATION) if part.name in layout]
        self._standstill = [places[part.name] for part in STANDSTILL_ERROR if part.name in layout]
        fading = problem.noise.gauss_markov
        self._fading = [(places[group], 1.0 / process.time) for group, process in fading.items() if group in layout]
        self._of_sensor, self._of_pose = (
            np.flatnonzero(terms.row < POSE_ROWS.start),
            np.flatnonzero(terms.row >= POSE_ROWS.start),
        )
        offsets = {
            rows[axis]: layout[group].start + i
            for group, rows in (("gyro_offset", GYRO_ROWS), ("accel_offset", ACCEL_ROWS))
            if group in layout
            for i, axis in enumerate(layout.present(group).tolist())
        }
        self._offset = np.array([offsets[int(row)] for row in terms.row[self._of_sensor]], dtype=np.int64)
        self._direction = terms.row[self._of_pose] - POSE_ROWS.start
        self._innovations: list[Array] = []

    def restart(self) -> None:
        """Begin navigation anew, from the reference."""
        for part in self._navigation:
            self.state[part] = 0.0

    def advance(self, at: int, updates: tuple[Update, ...], record: Record, first: int) -> None:
        """Carry on over updates from number `at` on, whose slopes begin at `first` of a record."""
        for k, update in enumerate(updates):
            self._sum_up(at + k)
            self._fade(update)
            slopes = np.concatenate([record.transition[first + k], record.design[first + k]])
            innovation = self._step(at + k, slopes, record.whitening[first + k])
            if not record.used[first + k]:
                continue
            self.state -= record.gain[first + k].T @ innovation
            measured = np.isfinite(record.whitened[first + k])
            whitened = record.whitened[first + k][measured]
            self.part_scores[self._part] += whitened @ innovation[measured]
            self.misfit += float(whitened @ whitened)
            self.degrees += float(whitened.size)
            self._innovations.append(innovation[measured])
        self._sum_up(at + len(updates))

    @property
    def score(self) -> Array:
        """Sum over all parts of their products with the innovations, (m,)."""
        return np.asarray(self.part_scores.sum(axis=0))

    def _sum_up(self, at: int) -> None:
        """Add the derivatives so far to the sums of their part, if it ends before update `at`."""
        if at < self._ends[self._part]:
            return
        if self._innovations:
            rows = np.concatenate(self._innovations)
            products = rows.T @ rows
            self.information += products
            self.part_information[self._part] = products
            self._innovations = []
        self._part = min(self._part + 1, _PARTS - 1)

    def _fade(self, update: Update) -> None:
        """Let what fades, fade until an update, and what is new at it, begin."""
        seconds = float(self._stamps[update.last] - self._stamps[update.first])
        for part, rate in self._fading:
            self.state[part] *= np.exp(-rate * seconds)
        if update.new_standstill:
            for part in self._standstill:
                self.state[part] = 0.0

    def _step(self, i: int, slopes: Array, whitening: Array) -> Array:
        """Predict over update i; return the derivatives of its whitened prediction, (9, m)."""
        value = self._terms.functions[i, self._terms.function]
        sensor, pose = value[self._of_sensor], value[self._of_pose]
        # equation (28): a term of the readings is a change of the offset for as long as the update lasts
        self.state[self._offset, self._of_sensor] += sensor
        predicted = slopes @ self.state
        self.state[self._offset, self._of_sensor] -= sensor
        moving = self._moving.stop - self._moving.start
        self.state[self._moving] = predicted[:moving]
        innovation = predicted[moving:]
        directions = whitening[:, : len(POSE_ROWS)] @ self._terms.directions[i]
        innovation[:, self._of_pose] -= directions[:, self._direction] * pose
        return innovation
