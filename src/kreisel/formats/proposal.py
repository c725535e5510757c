"""A mapping proposed from the data: gravity shows the accelerometers, unit length the quaternions, rotation the rest.

Every combination that is possible is held against the motion: the rates must turn the body as the orientations say.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kreisel.errors import KreiselError, RecordingError, UnknownColumnsError
from kreisel.formats.mapped import load_mapped, settings_beside, tables_in
from kreisel.formats.mapping import parse_terms
from kreisel.formats.sheet import Sheet, read_sheet
from kreisel.formats.write import toml_table
from kreisel.geometry.rotation import Array, apply, nearest_rotation
from kreisel.inertial.readings import Readings
from kreisel.recording.header import UNITS
from kreisel.recording.recording import Recording
from kreisel.recording.settings import ColumnsTable, RecordingSettings
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.correlation import correlate
from kreisel.synchronization.rate_fit import fit_linear_rates
from kreisel.units import DEG, STANDARD_GRAVITY

_GRAVITY = {"m/s^2": 1.0, "g": 1.0 / STANDARD_GRAVITY, "mg": 1e3 / STANDARD_GRAVITY}
_ANGLE_FORMS = (
    "kuka abc", "rotation vector", *(f"euler {s}" for s in ("XYZ", "xyz", "ZXY", "YXZ", "XZY", "YZX", "ZYZ", "ZXZ")),
    *(f"euler {s}" for s in ("zxy", "yxz", "xzy", "yzx", "zyz", "zxz")),
)  # fmt: skip
_NO_TIME = "100 Hz"
_LONGEST_ROBOT = 20.0
"""m; larger numbers of positions are millimetres."""

_ALIKE = 2e-3
"""Difference in the share explained below which two mappings are equally good."""

_NAMES = {
    "time": r"time|stamp|^t$|^t_|tick|sec|date|utc",
    "rate": r"gyr|omega|^w_?[xyz]|^g_?[xyz]|rate|angvel|ang_vel|angular",
    "acceleration": r"acc|^a_?[xyz]|force|lin",
    "position": r"pos|^p_?[xyz]|trans|^t_?[xyz]$|^[xyz]$|act$",
    "magnetometer": r"mag|^m_?[xyz]$|temp|press|baro",
}


@dataclass(frozen=True)
class _Part:
    """Adjacent columns of a sheet: numbers of the first and behind the last."""

    sheet: int
    first: int
    last: int

    def overlaps(self, other: _Part | None) -> bool:
        return other is not None and self.sheet == other.sheet and self.first < other.last and other.first < self.last


@dataclass(frozen=True)
class _Try:
    """A mapping, how much of the rotation it explains, the size of the rates' matrix, and how upright gravity is."""

    columns: ColumnsTable
    explained: float
    size: float
    upright: float


def unknown_columns(path: Path) -> UnknownColumnsError:
    """Return the error for tables of which nobody said what their columns are, with a proposal where there is one."""
    found = tables_in(path)
    try:
        text = proposal(path)
    except RecordingError as error:
        return UnknownColumnsError(
            f"which columns hold what is not said, and the data suggest no mapping ({error.message}); write [columns] "
            "into recording.toml, or give --map",
            "",
            file=path,
        )
    names = ", ".join(file.name for file in found)
    place = (path if path.is_dir() else path.parent) / "recording.toml"
    return UnknownColumnsError(
        f"which columns of {names} hold what is not said; write the mapping above into {place}, if it is right, or "
        "give --map",
        text,
        file=path,
    )


def proposal(path: Path) -> str:
    """Return the mapping that the data suggest, as TOML to paste.

    Raises
    ------
    RecordingError
        If no readings of an IMU are found.
    """
    sheets = _readable(path)
    best = _best(path, sheets)
    comment = "# proposed from the data; check it"
    if best.explained > 0.0:
        comment += f": the rates explain {100 * best.explained:.1f} % of the rotation"
    elif best.columns.reference.orientation is not None:
        comment += ": the motion does not confirm it, the stamps may be in another unit"
    lines = [comment]
    if best.columns.imu.time == _NO_TIME:
        lines.append("# no column of time was found: write the rate of the rows, or the column")
    for name, table in best.columns.model_dump(exclude_none=True).items():
        if table:
            lines.append(toml_table(f"columns.{name}", table))
    if best.columns.reference.time is not None and settings_beside(path).reference.kind is None:
        lines.append('# are these poses of motion capture? Then state [reference] kind = "mocap"; a robot is assumed')
    return "\n".join(lines).rstrip()


