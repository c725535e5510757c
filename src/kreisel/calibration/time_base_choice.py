"""Which clock counts true seconds, where the data show it.

Accelerations by the positions change with the square of the seconds, gravity does not. By a clock that is 3 per mille
off, positions seem 6 per mille too long: more than arms or cameras err.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.estimation.uncertainty import Contribution
from kreisel.estimation.uncertainty_budget import Source
from kreisel.model.parameters import SENSOR_GROUPS
from kreisel.model.problem import usual_covariance
from kreisel.preparation.preparation import Preparation
from kreisel.preparation.time_base import CRYSTALS
from kreisel.recording.recording import DataWarning, Recording
from kreisel.refinement.estimate import Estimate

_SCALES = ("gravity", "position_scale", "robot_placement")
"""Groups that take up what wrong seconds do to accelerations."""

_SURE = 10.0
"""Logarithm of the odds that are enough to choose a clock."""


def is_open(preparation: Preparation) -> bool:
    """Return whether it is not known which clock is right, and the clocks differ by more than crystals do."""
    clock, reference = preparation.rate_fit.clock, preparation.reference
    stated = preparation.recording.settings.imu.time_base is not None
    measured = reference.positions is not None and reference.quaternions is not None
    return not stated and measured and abs(clock.skew) > CRYSTALS + 3.0 * clock.skew_sd


def with_time_base(recording: Recording, base: str) -> Recording:
    """Return the recording as if its user had stated whose seconds are true."""
    imu = recording.settings.imu.model_copy(update={"time_base": base})
    return replace(recording, settings=recording.settings.model_copy(update={"imu": imu}))


def conflict(found: Estimate) -> float:
    """Return how improbable gravity and the lengths of the reference are, half a chi-square.

    Likelihoods are not compared: with other stamps other readings belong to an update.
    """
    problem, run, total = found.problem, found.run, 0.0
    for group in _SCALES:
        if group not in problem.layout:
            continue
        far = run.parameters.stored(group) - problem.prior.value.stored(group)
        wide = group == "position_scale"  # its prior grows with its size where the data show it
        P = usual_covariance(group, problem) if wide else problem.prior.covariance[group]
        total += 0.5 * float(far @ np.linalg.solve(P, far))
    return total


def better_base(by_imu: Estimate, by_reference: Estimate) -> str | None:
    """Return the clock whose seconds are the true ones, or None where the data do not show it."""
    gain = conflict(by_imu) - conflict(by_reference)
    return None if abs(gain) < _SURE else "reference" if gain > 0.0 else "imu"


def with_choice(found: Estimate, base: str, skew: float) -> Estimate:
    """Return the estimate by the seconds of the clock that was chosen, with a warning that says so."""
    whose = "reference" if base == "reference" else "IMU"
    text = (
        f"the clocks differ by {1e3 * skew:+.2f} per mille. Motion by the positions agrees with gravity only if the "
        f'seconds of the {whose} are the true ones: they are used (imu.time_base = "{base}" in recording.toml)'
    )
    noise = replace(found.problem.noise, time_base_sd=0.0) if base == "imu" else found.problem.noise
    warnings = (*found.warnings, DataWarning("clocks", text))
    return replace(found, problem=replace(found.problem, noise=noise), warnings=warnings)


def with_either(found: Estimate, other: Estimate) -> Estimate:
    """Return an estimate with deviations for the seconds of either clock, where it is not known which are true.

    Parameters
    ----------
    found, other
        By the seconds of the IMU and of the reference.

    Notes
    -----
    Gyros follow the difference of the clocks, accelerometers its double as far as motion, and not gravity, determines
    their scale: the difference of the two estimates is one deviation.
    """
    problem, layout, there = found.problem, found.problem.layout, other.problem.layout
    column = np.zeros((layout.degrees, 1))
    for group in (*SENSOR_GROUPS, "gravity"):
        if group in layout and group in there:
            change = problem.columns(group, other.run.parameters.stored(group) - found.run.parameters.stored(group))
            column[layout[group], 0] = change
    problem = replace(problem, noise=replace(problem.noise, time_base_sd=0.0))
    return replace(found, problem=problem).adding([Contribution("whose seconds are true", Source.CLOCKS, column)])
