"""What several estimators find in one recording, and how they differ."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel.calibration.result import Calibration

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


@dataclass(frozen=True)
class ByMethod:
    """A recording's calibration by one estimator.

    Attributes
    ----------
    name
        Of the estimator.
    calibration
        None where it failed.
    error
        Why it failed; None where it did not.
    seconds
        That it took, with all checks.
    drift
        Root mean square of the innovations in position (m) and orientation (rad) on data not used, by navigation with
        the calibration of the first part; None where it failed.
    """

    name: str
    calibration: Calibration | None
    error: str | None
    seconds: float
    drift: tuple[float, float] | None = None

    @property
    def estimate(self) -> dict[str, float]:
        """The parameters, by their paths in the result file."""
        return {} if self.calibration is None else parameters_in(self.calibration.document)

    @property
    def standard_deviation(self) -> dict[str, float]:
        """Their standard deviations, by the same paths."""
        if self.calibration is None:
            return {}
        return parameters_in(self.calibration.document["standard_deviation"])


def differences(one: ByMethod, other: ByMethod) -> dict[str, float]:
    """Return by how much the first differs from the other, in the other's standard deviations, for each parameter.

    Both use the same data: if both are right, most differ by far less than one.
    """
    return _in_deviations(one.estimate, other.estimate, other.standard_deviation)


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


def document_of(found: Sequence[ByMethod], truth: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Return the comparison as one object, for JSON."""
    methods: dict[str, Any] = {}
    for one in found:
        if one.calibration is None:
            methods[one.name] = {"error": one.error, "seconds": one.seconds}
            continue
        methods[one.name] = {
            "estimate": one.estimate,
            "standard_deviation": one.standard_deviation,
            "accepted": one.calibration.accepted,
            "reasons": list(one.calibration.verdict.reasons),
            "seconds": one.seconds,
            "drift": _drift_document(one.drift),
        }
        if truth:
            methods[one.name]["scores"] = scores(one, truth)
    return {"methods": methods}


def _drift_document(drift: tuple[float, float] | None) -> dict[str, float | None] | None:
    if drift is None:
        return None
    return {"position_m": _or_none(drift[0]), "orientation_rad": _or_none(drift[1])}


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None
