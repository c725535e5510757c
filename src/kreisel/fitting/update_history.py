"""What happened at every update of a fit."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from kreisel.geometry.rotation import Array, Mask

_IN_LENGTHS = np.array([0, 1, 2, 6, 7, 8])
"""Rows of innovations that are lengths, or lengths per second."""


@dataclass(frozen=True)
class History:
    """What happened at every update; the first axis counts updates.

    Innovations are those before an update is used, given all earlier ones. What an estimator does not
    have of `correction` and `turn_information` is zero: noise of the IMU is then not adapted.

    Attributes
    ----------
    seconds
        IMU seconds.
    parameters, deviations : (u, parameters)
        Estimates and standard deviations; those of the alignment are distances from the last.
    at_standstill, used
        Kind of update, and whether it passed the gate.
    nis, degrees
        Normalised innovation squared, and the degrees of freedom it is expected to equal.
    log_likelihood
        Of each innovation, up to a constant.
    whitened, innovation, residual : (u, 9)
        Innovation divided by its factor; innovation; residual after the update. Position, orientation, velocity; nan
        where there is no such measurement.
    noise_variance : (u, 9)
        The assumed measurement noise, along the diagonal.
    passing : (u, 6)
        Velocity in n and rotation rate in b, m/s and rad/s: what an error of a stamp does to position and orientation.
    late : (u, 2)
        Error of the pose's stamp by the innovation, s, and its deviation, that of the stamp's own noise included.
    correction, correction_variance : (u, 6)
        Change of velocity and attitude by the update, and the variance the filter expected of it; of a rejected update
        what it would have been.
    turn_information
        Information of an update about a rotation, summed over the three axes: trace of the inverse covariance of
        innovations in orientation, rad^-2; 0 where it was rejected or there is no such measurement.
    """

    seconds: Array
    parameters: Array
    deviations: Array
    at_standstill: Mask
    used: Mask
    nis: Array
    degrees: Array
    log_likelihood: Array
    whitened: Array
    innovation: Array
    residual: Array
    noise_variance: Array
    passing: Array
    late: Array
    correction: Array
    correction_variance: Array
    turn_information: Array

    def first(self, count: int) -> History:
        """Return what happened at the first updates."""
        return History(**{one.name: getattr(self, one.name)[:count] for one in fields(self)})

    @property
    def pull_of_unit(self) -> float:
        """By how much noise raises the score of motion that is shorter than reported, relative to its length.

        By equation (41) of docs/explanation/model.md.
        """
        return float(np.nansum(self.whitened[self.used][:, _IN_LENGTHS] ** 2))
