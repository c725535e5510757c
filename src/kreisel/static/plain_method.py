"""The method of Tedaldi, Pretto and Menegatti (2014) as they published it, to compare with.

Offsets of the gyros are those of the first standstill, and held. All standstills count alike, and all turns. There
are no deviations.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import skew
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.static.first_values import first_values
from kreisel.static.rest_problem import RestProblem
from kreisel.static.turns import turns_between

_ITERATIONS, _SETTLED = 30, 1e-9
"""Steps of Gauss-Newton, and change of the matrix at which they end."""


def plain_values(problem: RestProblem) -> SensorParameters:
    """Return the parameters by the lengths of forces, and then by how turns lead from one vertical to the next.

    Raises
    ------
    RecordingError
        If there are too few standstills, or turns about too few axes.
    """
    rests = problem.rests
    sensors = replace(first_values(problem).sensors, k_w=-rests.rates[:1])
    up = (rests.forces + sensors.k_a[0]) @ sensors.K_a.T
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    for _ in range(_ITERATIONS):
        turns = turns_between(problem.imu, problem.raw, rests, sensors)
        seen = np.einsum("mkj,mk->mj", turns.rotations, up[:-1])[turns.whole]
        slopes = skew(seen) @ turns.derivatives["gyro_cross_coupling"][turns.whole]
        J, misfit = slopes.reshape(-1, 9), (up[1:][turns.whole] - seen).ravel()
        change, _, rank, _ = np.linalg.lstsq(J, misfit, rcond=1e-9)
        if rank < J.shape[1]:
            raise RecordingError("turns about too few axes for a gyro matrix", file=problem.imu.source)
        sensors = replace(sensors, K_omega=sensors.K_omega + change.reshape(3, 3))
        if np.max(np.abs(change)) < _SETTLED:
            return sensors
    raise RecordingError("the turns between standstills fit no gyro matrix", file=problem.imu.source)
