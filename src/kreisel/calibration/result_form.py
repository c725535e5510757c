"""The form of the numbers in a result file: what a user may have changed is named by its entry."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from kreisel.calibration.device_axes import AXES
from kreisel.model.groups import group_named
from kreisel.model.parameters import other_groups

_SHAPES = {"cross_coupling": (3, 3), "offset": (3,), "lever_arms": (3, 3)}
"""Of entries of a sensor."""

_REQUIRED = ("cross_coupling", "offset")
"""Entries of a sensor without which nothing can be corrected."""

_NUMBERS = ("gyroscope", "accelerometer", "timing", "alignment", "derived")
"""Tables that hold numbers alone."""

_TABLES = ("standard_deviation", "device_axes", "estimator", *_NUMBERS)
"""Entries that are tables."""


def check_form(document: Mapping[str, Any]) -> None:
    """Raise an error for an entry that is missing, no number, or of another size.

    Raises
    ------
    ValueError, TypeError
        With its name, and what is expected.
    """
    if "verdict" not in document:
        raise ValueError("verdict is missing")
    for name in _TABLES:
        if not isinstance(document.get(name) or {}, dict):
            raise TypeError(f"{name} is {_short(document[name])}, expected a table")
    _check_sensors(document, "", required=True)
    deviations = document.get("standard_deviation") or {}
    _check_sensors(deviations, "standard_deviation.")
    for axes, table in (document.get("device_axes") or {}).items():
        _check_sensors(table, f"device_axes.{axes}.")
    for place, tables in (("", document), ("standard_deviation.", deviations)):
        for name in _NUMBERS:
            for entry, value in _leaves(tables.get(name) or {}, place + name):
                if value is not None and not _is_number(value):
                    raise ValueError(f"{entry} is {_short(value)}, expected a number")
                if place and value is not None and value < 0.0:
                    raise ValueError(f"{entry} is {_short(value)}, expected a standard deviation")
    _check_terms(document)
    if (axes := document.get("axes", "tool")) not in AXES:
        raise ValueError(f"axes is {_short(axes)}, expected {', '.join(AXES)}")
    if isinstance(recording := document.get("recording"), dict):
        _check_recording(recording)


def _check_terms(document: Mapping[str, Any]) -> None:
    """Raise an error for error terms of a sensor that have another number of values, and for powers that are none."""
    for group in map(group_named, other_groups()):
        sensor, _, entry = group.path.partition(".")
        value = document[group.owner].get(entry) if group.is_sensor and sensor == group.owner else None
        if value is not None and np.size(value) != group.degrees(1):
            raise ValueError(f"{group.path} has {np.size(value)} numbers, expected {group.degrees(1)}")
    for sensor in ("gyroscope", "accelerometer"):
        for power in document[sensor].get("polynomial") or {}:
            if not str(power).isdecimal() or int(power) < 2:
                raise ValueError(f"{sensor}.polynomial has the power {power}, expected 2 or more")


def _check_recording(table: Mapping[str, Any]) -> None:
    """Raise an error for numbers of a recording that the calibration is applied with."""
    warm = table.get("temperature_c")
    if warm is not None and not _is_finite(warm):
        raise ValueError(f"recording.temperature_c is {_short(warm)}, expected a number")
    counts = table.get("counts") or {}
    for name in ("rate", "acceleration") if counts else ():
        size, zero = counts[name]["size"], counts[name]["zero"]
        if not _is_finite(size) or size <= 0.0:
            raise ValueError(f"recording.counts.{name}.size is {_short(size)}, expected a number above 0")
        if not _fits(zero, (3,)) or not all(map(_is_finite, zero)):
            raise ValueError(f"recording.counts.{name}.zero is {_short(zero)}, expected 3 numbers")


def _check_sensors(tables: Any, place: str, *, required: bool = False) -> None:
    for sensor in ("gyroscope", "accelerometer"):
        table = tables.get(sensor) if isinstance(tables, dict) else None
        if not isinstance(table, dict):
            if required or table is not None:
                raise ValueError(f"{place}{sensor} is {_short(table)}, expected a table")
            continue
        for name in _REQUIRED if required else ():
            if table.get(name) is None:
                raise ValueError(f"{place}{sensor}.{name} is missing")
        if not isinstance(table.get("polynomial") or {}, dict):
            raise TypeError(f"{place}{sensor}.polynomial is {_short(table['polynomial'])}, expected a table")
        for name, shape in _SHAPES.items():
            flat = (int(np.prod(shape)),)
            if name in table and not (_fits(table[name], shape) or _fits(table[name], flat)):
                size = " x ".join(map(str, shape))
                raise ValueError(f"{place}{sensor}.{name} is {_short(table[name])}, expected {size} numbers")


def _fits(value: Any, shape: tuple[int, ...]) -> bool:
    if not shape:
        return value is None or _is_number(value)
    return isinstance(value, list) and len(value) == shape[0] and all(_fits(one, shape[1:]) for one in value)


def _leaves(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield the entries of tables and lists with their names."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, f"{name}.{key}")
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from _leaves(inner, f"{name}[{i}]")
    else:
        yield name, value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_finite(value: Any) -> bool:
    return _is_number(value) and math.isfinite(value)


def _short(value: Any) -> str:
    text = "missing" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
