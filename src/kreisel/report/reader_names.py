"""The parameters in the words of data sheets, for readers who do not look into the result file."""

from __future__ import annotations

import re
from collections.abc import Sequence

from kreisel.calibration.outcome import Outcome
from kreisel.model.groups import REGISTRY, ParameterGroup
from kreisel.report.cells import NOTHING, Row, Table, number
from kreisel.report.group_titles import SENSORS, TITLES
from kreisel.units import MRAD, PPM

AXES = "xyz"


_PLACED = ("x", "y", "z", "about x", "about y", "about z")

_UNITS = {"scale factor": ("ppm", PPM), "misalignment": ("mrad", MRAD)}
"""Units of the two kinds of elements of the sensors' matrices."""

_TURNS = "turns about {} of the sensor, by large angles and in both directions"
_STANDS = "standstills with {} of the sensor upward and downward"
_SHOWN_BY = {
    "gyro_cross_coupling": _TURNS,
    "gyro_offset": "more and longer standstills",
    "gyro_polynomial": "a wider range of angular rates about {}",
    "accel_cross_coupling": _STANDS,
    "accel_offset": _STANDS,
    "accel_polynomial": "a wider range of accelerations along {}",
    "lever_arms": "turns about all axes that begin and end more quickly",
    "time_offset": "moves that begin and end more quickly",
    "time_skew": "a longer recording",
}
"""What shows a group of parameters; the axes of the sensor are put in."""


def group_of(name: str) -> ParameterGroup | None:
    """Return the group of a parameter's name; None if there is none."""
    path = re.sub(r"(\.\d+)?(\[[\d,]+\])?$", "", name)
    return next((group for group in REGISTRY if group.path == path), None)


def reader_name(name: str) -> tuple[str, str]:
    """Return the quantity of a parameter, and its axis or pair of axes; empty where it has none.

    Names that are not known stay as they are.
    """
    group, index = group_of(name), [int(k) for k in re.findall(r"\d+", name.partition("[")[2])]
    if group is None:
        return name, ""
    if group.name in SENSORS:
        i, j = index
        return (f"{SENSORS[group.name]} {'scale factor' if i == j else 'misalignment'}", AXES[i] + AXES[j] * (i != j))
    title = TITLES.get(group.name, group.meaning.partition(",")[0])
    if group.name == "lever_arms":
        return f"{title} {AXES[index[0]]}", AXES[index[1]]
    if group.owner == "robot":
        return f"{title} {index[0] + 1}", "".join(_PLACED[k] for k in index[1:]) if "placement" in group.name else ""
    if group.name == "north":
        return title, ""
    order = re.search(r"\.(\d+)\[", name)
    return title + (f", order {order[1]}" if order else ""), "".join(AXES[k] for k in index)


def in_words(name: str) -> str:
    """Return the quantity and the axis of a parameter in one text."""
    return " ".join(part for part in reader_name(name) if part)


def by_quantity(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return the quantities of parameters, each once, and their axes."""
    found: dict[str, list[str]] = {}
    for name in names:
        title, axis = reader_name(name)
        found.setdefault(title, [])
        found[title] += [axis] if axis and axis not in found[title] else []
    return [(title, ", ".join(axes)) for title, axes in found.items()]


def unobservable_table(outcome: Outcome) -> Table | None:
    """Return what this motion does not show, by quantity, with what shows it; None if it shows all."""
    seen, rows = outcome.observability, []
    sizes = {name: (b, a) for name, b, a in zip(seen.names, seen.prior, seen.posterior, strict=True)}
    for title, axes in by_quantity(seen.unobservable):
        own = [name for name in seen.unobservable if reader_name(name)[0] == title]
        group = group_of(own[0])
        before, after = (max(sizes.get(name, (0.0, 0.0))[k] for name in own) for k in (0, 1))
        unit, size = ("SI", 1.0) if group is None else (group.unit, group.size)
        unit, size = _UNITS.get(title.partition(" ")[2], (unit, size))
        hardly = any(name in seen.not_narrowed for name in own)
        why = "hardly known better than before" if hardly else "too uncertain to be of use"
        cells = (title, axes or NOTHING, unit, number(before / size), number(after / size), why, _shown_by(own, group))
        rows.append(Row(cells))
    if not rows:
        return None
    columns = ("Quantity", "Axes", "Unit", "Deviation before", "Deviation now", "What is wrong", "What shows it")
    return Table("What this motion does not show", columns, tuple(rows), 7, prose=True)


def _shown_by(names: Sequence[str], group: ParameterGroup | None) -> str:
    """Return which motion shows some parameters of a group, with the axes that it is about."""
    text = _SHOWN_BY.get("" if group is None else group.name, "another motion, or a value that is stated")
    last = sorted({int(re.findall(r"\d+", name)[-1]) for name in names if "[" in name})
    return text.format(" and ".join(AXES[k] for k in last if k < len(AXES)))
