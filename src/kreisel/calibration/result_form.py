"""The form of the numbers in a result file: what a user may have changed is named by its entry."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

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


def _short(value: Any) -> str:
    text = "missing" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
