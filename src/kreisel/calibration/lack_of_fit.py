"""Lack of fit: how much more the parts of a recording differ in what they say than the model lets them differ.

An error that nobody listed changes from move to move, for it depends on something that the moves do not have in
common. The blocks' scores then scatter more than their information says, whatever the error is, and the covariance
that follows from their scatter (Huber 1967, White 1980: the sandwich) is that of the estimate under the wrong model.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from kreisel.calibration.evidence import Disagreement, LackOfFit
from kreisel.estimation.consistency import chi_square_bound
from kreisel.estimation.uncertainty import Contribution
from kreisel.estimation.uncertainty_budget import Source
from kreisel.fitting.blocks import Blocks
from kreisel.fitting.partition import MIN_BLOCKS, block_ends
from kreisel.geometry.rotation import Array, Mask
from kreisel.model.parameters import SENSOR_GROUPS
from kreisel.progress import StepProgress
from kreisel.recording.recording import DataWarning
from kreisel.refinement.estimate import Estimate

CHANCE = 1e-3
"""Probability that a group's scatter is as large by chance."""

_KNOWN_CHANCE = 0.5
"""The same where generic terms were found: the model is known to be wrong, and what is left of an error remains."""

_MIN_SHARE = 0.01
"""Share of a parameter's variance that must come from the blocks, not from its prior."""

_BEYOND = 2.5
"""Standard deviations of sums of neighbours' products beyond which they count."""

_LAGS = 2
"""Blocks after which scores are independent, for sums of their products (Bartlett weights, Newey and West 1987)."""


def lack_of_fit(found: Estimate, progress: StepProgress | None = None) -> LackOfFit | None:
    """Return the scatter of blocks about an estimate; None where there are too few."""
    ends = block_ends(found.problem)
    belief = found.run.belief
    if len(ends) < MIN_BLOCKS or found.problem.constant(belief.standard_deviation).size == 0:
        return None
    blocks = found.blocks or found.estimator.blocks(found.problem, found.run, ends, progress)
    factor = belief.factor[blocks.parameters]
    names = tuple(found.problem.parameter_names[k] for k in blocks.parameters)
    return replace(scatter(blocks, factor @ factor.T), names=names)


def scatter(blocks: Blocks, P: Array) -> LackOfFit:
    """Return the scatter of blocks, for the covariance P (n, n) of the estimate.

    Notes
    -----
    The sums of equation (27). Scores at the estimate have the covariance I_b - I_b P I_b, for what the block itself has
    moved the estimate by is missing in them. Products of neighbours count where they add to the variance beyond chance.
    """
    reduced = P @ (blocks.information - blocks.information @ P @ blocks.information) @ P
    influence = blocks.score @ P
    found = influence.T @ influence
    own = np.maximum(np.diagonal(reduced, axis1=1, axis2=2), 0.0)
    degrees = float(np.median(degrees_of(own.T[:, :, None, None])))
    weights = [2.0 * (1.0 - lag / (_LAGS + 1)) for lag in range(1, min(_LAGS, len(influence) - 1) + 1)]
    neighbours = sum(
        (weight * np.sum(influence[lag:] * influence[:-lag], axis=0) for lag, weight in enumerate(weights, start=1)),
        np.zeros(len(P)),
    )
    more = neighbours / np.maximum(np.diag(found), 1e-300)
    chance = _BEYOND * math.hypot(*weights) / degrees**0.5
    larger = np.sqrt(1.0 + np.where(more > chance, more, 0.0))
    return LackOfFit(blocks, influence, reduced, larger[:, None] * found * larger, degrees)


def degrees_of(covariance: Array) -> Array:
    """Return the degrees of freedom (...,) of the sums of squares of independent vectors, by their covariances.

    Parameters
    ----------
    covariance : (..., B, k, k)
        Of each vector.

    Notes
    -----
    Those of the chi-square distribution, times a factor, that has the same mean and variance (Satterthwaite 1946).
    """
    mean = np.trace(covariance.sum(axis=-3), axis1=-2, axis2=-1)
    return np.asarray(np.maximum(1.0, mean**2 / np.maximum(np.sum(covariance**2, axis=(-3, -2, -1)), 1e-300)))


