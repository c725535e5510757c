"""Rates and accelerations in files of their own, as apps on phones write them: a mapping by the files' names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.errors import RecordingError
from kreisel.formats.readings_in_tables import numbers, text_of
from kreisel.formats.sheet import Sheet
from kreisel.formats.time_columns import SLOWEST_IMU, times_of
from kreisel.geometry.rotation import lengths
from kreisel.units import STANDARD_GRAVITY

_AXIS = re.compile(r"(?:.*[^a-z])?([xyz])(?:[^a-z].*)?")
_GRAVITY = {"m/s^2": STANDARD_GRAVITY, "g": 1.0}
_NEAR = 0.05
"""Share by which the median length of accelerations may differ from gravity."""


@dataclass(frozen=True)
class _Triad:
    """Three columns of a file, with the way to read its time."""

    sheet: Sheet
    places: tuple[int, ...]
    time: str

    def entry(self, quantity: str, unit: str) -> str:
        """Return the columns as the mapping names them."""
        return text_of(self.sheet, self.places, quantity, unit)


def mapping_of_separate_files(sheets: Sequence[Sheet]) -> list[str] | None:
    """Return the lines of a mapping, where a file is that of gyros by its name, and another one holds accelerations.

    Raises
    ------
    RecordingError
        If there are gyros, but no accelerations with gravity.
    """
    rates = [one for sheet in sheets if "gyro" in _name(sheet) and (one := _triad(sheet)) is not None]
    if not rates:
        return None
    gyro = rates[0]
    others = [one for sheet in sheets if "gyro" not in _name(sheet) and (one := _triad(sheet)) is not None]
    found = [
        (one, unit)
        for one in sorted(others, key=lambda one: "total" not in _name(one.sheet))
        for unit in _GRAVITY
        if "acc" in _name(one.sheet) and _is_gravity(one, unit)
    ]
    if not found:
        raise RecordingError(
            f"{gyro.sheet.source.name} holds rates, but no other file accelerations that contain gravity: record those "
            "too (\"total acceleration\", or \"with g\")", file=gyro.sheet.source.parent,
        )  # fmt: skip
    force, unit = found[0]
    unit_of_rates = gyro.sheet.units[gyro.places[0]] or "rad/s"
    return [
        "# proposed from the data; check it",
        "[columns.imu]",
        f'file = "{gyro.sheet.source.name}"',
        f'time = "{gyro.time}"',
        f'rate = "{gyro.entry("rate", unit_of_rates)}"',
        f'acceleration_file = "{force.sheet.source.name}"',
        f'acceleration_time = "{force.time}"',
        f'acceleration = "{force.entry("acceleration", unit)}"',
    ]


def _name(sheet: Sheet) -> str:
    """Return the name of a file, in small letters; that of readings without the device's own corrections is empty."""
    name = sheet.source.name.lower()
    return "" if "uncal" in name else name


def _triad(sheet: Sheet) -> _Triad | None:
    """Return the columns of the axes x, y, z of a table, if it has one of each."""
    axes = [match[1] if (match := _AXIS.fullmatch(name.lower())) else "" for name in sheet.names]
    if any(axes.count(axis) != 1 for axis in "xyz"):
        return None
    places = tuple(axes.index(axis) for axis in "xyz")
    if any(sheet.columns[k].dtype.kind not in "fiu" for k in places):
        return None
    times = times_of(sheet, places, (), SLOWEST_IMU)
    return _Triad(sheet, places, times[0].text) if times else None


def _is_gravity(one: _Triad, unit: str) -> bool:
    length = float(np.nanmedian(lengths(numbers(one.sheet, one.places))))
    return abs(length / _GRAVITY[unit] - 1.0) < _NEAR
