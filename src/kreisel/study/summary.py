"""Summary of many trials: error over standard deviation, NEES, coverage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.estimation.consistency import chi_square_bound
from kreisel.geometry.rotation import Array
from kreisel.study.trial import Trial
from kreisel.units import DEG_PER_HOUR, MG

GROUPS = (
    ("gyroscope.cross_coupling", "gyro cross-coupling", "ppm", 1e6),
    ("gyroscope.offset", "gyro offset", "deg/h", 1.0 / DEG_PER_HOUR),
    ("gyroscope.polynomial", "gyro polynomial", "SI", 1.0),
    ("accelerometer.cross_coupling", "accelerometer cross-coupling", "ppm", 1e6),
    ("accelerometer.offset", "accelerometer offset", "mg", 1.0 / MG),
    ("accelerometer.polynomial", "accelerometer polynomial", "SI", 1.0),
    ("accelerometer.lever_arms", "lever arms", "mm", 1e3),
    ("alignment.tilt", "gravity's direction", "urad", 1e6),
    ("timing.offset", "time offset", "ms", 1e3),
    ("timing.skew", "clock ratio", "ppm", 1e6),
)
"""Start of the parameters' names, title, unit and its inverse."""

WITHIN = {"68 %": 0.9944579, "95 %": 1.9599640}
"""Standard deviations on either side that contain 68 and 95 % of a normal variable."""


@dataclass(frozen=True)
class GroupSummary:
    """A group over all trials.

    Attributes
    ----------
    error, deviation
        Rms, in `unit`.
    ratio, ratio_bounds
        Rms of error over standard deviation, and its 95 % interval over trials.
    coverage
        Share of errors within the intervals of `WITHIN`.
    """

    title: str
    unit: str
    error: float
    deviation: float
    ratio: float
    ratio_bounds: tuple[float, float]
    coverage: dict[str, float]


@dataclass(frozen=True)
class Summary:
    """All trials together; `nees` is the mean per degree of freedom, with the 95 % interval it should lie in."""

    trials: int
    failed: int
    rejected: int
    groups: tuple[GroupSummary, ...]
    nees: float
    nees_bounds: tuple[float, float]
    nis_path: float
    nis_standstill: float
    seconds: float

    @property
    def consistent(self) -> bool:
        """Whether the NEES lies in its interval."""
        return self.nees_bounds[0] <= self.nees <= self.nees_bounds[1]


def summarise(trials: Sequence[Trial]) -> Summary | None:
    """Return the summary of trials, or None if all failed.

    Rejected trials are counted. Their errors are left out unless all were rejected, because a user sees the verdict.
    """
    good = [trial for trial in trials if not trial.failure]
    judged = [trial for trial in good if trial.accepted] or good
    if not good:
        return None
    degrees = float(sum(len(trial.names) for trial in judged))
    tails = tuple(chi_square_bound(tail, degrees) / degrees for tail in (0.975, 0.025))
    groups = [_group(judged, *group) for group in GROUPS]
    return Summary(
        trials=len(trials),
        failed=len(trials) - len(good),
        rejected=sum(not trial.accepted for trial in good),
        groups=tuple(group for group in groups if group is not None),
        nees=sum(trial.nees for trial in judged) / degrees,
        nees_bounds=(tails[0], tails[1]),
        nis_path=float(np.mean([trial.nis_path for trial in judged])),
        nis_standstill=float(np.nanmean([trial.nis_standstill for trial in judged])),
        seconds=float(np.mean([trial.seconds for trial in good])),
    )


def scores_of(trials: Sequence[Trial], stem: str) -> list[float]:
    """Return error over standard deviation of every parameter whose name begins with `stem`, in accepted trials."""
    return [
        e / sd
        for trial in trials
        if trial.accepted
        for name, e, sd in zip(trial.names, trial.error.tolist(), trial.deviation.tolist(), strict=True)
        if name.startswith(stem)
    ]


def _group(trials: Sequence[Trial], stem: str, title: str, unit: str, factor: float) -> GroupSummary | None:
    errors, deviations, means = [], [], []
    for trial in trials:
        own = np.array([name.startswith(stem) for name in trial.names])
        if not own.any():
            continue
        e, sd = trial.error[own], trial.deviation[own]
        errors.append(e)
        deviations.append(sd)
        means.append(float(np.mean((e / sd) ** 2)))
    if not errors:
        return None
    e, sd = np.concatenate(errors), np.concatenate(deviations)
    score = np.abs(e / sd)
    return GroupSummary(
        title,
        unit,
        factor * float(np.sqrt(np.mean(e**2))),
        factor * float(np.sqrt(np.mean(sd**2))),
        float(np.sqrt(np.mean(means))),
        _interval(np.array(means)),
        {name: float(np.mean(score <= bound)) for name, bound in WITHIN.items()},
    )


def _interval(means: Array) -> tuple[float, float]:
    """Return the 95 % interval of the root of the mean over trials, by bootstrap over trials."""
    rng = np.random.default_rng(0)
    drawn = np.sqrt(rng.choice(means, size=(2000, means.size)).mean(axis=1))
    low, high = np.quantile(drawn, [0.025, 0.975])
    return float(low), float(high)
