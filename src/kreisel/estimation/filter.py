"""The rare-update sigma-point Kalman filter in square-root form.

The belief is a mean on the manifold and a lower triangular factor S of the covariance S S^T. A step draws
sigma points once, lets the model run them to the next update, and puts them together there. Prediction
and update are orthogonal triangularisations of arrays whose rows are the state and the measurement, so
the covariance is a sum of squares by construction and cannot lose its positive sign.

Parameters do not change between updates: their rows of S stay as they are. The parts that do change
stand last in the layout, so only their few rows need triangularising again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.linalg import lapack, solve_triangular

from kreisel.estimation.sigma_points import SigmaWeights
from kreisel.estimation.state import StateLayout
from kreisel.geometry.rotation import Array


@dataclass(frozen=True)
class Belief:
    """Mean (size,) as stored, and lower triangular factor (degrees, degrees) of the covariance."""

    mean: Array
    factor: Array

    @property
    def covariance(self) -> Array:
        """The covariance (degrees, degrees)."""
        return np.asarray(self.factor @ self.factor.T)

    @property
    def standard_deviation(self) -> Array:
        """Standard deviation of every degree of freedom."""
        return np.asarray(np.sqrt(np.sum(self.factor**2, axis=1)))


class Transition(Protocol):
    """What a model must do for a step of the filter."""

    def propagate(self, points: Array) -> Array:
        """Return sigma points (size, 2 n + 1) at the update; parameters unchanged."""

    def process_noise(self, centre: Array) -> Array:
        """Return a factor (degrees, k) of the noise covariance at the update, about the centre."""

    def observe(self, points: Array) -> Array:
        """Return predicted measurements as distances (m, points) from that of the first point."""

    def innovation(self, centre: Array) -> Array:
        """Return the distance (m,) of the measurement from that predicted for a state (size,)."""


@dataclass(frozen=True)
class Prediction:
    """Belief at the time of an update, together with the measurement it predicts.

    Attributes
    ----------
    mean, columns
        The predicted mean, and columns (degrees, k) whose outer products make up its covariance.
    innovation, innovation_factor : (m,), (m, m)
        Measurement less its prediction, and the lower triangular factor of its covariance.
    gain_factor : (degrees, m)
        Cross-covariance times the inverse transpose of `innovation_factor`.
    posterior_factor : (degrees, degrees)
        Factor of the covariance once the measurement is used.
    """

    mean: Array
    columns: Array
    innovation: Array
    innovation_factor: Array
    gain_factor: Array
    posterior_factor: Array

    @property
    def belief(self) -> Belief:
        """The predicted belief, for when the measurement is not used."""
        return Belief(self.mean, triangularise(self.columns))

    @property
    def normalised_innovation(self) -> Array:
        """Innovation whitened by its covariance, (m,); its squared length is the NIS."""
        return np.asarray(solve_triangular(self.innovation_factor, self.innovation, lower=True, check_finite=False))


def triangularise(columns: Array) -> Array:
    """Return the lower triangular L (n, n) with L L^T = columns columns^T, for columns (n, k)."""
    n = columns.shape[0]
    if columns.shape[1] < n:
        columns = np.hstack([columns, np.zeros((n, n - columns.shape[1]))])
    qr, _, _, _ = lapack.dgeqrf(columns.T)
    upper = np.triu(qr[:n])
    return np.asarray(upper.T * np.where(np.diag(upper) < 0.0, -1.0, 1.0))


def draw(layout: StateLayout, belief: Belief, w: SigmaWeights) -> Array:
    """Return the sigma points (size, 2 n + 1): centre, then all in plus, then all in minus direction."""
    spread = w.spread * belief.factor
    zero = np.zeros((layout.degrees, 1))
    return layout.plus(belief.mean, np.hstack([zero, spread, -spread]))


def predict(
    layout: StateLayout,
    belief: Belief,
    transition: Transition,
    w: SigmaWeights,
    measurement_factor: Array,
    changing: int,
) -> Prediction:
    """Return the belief at the next update and what it says about the measurement.

    Parameters
    ----------
    belief
        Belief at the last update.
    measurement_factor : (m, k)
        Factor of the measurement noise's covariance.
    changing
        Degrees of freedom, at the end of the layout, that change between updates.
    """
    n = layout.degrees
    held = n - changing
    points = transition.propagate(draw(layout, belief, w))
    centre = points[:, 0].copy()
    noise = transition.process_noise(centre)
    distance = _changing_distance(layout, points, centre, held)

    # Process noise is put in as further, linearised sigma points.
    k = noise.shape[1]
    seen = transition.observe(np.hstack([points, layout.plus(centre, np.hstack([noise, -noise]))]))
    seen_noise = 0.5 * (seen[:, 2 * n + 1 : 2 * n + 1 + k] - seen[:, 2 * n + 1 + k :])
    first, curved, shift = _recombine(np.vstack([seen[:, : 2 * n + 1], distance]), n, w)
    m = seen.shape[0]
    curved = triangularise(curved)

    linear = np.vstack([first[:m], belief.factor[:held], first[m:]])
    further = np.zeros((m + n, curved.shape[1] + k))
    further[:m, : curved.shape[1]] = curved[:m]
    further[m + held :, : curved.shape[1]] = curved[m:]
    further[:m, curved.shape[1] :] = seen_noise
    further[m:, curved.shape[1] :] = noise
    measured = np.zeros((m + n, measurement_factor.shape[1]))
    measured[:m] = measurement_factor
    lower = triangularise(np.hstack([measured, linear, further]))
    mean_change = np.zeros((n, 1))
    mean_change[held:, 0] = shift[m:]
    mean = layout.plus(centre, mean_change)[:, 0].copy() if np.any(shift[m:]) else centre
    return Prediction(
        mean=mean,
        columns=np.hstack([linear[m:], further[m:]]),
        innovation=transition.innovation(centre) - shift[:m],
        innovation_factor=lower[:m, :m],
        gain_factor=lower[m:, :m],
        posterior_factor=lower[m:, m:],
    )


def update(layout: StateLayout, prediction: Prediction, whitened: Array) -> Belief:
    """Return the belief once the measurement is used; `whitened` is the prediction's normalised innovation."""
    change = prediction.gain_factor @ whitened
    mean = layout.plus(prediction.mean, change[:, None])[:, 0].copy()
    return Belief(mean, prediction.posterior_factor)