def within_subsets(lack: LackOfFit, subset: Mask) -> Array:
    """Return the covariance (n, n) by the scatter of blocks about what a subset of them (B,), and all others, say.

    A difference between the two does not count in it.
    """
    rest = lack.influence.copy()
    for half in (subset, ~subset):
        share = lack.variance[half] / np.maximum(lack.variance[half].sum(axis=0), 1e-300)
        rest[half] -= share * lack.influence[half].sum(axis=0)
    count = len(rest)
    return np.asarray(rest.T @ rest * (count / max(count - 2, 1)))


def larger_deviations(found: Estimate, lack: LackOfFit | None, scattered: Array | None = None) -> Array:
    """Return factors (degrees,) on the deviations of the sensors' parameters by the scatter of blocks; 1 by chance.

    scattered: covariance of the estimate by their scatter (n, n), if it is not that about the estimate.

    Notes
    -----
    A group is judged as a whole, in units of what is expected of it, so that few blocks say enough; correlated
    innovations, which have been counted, are the same scatter. In a group that differs, a parameter that scatters more
    than the others, beyond chance, counts with its own scatter.
    """
    problem = found.problem
    out = np.ones(problem.layout.degrees)
    if lack is None:
        return out
    scattered = lack.found if scattered is None else scattered
    place = {int(k): i for i, k in enumerate(lack.blocks.parameters)}
    variance = found.run.belief.standard_deviation**2
    for group in SENSOR_GROUPS:
        if group not in problem.layout:
            continue
        part = problem.layout[group]
        inside = np.array([k for k in range(part.start, part.stop) if k in place], dtype=np.int64)
        places = np.array([place[k] for k in inside.tolist()], dtype=np.int64)
        enough = np.diag(lack.expected)[places] > _MIN_SHARE * variance[inside]
        shown, own = inside[enough], places[enough]
        if own.size == 0:
            continue
        expected = found.correlation_factor**2 * lack.expected[np.ix_(own, own)]
        size = np.sqrt(np.diag(expected))
        values, vectors = np.linalg.eigh(expected / np.outer(size, size))
        kept = values > _MIN_SHARE
        white = vectors[:, kept] / np.sqrt(values[kept])
        scaled = scattered[np.ix_(own, own)] / np.outer(size, size)
        parts = lack.covariance[:, own[:, None], own] / np.outer(size, size)
        degrees = float(degrees_of(white.T @ parts @ white))
        ratio = float(np.trace(white.T @ scaled @ white)) / int(kept.sum())
        if ratio > chi_square_bound(_KNOWN_CHANCE if found.discrepancy else CHANCE, degrees) / degrees:
            alone = np.diag(scaled) / (chi_square_bound(0.05, lack.degrees) / lack.degrees)
            out[shown] = np.sqrt(np.maximum(1.0, np.maximum(ratio, alone)))
    return out


def lack_of_fit_disagreement(found: Estimate, factor: Array) -> Disagreement:
    """Return what factors on deviations, from the scatter of blocks, add to the uncertainty."""
    if not (factor > 1.0).any():
        return Disagreement()
    problem, root, columns, differing = found.problem, found.as_noisy, [], []
    for group in SENSOR_GROUPS:
        if group in problem.layout and (factor[problem.layout[group]] > 1.0).any():
            part = problem.layout[group]
            further = np.zeros_like(root)
            further[part] = np.sqrt(factor[part, None] ** 2 - 1.0) * root[part]
            columns.append(further)
            differing.append(f"{group} {float(np.median(factor[part])):.1f}")
    words = (
        "parts of the recording differ in what they say by more than the model lets them; standard deviations were "
        f"multiplied: {', '.join(differing)}"
    )
    return Disagreement(
        (Contribution("lack of fit: parts of the recording", Source.MISFIT, np.hstack(columns)),),
        (DataWarning("fit", words),),
    )
