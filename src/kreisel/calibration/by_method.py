"""What several estimators find in recordings, and how they differ."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import Measured

SECTIONS = ("gyroscope", "accelerometer", "timing")
"""Of the result file, whose numbers are compared."""

GROUPS = {
    "gyroscope.cross_coupling": "gyro matrix",
    "gyroscope.offset": "gyro offset",
    "accelerometer.cross_coupling": "accel. matrix",
    "accelerometer.offset": "accel. offset",
    "accelerometer.lever_arms": "positions",
    "timing.offset": "time offset",
}
"""Beginnings of parameters' names, and what tables call them."""

_APART = 0.3
"""Expected difference, in deviations, from which on it says something. Chosen: estimators that linearise elsewhere
differ by up to so much."""


@dataclass(frozen=True)
class ByMethod:
    """What an estimator finds in a recording.

    Attributes
    ----------
    name
        Of the estimator.
    seconds
        That it took, with all checks.
    estimate, standard_deviation
        The parameters by their paths in the result file; empty where it failed.
    derived
        The quantities of data sheets; empty where it failed.
    accepted
        Whether the result may be used; None for own estimators, which nobody judges.
    reasons
        Why it may not.
    drift
        Root mean square of the innovations in position (m) and orientation (rad) on data not used, by navigation with
        the calibration of the first part; None where that failed.
    error
        Why there is no result; None where there is.
    """

    name: str
    seconds: float
    estimate: Mapping[str, float] = field(default_factory=dict)
    standard_deviation: Mapping[str, float] = field(default_factory=dict)
    derived: Mapping[str, Measured] = field(default_factory=dict)
    accepted: bool | None = None
    reasons: tuple[str, ...] = ()
    drift: tuple[float, float] | None = None
    error: str | None = None

    @classmethod
    def of(cls, name: str, seconds: float, found: Calibration, drift: tuple[float, float] | None = None) -> ByMethod:
        """Return what a calibration of kreisel's found."""
        document = found.document
        return cls(
            name,
            seconds,
            parameters_in(document),
            parameters_in(document["standard_deviation"]),
            found.derived,
            found.accepted,
            tuple(found.verdict.reasons),
            drift,
        )

    @property
    def result(self) -> str:
        """What became of it, in a word or two."""
        if self.error is not None:
            return "failed"
        return "not judged" if self.accepted is None else "accepted" if self.accepted else "rejected"


@dataclass(frozen=True)
class Comparison:
    """Several estimators on one recording.

    Attributes
    ----------
    recording
        Its name.
    found
        In the order they were asked for.
    unit
        Time of one strapdown pass over the recording's samples on this machine, s.
    truth
        True values by the parameters' paths; empty where they are not known.
    """

    recording: str
    found: tuple[ByMethod, ...]
    unit: float
    truth: Mapping[str, float] = field(default_factory=dict)

    @property
    def done(self) -> list[ByMethod]:
        """Those that have a result."""
        return [one for one in self.found if one.error is None]

    @property
    def first(self) -> ByMethod:
        """The first that has a result: what others are compared with."""
        return self.done[0]


def differences(one: ByMethod, other: ByMethod) -> dict[str, float]:
    """Return by how much the first differs from the other, in the other's standard deviations, for each parameter.

    Both use the same data: if both are right, most differ by far less than one.
    """
    return _in_deviations(one.estimate, other.estimate, other.standard_deviation)


def expected(one: ByMethod, other: ByMethod) -> dict[str, float]:
    """Return the deviation of the difference of two estimates from the same data, in the other's deviations.

    Notes
    -----
    If the other makes the best of the data, the covariance of the difference is the difference of their covariances
    (Hausman 1978); zero where this one claims to know more.
    """
    return {name: max(ratio**2 - 1.0, 0.0) ** 0.5 for name, ratio in _ratios(one, other).items()}


