"""The linear description of a sensor that fits best over a recording.

A random error of a sensor has no linear part over its recording, by the way it is made; a result's further terms may
have one. The two are compared by what is linear in them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from kreisel.calibration.outcome import Outcome
from kreisel.calibration.result import Calibration
from kreisel.geometry.rotation import Array
from kreisel.inertial.effects import EFFECTS, RawReadings, added
from kreisel.inertial.sensor_model import linear_columns
from kreisel.inertial.slopes import local_cubics, usual_interval
from kreisel.recording.recording import ImuSamples

_ENOUGH = 20_000
"""Samples by which a linear part is found."""

_OWN = {"gyroscope": slice(1, 4), "accelerometer": slice(4, 7)}
"""Of the columns of `linear_columns`, the sensor's own readings."""


class _Basis:
    """What is linear over a recording: a constant, rates, accelerations, angular accelerations, products of rates."""

    def __init__(self, imu: ImuSamples) -> None:
        seconds = (imu.stamps_ns - imu.stamps_ns[0]) * 1e-9
        cubics = local_cubics(seconds, usual_interval(seconds))
        difference = np.zeros(seconds.size)
        self._raw = RawReadings(seconds, imu.rates, imu.accelerations, cubics.slopes, cubics.curvatures, difference)
        self._some = slice(None, None, max(1, seconds.size // _ENOUGH))
        basis = linear_columns(imu.rates, imu.accelerations, cubics.slopes(imu.rates))
        self._inverse = np.linalg.pinv(basis[self._some])

    def share(self, values: Mapping[str, Array], sensor: str) -> tuple[Array, Array]:
        """Return the constant (3,) and the matrix (3, 3) on readings in what terms add to a sensor's readings."""
        part = added(self._raw, values)[sensor == "accelerometer"][self._some]
        share = self._inverse @ part
        return share[0], share[_OWN[sensor]].T


def with_linear_part(outcome: Outcome, without: Mapping[str, Array]) -> Calibration:
    """Return a calibration with what is linear in its further terms in offsets and matrices, and their deviations.

    without: terms that the device has.

    Notes
    -----
    Over the recording, of what the terms add to raw readings, the part that a constant, rates, accelerations, angular
    accelerations and products of rates explain; of it, the constant and the sensor's own readings are taken over.
    """
    found, sd, basis = outcome.calibration.sensors, outcome.calibration.sensor_sd, _Basis(outcome.recording.imu)
    values: dict[str, Any] = {}
    deviations: dict[str, Any] = {}
    for sensor, matrix, offset in (("gyroscope", "K_omega", "k_w"), ("accelerometer", "K_a", "k_a")):
        K, k = getattr(found, matrix), getattr(found, offset).copy()
        ours, theirs = (
            basis.share({g: v for g, v in terms.items() if EFFECTS[g].sensor == sensor}, sensor)
            for terms in (found.effects, without)
        )
        C = np.eye(3) + ours[1] - theirs[1]
        k[0] = np.linalg.solve(C, k[0] + ours[0] - theirs[0])
        values |= {matrix: K @ C, offset: k}
        of_matrix, of_offset = _further_variance(outcome, basis, sensor, K)
        own = getattr(sd, offset).copy()
        own[0] = np.where(own[0] > 0.0, np.sqrt(np.maximum(own[0] ** 2 + of_offset, 0.0)), 0.0)
        square = getattr(sd, matrix) ** 2 + of_matrix
        fixed = getattr(sd, matrix) == 0.0
        deviations |= {matrix: np.where(fixed, 0.0, np.sqrt(np.maximum(square, 0.0))), offset: own}
    return replace(outcome.calibration, sensors=replace(found, **values), sensor_sd=replace(sd, **deviations))


def _further_variance(outcome: Outcome, basis: _Basis, sensor: str, K: Array) -> tuple[Array, Array]:
    """Return what the uncertainty of terms adds to the variances of matrix (3, 3) and offset (3,)."""
    layout, P = outcome.estimate.problem.layout, outcome.estimate.belief.covariance
    short = "gyro" if sensor == "gyroscope" else "accel"
    groups = [part.name for part in layout if part.name in EFFECTS and EFFECTS[part.name].sensor == sensor]
    if not groups or f"{short}_offset" not in layout or f"{short}_cross_coupling" not in layout:
        return np.zeros((3, 3)), np.zeros(3)
    places = np.concatenate([np.r_[layout[group]] for group in groups])
    columns = []
    for group in groups:
        size = layout[group].stop - layout[group].start
        for unit in np.eye(size):
            constant, matrix = basis.share({group: unit}, sensor)
            columns.append(np.concatenate([(K @ matrix).ravel(), constant]))
    own = np.r_[layout[f"{short}_cross_coupling"], layout[f"{short}_offset"]]
    J = np.stack(columns, axis=1)
    more = 2.0 * np.sum(J * P[np.ix_(own, places)], axis=1) + np.sum((J @ P[np.ix_(places, places)]) * J, axis=1)
    return more[:9].reshape(3, 3), more[9:]
