"""The Allan deviation of readings at rest, and the noise figures in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kreisel.geometry.rotation import Array, Indices
from kreisel.inertial.allan_fit import fit_axis, terms_of
from kreisel.inertial.noise_figures import equivalent_walk

_PER_DECADE = 10
"""Cluster sizes in a decade. Chosen: more sizes are averages of nearly the same readings."""

TERMS = ("quantisation", "density", "instability", "walk", "ramp")
"""Names of the noises of IEEE 952, in the order of the powers of the averaging time."""

_SHOWN, _LIKELY = 0.3, 0.99
"""Share of the variance that a noise has at some averaging time, and how likely it is there, if it is shown."""


@dataclass(frozen=True)
class NoiseFigures:
    """Figures of IEEE 952 for each axis, (3,), in the readings' unit.

    Attributes
    ----------
    quantisation
        Q, of the integral.
    density
        N, white noise, per root hertz.
    instability
        B, flicker noise.
    walk
        K, random walk of the offset, per second and root hertz.
    ramp
        R, a steady change of the offset, per second.
    deviation
        Standard deviation of each, by name.
    shown
        Whether the curve shows each, by name: elsewhere it may be anything that is smaller than the others at all
        averaging times.
    slow : (3,)
        Whether there is flicker noise, a walk or a ramp, whichever of them.
    passing : (2, 3)
        Instability and walk if there is no ramp.
    tau, curve, fitted : (m,), (m, 3), (m, 3)
        Averaging times, s; the Allan deviation, and what the figures make of it.
    shortest : (3,)
        Averaging time from which on the curve is used, s: shorter averages are no sum of these noises.
    smoothed : (3,)
        Whether short averages have less noise than white noise has.
    """

    quantisation: Array
    density: Array
    instability: Array
    walk: Array
    ramp: Array
    deviation: dict[str, Array]
    shown: dict[str, NDArray[np.bool_]]
    slow: NDArray[np.bool_]
    passing: Array
    tau: Array
    curve: Array
    fitted: Array
    shortest: Array
    smoothed: NDArray[np.bool_]


def allan_deviation(values: Array, clusters: Indices) -> Array:
    """Return the overlapping Allan deviation (m, 3) of readings (n, 3).

    Parameters
    ----------
    clusters : (m,)
        Numbers of readings averaged together, each less than half of all.

    Notes
    -----
    IEEE 952-1997, annex C: of second differences of the integral.
    """
    integral = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values - values.mean(axis=0), axis=0)])
    out = np.empty((clusters.size, values.shape[1]))
    for i, m in enumerate(clusters.tolist()):
        second = integral[2 * m :] - 2.0 * integral[m:-m] + integral[: -2 * m]
        out[i] = np.sqrt(0.5 * np.einsum("ij,ij->j", second, second) / len(second)) / m
    return out


def usual_clusters(count: int) -> Indices:
    """Return numbers of readings (m,) to average together: ten a decade, up to a tenth of all."""
    decades = np.log10(max(count / 10.0, 2.0))
    return np.unique(np.round(np.logspace(0.0, decades, max(int(_PER_DECADE * decades), 2))).astype(np.int64))


def noise_figures(values: Array, interval: float) -> NoiseFigures:
    """Return the noise figures of readings (n, 3) at rest.

    Notes
    -----
    sigma^2(tau) = 3 Q^2 / tau^2 + N^2 / tau + (0.664 B)^2 + K^2 tau / 3 + R^2 tau^2 / 2, see `allan_fit`.
    """
    clusters = usual_clusters(len(values))
    tau: Array = clusters.astype(float) * interval
    curve = allan_deviation(values, clusters)
    fits = [fit_axis(clusters, interval, one, interval * len(values)) for one in (curve**2).T]
    squares = np.array([fit.squares for fit in fits]).T
    figures = np.sqrt(np.maximum(squares, 0.0))
    deviation = np.sqrt(np.array([fit.variances for fit in fits])).T / np.maximum(2.0 * figures, 1e-300)
    parts = terms_of(tau).T[:, :, None] * squares[:, None]
    fitted = parts.sum(axis=0)
    first = np.array([fit.first for fit in fits])
    used = np.arange(tau.size)[:, None] >= first
    share = np.where(used, parts / np.maximum(fitted, 1e-300), 0.0).max(axis=1)
    likely = np.array([fit.likely for fit in fits]).T
    shown = (share > _SHOWN) & (likely > _LIKELY) & (figures > 0.0)
    Q, N, B, K, R = figures
    by_name = [dict(zip(TERMS, part, strict=True)) for part in (deviation, shown)]
    slow = np.array([fit.slow for fit in fits]) > _LIKELY
    passing = np.sqrt([fit.passing for fit in fits]).T
    smoothed = (squares[0] < 0.0) & (likely[0] > _LIKELY)
    fitted = np.sqrt(np.maximum(fitted, 0.0))
    return NoiseFigures(
        Q, N, B, K, R, by_name[0], by_name[1], slow, passing, tau, curve, fitted, tau[first], smoothed
    )  # fmt: skip


def density_and_walk(one: NoiseFigures) -> dict[str, float]:
    """Return what a filter takes of a sensor, `density` and `walk`: the rms over the axes that show it, SI.

    Flicker noise is a random walk there that changes offsets as much in ten minutes. Slow noise counts where the length
    shows it, though not of which kind it is; axes without white noise are left out.
    """
    out = {}
    noisy = one.shown["density"]
    if noisy.any():
        out["density"] = _rms(one.density[noisy])
    flicker, walk = np.where(one.shown["ramp"], (one.instability, one.walk), one.passing) * one.slow
    walks = np.array([equivalent_walk(b, k) for b, k in zip(flicker, walk, strict=True)])
    if walks.any():
        out["walk"] = _rms(walks[noisy | (walks > 0.0)])
    return out


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


WARM_UP, _PARTS = 14.5, 20
"""Change of the mean from the first fifth of a recording to the last, over the usual one between neighbouring
twentieths of its second half, from which on it counts as warming up. Chosen: 0.5 % of 6000 drawn random walks do so; a
ramp changes by 16."""


def warms_up(values: Array) -> NDArray[np.bool_]:
    """Return which axes (3,) of readings at rest change more from beginning to end than they vary at last."""
    means = np.array([part.mean(axis=0) for part in np.array_split(values, _PARTS)])
    usual = np.sqrt(np.mean(np.diff(means[_PARTS // 2 :], axis=0) ** 2, axis=0))
    change = np.abs(means[-_PARTS // 5 :].mean(axis=0) - means[: _PARTS // 5].mean(axis=0))
    return np.asarray(change > WARM_UP * usual)


MOVING = 10.0
"""Largest change from second to second at rest, in units of the usual one."""


def moved(values: Array, interval: float, middle: Callable[..., Array] = np.mean) -> tuple[float, int]:
    """Return the largest change of means over a second, over the usual one, and the second it is at.

    middle: instead of the mean; the median does not see single readings.
    """
    m = max(round(1.0 / interval), 2)
    means = middle(values[: len(values) // m * m].reshape(-1, m, 3), axis=1)
    steps = np.abs(np.diff(means, axis=0))
    # a converter's step is no motion, where it is larger than the noise
    least = np.array([np.diff(np.unique(axis)).min(initial=np.ptp(axis)) for axis in values.T]) / MOVING
    over = steps / (np.median(steps, axis=0) + least + 1e-12)
    return float(over.max()), int(np.argmax(over.max(axis=1)))


def unrest(values: Array, interval: float) -> str | None:
    """Return why readings are not at rest, as the end of a sentence about them; None if they are."""
    most, second = moved(values, interval)
    if most <= MOVING:
        return None
    if moved(values, interval, np.median)[0] <= MOVING:
        return f"single readings near {second} s are far off: leave them out"
    return (
        f"near {second} s they change {most:.0f} times as much from second to second as usually; cut out the part at "
        "rest"
    )
