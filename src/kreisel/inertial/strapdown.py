"""Sampled readings prepared for integration, and the strapdown computation over intervals of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from kreisel._kernels import quadrature
from kreisel._kernels.filter_arguments import Samples
from kreisel.geometry.rotation import Array, Indices
from kreisel.inertial.effects import RawReadings, added, features_of
from kreisel.inertial.sensor_model import SensorParameters

NOISE_STEP = 0.02
"""Seconds of readings whose noise is added up in one step."""

_UNCORRELATED = 0.52161
"""Share of the fourth difference for which the second derivative of `raw_readings` is so, at equal intervals."""

_NONE: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class InertialSignal:
    """Raw readings prepared for integration.

    Attributes
    ----------
    samples
        All readings with their stencils, derivatives and integrals.
    segments
        First and last sample (inclusive) of every segment, each of six samples or more.
    begin
        Number of its first sample in the whole recording.
    """

    samples: Samples
    segments: tuple[tuple[int, int], ...]
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
    segments: tuple[tuple[int, int], ...] | None = None,
    noise: Array | None = None,
    estimated: Mapping[str, int] = _NONE,
    applied: Mapping[str, Array] = _NONE,
    temperature_difference: Array | None = None,
) -> InertialSignal:
    """Return the prepared signal: stencils, features, derivatives and integrals.

    Parameters
    ----------
    stamps : (n,)
        Seconds, ascending.
    rates, accelerations : (n, 3)
        Raw readings, rad/s and m/s^2.
    segments
        Segments as pairs of first and last sample; all samples by default.
    noise : (4, 3)
        See `Samples`; none by default.
    estimated
        Numbers of parameters of the effects that are estimated, by group: their features are added.
    applied
        Values of effects, by group: the readings are corrected by them.
    temperature_difference : (n,)
        Temperature above that of the parameters, K, where it was recorded.
    """
    stamps, rates, accelerations = (np.ascontiguousarray(x, dtype=float) for x in (stamps, rates, accelerations))
    n = stamps.size
    segments = ((0, n - 1),) if segments is None else segments
    stencils = Stencils.of(stamps, segments)
    raw = raw_readings(stamps, rates, accelerations, segments, temperature_difference)
    change = added(raw, applied)
    rates, accelerations = rates + change[0], accelerations + change[1]
    slope = raw.derivative(rates)
    features = _stacked(np.ones(n), rates.T, features_of(raw, estimated, "gyroscope"))
    samples = Samples(
        stamps=stamps,
        base=stencils.base,
        single=stencils.single,
        twice=stencils.twice,
        rates=features,
        slopes=_stacked(np.zeros(n), slope.T),
        integrals=stencils.integrals(features),
        forces=_stacked(accelerations.T, features_of(raw, estimated, "accelerometer")),
        noise=np.zeros((4, 3)) if noise is None else noise,
        usual=float(np.median(np.diff(stamps))),
    )
    return InertialSignal(samples, segments)


@dataclass(frozen=True)
class Stencils:
    """Samples, and their weights, of which integrals over sampling intervals are made: see `interval_weights`."""

    base: Indices
    single: Array
    twice: Array

    @classmethod
    def of(cls, stamps: Array, segments: tuple[tuple[int, int], ...]) -> Stencils:
        """Return the stencils of samples (n,): quintics within segments, and straight lines between these."""
        n = stamps.size
        base = np.zeros(n - 1, dtype=np.int64)
        within = np.zeros(n - 1, dtype=bool)
        for start, stop in segments:
            k = np.arange(start, stop)
            base[k] = np.clip(k - 2, start, stop - 5)
            within[k] = True
        between = np.flatnonzero(~within)
        base[between] = np.clip(between - 2, 0, n - 6)
        single, twice = np.empty((n - 1, quadrature.POINTS)), np.empty((n - 1, quadrature.POINTS))
        quadrature.interval_weights(stamps, base, single, twice)
        _straighten(between, stamps, base, single, twice)
        return cls(base, single, twice)

    def integrals(self, values: Array) -> Array:
        """Return the integrals of values (c, n) over each sampling interval, (c, n - 1)."""
        out = np.empty((len(values), self.base.size))
        quadrature.integrate_intervals(self.base, self.single, values, out)
        return out


def raw_readings(
    stamps: Array,
    rates: Array,
    accelerations: Array,
    segments: tuple[tuple[int, int], ...] = (),
    temperature_difference: Array | None = None,
) -> RawReadings:
    """Return raw readings (n, 3) with derivatives over five samples of one segment; by default without gaps.

    The noise of the second derivative, integrated between two updates, is not correlated with that of the integrated
    readings. Otherwise the smoothing would be estimated by how much of that noise it takes away.
    """
    n = stamps.size
    first = np.clip(np.arange(n) - 2, 0, n - 5)
    for start, stop in segments:
        first[start : stop + 1] = np.clip(first[start : stop + 1], start, stop - 4)

    def derivative(values: Array) -> Array:
        values = np.ascontiguousarray(values, dtype=float)
        out = np.empty_like(values)
        quadrature.differentiate(np.ascontiguousarray(stamps, dtype=float), first, values, out)
        return out

    def second_derivative(values: Array) -> Array:
        sharp = derivative(derivative(values))
        around = np.pad(sharp, ((2, 2), (0, 0)), mode="edge")
        return np.asarray(sharp - _UNCORRELATED * np.diff(around, n=4, axis=0))

    temperature_difference = (
        np.zeros(stamps.size) if temperature_difference is None else np.asarray(temperature_difference)
    )
    return RawReadings(stamps, rates, accelerations, derivative, second_derivative, temperature_difference)


def without_effects(raw: RawReadings, parameters: SensorParameters) -> tuple[Array, Array]:
    """Return raw rates and accelerations (n, 3) each, corrected for all effects beyond offset and matrix."""
    rates, accelerations = added(raw, parameters.effects)
    return raw.rates + rates, raw.accelerations + accelerations


def _stacked(*rows: Array) -> Array:
    return np.ascontiguousarray(np.vstack(rows))


def _straighten(between: Indices, stamps: Array, base: Indices, single: Array, double: Array) -> None:
    """Write the weights of a straight line into intervals outside all segments, where a quintic would diverge."""
    h, left = np.diff(stamps)[between], between - base[between]
    single[between], double[between] = 0.0, 0.0
    for at, once, twice in ((left, 1.0 / 2.0, 1.0 / 3.0), (left + 1, 1.0 / 2.0, 1.0 / 6.0)):
        single[between, at] = h * once
        double[between, at] = h**2 * twice


def rate_coefficients(p: SensorParameters) -> Array:
    """Return the rate coefficients (4, 3) of equation (1): omega = features @ these, for readings free of effects."""
    return linear_rate(p.K_omega, p.K_omega @ p.k_w[0])


def linear_rate(K: Array, b: Array) -> Array:
    """Return the rate coefficients (4, 3) of omega = K w' + b, for `integrate_attitude`."""
    return np.vstack([b, K.T])


def integrate_attitude(signal: InertialSignal, rate: Array) -> Array:
    """Return attitudes (n, 4) seen from the first sample's, from rate coefficients (4, 3) only.

    See `rate_coefficients` and `linear_rate`; gaps are bridged by straight lines.
    """
    q = np.empty((signal.stamps.size, 4))
    q[0] = (1.0, 0.0, 0.0, 0.0)
    stamps, rates, integrals = signal.samples.stamps, signal.samples.rates[:4], signal.samples.integrals[:4]
    quadrature.integrate_attitude(stamps, rates, integrals, np.ascontiguousarray(rate), q)
    return q
