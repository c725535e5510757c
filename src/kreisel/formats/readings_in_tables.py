"""What columns may be: IMUs and poses, by names and units first, by their numbers where names say nothing."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from kreisel.errors import RecordingError
from kreisel.formats.column_names import OF_A_REFERENCE, Group, groups_of, known_unit, read_name
from kreisel.formats.sheet import Sheet
from kreisel.formats.time_columns import called
from kreisel.geometry.rotation import Array, lengths
from kreisel.recording.header import UNITS
from kreisel.units import DEG, STANDARD_GRAVITY
from kreisel.validation.empty_rows import all_alike

_GRAVITY_UNITS = ("m/s^2", "g", "mg", "cm/s^2")
_NOT_IN_GAL = 990.0
"""Gravity above which numbers without a unit are in mg, and below which they may be in cm/s^2, of which it is 981."""

_NAMED, _UNNAMED = (0.75, 1.35), (0.9, 1.15)
"""Median lengths of accelerations in g, of columns that are named so, and of others."""

_UNIT_LENGTH, _ORTHOGONAL = 0.01, 0.02
"""Deviation of a quaternion's length from 1, as `validation.pose_checks` accepts it, and of a matrix times its
transpose from the identity, as in `rotation_forms`."""

_LARGEST_ANGLE, _FULL_TURN = 361.0, 6.4
"""Largest number of an angle, a full turn in degrees, and the number above which angles are not in rad: 2 pi is
6.283."""

_SHORT_ARRAY = 7
"""Columns of a numbered array that is one group: a position and a quaternion have seven."""

_FEW, _FEW_BODIES = 12, 6
"""Windows of unnamed columns that are looked at, and groups of orientations."""

OTHER_SEQUENCES = (
    "kuka abc", "rotation vector", *(f"euler {s}" for s in ("XYZ", "xyz", "ZXY", "YXZ", "XZY", "YZX", "ZYZ", "ZXZ")),
    *(f"euler {s}" for s in ("zxy", "yxz", "xzy", "yzx", "zyz", "zxz")),
)  # fmt: skip
"""Forms of three angles whose axes no name says."""


@dataclass(frozen=True)
class Device:
    """An IMU in a table: its columns, the unit its accelerations have by their length; `named` if names say so."""

    rate: Group
    force: Group
    force_unit: str
    named: bool

    @property
    def sheet(self) -> int:
        """Number of the table."""
        return self.rate.sheet

    @property
    def places(self) -> tuple[int, ...]:
        """All its columns."""
        return (*self.rate.places, *self.force.places)


@dataclass(frozen=True)
class Attitude:
    """One way to read orientations: form, columns in its order, signs, unit of angles; positions beside them."""

    group: Group
    form: str
    places: tuple[int, ...]
    signs: tuple[int, ...]
    unit: str | None = None
    position: Group | None = None
    likely: bool = True

    @property
    def of_a_reference(self) -> bool:
        """Whether its name is that of a reference."""
        return _of_a_reference(self.group)


def _of_a_reference(group: Group) -> bool:
    return any(OF_A_REFERENCE.search(part) for part in group.owner)


def numbers(sheet: Sheet, places: Sequence[int]) -> Array:
    """Return columns as floats, (n, k)."""
    return np.column_stack([sheet.columns[k] for k in places]).astype(np.float64)


def all_groups(sheets: Sequence[Sheet]) -> list[Group]:
    """Return what the names of all tables show."""
    out: list[Group] = []
    for s, sheet in enumerate(sheets):
        usable = [column.dtype.kind in "fiu" for column in sheet.columns]
        out += groups_of(s, sheet.names, sheet.units, usable)
    return [group for group in out if _together(sheets[group.sheet], group.places)]


_READINGS = ("rate", "acceleration", "position", "quaternion", "orientation", "angle", "matrix")

_TEXTS = 3
"""Columns of text that are named."""


def texts(sheets: Sequence[Sheet]) -> list[str]:
    """Return what is said of the first columns that are readings by their names, and hold text."""
    found = [
        sheet.text_in(k)
        for sheet in sheets
        for k, name in enumerate(sheet.names)
        if sheet.columns[k].dtype.kind in "OUS" and read_name(name).quantity in _READINGS
    ]
    return [text for text in found if text is not None][:_TEXTS]


def _together(sheet: Sheet, places: tuple[int, ...]) -> bool:
    """Return whether columns have some rows in common in which they are known."""
    return len({sheet.lengths[k] for k in places}) < 2 if sheet.lengths else True


def text_of(sheet: Sheet, places: Sequence[int], quantity: str, unit: str | None, signs: Sequence[int] = ()) -> str:
    """Return columns as the mapping names them, with their unit where the header does not state it as it is read."""
    signs = signs or [1] * len(places)
    names = ", ".join(("-" if sign < 0 else "") + called(sheet, k) for k, sign in zip(places, signs, strict=True))
    stated = {sheet.units[k] for k in places} - {None}
    return names if unit is None or (stated == {unit} and unit in UNITS[quantity]) else f"{names} [{unit}]"


# ---- IMUs


def devices(sheets: Sequence[Sheet], groups: Sequence[Group]) -> list[Device]:
    """Return the IMUs that tables hold: by names where there are some, else by the length of gravity.

    Raises
    ------
    RecordingError
        If columns are named accelerations, and none of them shows gravity in any unit.
    """
    named = [group for group in groups if group.quantity == "acceleration"]
    forces = [(group, unit) for group in named for unit in gravity_units(sheets, group, _NAMED)]
    if named and not forces:
        raise _no_gravity(sheets, named, groups)
    by_name = bool(forces)
    if not by_name:
        forces = list(_by_length(sheets, groups))[:_FEW]
    out = []
    for force, unit in forces:
        rates = [group for group in groups if group.quantity == "rate" and group.sheet == force.sheet]
        rates = [group for group in rates if not set(group.places) & set(force.places)]
        if rates:
            most = max(_shared(group.owner, force.owner) for group in rates)
            rates = [group for group in rates if _shared(group.owner, force.owner) == most]
        else:
            rates = list(_beside(sheets, groups, force))
        out += [Device(rate, force, unit, by_name and rate.quantity == "rate") for rate in rates]
    return out


def _shared(owner: tuple[str, ...], other: tuple[str, ...]) -> float:
    """Return how alike two owners are: what both have, less what one of them has."""
    a, b = set(owner), set(other)
    return len(a & b) - 0.5 * len(a ^ b)


def gravity_units(sheets: Sequence[Sheet], group: Group, limits: tuple[float, float]) -> list[str]:
    """Return the units in which three columns usually have the length of gravity, the one that is stated alone."""
    values = numbers(sheets[group.sheet], group.places)
    values = values[np.isfinite(values).all(axis=1)]
    length = lengths(values)
    if length.size < 20:
        return []
    usual = float(np.median(length))
    fits = [unit for unit in _GRAVITY_UNITS
            if limits[0] < usual * UNITS["acceleration"][unit] / STANDARD_GRAVITY < limits[1]]  # fmt: skip
    spread = float(np.percentile(np.abs(length / max(usual, 1e-30) - 1.0), 50))
    stated = known_unit(group.unit, "acceleration")
    size = 0.0 if stated is None else UNITS["acceleration"][stated]
    fits = [unit for unit in fits if UNITS["acceleration"][unit] == size] or fits
    if "mg" in fits and usual > _NOT_IN_GAL:
        fits = [unit for unit in fits if unit != "cm/s^2"]
    return fits if spread < 0.3 else []


def _no_gravity(sheets: Sequence[Sheet], named: Sequence[Group], groups: Sequence[Group]) -> RecordingError:
    """Return the error for columns that are accelerations by their names alone."""
    group = named[0]
    sheet = sheets[group.sheet]
    usual = float(np.nanmedian(lengths(numbers(sheet, group.places))))
    found = [one for one in groups if one not in named and len(one.places) == 3
             and one.quantity not in ("position", "angle") and gravity_units(sheets, one, _UNNAMED)]  # fmt: skip
    others = (
        ": was gravity removed? Raw counts are named by --map 'imu.acceleration=… [counts]' and 'imu.rate=… [counts]', "
        "for `kreisel static`"
    )
    if found:
        names = ", ".join(called(sheets[found[0].sheet], k) for k in found[0].places)
        others = f", but that of {names} is: are the names exchanged?"
    return RecordingError(
        f"columns {', '.join(called(sheet, k) for k in group.places)} are accelerations by their names, but their "
        f"median length is {usual:.4g}, which is gravity in no known unit{others}",
        file=sheet.source,
    )


def _by_length(sheets: Sequence[Sheet], groups: Sequence[Group]) -> Iterator[tuple[Group, str]]:
    """Yield three adjacent columns each, without names of anything else, that have the length of gravity."""
    for window in windows(sheets, groups, 3):
        for unit in gravity_units(sheets, window, _UNNAMED):
            yield window, unit


def _beside(sheets: Sequence[Sheet], groups: Sequence[Group], force: Group) -> Iterator[Group]:
    """Yield three adjacent columns each that may be the rates to accelerations; nearest first."""
    found = [window for window in windows(sheets, groups, 3)
             if window.sheet == force.sheet and not set(window.places) & set(force.places)
             and _together(sheets[force.sheet], (*window.places, *force.places))]  # fmt: skip
    first, last = min(force.places), max(force.places)

    def distance(window: Group) -> int:
        return min(abs(window.places[-1] + 1 - first), abs(window.places[0] - last - 1))

    yield from sorted(found, key=distance)[:_FEW]


def windows(sheets: Sequence[Sheet], groups: Sequence[Group], count: int) -> Iterator[Group]:
    """Yield adjacent columns of numbers that change, that no name gives another meaning, and that are no times."""
    for s, sheet in enumerate(sheets):
        taken = {k for group in groups if group.sheet == s for k in group.places}
        free, usable = [], []
        for k, column in enumerate(sheet.columns):
            said = read_name(sheet.names[k]).quantity
            usable.append(column.dtype.kind in "fiu" and k not in taken and said not in ("time", "counter", "other"))
            free.append(usable[-1] and _changes(column.astype(np.float64)))
        starts = _starts(sheet)
        for first in range(len(free) - count + 1):
            places = tuple(range(first, first + count))
            changing = sum(free[k] for k in places)
            full = changing == count or (count > 9 and changing >= 9 and all(usable[k] for k in places))
            if full and all(starts[k] for k in places[:1]) and _together(sheet, places):
                units = {sheet.units[k] for k in places}
                unit = next(iter(units)) if len(units) == 1 else None
                yield Group(s, places, "", "", _parts_of(sheet.names[first]), unit, named=False)


def _parts_of(name: str) -> tuple[str, ...]:
    return tuple(re.findall(r"[a-z]+", name.lower()))


def _starts(sheet: Sheet) -> list[bool]:
    """Return the columns at which a triad or a quaternion may begin: not inside a short numbered array.

    Six or seven of them may be a position and a rotation.
    """
    stems = [re.match(r"(.*?)[_(\[]?(\d+)[)\]]?$", name) if not name.startswith("#") else None for name in sheet.names]
    out = [True] * len(stems)
    first = 0
    for k in range(1, len(stems) + 1):
        a, b = stems[first], stems[k] if k < len(stems) else None
        if a is not None and b is not None and a[1] == b[1] and int(b[2]) == int(a[2]) + k - first:
            continue
        size = k - first
        if 1 < size <= _SHORT_ARRAY:
            for inside in range(1, size):
                out[first + inside] = size > 5 and inside == 3
        first = k
    return out


def _changes(column: Array) -> bool:
    """Return whether a column changes, and not only upwards as a time."""
    known = column[np.isfinite(column)]
    steps = np.diff(known)
    return bool(known.size > 20 and (steps != 0.0).any() and not (steps >= 0.0).all())


# ---- orientations


def attitudes(sheets: Sequence[Sheet], groups: Sequence[Group], taken: set[tuple[int, int]]) -> list[list[Attitude]]:
    """Return the ways to read each group of columns that may be orientations; those of names, else those of numbers.

    Parameters
    ----------
    taken
        Columns that are readings of an IMU: number of the table and of the column.
    """
    out = []
    free = [group for group in groups if not {(group.sheet, k) for k in group.places} & taken]
    for group in free:
        found = list(_readings(sheets, group))
        if found:
            out.append(found)
    if not out:
        for count in (4, 16, 12, 9, 3):
            found_here = sorted(windows(sheets, groups, count), key=lambda one: not _of_a_reference(one))
            for window in found_here:
                if {(window.sheet, k) for k in window.places} & taken:
                    continue
                quantity = {4: "quaternion", 9: "matrix", 3: "angle"}.get(count, "pose matrix")
                found = list(_readings(sheets, replace(window, quantity=quantity)))
                if found:
                    out.append(found)
            if out:
                break
    return [[_with_position(sheets, groups, one) for one in found] for found in out[:_FEW_BODIES]]


def _readings(sheets: Sequence[Sheet], group: Group) -> Iterator[Attitude]:
    """Yield the ways in which a group may be read, the likeliest first; none if its numbers are no orientations."""
    sheet = sheets[group.sheet]
    values = numbers(sheet, group.places)
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < 20 or not np.ptp(values, axis=0).max() > 0.0:
        return
    if group.quantity == "quaternion":
        length = lengths(values[~all_alike(values)])
        if np.percentile(np.abs(length[length > 0.5] - 1.0), 95) < _UNIT_LENGTH if (length > 0.5).any() else False:
            yield from _quaternions(group)
    elif group.quantity == "matrix":
        C = values[~all_alike(values)][::37].reshape(-1, 3, 3)
        if not len(C):
            return
        if np.abs(C @ np.swapaxes(C, 1, 2) - np.eye(3)).max() < _ORTHOGONAL:
            across = tuple(group.places[3 * (k % 3) + k // 3] for k in range(9))
            yield Attitude(group, "matrix", group.places, (1,) * 9)
            yield Attitude(group, "matrix", across, (1,) * 9, likely=len(group.axes) == 9)
    elif group.quantity == "pose matrix":
        yield from _pose_matrices(group, values)
    elif group.quantity == "angle" and np.abs(values).max() <= _LARGEST_ANGLE:
        yield from _angles(sheet, group, float(np.abs(values).max()))


def _quaternions(group: Group) -> Iterator[Attitude]:
    forms = ["quaternion wxyz"] if group.axes == "wxyz" else ["quaternion wxyz", "quaternion xyzw"]
    for form in forms:
        yield Attitude(group, form, group.places, (1,) * 4)
    for form in forms:  # of the reference against the body
        signs = (1, -1, -1, -1) if form.endswith("wxyz") else (-1, -1, -1, 1)
        yield Attitude(group, form, group.places, signs, likely=False)


def _pose_matrices(group: Group, values: Array) -> Iterator[Attitude]:
    count = len(group.places)
    C = values[::37].reshape(-1, count // 4, 4)
    if np.abs(C[:, :3, :3] @ np.swapaxes(C[:, :3, :3], 1, 2) - np.eye(3)).max() > _ORTHOGONAL:
        return
    if count == 16 and np.abs(C[:, 3] - [0.0, 0.0, 0.0, 1.0]).max() > _ORTHOGONAL:
        across = tuple(group.places[4 * (k % 4) + k // 4] for k in range(16))
        if np.abs(C[:, :, 3] - [0.0, 0.0, 0.0, 1.0]).max() < _ORTHOGONAL:
            yield Attitude(group, "pose matrix", across, (1,) * 16)
        return
    yield Attitude(group, "pose matrix", group.places, (1,) * count)


def _angles(sheet: Sheet, group: Group, largest: float) -> Iterator[Attitude]:
    stated = known_unit(group.unit, "angle")
    unit = stated or ("deg" if largest > _FULL_TURN else "rad")
    words = " ".join(sheet.names[k].lower() for k in group.places)
    vector = Attitude(group, "rotation vector", group.places, (1,) * 3, unit)
    if re.search(r"rot(ation)?_?vec|axis_?angle", words):
        yield vector
        return
    if group.axes == "xyz":
        for order in ("ZYX", *("".join(p) for p in permutations("XYZ") if "".join(p) != "ZYX")):
            places = tuple(group.places["XYZ".index(letter)] for letter in order)
            yield Attitude(group, f"euler {order}", places, (1,) * 3, unit)
        if re.search(r"(^|[^a-z])r_?x", words):
            yield vector
        return
    for k, form in enumerate(OTHER_SEQUENCES):
        yield Attitude(group, form, group.places, (1,) * 3, unit, likely=k == 0 or group.axes != "ABC")


def _with_position(sheets: Sequence[Sheet], groups: Sequence[Group], one: Attitude) -> Attitude:
    """Return orientations with the positions that stand with them, by owner, or because there are no others."""
    found = named_positions(sheets, groups, one)
    if not found:
        return one
    most = max(_shared(group.owner, one.group.owner) for group in found)
    best = [group for group in found if _shared(group.owner, one.group.owner) == most]
    return replace(one, position=best[0]) if len(best) == 1 else one


def named_positions(sheets: Sequence[Sheet], groups: Sequence[Group], one: Attitude) -> list[Group]:
    """Return the columns named positions that stand in rows of orientations, and change."""
    own, sheet = one.group, sheets[one.group.sheet]
    if one.form == "pose matrix":
        return []
    found = [group for group in groups if group.quantity == "position" and group.sheet == own.sheet
             and len(group.places) == 3 and _together(sheet, (*group.places, *own.places))]  # fmt: skip
    return [group for group in found if np.ptp(_finite(sheet, group.places), axis=0).max() > 0.0]


def possible_positions(sheets: Sequence[Sheet], groups: Sequence[Group], device: Device, one: Attitude) -> list[Group]:
    """Return columns without names that may be the positions of orientations."""
    own = one.group
    taken = {*own.places, *(device.places if device.sheet == own.sheet else ())}
    if one.form == "pose matrix":
        return []
    sheet = sheets[own.sheet]
    near = [window for window in windows(sheets, groups, 3) if window.sheet == own.sheet]
    found = [one for one in near if not set(one.places) & taken and _together(sheet, (*one.places, *own.places))]
    return found[:_FEW]


def _finite(sheet: Sheet, places: Sequence[int]) -> Array:
    values = numbers(sheet, places)
    return values[np.isfinite(values).all(axis=1)]


def values_of(sheet: Sheet, one: Attitude) -> tuple[str, Array]:
    """Return form and numbers of orientations, angles in rad; NaN where all are the same, which mark what was lost."""
    raw = numbers(sheet, one.places)
    values = raw * np.array(one.signs, dtype=np.float64)
    if len(one.places) > 3:
        values[all_alike(raw)] = np.nan
    return one.form, values * (DEG if one.unit == "deg" else 1.0)
