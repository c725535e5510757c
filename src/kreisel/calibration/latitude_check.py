"""Comparison of the stated latitude with the Earth's rotation that good gyros measure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.calibration.evidence import LatitudeCheck
from kreisel.fitting.fit import Fit
from kreisel.fitting.terms import GYRO_ROWS, Terms
from kreisel.geometry.rotation import Array
from kreisel.inertial.earth import EARTH_RATE
from kreisel.model.problem import Problem, with_nominal, without_groups
from kreisel.model.site import EARTH_SD
from kreisel.progress import Progress, of_step
from kreisel.refinement.discrepancy_terms import axes_of_n
from kreisel.refinement.estimate import Estimate
from kreisel.refinement.named_terms import has_offsets
from kreisel.refinement.sample_groups import SampleGroups
from kreisel.refinement.turning_reference import BY_CHANCE, MIMICS, same_in_all_axes, with_free_earth_rate
from kreisel.units import STANDARD_GRAVITY

_AS_GOOD = 10.0
"""By how much the likelihood must fall without the effect that a wrong latitude looks like, to be accepted."""

_NO_LATITUDE, _VAGUE_DEG = 9.0, 10.0
"""Square of the deviations by which a rotation of the Earth's size may miss what is found, and deviation (deg) of a
latitude, beyond which it is not the latitude that is found."""

_CLEAR = 2.0
"""Score below which a check to first order needs no run. Chosen: half of that at which a latitude is contradicted."""

SEEN = 0.2
"""Standard deviation of north, in units of the Earth's rate, above which the gyros cannot determine the latitude."""


def check_latitude(found: Estimate, progress: Progress | None = None) -> LatitudeCheck | None:
    """Return the stated latitude compared with the data; None without a latitude, or if it is not observable."""
    problem, run, estimator = found.problem, found.run, found.estimator
    layout, site = problem.layout, problem.site
    if site.earth_rate_n is None or "north" not in layout:
        return None
    level, down = site.earth_rate_units
    north_sd = abs(level) / EARTH_RATE * float(np.max(run.belief.standard_deviation[layout["north"]]))
    if north_sd > SEEN and abs(level) > 0.1 * EARTH_RATE and MIMICS not in layout:
        return None
    # what is not estimated is in the north as it is in the Earth's rotation
    larger = float(np.max(found.deviation[layout["north"]] / run.belief.standard_deviation[layout["north"]]))
    stated = down / EARTH_RATE
    if MIMICS not in layout:
        check = _linearised(found, stated, larger)
        if check is not None and check.score < _CLEAR:
            return check
    step = of_step(progress, "latitude")
    free = with_free_earth_rate(problem, run)
    fit = estimator.fit(free, progress=step)
    if MIMICS in layout:
        # A wrong latitude looks like gyros that respond to acceleration: along gravity, and equally in all axes.
        plain = replace(run, parameters=with_nominal(problem, run.parameters, (MIMICS,)))
        simpler = with_free_earth_rate(without_groups(problem, (MIMICS,)), plain)
        other = estimator.fit(simpler, progress=step)
        if other.history.log_likelihood.sum() > fit.history.log_likelihood.sum() - _AS_GOOD:
            isotropic = _isotropic(free, fit) > BY_CHANCE
            check = _check_of(simpler, other, stated, larger, 0.0 if isotropic else _by_effect(problem))
            if check is not None:
                return check
    return _check_of(free, fit, stated, larger)


def _linearised(found: Estimate, stated: float, larger: float) -> LatitudeCheck | None:
    """Return the check to first order about an estimate; None where it takes a run with a free rotation."""
    problem, run = found.problem, found.run
    # terms of readings enter with the offsets of their axes
    if found.linear is None or problem.reference.quaternions is None or not has_offsets(problem, "gyro_offset"):
        return None
    part, level = problem.layout["north"], problem.site.earth_rate_units[0] / EARTH_RATE
    about = found.linear.about(_vertical_terms(problem, run))
    alike = np.ones(3)  # one rate in all three axes of the gyros
    information = float(alike @ about.information @ alike) + EARTH_SD**-2
    more = (float(alike @ about.score) - stated * EARTH_SD**-2) / information
    column = level * (about.change @ alike)[part]
    north = level * run.parameters.north + column * more
    P = np.empty((3, 3))
    P[:2, :2] = level**2 * run.belief.covariance[part, part] + np.outer(column, column) / information
    P[:2, 2] = P[2, :2] = column / information
    P[2, 2] = 1.0 / information
    return _of_rotation(north, stated + more, larger**2 * P, stated)


