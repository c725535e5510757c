"""Parts of a recording split along what could matter: speed, attitude, posture, sense of rotation, force, temperature.

An error that nobody listed may be the same in both halves of the time, and still differ between slow and fast moves, or
between one side of the arm and the other. The parts of a recording are therefore split at the median of each quantity;
their scores say by how much the two subsets differ in every parameter, without another fit.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from kreisel.calibration.evidence import Disagreement, LackOfFit, Split
from kreisel.calibration.lack_of_fit import larger_deviations, within_subsets
from kreisel.estimation.consistency import chi_square_bound
from kreisel.estimation.uncertainty import Contribution
from kreisel.estimation.uncertainty_budget import Source
from kreisel.geometry.rotation import Array, Indices, Mask, lengths, mean_row
from kreisel.inertial.readings import Readings
from kreisel.model.groups import group_named
from kreisel.model.parameters import PASSING_GROUPS, SENSOR_GROUPS
from kreisel.model.problem import Problem
from kreisel.recording.recording import DataWarning
from kreisel.refinement.estimate import Estimate
from kreisel.units import STANDARD_GRAVITY

CHANCE = 1e-4
"""Probability that the subsets of one split differ as much in one group by chance: there are about a hundred pairs."""

_MIN_SHARE = 0.01
"""Share of a parameter's variance that a subset must give, and of the largest eigenvalue that counts."""

_MIN_PARTS = 4
"""Parts of a subset at least, for their scatter."""

_AXES = "xyz"


def quantities(problem: Problem, ends: Indices) -> dict[str, Array]:
    """Return what may matter, by name: its mean over each part of the updates, (B,). `ends`: see `Blocks`."""
    updates, readings, reference = problem.schedule.updates, problem.sensor.readings, problem.reference
    edges = [0, *ends.tolist()]
    parts = [updates[a:b] for a, b in pairwise(edges)]
    samples = [slice(part[0].first, max(part[-1].last, part[0].first + 1)) for part in parts]
    out = _of_readings(readings, samples)
    poses = [[update.pose for update in part] for part in parts]
    if problem.robot is not None:
        angles = np.stack([problem.robot.angles[own].mean(axis=0) for own in poses], axis=1)
        out |= {f"angle of joint {j + 1}": angle for j, angle in enumerate(angles)}
    elif reference.positions is not None:
        places = np.stack([reference.positions[own].mean(axis=0) for own in poses], axis=1)
        out |= {f"position {axis}": place for axis, place in zip(_AXES, places, strict=True)}
    return out


def _of_readings(readings: Readings, samples: list[slice]) -> dict[str, Array]:
    """Return the quantities that the readings of parts show."""
    rates, forces = [readings.rates[own] for own in samples], [readings.accelerations[own] for own in samples]
    turned = np.array([mean_row(rate) * len(rate) / max(float(np.abs(rate).sum()), 1e-12) for rate in rates])
    upward = np.array([mean_row(force) for force in forces])
    out = {
        "speed": np.array([np.sqrt(np.vdot(rate, rate) / len(rate)) for rate in rates]),
        "force": np.array([np.std(lengths(force)) for force in forces]) / STANDARD_GRAVITY,
    }
    for i, axis in enumerate(_AXES):
        out[f"gravity along {axis}"] = upward[:, i]
        out[f"sense of rotation about {axis}"] = turned[:, i]
    if readings.temperature_difference is not None:
        out["temperature"] = np.array([readings.temperature_difference[own].mean() for own in samples])
    return out


