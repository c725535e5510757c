"""Stated priors against what the data alone say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.fitting.fit import Fit
from kreisel.fitting.stored_state import stored_state
from kreisel.geometry.rotation import Array
from kreisel.model.problem import Problem

MAX_SCORE = 4.5
"""Standard deviations by which estimates may differ between halves of a recording, or from stated values."""

_WIDER = 2.0
"""Deviations of the wider prior that the data then lie from its centre."""

_MIN_SHARE = 0.02
"""Share of the information about a parameter that the data must give to be compared with its prior."""

OFFSETS = {"gyro_offset": "gyro", "accel_offset": "accelerometer"}
"""Groups of offsets, and the word for their sensor."""

_MIXED = ("robot_placement",)
"""Groups of which the data show mixtures, but hardly any parameter by itself."""


def prior_scores(problem: Problem, run: Fit, group: str, total: Array | None = None) -> Array:
    """Return how far the data alone lie from a group's prior, in standard deviations of the difference, (k,).

    The data alone: what the estimate says beyond its prior. Where that is too little to be told from rounding, and for
    `_MIXED` groups, the estimate itself is compared.

    total: standard deviations (degrees,) with what the run does not know of; the run's own if None. Data and prior have
    the weights that the run gave them.
    """
    place = problem.layout[group]
    prior, own = np.diag(problem.prior.covariance[group]), run.belief.standard_deviation[place] ** 2
    further = np.zeros_like(own) if total is None else np.maximum(total[place] ** 2 - own, 0.0)
    moved = np.abs(problem.stored(run.parameters, group) - problem.stored(problem.prior.value, group))
    if group in _MIXED:
        return np.asarray(moved / np.sqrt(prior))
    share = np.maximum(1.0 - own / prior, 1e-12)  # of the information that the data give
    score = moved / np.sqrt(share * own + further + share**2 * prior)
    return np.asarray(np.where(share > _MIN_SHARE, score, moved / np.sqrt(prior + further)))


def largest_score(problem: Problem, run: Fit, group: str, total: Array | None = None) -> float:
    """Return the largest score of a group's parameters that have the group's prior, not one of their own."""
    own = problem.known_places[problem.layout[group]]
    return float(np.max(prior_scores(problem, run, group, total)[~own], initial=0.0))


def prior_penalty(problem: Problem, run: Fit) -> float:
    """Return the log-likelihood that a run's estimate costs by its distance from the problem's prior."""
    layout, prior = problem.layout, problem.prior
    change = layout.minus(run.belief.mean[:, None], stored_state(problem, prior.value))[:, 0]
    groups = [group for group in problem.groups if group in prior.covariance]
    penalties = [change[layout[g]] @ np.linalg.solve(prior.covariance[g], change[layout[g]]) for g in groups]
    return 0.5 * float(sum(penalties))


def contradicted_offsets(problem: Problem, run: Fit) -> dict[str, float]:
    """Return the offsets whose stated prior the data contradict, with their scores."""
    stated = [g for g in OFFSETS if g in problem.layout and g in problem.prior.stated]
    scores = {g: largest_score(problem, run, g) for g in stated}
    return {group: score for group, score in scores.items() if score > MAX_SCORE}


def with_wider_priors(problem: Problem, scores: dict[str, float]) -> Problem:
    """Return the problem with priors so wide that the data no longer contradict them."""
    covariance = dict(problem.prior.covariance)
    for group, score in scores.items():
        factor = np.where(problem.known_places[problem.layout[group]], 1.0, score / _WIDER)
        covariance[group] = covariance[group] * np.outer(factor, factor)
    return replace(problem, prior=replace(problem.prior, covariance=covariance))