def _vertical_terms(problem: Problem, run: Fit) -> Terms:
    """Return what a further unit of the Earth's rate downward adds to the readings of each gyro."""
    stamps, (first, last) = problem.sensor.readings.stamps, problem.schedule.samples
    grid = SampleGroups.of(stamps)
    t = grid.average(stamps[:, None])[:, 0]
    down = axes_of_n(problem, run.parameters, t)[:, :, 2]
    rates = -EARTH_RATE * down @ np.linalg.inv(run.parameters.sensors.K_omega).T
    directions = np.broadcast_to(np.eye(6), (first.size, 6, 6))
    return Terms(grid.mean(rates.__getitem__, first, last), np.arange(3), np.array(GYRO_ROWS), directions)


def _isotropic(free: Problem, fit: Fit) -> float:
    """Return the logarithm of how much likelier the effect is the same in all axes than as its prior has it."""
    part = free.layout[MIMICS]
    value = fit.belief.mean[free.layout.stored(MIMICS)]
    return same_in_all_axes(value, fit.belief.covariance[part, part], free.prior.covariance[MIMICS])


def _by_effect(problem: Problem) -> float:
    """Return the rotation that gyros of the grade may seem to see by their response to gravity, in Earth's rates."""
    prior = problem.prior
    if MIMICS not in (*prior.expected, *prior.likely):
        return 0.0
    usual = float(np.sqrt(np.max(np.diag(prior.covariance[MIMICS]))))
    return usual * STANDARD_GRAVITY / EARTH_RATE


def _check_of(free: Problem, found: Fit, stated: float, larger: float, beyond: float = 0.0) -> LatitudeCheck | None:
    """Return the check of a run with a free Earth's rotation; None where it says nothing of the latitude.

    Parameters
    ----------
    larger
        Factor on its deviations.
    beyond
        Deviation of each component that the run does not contain.
    """
    d = free.layout
    index = np.r_[d["north"], d["earth_down"]]
    P = larger**2 * found.belief.covariance[np.ix_(index, index)] + beyond**2 * np.eye(3)
    return _of_rotation(found.parameters.north, found.parameters.earth_down, P, stated)


def _of_rotation(north: Array, vertical: float, P: Array, stated: float) -> LatitudeCheck | None:
    """Return the check of an estimated rotation; None where it is too uncertain, or no latitude explains it."""
    return None if float(np.sqrt(np.diag(P)).max()) > SEEN else _compared(north, vertical, P, stated)


def _compared(north: Array, vertical: float, P: Array, stated: float) -> LatitudeCheck | None:
    """Return the check of an estimated Earth's rotation, in units of its rate; None where no latitude explains it.

    Parameters
    ----------
    P : (3, 3)
        Covariance of its two level components and the downward one.
    stated
        Downward component at the stated latitude.

    Notes
    -----
    The size of the rotation is known, so only its direction is free: the score is the root of how much better the best
    latitude fits than the stated one.
    """
    horizontal = float(np.linalg.norm(north))
    J = np.zeros((2, 3))
    J[0, :2], J[1, 2] = north / horizontal if horizontal > 0.0 else (1.0, 0.0), 1.0
    information = np.linalg.inv(J @ P @ J.T)

    def misfit(latitude: Array) -> Array:
        off = np.array([horizontal - np.cos(latitude), vertical + np.sin(latitude)])
        return np.einsum("i...,ij,j...->...", off, information, off)

    everywhere = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 18_001)
    fits = misfit(everywhere)
    best = float(everywhere[int(np.argmin(fits))])
    along = np.array([-np.sin(best), -np.cos(best)])
    deviation = float(np.degrees((along @ information @ along) ** -0.5))
    if float(fits.min()) > _NO_LATITUDE or deviation > _VAGUE_DEG:
        return None
    here = float(misfit(np.array(np.arcsin(-stated))))
    score = float(np.sqrt(max(here - float(fits.min()), 0.0)))
    return LatitudeCheck(float(np.degrees(np.arcsin(-stated))), float(np.degrees(best)), deviation, score)
