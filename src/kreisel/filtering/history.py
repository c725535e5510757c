"""Result of one run of the filter: its belief, and what happened at every update."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kreisel.estimation.belief import Belief
from kreisel.geometry.rotation import Array, Mask
from kreisel.model.parameters import CellParameters


@dataclass(frozen=True)
class History:
    """What happened at every update; the first axis counts updates.

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
    correction: Array
    correction_variance: Array
    turn_information: Array


@dataclass(frozen=True)
class FilterRun:
    """Result of one run: start values, final belief, parameters in it, history.

    `fitted` is the number of parameters that were fitted to the same data before the run began: the innovations are
    smaller by so many degrees of freedom. `jumps` is how often parameters with a random walk may have jumped. `begun`
    and `gate` are the belief and the gate it began with.
    """

    start: CellParameters
    belief: Belief
    parameters: CellParameters
    history: History
    fitted: float = 0.0
    jumps: int = 0
    begun: Belief | None = None
    gate: float = 1.0

    @property
    def excess(self) -> float:
        """Factor on normalised innovations squared for the degrees of freedom fitted before; 1 where none were."""
        degrees = float(np.sum(self.history.degrees[self.history.used]))
        return degrees / max(degrees - self.fitted, 0.3 * degrees, 1.0) if degrees > 0.0 else 1.0


Pass = Callable[..., FilterRun]
"""A further pass: `prior_exchange.further_pass`, which takes a problem, a run near the result, a gate and progress."""
