"""Random errors of the reference's stamps, as the gyros show them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from kreisel.estimation.robust import normal_scale
from kreisel.geometry.interpolation import running_mean
from kreisel.geometry.rotation import Array, Indices, Mask, lengths
from kreisel.inertial.readings import Readings
from kreisel.recording.recording import ReferencePoses
from kreisel.synchronization.fits import RateFit
from kreisel.synchronization.rate_fit import MIN_ROTATIONS, steps_between

_SLOW, _SAME_AXIS = 0.2, 0.8
"""rad/s, and the cosine between axes: how neighbouring rotations must be to show errors of the stamp between them."""

_NEAR = 7
"""Poses from whose median error that of the middle one is taken; an odd number."""

_TAIL, _LEAST, _AROUND, _STEPS = 0.01, 1e-7, 25, 8
"""Share of squares, the largest, that counts no more than the others; s; errors whose noise is that of one; steps of
reweighting."""

_CERTAIN, _CLEAR = 4.0, 4.0
"""Deviations of chance, and times the variance by orientations, above which stamps count as noisy. Chosen: orientations
need not be as good about all axes."""

_SMALL = 1e-4
"""s; errors of stamps that matter nowhere."""

_WRONG, _FEW = 4.0, 0.25
"""Deviations of most errors beyond which a stamp is wrong; share of such stamps up to which they are not the usual."""


@dataclass(frozen=True)
class StampErrors:
    """What the gyros show of stamps.

    Attributes
    ----------
    deviation
        By which they differ from each other at random, s; zero if not shown.
    wrong : (m,)
        Those that differ by far more.
    """

    deviation: float
    wrong: Mask


def stamp_errors(readings: Readings, reference: ReferencePoses, fit: RateFit) -> StampErrors:
    """Return the random errors of a reference's stamps; none without orientations.

    fit: of the gyros and clocks.

    Notes
    -----
    Between neighbouring poses the reference and the gyros should turn alike. Differences along the axis that b turns
    about, over the rate, add up to the errors of the stamps; across it they add up to those of orientations over the
    rate, of which as much lies along it. Of each the median of those nearby is taken off: what lasts is not noise.
    """
    wrong, tau = np.zeros(reference.stamps_ns.size, dtype=bool), reference.seconds
    if reference.quaternions is None:
        return StampErrors(0.0, wrong)
    pose, errors = _errors(readings, tau, reference.quaternions, fit)
    if pose.size < MIN_ROTATIONS:
        return StampErrors(0.0, wrong)
    of_orientations = 0.5 * np.sum(errors[:, 1:] ** 2, axis=1)
    around = np.maximum(running_mean(of_orientations[:, None], _AROUND)[:, 0], _LEAST**2)
    squares = errors[:, 0] ** 2
    excess = np.minimum(squares, np.quantile(squares, 1.0 - _TAIL)) - of_orientations
    # errors overlap; the square of one number and half that of two have three times the variance of their mean's square
    by_chance = around**-2.0
    chance = (3.0 * _NEAR / float(np.sum(by_chance))) ** 0.5
    clear = float(np.average(excess / around, weights=by_chance)) > _CLEAR
    if not clear or float(np.average(excess, weights=by_chance)) < _CERTAIN * chance:
        return StampErrors(0.0, wrong)
    usual = np.maximum(normal_scale(errors[:, 0]) ** 2, around)
    far = squares > _WRONG**2 * usual
    if few := float(far.mean()) <= _FEW:
        excess, around = excess[~far], around[~far]
    variance = 0.0
    for _ in range(_STEPS):
        variance = max(float(np.average(excess, weights=(around + variance) ** -2.0)), 0.0)
    if variance < _SMALL**2:
        return StampErrors(0.0, wrong)
    wrong[pose[far]] = few
    return StampErrors(variance**0.5, wrong)


def _errors(readings: Readings, tau: Array, q: Array, fit: RateFit) -> tuple[Indices, Array]:
    """Return poses (k,), and errors (k, 4) of their stamps by rotations along the motion and across it, s."""
    seen = steps_between(readings, tau, q, fit)
    rate = lengths(seen.rotation) / np.maximum(seen.duration, 1e-9)
    axis = seen.rotation / np.maximum(rate * seen.duration, 1e-12)[:, None]
    along = np.sum(seen.residual * axis, axis=1)
    across = seen.residual - along[:, None] * axis
    apart = 0.5 * (seen.duration[:-1] + seen.duration[1:])
    follows = (np.abs(np.diff(seen.tau) - apart) < 0.1 * apart) & (np.sum(axis[:-1] * axis[1:], axis=1) > _SAME_AXIS)
    follows &= np.minimum(rate[:-1], rate[1:]) > _SLOW
    if follows.size < _NEAR:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 4))
    steps = np.column_stack([along, across]) / np.maximum(rate, _SLOW)[:, None]
    begin = np.flatnonzero(sliding_window_view(follows, _NEAR - 2).all(axis=1))
    sums = np.zeros((begin.size, _NEAR, 4))
    np.cumsum(steps[begin[:, None] + np.arange(_NEAR - 1)], axis=1, out=sums[:, 1:])
    middle = _NEAR // 2
    errors = sums[:, middle] - np.median(sums, axis=1)
    return np.searchsorted(tau, seen.tau[begin + middle]) - 1, errors