def _readable(path: Path) -> list[Sheet]:
    """Return the tables that can be read; others may lie beside them.

    Raises
    ------
    RecordingError
        If none can be read.
    """
    found, first = [], None
    for file in tables_in(path):
        try:
            found.append(read_sheet(file))
        except RecordingError as error:
            first = first or error
    if first is not None and not found:
        raise first
    return found


def _best(path: Path, sheets: list[Sheet]) -> _Try:
    accelerations = list(_accelerations(sheets))
    if not accelerations:
        raise RecordingError("no three adjacent columns have the length of gravity", file=path)
    tried: list[_Try] = []
    orientations = list(_orientations(sheets))
    rate_parts, positions = _triads(sheets, "rate"), _triads(sheets, "position")
    for force, force_unit in accelerations[:3]:
        for rates in rate_parts:
            if rates.sheet != force.sheet or rates.overlaps(force):
                continue
            imu = {
                "file": sheets[force.sheet].source.name,
                "time": _time(sheets[force.sheet], force) or _NO_TIME,
                "rate": _named(sheets, rates, "rate"),
                "acceleration": _named(sheets, force, "acceleration", force_unit),
            }
            before = len(tried)
            for reference in _references(sheets, orientations, positions, (force, rates)):
                columns = ColumnsTable.model_validate({"imu": imu, "reference": reference})
                tried.append(_Try(columns, *_agreement(path, sheets, columns)))
            if len(tried) == before:
                tried.append(_Try(ColumnsTable.model_validate({"imu": imu}), -1.0, 1.0, 0.0))
    if not tried:
        raise RecordingError("no three columns beside the accelerometers' look like rates", file=path)
    most = max(one.explained for one in tried)
    # axes in another order explain the rotation as well, but not where up is
    best = max((one for one in tried if one.explained > most - _ALIKE), key=lambda one: one.upright)
    return _with_rate_unit(best, sheets)


def _with_rate_unit(best: _Try, sheets: list[Sheet]) -> _Try:
    """Return a mapping with the unit of the rates that the rotation shows, where no header states one."""
    imu = best.columns.imu
    sheet = next(sheet for sheet in sheets if sheet.source.name == imu.file)
    named = [term.name for term in parse_terms(str(imu.rate), "rate")]
    if any(sheet.units[sheet.place(name)] for name in named) or best.explained < 0.0:
        return best
    for unit in ("rad/s", "deg/s", "mdps"):
        if 0.7 < best.size / UNITS["rate"][unit] < 1.4:
            told = imu.model_copy(update={"rate": f"{imu.rate} [{unit}]"})
            return replace(best, columns=best.columns.model_copy(update={"imu": told}))
    return best


def _agreement(path: Path, sheets: list[Sheet], columns: ColumnsTable) -> tuple[float, float, float]:
    """Return the share of the rotation that the rates explain, the size of the matrix, and how upright gravity is."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # most combinations make no sense
        return _compared(path, sheets, columns)


def _compared(path: Path, sheets: list[Sheet], columns: ColumnsTable) -> tuple[float, float, float]:
    try:
        recording = load_mapped(path, RecordingSettings(), columns, {sheet.source: sheet for sheet in sheets})
        readings, tau, q = _thinned(recording)
        clock = correlate(recording.imu, recording.reference).clock if recording.reference is not None else None
        if clock is None:
            return -1.0, 1.0, 0.0
        K, explained = fit_linear_rates(readings, tau, q, clock)
        return explained, float(np.cbrt(abs(np.linalg.det(K)))), _upright(readings, tau, q, clock, K)
    except (KreiselError, ValueError, IndexError, ArithmeticError, np.linalg.LinAlgError):
        return -1.0, 1.0, 0.0


def _upright(readings: Readings, tau: Array, q: Array, clock: Clock, K: Array) -> float:
    """Return the share of the mean acceleration that lies along the reference's third axis."""
    k = np.clip(np.searchsorted(readings.stamps, clock.imu_time(tau)), 0, readings.stamps.size - 1)
    mean = apply(q, readings.accelerations[k] @ nearest_rotation(K).T).mean(axis=0)
    return float(abs(mean[2]) / np.linalg.norm(mean))


def _thinned(recording: Recording) -> tuple[Readings, Array, Array]:
    imu, reference = recording.imu, recording.reference
    if reference is None or reference.quaternions is None:
        raise RecordingError("has no orientations", file=recording.path)
    streams = (imu.rates, imu.accelerations, reference.quaternions)
    if not all(np.isfinite(values).all() for values in streams):
        raise RecordingError("holds numbers that are not finite", file=recording.path)
    readings = Readings(imu.seconds, imu.rates, imu.accelerations, ((0, imu.stamps_ns.size - 1),))
    q = reference.quaternions / np.linalg.norm(reference.quaternions, axis=1)[:, None]
    return readings, reference.seconds, q