def too_sure(one: ByMethod, other: ByMethod) -> float:
    """Return by how many times this one claims to know more, of a quarter of its parameters; 1 if it does not."""
    ratios = list(_ratios(one, other).values())
    return max(1.0, 1.0 / float(np.quantile(ratios, 0.25))) if ratios else 1.0


def _ratios(one: ByMethod, other: ByMethod) -> dict[str, float]:
    """Return the ratios of deviations of the parameters of which both have one."""
    return {
        name: one.standard_deviation[name] / sd
        for name, sd in other.standard_deviation.items()
        if sd > 0.0 and one.standard_deviation.get(name, 0.0) > 0.0
    }


def over_expected(one: ByMethod, other: ByMethod) -> float:
    """Return the rms of differences over their expected deviations, of parameters where these are not small; or nan.

    About one where both are right and one knows less than the other.
    """
    found, wide = differences(one, other), expected(one, other)
    ratios = [found[name] / wide[name] for name in found if wide.get(name, 0.0) > _APART]
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else float("nan")


def scores(one: ByMethod, truth: Mapping[str, float]) -> dict[str, float]:
    """Return the errors against true values, in standard deviations, for each parameter of which both are known."""
    return _in_deviations(one.estimate, truth, one.standard_deviation)


def _in_deviations(
    values: Mapping[str, float], about: Mapping[str, float], sd: Mapping[str, float]
) -> dict[str, float]:
    return {
        name: (value - about[name]) / sd[name]
        for name, value in values.items()
        if sd.get(name, 0.0) > 0.0 and name in about
    }


def largest(values: Mapping[str, float], group: str) -> float:
    """Return the largest size of the values of a group, by the beginning of their names; nan where there are none."""
    own = [abs(value) for name, value in values.items() if name.startswith(group)]
    return max(own, default=float("nan"))


def parameters_in(document: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers in a tree of parameters, by their paths: ``gyroscope.cross_coupling[0,1]``."""
    return {
        name: value
        for section in SECTIONS
        if section in document
        for name, value in _numbers(document[section], section)
    }


def _numbers(tree: Any, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(tree, Mapping):
        for key, branch in tree.items():
            yield from _numbers(branch, f"{path}.{key}")
        return
    values = np.asarray(tree, dtype=object)
    for index, value in np.ndenumerate(values):
        if isinstance(value, int | float) and not isinstance(value, bool):
            yield path + (f"[{','.join(map(str, index))}]" if index else ""), float(value)


def document_of(compared: Comparison) -> dict[str, Any]:
    """Return the comparison on a recording as one object, for JSON."""
    return {"methods": {one.name: _document(one, compared) for one in compared.found}}


def document_of_all(compared: Sequence[Comparison], runs: Sequence[str]) -> dict[str, Any]:
    """Return comparisons on several recordings as one object, for JSON; of one, that one's.

    runs: names of the recordings.
    """
    if len(compared) == 1:
        return document_of(compared[0])
    return {"recordings": {name: document_of(one) for name, one in zip(runs, compared, strict=True)}}


def _document(one: ByMethod, compared: Comparison) -> dict[str, Any]:
    time = {"seconds": one.seconds, "passes": one.seconds / compared.unit}
    if one.error is not None:
        return {"error": one.error, **time}
    out: dict[str, Any] = {
        "estimate": dict(one.estimate),
        "standard_deviation": dict(one.standard_deviation),
        "accepted": one.accepted,
        "reasons": list(one.reasons),
        **time,
        "drift": _drift_document(one.drift),
    }
    if one is not compared.first:
        out["difference"] = differences(one, compared.first)
        out["expected_difference"] = expected(one, compared.first)
    if compared.truth:
        out["scores"] = scores(one, compared.truth)
    return out


def _drift_document(drift: tuple[float, float] | None) -> dict[str, float | None] | None:
    if drift is None:
        return None
    return {"position_m": _or_none(drift[0]), "orientation_rad": _or_none(drift[1])}


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None