def compare_splits(found: Estimate, lack: LackOfFit | None) -> tuple[tuple[Split, Array], ...]:
    """Return all splits and groups, the one that differs most first, with differences of the state (degrees,).

    Scores are in deviations with the scatter within the subsets; differences are half of those between them.

    Notes
    -----
    With the information I and the score s of a subset at the estimate, whose covariance is P, the subset moves the
    estimate by P s, of covariance P (I - I P I) P; the other moves it back. The estimates by the two subsets, of about
    equal information, lie four times that far apart, and have twice the deviation of the estimate.
    """
    if lack is None:
        return ()
    problem, constant = found.problem, lack.blocks.parameters
    factor = found.run.belief.factor[constant]
    P, out = factor @ factor.T, []
    weight = np.einsum("ij,bji->b", P, lack.blocks.information)
    for name, value in quantities(problem, lack.blocks.ends).items():
        subset = _upper_half(value, weight)
        if min(int(subset.sum()), int((~subset).sum())) < _MIN_PARTS:
            continue
        larger = larger_deviations(found, lack, within_subsets(lack, subset))
        scale = found.correlation_factor * larger[constant]
        information = lack.blocks.information[subset].sum(axis=0)
        moved = P @ lack.blocks.score[subset].sum(axis=0)
        covariance = P @ (information - information @ P @ information) @ P
        out += _by_group(problem, constant, name, moved, covariance, np.diag(P), scale)
    return tuple(sorted(out, key=lambda one: one[0].limit - one[0].size))


def _upper_half(value: Array, weight: Array) -> Mask:
    """Return the parts with the larger values of a quantity that have about half of the weight; all are (B,)."""
    order = np.argsort(value, kind="stable")
    share = np.cumsum(weight[order])
    out = np.zeros(value.size, dtype=bool)
    out[order[share > 0.5 * share[-1]]] = True
    return out


def _by_group(
    problem: Problem, constant: Indices, quantity: str, moved: Array, covariance: Array, whole: Array, scale: Array
) -> list[tuple[Split, Array]]:
    """Return how two subsets differ in each group, with half of the differences.

    Parameters
    ----------
    moved, covariance
        By how much a subset moves the estimate, (n,), and the covariance of that, (n, n).
    whole, scale
        Variances of the estimate (n,), and factors on its deviations (n,).
    """
    place = {int(k): i for i, k in enumerate(constant)}
    out = []
    for group in (g for g in SENSOR_GROUPS if g in problem.layout and g not in PASSING_GROUPS):
        part = problem.layout[group]
        own = np.array([place[k] for k in range(part.start, part.stop) if k in place], dtype=np.int64)
        own = own[np.diag(covariance)[own] > _MIN_SHARE * whole[own]]
        if own.size == 0:
            continue
        deviation = scale[own] * np.sqrt(np.diag(covariance)[own])
        score, P = moved[own] / deviation, covariance[np.ix_(own, own)] * np.outer(scale[own], scale[own])
        values, vectors = np.linalg.eigh(P / np.outer(deviation, deviation))
        kept = values > _MIN_SHARE * values[-1]
        white, count = (score @ vectors[:, kept]) / np.sqrt(values[kept]), int(kept.sum())
        worst, differences = int(np.argmax(np.abs(score))), np.zeros(problem.layout.degrees)
        differences[constant[own]] = 2.0 * moved[own]
        name = problem.parameter_names[constant[own[worst]]]
        size, limit = float(np.sqrt(np.mean(white**2))), (chi_square_bound(CHANCE, count) / count) ** 0.5
        out.append((Split(quantity, group, name, float(score[worst]), size, limit), differences))
    return out


def splits_disagreement(compared: tuple[tuple[Split, Array], ...]) -> Disagreement:
    """Return what groups add to the uncertainty in which subsets contradict each other.

    Either subset may be right: half of their difference, less what is by chance, is one deviation of the result.
    The split that differs most counts in a group, and names along what the error changes.
    """
    columns, words, seen = [], [], set[str]()
    for split, differences in compared:
        if not split.contradicts or split.group in seen:
            continue
        seen.add(split.group)
        columns.append((1.0 - split.size**-2) ** 0.5 * differences[:, None])
        differ = f"{split.parameter} by {abs(split.score):.1f} deviations"
        words.append(f"{split.quantity} in {group_named(split.group).path} ({differ})")
    if not columns:
        return Disagreement()
    text = (
        "parts of the recording with low and high values of a quantity contradict each other: an error that is not "
        f"modelled changes with {'; '.join(words)}. Standard deviations contain half of the differences"
    )
    return Disagreement(
        (Contribution("disagreement: splits", Source.MISFIT, np.hstack(columns)),), (DataWarning("splits", text),)
    )