def _time(sheet: Sheet, part: _Part) -> str | None:
    """Return the time of columns of a table, with its unit, or None where there is none."""
    found: list[tuple[float, str]] = []
    rows = _known(sheet.columns[part.first])
    prefix = sheet.names[part.first].partition(".")[0]
    for k, (name, column) in enumerate(zip(sheet.names, sheet.columns, strict=True)):
        by_name = bool(re.search(_NAMES["time"], name.lower()))
        if column.dtype.kind in "OUS":
            if by_name or re.search(r"\d:\d\d:\d\d", str(column[0])):
                found.append((3 if by_name else 1, f"{name} [date]"))
            continue
        values = column[np.isfinite(column)] if column.dtype.kind == "f" else column
        steps = np.diff(values.astype(np.float64))
        if np.sum(steps > 0.0) < 10 or np.mean(steps >= 0.0) < 0.99:
            continue
        fits = float(4.0 * np.mean(_known(column)[rows]) - 2.0 * np.mean(_known(column) & ~rows))
        own = not rows.all() and bool((_known(column) == rows).all())
        fits += (name.partition(".")[0] == prefix) + 3.0 * (own or _held_alike(column, sheet.columns[part.first]))
        step, duration = float(np.median(steps[steps > 0.0])), float(steps.sum())
        for unit, size in UNITS["time"].items():
            if 1.0 <= 1e9 / (step * size) <= 20e3 and 2.0 <= duration * size * 1e-9 <= 1e6:
                stated = sheet.units[k]
                text = name if stated is not None else f"{name} [{unit}]"
                found.append((fits + (2 if by_name else 0) + (stated == unit) + (k == 0), text))
        if k + 1 < len(sheet.columns) and (steps[steps > 0.0] == 1.0).all():  # whole seconds, and what is left
            rest = sheet.columns[k + 1]
            for unit, size in (("ns", 1e9), ("us", 1e6), ("ms", 1e3)):
                whole = rest.dtype.kind in "iuf" and (np.mod(rest, 1.0) == 0.0).all()
                if whole and rest.min() >= 0 and 0.5 * size < rest.max() < size:
                    found.append((fits + 4.0, f"{name} [s] + {sheet.names[k + 1]} [{unit}]"))
    return max(found)[1] if found else None


def _held_alike(time: NDArray[Any], column: NDArray[Any]) -> bool:
    """Return whether a time repeats just where another column does: both are held until the next pose."""
    same, held = time[1:] == time[:-1], column[1:] == column[:-1]
    return bool(np.mean(same) > 0.1 and np.mean(held[same]) > 0.98)


