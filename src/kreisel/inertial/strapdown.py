"""Sampled readings prepared for integration, and the strapdown computation over intervals of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel._kernels import coefficients, quadrature
from kreisel._kernels.cell import Samples
from kreisel.geometry.rotation import Array, Indices
from kreisel.inertial.sensor_model import SensorParameters, power_slopes, powers

NOISE_STEP = 0.02
"""Seconds of readings whose noise is added up in one step."""


@dataclass(frozen=True)
class InertialSignal:
    """Raw readings prepared for integration.

    Attributes
    ----------
    samples
        All readings with their stencils, derivatives and integrals.
    segments
        First and last sample (inclusive) of every segment, each of six samples or more.
    order
        Polynomial order N it was prepared for.
    begin
        Number of its first sample in the whole recording.
    """

    samples: Samples
    segments: tuple[tuple[int, int], ...]
    order: int
    begin: int = 0

    @property
    def stamps(self) -> Array:
        """Seconds since the first sample, (n,)."""
        return self.samples.stamps

    @property
    def rates(self) -> Array:
        """Raw rates, (n, 3)."""
        return self.samples.rates[1:4].T

    @property
    def slopes(self) -> Array:
        """Derivatives of the raw rates, (n, 3)."""
        return self.samples.slopes[1:4].T

    @property
    def integrals(self) -> Array:
        """Integrals of the raw rates over each sampling interval, (n - 1, 3)."""
        return self.samples.integrals[1:4].T

    @property
    def accelerations(self) -> Array:
        """Raw accelerations, (n, 3)."""
        return self.samples.forces[:3].T


def prepare(
    stamps: Array,
    rates: Array,
    accelerations: Array,
    *,
    order: int = 1,
    segments: tuple[tuple[int, int], ...] | None = None,
    noise: Array | None = None,
) -> InertialSignal:
    """Return the prepared signal: stencils, powers, derivatives and integrals.

    Parameters
    ----------
    stamps : (n,)
        Seconds, ascending.
    rates, accelerations : (n, 3)
        Raw readings, rad/s and m/s^2.
    order
        Polynomial order N of the sensor model; 1 is only offset and scale.
    segments
        Segments as pairs of first and last sample; all samples by default.
    noise : (4, 3)
        See `Samples`; none by default.
    """
    stamps, rates, accelerations = (np.ascontiguousarray(x, dtype=float) for x in (stamps, rates, accelerations))
    n = stamps.size
    segments = ((0, n - 1),) if segments is None else segments
    base = np.zeros(n - 1, dtype=np.int64)
    first = np.zeros(n, dtype=np.int64)
    inside, within = np.zeros(n, dtype=bool), np.zeros(n - 1, dtype=bool)
    for start, stop in segments:
        k = np.arange(start, stop)
        base[k] = np.clip(k - 2, start, stop - 5)
        within[k] = True
        k = np.arange(start, stop + 1)
        first[k] = np.clip(k - 2, start, stop - 4)
        inside[k] = True
    outside = np.flatnonzero(~inside)
    first[outside] = np.clip(outside - 2, 0, n - 5)
    between = np.flatnonzero(~within)
    base[between] = np.clip(between - 2, 0, n - 6)
    single, double = np.empty((n - 1, quadrature.POINTS)), np.empty((n - 1, quadrature.POINTS))
    quadrature.interval_weights(stamps, base, single, double)
    _straighten(between, stamps, base, single, double)
    slope = np.empty_like(rates)
    quadrature.differentiate(stamps, first, rates, slope)
    features = powers(rates, order)
    integrals = np.empty((features.shape[0], n - 1))
    quadrature.integrate_intervals(base, single, features, integrals)
    samples = Samples(
        stamps=stamps,
        base=base,
        single=single,
        double=double,
        rates=features,
        slopes=power_slopes(rates, slope, order),
        integrals=integrals,
        forces=powers(accelerations, order)[1:],
        noise=np.zeros((4, 3)) if noise is None else noise,
        usual=float(np.median(np.diff(stamps))),
    )
    return InertialSignal(samples, segments, order)


def _straighten(between: Indices, stamps: Array, base: Indices, single: Array, double: Array) -> None:
    """Write the weights of a straight line into intervals outside all segments, where a quintic would diverge."""
    h, left = np.diff(stamps)[between], between - base[between]
    single[between], double[between] = 0.0, 0.0
    for at, once, twice in ((left, 1.0 / 2.0, 1.0 / 3.0), (left + 1, 1.0 / 2.0, 1.0 / 6.0)):
        single[between, at] = h * once
        double[between, at] = h**2 * twice


def rate_coefficients(p: SensorParameters) -> Array:
    """Return the rate coefficients (P, 3) of equation (1), see `_kernels.coefficients`: omega = features @ these."""
    return coefficients.rate_coefficients(p.K_omega[..., None], p.k_w[..., None])[..., 0]


def linear_rate(K: Array, b: Array, order: int) -> Array:
    """Return the rate coefficients (P, 3) of omega = K w' + b, for `integrate_attitude`."""
    return np.vstack([b, K.T, np.zeros((3 * (order - 1), 3))])


def integrate_attitude(signal: InertialSignal, rate: Array) -> Array:
    """Return attitudes (n, 4) seen from the first sample's, from rate coefficients (P, 3) only.

    See `rate_coefficients` and `linear_rate`; gaps are bridged by straight lines.
    """
    q = np.empty((signal.stamps.size, 4))
    q[0] = (1.0, 0.0, 0.0, 0.0)
    samples = signal.samples
    quadrature.integrate_attitude(samples.stamps, samples.rates, samples.integrals, np.ascontiguousarray(rate), q)
    return q
