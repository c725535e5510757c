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
from typing import NamedTuple, Protocol

import numpy as np

from kreisel._kernels import triangular
from kreisel.estimation.sigma_points import SigmaWeights
from kreisel.estimation.state import StateLayout
from kreisel.geometry.rotation import Array, Indices


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

    def process_noise(self) -> Array:
        """Return a factor (changing, k) of the noise covariance at the update, about the centre."""

    def observe(self, points: Array) -> tuple[Array, Array]:
        """Return predicted measurements (m, points) and the measurement (m,), as distances from the first point's."""


class Innovation(NamedTuple):
    """What a history keeps of a prediction: see `Prediction`; `gain` holds some rows of `gain_factor`."""

    innovation: Array
    innovation_factor: Array
    whitened: Array
    gain: Array


@dataclass(frozen=True)
class Prediction:
    """Belief at the time of an update, together with the measurement it predicts.

    Attributes
    ----------
    mean
        The predicted mean.
    prior : Belief
        The belief before the step.
    columns : (changing, n), (changing, k)
        What has become of the changing degrees of freedom: first-order columns, and further ones.
    innovation, innovation_factor : (m,), (m, m)
        Measurement less its prediction, and the lower triangular factor of its covariance.
    whitened : (m,)
        Innovation divided by that factor; its squared length is the NIS.
    gain_factor : (degrees, m)
        Cross-covariance times the inverse transpose of `innovation_factor`.
    posterior_factor : (degrees, degrees)
        Factor of the covariance once the measurement is used.
    """

    mean: Array
    prior: Belief
    columns: tuple[Array, Array]
    innovation: Array
    innovation_factor: Array
    whitened: Array
    gain_factor: Array
    posterior_factor: Array

    @property
    def belief(self) -> Belief:
        """The predicted belief, for when the measurement is not used."""
        first, further = self.columns
        *_, factor = _condition(first, self.prior.factor, np.ascontiguousarray(further.T), np.empty(0))
        return Belief(self.mean, factor)

    def light(self, rows: Indices) -> Innovation:
        """Return what is worth keeping of it; `rows` choose degrees of freedom of the gain."""
        return Innovation(self.innovation, self.innovation_factor, self.whitened, self.gain_factor[rows])


def triangularise(columns: Array) -> Array:
    """Return the lower triangular L (n, n) with L L^T = columns columns^T, for columns (n, k)."""
    n, k = columns.shape
    rows = np.zeros((max(n, k), n))
    rows[:k] = columns.T
    triangular.triangularise(rows)
    return rows[:n].T.copy()


def draw(layout: StateLayout, belief: Belief, w: SigmaWeights) -> Array:
    """Return the sigma points (size, 2 n + 1): centre, then all in plus, then all in minus direction."""
    n = layout.degrees
    change = np.empty((n, 2 * n + 1))
    change[:, 0] = 0.0
    np.multiply(belief.factor, w.spread, out=change[:, 1 : n + 1])
    np.negative(change[:, 1 : n + 1], out=change[:, n + 1 :])
    return layout.plus(belief.mean, change)


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
    moving = layout.tail(changing)
    points = transition.propagate(draw(layout, belief, w))
    centre, at = points[:, 0].copy(), layout.size - moving.size

    # Process noise is put in as further, linearised sigma points.
    noise = transition.process_noise()
    k = noise.shape[1]
    all_points = np.empty((layout.size, 2 * n + 1 + 2 * k))
    all_points[:, : 2 * n + 1] = points
    all_points[:at, 2 * n + 1 :] = centre[:at, None]
    all_points[at:, 2 * n + 1 :] = moving.plus(centre[at:], np.hstack([noise, -noise]))
    seen, innovation = transition.observe(all_points)
    m = seen.shape[0]
    distance = np.empty((m + changing, 2 * n + 1))
    distance[:m] = seen[:, : 2 * n + 1]
    distance[m:] = moving.minus(points[at:], centre[at:])
    first, curved, shift = _recombine(distance, n, w)

    c, r = curved.shape[1], measurement_factor.shape[1]
    further = np.zeros((c + k + r, m + changing))
    further[:c] = curved.T
    further[c : c + k, :m] = 0.5 * (seen[:, 2 * n + 1 : 2 * n + 1 + k] - seen[:, 2 * n + 1 + k :]).T
    further[c : c + k, m:] = noise.T
    further[c + k :, :m] = measurement_factor.T
    innovation = innovation - shift[:m]
    innovation_factor, whitened, gain, posterior = _condition(first, belief.factor, further, innovation)
    mean = centre
    if np.any(shift[m:]):
        mean = centre.copy()
        mean[at:] = moving.plus(centre[at:], shift[m:, None])[:, 0]
    return Prediction(
        mean=mean,
        prior=belief,
        columns=(first[m:], further[: c + k, m:].T),
        innovation=innovation,
        innovation_factor=innovation_factor,
        whitened=whitened,
        gain_factor=gain,
        posterior_factor=posterior,
    )


def _condition(first: Array, factor: Array, further: Array, innovation: Array) -> tuple[Array, Array, Array, Array]:
    n, m = factor.shape[0], innovation.size
    innovation_factor, whitened = np.empty((m, m)), np.empty(m)
    gain, posterior = np.empty((n, m)), np.empty((n, n))
    triangular.condition(
        np.ascontiguousarray(first), factor, further, innovation, innovation_factor, whitened, gain, posterior
    )
    return innovation_factor, whitened, gain, posterior


def update(layout: StateLayout, prediction: Prediction) -> Belief:
    """Return the belief once the measurement is used."""
    change = prediction.gain_factor @ prediction.whitened
    mean = layout.plus(prediction.mean, change[:, None])[:, 0].copy()
    return Belief(mean, prediction.posterior_factor)


def widen(layout: StateLayout, belief: Belief, name: str, deviation: float) -> Belief:
    """Return the belief with a part's variances raised by the square of a deviation."""
    factor = belief.factor.copy()
    for i in range(layout[name].start, layout[name].stop):
        triangular.widen(factor, i, deviation)
    return replace(belief, factor=factor)


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