def _known(column: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which cells of a column are not empty."""
    if column.dtype.kind == "f":
        return np.isfinite(column)
    return column != "" if column.dtype.kind in "OUS" else np.ones(column.size, dtype=bool)


def _accelerations(sheets: list[Sheet]) -> Iterator[tuple[_Part, str | None]]:
    """Yield three columns each whose length is usually that of gravity, with the unit; the likeliest first."""
    found = []
    for part, values in _windows(sheets, 3):
        length = np.linalg.norm(values, axis=1)
        usual = float(np.median(length))
        for unit, size in _GRAVITY.items():
            if not 0.9 < usual / (STANDARD_GRAVITY * size) < 1.15:
                continue
            spread = float(np.percentile(np.abs(length / usual - 1.0), 50))
            named = _name_score(sheets, part, "acceleration")
            if spread < 0.3 and named > -2:
                stated = any(sheets[part.sheet].units[k] for k in range(part.first, part.last))
                found.append((-named, spread, part.sheet, part.first, part, None if stated else unit))
    for *_, part, named_unit in sorted(found, key=lambda one: one[:4]):
        yield part, named_unit


def _references(
    sheets: list[Sheet],
    orientations: list[tuple[_Part, str]],
    positions: list[_Part],
    taken: tuple[_Part, ...],
) -> Iterator[dict[str, str]]:
    """Yield possible columns of poses."""
    for orientation, form in orientations:
        time = _time(sheets[orientation.sheet], orientation)
        if any(orientation.overlaps(other) for other in taken) or time is None:
            continue
        angle_unit = _angle_unit(sheets, orientation) if form in _ANGLE_FORMS else None
        out: dict[str, str] = {
            "file": sheets[orientation.sheet].source.name,
            "time": time,
            "orientation": f"{form}: {_named(sheets, orientation, 'angle', angle_unit)}",
        }
        free = [part for part in positions
                if part.sheet == orientation.sheet and not part.overlaps(orientation)
                and not any(part.overlaps(other) for other in taken)]  # fmt: skip
        if free and form != "pose matrix":
            out["position"] = _named(sheets, free[0], "length", _length_unit(sheets, free[0]))
        yield out


def _orientations(sheets: list[Sheet]) -> Iterator[tuple[_Part, str]]:
    for part, values in _windows(sheets, 4):
        if np.percentile(np.abs(np.linalg.norm(values, axis=1) - 1.0), 95) < 0.01:
            letters = "".join(sheets[part.sheet].names[k].lower()[-1:] for k in range(part.first, part.last))
            forms = [f"quaternion {letters}"] if letters in ("wxyz", "xyzw") else ["quaternion wxyz", "quaternion xyzw"]
            for form in forms:
                yield part, form
    for count, form in ((16, "pose matrix"), (12, "pose matrix"), (9, "matrix")):
        for part, values in _windows(sheets, count):
            C = values[::37].reshape(-1, count // (3 if count == 9 else 4), 3 if count == 9 else 4)[:, :3, :3]
            if np.abs(C @ np.swapaxes(C, 1, 2) - np.eye(3)).max() < 0.02:
                yield part, form
                return
    for part, values in _windows(sheets, 3):
        if np.abs(values).max() <= 361.0 and _name_score(sheets, part, "position") < 2:
            for form in _ANGLE_FORMS:
                yield part, form


def _triads(sheets: list[Sheet], quantity: str) -> list[_Part]:
    """Return three adjacent columns each, those first whose names fit a quantity."""
    parts = [(part, _name_score(sheets, part, quantity)) for part, _ in _windows(sheets, 3)]
    named = [part for part, score in parts if score > 0]
    return named or [part for part, score in parts if score == 0]


def _name_score(sheets: list[Sheet], part: _Part, quantity: str) -> int:
    """Return how well names fit a quantity: 3 if all do, negative if they fit others."""
    names = [sheets[part.sheet].names[k].lower() for k in range(part.first, part.last)]
    score = sum(bool(re.search(_NAMES[quantity], name)) for name in names)
    others = sum(any(re.search(pattern, name) for key, pattern in _NAMES.items() if key != quantity) for name in names)
    axes = "".join(name[-1:] for name in names)
    return score - others if score != others else (1 if axes == "xyz" and score else 0)


def _windows(sheets: list[Sheet], count: int) -> Iterator[tuple[_Part, Array]]:
    """Yield adjacent columns of numbers that change, with all their rows that are complete."""
    for s, sheet in enumerate(sheets):
        usable = [column.dtype.kind in "fiu" for column in sheet.columns]
        for first in range(len(sheet.columns) - count + 1):
            if not all(usable[first : first + count]):
                continue
            values = np.column_stack(sheet.columns[first : first + count]).astype(np.float64)
            values = values[np.isfinite(values).all(axis=1)]
            if len(values) > 20 and np.ptp(values, axis=0).max() > 0.0 and not _counts(values):
                yield _Part(s, first, first + count), values


def _counts(values: Array) -> bool:
    """Return whether a column only grows: a time."""
    return bool(((np.diff(values, axis=0) >= 0.0).all(axis=0) & (np.ptp(values, axis=0) > 0.0)).any())


def _named(sheets: list[Sheet], part: _Part, quantity: str, unit: str | None = None) -> str:
    sheet, places = sheets[part.sheet], list(range(part.first, part.last))
    axes = [sheet.names[k].lower()[-1:] for k in places]
    if quantity != "angle" and sorted(axes) == ["x", "y", "z"]:
        places.sort(key=lambda k: sheet.names[k].lower()[-1:])
    names = ", ".join(_unique(sheet, k) for k in places)
    stated = any(sheets[part.sheet].units[k] in UNITS[quantity] for k in range(part.first, part.last))
    return names if unit is None or stated else f"{names} [{unit}]"


def _unique(sheet: Sheet, k: int) -> str:
    """Return the name of a column, or its number where the name is not unique or would be read otherwise."""
    name = sheet.names[k]
    plain = sheet.names.count(name) == 1 and not re.search(r"[,\[\]:+\"]|^[-+#]|^$", name)
    return name if plain else f"#{k + 1}"


def _angle_unit(sheets: list[Sheet], part: _Part) -> str:
    values = np.concatenate([sheets[part.sheet].columns[k] for k in range(part.first, part.last)]).astype(np.float64)
    return "deg" if np.nanmax(np.abs(values)) * DEG > 0.12 and np.nanmax(np.abs(values)) > 6.3 else "rad"


def _length_unit(sheets: list[Sheet], part: _Part) -> str:
    values = np.concatenate([sheets[part.sheet].columns[k] for k in range(part.first, part.last)]).astype(np.float64)
    return "mm" if np.nanmedian(np.abs(values)) > _LONGEST_ROBOT else "m"
