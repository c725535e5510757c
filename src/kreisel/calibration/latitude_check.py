"""Comparison of the stated latitude with the Earth's rotation that good gyros measure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.calibration.evidence import LatitudeCheck
from kreisel.fitting.fit import Fit
from kreisel.geometry.rotation import Array
from kreisel.inertial.earth import EARTH_RATE
from kreisel.model.problem import Problem, with_groups, with_nominal, without_groups
from kreisel.preparation.start_values import EARTH_SD
from kreisel.progress import Progress, of_step
from kreisel.refinement.estimate import Estimate
from kreisel.units import STANDARD_GRAVITY

_MIMICS, _AS_GOOD = "gyro_g_sensitivity", 10.0
"""The effect that a wrong latitude looks like, and by how much the likelihood must fall without it to be accepted."""

_BY_CHANCE = 5.0
"""Logarithm of the ratio of evidences above which an effect is the same in all axes not by chance. Chosen: one stated
latitude in a hundred is wrong."""

_NO_LATITUDE, _VAGUE_DEG = 9.0, 10.0
"""Square of the deviations by which a rotation of the Earth's size may miss what is found, and deviation (deg) of a
latitude, beyond which it is not the latitude that is found."""

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
    if north_sd > SEEN and abs(level) > 0.1 * EARTH_RATE and _MIMICS not in layout:
        return None
    step = of_step(progress, "latitude")
    # what is not estimated is in the north as it is in the Earth's rotation
    larger = float(np.max(found.deviation[layout["north"]] / run.belief.standard_deviation[layout["north"]]))
    free = _with_free_earth_rate(problem, run)
    fit, stated = estimator.fit(free, progress=step), down / EARTH_RATE
    if _MIMICS in layout:
        # A wrong latitude looks like gyros that respond to acceleration: along gravity, and equally in all axes.
        plain = replace(run, parameters=with_nominal(problem, run.parameters, (_MIMICS,)))
        simpler = _with_free_earth_rate(without_groups(problem, (_MIMICS,)), plain)
        other = estimator.fit(simpler, progress=step)
        if other.history.log_likelihood.sum() > fit.history.log_likelihood.sum() - _AS_GOOD:
            isotropic = _isotropic(free, fit) > _BY_CHANCE
            check = _check_of(simpler, other, stated, larger, 0.0 if isotropic else _by_effect(problem))
            if check is not None:
                return check
    return _check_of(free, fit, stated, larger)


def _isotropic(free: Problem, fit: Fit) -> float:
    """Return the logarithm of how much likelier the effect is the same in all axes than as its prior has it."""
    part = free.layout[_MIMICS]
    value = fit.belief.mean[free.layout.stored(_MIMICS)]
    return same_in_all_axes(value, fit.belief.covariance[part, part], free.prior.covariance[_MIMICS])


def same_in_all_axes(value: Array, P: Array, prior: Array) -> float:
    """Return the logarithm of how much likelier a matrix is a multiple of the unit matrix than as its prior has it.

    The ratio of the posterior density of its eight other components to their prior one, both at zero (Savage and
    Dickey). Gyros respond to acceleration by nine numbers, which are no multiple of the unit matrix by chance.

    Parameters
    ----------
    value : (9,)
        Its entries; of fewer the answer is minus infinity.
    P, prior : (9, 9)
        Their covariance, and that before any look at the data.
    """
    others = np.linalg.svd(np.eye(3).reshape(1, 9))[2][1:]
    if value.size != others.shape[1]:
        return -np.inf
    found, before = (others @ C @ others.T for C in (P, prior))
    off = others @ value
    more = np.linalg.slogdet(before)[1] - np.linalg.slogdet(found)[1]
    return float(0.5 * (more - off @ np.linalg.solve(found, off)))


def _by_effect(problem: Problem) -> float:
    """Return the rotation that gyros of the grade may seem to see by their response to gravity, in Earth's rates."""
    prior = problem.prior
    if _MIMICS not in (*prior.expected, *prior.likely):
        return 0.0
    usual = float(np.sqrt(np.max(np.diag(prior.covariance[_MIMICS]))))
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
    if float(np.sqrt(np.diag(P)).max()) > SEEN:
        return None
    return _compared(found.parameters.north, found.parameters.earth_down, P, stated)


def _with_free_earth_rate(problem: Problem, run: Fit) -> Problem:
    """Return the problem with the Earth's rotation as three unknowns that start at a run's result."""
    level, down = (rate / EARTH_RATE for rate in problem.site.earth_rate_units)
    earth = {"north": EARTH_SD**2 * np.eye(2), "earth_down": np.array([[EARTH_SD**2]])}
    free = with_groups(replace(problem, site=replace(problem.site, earth_rate_n=None)), tuple(earth), earth)
    start = replace(run.parameters, north=level * run.parameters.north, earth_down=down)
    value = replace(problem.prior.value, north=np.zeros(2), earth_down=0.0)
    return replace(free, prior=replace(free.prior, start=start, value=value))


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
