"""A result as a few lines of text, as a table of a notebook, and as a data frame."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from math import floor, isnan, log10
from typing import Any

import numpy as np

from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.calibration.result_sections import CalibrationParts
from kreisel.errors import SettingsError
from kreisel.geometry.rotation import Array
from kreisel.model.groups import REGISTRY, ParameterGroup


def with_deviation(value: float, deviation: float) -> str:
    """Return value ± standard deviation, rounded to two digits of the latter; a value without deviation was held."""
    if isnan(value):
        return "not determined"
    if not deviation > 0.0:
        return f"user-fixed at {value:.6g}"
    digits = max(0, min(6, 1 - floor(log10(deviation))))
    return f"{value:.{digits}f} ± {deviation:.{digits}f}"


def _heading(calibration: CalibrationParts, count: int) -> str:
    facts, verdict = calibration.recording, calibration.verdict
    of = "" if facts is None else f" of {facts.name} ({facts.imu_samples} readings, {facts.duration_s:.1f} s)"
    return f"Calibration{of}, {count} parameters: {verdict.headline.lower()}"


def _rows(calibration: CalibrationParts) -> list[tuple[str, str, tuple[str, ...]]]:
    """Return title, unit and the three values of every derived quantity."""
    rows = []
    for quantity in QUANTITIES:
        if quantity.name in calibration.derived:
            found = calibration.derived[quantity.name]
            pairs = zip(np.ravel(found.value), np.ravel(found.deviation), strict=True)
            rows.append((quantity.title, quantity.unit, tuple(with_deviation(v, d) for v, d in pairs)))
    return rows


def text_of(calibration: CalibrationParts, count: int) -> str:
    """Return a result in a few lines: recording, verdict, errors of the sensors; count: number of parameters."""
    rows = _rows(calibration)
    width = max((len(title) for title, _, _ in rows), default=0)
    lines = [f"  {title:{width}}  {'; '.join(values)} {unit}" for title, unit, values in rows]
    return "\n".join([_heading(calibration, count), *lines])


def html_of(calibration: CalibrationParts, count: int) -> str:
    """Return a result as a table of HTML; count: number of parameters."""
    rows = "".join(
        f"<tr><td style='text-align:left'>{escape(title)} ({escape(unit)})</td>"
        + "".join(f"<td>{escape(value)}</td>" for value in values) + "</tr>"
        for title, unit, values in _rows(calibration)
    )  # fmt: skip
    verdict = escape(calibration.verdict.sentence)
    head = "<tr><th></th><th>x, yz</th><th>y, xz</th><th>z, xy</th></tr>"
    return f"<p><b>{escape(_heading(calibration, count))}</b></p><table>{head}{rows}</table><p>{verdict}</p>"


def frame_of(document: Any, names: Sequence[str], covariance: Array, prior_deviation: Array) -> Any:
    """Return a pandas data frame with a row for each estimated parameter, in SI units.

    Its index is the parameter's name; its columns are `group`, `value`, `standard_deviation`, `prior_deviation`, and
    `shown_unit` with `shown_factor`, by which a value is divided for it. The value is nan where `calibration.yaml` has
    another form of it, as for rotations.

    Parameters
    ----------
    document
        The content of `calibration.yaml`.
    names, covariance, prior_deviation
        As of `Calibration`.

    Raises
    ------
    SettingsError
        If pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise SettingsError("a data frame needs pandas: pip install pandas") from error
    groups = [group_of(name) for name in names]
    return pandas.DataFrame(
        {
            "group": ["" if group is None else group.name for group in groups],
            "value": [_value(document, name) for name in names],
            "standard_deviation": np.sqrt(np.maximum(np.diag(covariance), 0.0)),
            "prior_deviation": prior_deviation,
            "shown_unit": ["" if group is None else group.unit for group in groups],
            "shown_factor": [1.0 if group is None else group.size for group in groups],
        },
        index=pandas.Index(names, name="parameter"),
    )


def group_of(name: str) -> ParameterGroup | None:
    """Return the group with the longest path that a parameter's name begins with."""
    fitting = (group for group in REGISTRY if name == group.path or name.startswith(f"{group.path}["))
    return max(fitting, key=lambda group: len(group.path), default=None)


def _value(document: Any, name: str) -> float:
    """Return the number at a parameter's name, its path in a result file; nan if there is none."""
    path, _, index = name.partition("[")
    keys = [*path.split("."), *(int(part) for part in index.rstrip("]").split(",") if index)]
    try:
        for key in keys:
            document = document[key]
        return float(document)
    except (KeyError, IndexError, TypeError):
        return float("nan")
