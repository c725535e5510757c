"""Readings that a device truncates to zero: half a step of each is restored, where the data show that it is missing.

Firmware that converts to integers by `(int)` does so. Means of readings that stay on one side of zero lack half a step;
it looks like an offset of one sign on one side, and of the other on the other, and scale factors take a part of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.model.considered_terms import MIN_GAIN
from kreisel.progress import Progress, of_step
from kreisel.recording.recording import DataWarning
from kreisel.static.multi_position import StaticEstimate, estimate_static, fitted, undecided_by
from kreisel.static.rest_problem import RestProblem, raw_of
from kreisel.static.rounding import ZEROS, alike, mean_of_truncated, steps_of
from kreisel.static.static_methods import Chosen

_MATTERS = 0.5
"""Deviations of an offset that half a step must be for truncation to be considered."""

_ODDS = 0.2
"""Odds that a device truncates, before any look at the data. Chosen: most round, or pass on a converter's counts."""

_FAR = 50.0
"""Logarithm of odds that are certain."""

_IN_REACH = -10.0
"""Gain with the effects that were found without it from which effects are chosen anew. Chosen: of three devices the
whole estimate changed the gain by 0.5 at most; an effect that only stands for truncation costs less than 10."""

_TRUNCATED = (
    "the device truncates its readings to zero, in steps of {steps}, as turns and gravity show: half a step of each is "
    "restored; have the device round, or add half a step away from zero to each reading to which the result is applied"
)
"""What is said of such a device."""


def with_truncation(
    chosen: Chosen, found: StaticEstimate, progress: Progress | None
) -> tuple[Chosen, StaticEstimate]:  # fmt: skip
    """Return method and estimate with half steps restored, if the data show that they are missing.

    One program truncates all that it sends: what gyros or accelerometers show holds for both. Where they do not decide,
    what it would do to the parameters counts by its probability.
    """
    problem, layout = chosen.problem, found.problem.layout
    steps = _steps(problem)
    deviations = [found.deviation[layout[name]][:3] for name in ("gyro_offset", "accel_offset")]
    matters = [bool((0.5 * step > _MATTERS * own).any()) for step, own in zip(steps, deviations, strict=True)]

    def anew(problem: RestProblem) -> StaticEstimate:
        return estimate_static(problem, chosen.start, of_step(progress, "fit"), chosen.attitudes)

    def without(which: tuple[bool, bool]) -> tuple[Chosen, StaticEstimate]:
        """Return method and estimate without truncation; effects are chosen anew where it may be shown."""
        restored = _restored(problem, (steps[0] * which[0], steps[1] * which[1]))
        alike = restored.with_effects(found.problem.effects)
        near = fitted(alike, found.parameters, found.noise, found.inflated, found.attitudes)
        if near.log_evidence - found.log_evidence >= _IN_REACH:
            near = anew(restored)
        return replace(chosen, problem=restored), near

    which = [own for own, one in zip(((True, False), (False, True)), matters, strict=True) if one]
    trials = [without(own) for own in which]
    plain = [other.log_evidence - found.log_evidence for _, other in trials]
    says = [not own[0] or _show_steps(problem) for own in which]
    gain = sum(own for own, one in zip(plain, says, strict=True) if one)
    if not trials or gain < MIN_GAIN:
        open_ = [
            undecided_by(found, other, _ODDS * float(np.exp(np.clip(gain - own, -_FAR, _FAR))))
            for (_, other), own in zip(trials, plain, strict=True)
        ]
        return chosen, replace(found, undecided=np.hstack([found.undecided, *open_]))
    whole, other = trials[0]
    if all(matters):
        whole = replace(chosen, problem=_restored(problem, steps))
        other = anew(whole.problem)
    sizes = [f"{step.max():.2g} {unit}" for step, unit in zip(steps, ("rad/s", "m/s^2"), strict=True) if step.any()]
    said = DataWarning("imu", _TRUNCATED.format(steps=" and ".join(sizes)))
    return replace(whole, warnings=(*chosen.warnings, said)), other


def _show_steps(problem: RestProblem) -> bool:
    """Return whether the gyros' readings differ between standstills.

    If all are zero, a single error of up to a step is counted as one of each standstill, and of each turn: wider ones
    would seem to fit worse by far.
    """
    return bool(np.ptp(problem.rests.rates, axis=0).any())


def _steps(problem: RestProblem) -> tuple[Array, Array]:
    parts = _parts(problem)
    return steps_of(problem.imu.rates, parts), steps_of(problem.imu.accelerations, parts)


def _parts(problem: RestProblem) -> list[tuple[int, int]]:
    return list(zip(problem.rests.first.tolist(), problem.rests.last.tolist(), strict=True))


def _restored(problem: RestProblem, steps: tuple[Array, Array]) -> RestProblem:
    """Return the problem with readings half a step farther from zero."""
    imu, rests = problem.imu, problem.rests
    rates, forces = (
        values + 0.5 * step * np.sign(values)
        for values, step in zip((imu.rates, imu.accelerations), steps, strict=True)
    )
    imu = replace(imu, rates=rates, accelerations=forces)
    if not rests.silent:
        means, variances = _means(problem, problem.imu.rates, rates, steps[0])
        rests = replace(rests, rates=means, rounding_w=np.maximum(variances, rests.rounding_w))
    means, variances = _means(problem, problem.imu.accelerations, forces, steps[1])
    rests = replace(rests, forces=means, rounding_a=np.maximum(variances, rests.rounding_a))
    return replace(problem, imu=imu, raw=raw_of(imu), rests=rests)


def _means(problem: RestProblem, read: Array, restored: Array, steps: Array) -> tuple[Array, Array]:
    """Return the means of standstills, (M, 3), and variances of those that are about zero."""
    means = problem.rests.means_of(restored.T)
    variances = np.zeros_like(means)
    for axis in np.flatnonzero(steps):
        for m, (a, b) in enumerate(_parts(problem)):
            part = read[a:b, axis]
            if np.mean(part == 0.0) > ZEROS:
                means[m, axis], variances[m, axis] = mean_of_truncated(part, steps[axis])
        unknown = variances[:, axis] >= steps[axis] ** 2 / 12.0
        variances[unknown, axis] *= alike(means[unknown, axis], steps[axis])
    return means, variances
