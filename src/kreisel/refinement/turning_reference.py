"""A reference that turns about the vertical, by what gyros seem to respond to acceleration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.fitting.fit import Fit
from kreisel.geometry.rotation import Array
from kreisel.inertial.earth import EARTH_RATE
from kreisel.model.problem import Problem, with_groups
from kreisel.model.site import EARTH_SD
from kreisel.recording.recording import DataWarning
from kreisel.units import DEG_PER_HOUR

MIMICS = "gyro_g_sensitivity"
"""The effect that a turn about the vertical looks like, for gravity is nearly all of the force."""

BY_CHANCE = 5.0
"""Logarithm of the ratio of evidences above which an effect is the same in all axes not by chance. Chosen: one stated
latitude in a hundred is wrong."""

NO_EARTH_RATE = "the gyros' readings contain no rotation of the Earth"

_SEEN, _LITTLE, _NONE = 0.2, 0.5, 16.0
"""Deviation of the level rotation, over that of the stated latitude, up to which it is seen; share of the Earth's
rotation that is little; square of the deviations of three components within which they are zero."""

_NO_LATITUDE = 3.0
"""Earth's rates beyond which a turn is that of the reference: a wrong latitude makes two at most."""


def turn_of(problem: Problem, run: Fit, value: Array, P: Array, prior: Array) -> float:
    """Return the rate, rad/s, of the turn about the vertical that a response of gyros to acceleration stands for.

    Zero where it stands for none: where it is not the same in all axes, or what a wrong latitude may be.

    Parameters
    ----------
    problem, run
        Without that response, and the fit of it.
    value, P, prior
        See `same_in_all_axes`.
    """
    rate = abs(float(np.mean(value[::4]))) * problem.site.gravity if value.size == 9 else 0.0
    if "earth_down" in problem.layout:  # without a latitude it has taken a part
        rate += abs(run.parameters.earth_down) * EARTH_RATE
    known = rate > _NO_LATITUDE * EARTH_RATE and same_in_all_axes(value, P, prior) > BY_CHANCE
    return rate if known else 0.0


def with_turn(problem: Problem, run: Fit, rate: float) -> Problem:
    """Return the problem whose vertical rotation is unknown by a rate, rad/s; it starts at a run's result."""
    free = problem if "earth_down" in problem.layout else with_free_earth_rate(problem, run)
    covariance = free.prior.covariance | {"earth_down": np.array([[(rate / EARTH_RATE) ** 2]])}
    start = free.prior.start_covariance | {"earth_down": covariance["earth_down"]}
    return replace(free, prior=replace(free.prior, covariance=covariance, start_covariance=start))


def may_lack_earth_rate(problem: Problem, run: Fit) -> bool:
    """Return whether gyros that would show the rotation at a stated latitude show little of its level part."""
    layout, site = problem.layout, problem.site
    if site.earth_rate_n is None or "north" not in layout or abs(site.earth_rate_units[0]) < _SEEN * EARTH_RATE:
        return False
    deviation = float(np.max(run.belief.standard_deviation[layout["north"]]))
    return float(np.linalg.norm(run.parameters.north)) < _LITTLE and deviation < _SEEN


def lacks_earth_rate(free: Problem, run: Fit) -> bool:
    """Return whether gyros show no rotation of the Earth, by a run with an unknown one; a wrong latitude turns it only.

    Navigation systems take it out of their rates.
    """
    d = np.r_[free.layout["north"], free.layout["earth_down"]]
    rotation = np.append(run.parameters.north, run.parameters.earth_down)
    P = run.belief.covariance[np.ix_(d, d)]
    return float(np.linalg.norm(rotation)) < _LITTLE and float(rotation @ np.linalg.solve(P, rotation)) < _NONE


def earth_rate_warning(first: Problem, last: Problem) -> list[DataWarning]:
    """Return the warning that the stated latitude says nothing of the gyros' rates.

    first, last: the problem as stated, and that of the result.
    """
    if not earth_rate_is_missing(first, last):
        return []
    text = (
        f"{NO_EARTH_RATE}, as in rates of a navigation system: it is estimated, and the stated latitude gives gravity "
        "alone (the gyros would have had to respond to acceleration alike in all axes)"
    )
    return [DataWarning("site", text)]


def earth_rate_is_missing(first: Problem, last: Problem) -> bool:
    """Return whether the rotation of a stated latitude was given up, and no turn of the reference found instead."""
    stated = first.site.earth_rate_n is not None and last.site.earth_rate_n is None
    return stated and last.prior.covariance["earth_down"][0, 0] <= EARTH_SD**2


def turn_found(first: Problem, last: Problem, run: Fit) -> tuple[float, float] | None:
    """Return the turn of the reference that was found, downward, and its deviation, deg/h; None if there is none.

    first, last: the problem as stated, and that of the run.
    """
    if "earth_down" not in last.layout:
        return None
    before = first.prior.covariance.get("earth_down", np.array([[EARTH_SD**2]]))
    if last.prior.covariance["earth_down"][0, 0] <= before[0, 0]:
        return None
    unit = EARTH_RATE / DEG_PER_HOUR
    deviation = float(run.belief.standard_deviation[last.layout["earth_down"]][0])
    return unit * run.parameters.earth_down, unit * deviation


def turn_warning(first: Problem, last: Problem, run: Fit) -> list[DataWarning]:
    """Return the warning about a turn of the reference that was found; see `turn_found`."""
    found = turn_found(first, last, run)
    if found is None:
        return []
    text = (
        f"{turn_in_words(*found)}: else the gyros would have to respond to acceleration alike in all axes. "
        "alignment.earth_rate contains this turn, which is taken to be steady"
    )
    return [DataWarning("reference", text)]


def turn_in_words(rate: float, deviation: float) -> str:
    """Return what a turn of the reference is, for a rate with its deviation, deg/h."""
    return (
        f"the reference's heading drifts, as by visual odometry: it turns about the vertical by {abs(rate):.3g} ± "
        f"{deviation:.2g} deg/h"
    )


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


def with_free_earth_rate(problem: Problem, run: Fit) -> Problem:
    """Return the problem with the Earth's rotation as three unknowns that start at a run's result."""
    level, down = (rate / EARTH_RATE for rate in problem.site.earth_rate_units)
    earth = {"north": EARTH_SD**2 * np.eye(2), "earth_down": np.array([[EARTH_SD**2]])}
    free = with_groups(replace(problem, site=replace(problem.site, earth_rate_n=None)), tuple(earth), earth)
    start = replace(run.parameters, north=level * run.parameters.north, earth_down=down)
    value = replace(problem.prior.value, north=np.zeros(2), earth_down=0.0)
    return replace(free, prior=replace(free.prior, start=start, value=value))