def renew(layout: StateLayout, belief: Belief, name: str, value: Array, deviation: Array) -> Belief:
    """Return the belief with a part forgotten and believed anew, independent of all else.

    Parameters
    ----------
    value
        The part's stored value.
    deviation
        Its standard deviations, one for each degree of freedom.
    """
    d = layout[name]
    mean = belief.mean.copy()
    mean[layout.stored(name)] = value
    fresh = np.zeros((layout.degrees, d.stop - d.start))
    fresh[d] = np.diag(deviation)
    old = belief.factor.copy()
    old[d] = 0.0
    return replace(belief, mean=mean, factor=triangularise(np.hstack([old, fresh])))


def _changing_distance(layout: StateLayout, points: Array, centre: Array, held: int) -> Array:
    """Distances of the changing degrees of freedom alone, (changing, points)."""
    parts = [part for part in layout if layout[part.name].start >= held]
    changing = StateLayout(parts)
    start = layout.stored(parts[0].name).start
    return changing.minus(points[start:], centre[start:])


def _recombine(distance: Array, n: int, w: SigmaWeights) -> tuple[Array, Array, Array]:
    """Return first-order columns, further columns and shift of the mean. See `SigmaWeights`."""
    plus, minus = distance[:, 1 : n + 1], distance[:, n + 1 : 2 * n + 1]
    first = (plus - minus) / (2.0 * w.spread)
    total = plus + minus
    shift = w.mean * total.sum(axis=1)
    if w.second == 0.0:
        return first, np.zeros((distance.shape[0], 0)), shift
    further = w.second * (total - 2.0 * w.shift * shift[:, None])
    if w.centre > 0.0:
        further = np.hstack([further, w.centre * shift[:, None]])
    return first, further, shift
