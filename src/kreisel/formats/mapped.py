"""Recordings from tables of any shape, by a mapping of their columns."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kreisel.errors import RecordingError, unknown_name
from kreisel.formats.csv_table import without_end
from kreisel.formats.mapping import Term, TimeRule, parse_orientation, parse_terms, parse_time
from kreisel.formats.robot_description import description_beside, is_there
from kreisel.formats.rotation_forms import positions_of, quantity_of, quaternions_of
from kreisel.formats.sheet import Sheet, is_sheet, read_sheet
from kreisel.geometry.rotation import Array
from kreisel.recording.header import UNITS, HeaderUnits
from kreisel.recording.nanoseconds import in_nanoseconds
from kreisel.recording.recording import (
    NO_STAMP,
    DataWarning,
    ImuSamples,
    JointAngles,
    Recording,
    ReferencePoses,
    Stamps,
)
from kreisel.recording.recording_settings import ColumnsTable, RecordingSettings, ReferenceColumns, read_settings
from kreisel.units import ZERO_CELSIUS

_DAY = 86_400 * 10**9  # ns
_GERMAN_DATE = re.compile(r"^(\d\d?)\.(\d\d?)\.(\d{4})\b")
_SHORT_HOUR = re.compile(r"(^|T)(\d):")
_HELD = 0.3
"""Share of rows in a common table that repeat the pose of the row before, above which poses are rarer than rows."""

_FEWEST, _APART = 10, 5.0
"""Least accelerations in a file of their own, and intervals between two of them over which nothing is interpolated."""


@dataclass(frozen=True)
class _Tables:
    """Tables of a recording, each read once; some may have been read before and not be used."""

    folder: Path
    usual: Path | None
    read: dict[Path, Sheet]
    used: set[Path] = field(default_factory=set)

    @classmethod
    def of_recording(cls, path: Path, read: dict[Path, Sheet]) -> _Tables:
        """Return the tables at a path; `read` are those that were read already."""
        found = tables_in(path)
        return cls(path if path.is_dir() else path.parent, found[0] if len(found) == 1 else None, read)

    def of(self, file: str | None, what: str) -> Sheet:
        path = self.usual if file is None else self.folder / file
        if path is None:
            raise RecordingError(
                f"the file of the {what} is not named; write columns.{what}.file in recording.toml, or "
                f"--map '{what}.file=NAME'",
                file=self.folder,
            )
        if path not in self.read:
            self.read[path] = read_sheet(path)
        self.used.add(path)
        return self.read[path]

    @property
    def cut(self) -> list[DataWarning]:
        """Warnings about last lines that were left out."""
        lines = {path.name: self.read[path].cut.strip() for path in sorted(self.used)}
        return [without_end(name, line) for name, line in lines.items() if line]


def tables_in(path: Path) -> list[Path]:
    """Return the tables that a path is, or that lie in a folder; that of a result in it is none of a recording."""
    if path.is_dir():
        result = {"estimates.csv"} if (path / "calibration.yaml").is_file() else set()
        return sorted(p for p in path.iterdir() if p.is_file() and is_sheet(p) and p.name not in result)
    return [path] if is_sheet(path) else []


def settings_beside(path: Path) -> RecordingSettings:
    """Return the settings of recording.toml in a folder, or beside a file."""
    file = (path if path.is_dir() else path.parent) / "recording.toml"
    return read_settings(file) if is_there(file) else RecordingSettings()


def load_mapped(
    path: Path,
    settings: RecordingSettings,
    columns: ColumnsTable,
    read: dict[Path, Sheet] | None = None,
    imu: str | None = None,
) -> Recording:
    """Return the recording in a table, or in the tables of a folder.

    Parameters
    ----------
    read
        Tables that were read already.
    imu
        Name of the IMU, where there are several; the first one by default.

    Raises
    ------
    RecordingError, SettingsError
        If a file or column is missing, or cannot be read.
    """
    tables, folder = _Tables.of_recording(path, {} if read is None else read), path if path.is_dir() else path.parent
    warnings: list[DataWarning] = []
    name = columns.names[0] if imu is None else imu
    columns, samples = _of_one(tables, columns, name, warnings)
    reference = _reference(tables, columns, warnings)
    joints = _joints(tables, columns)
    warnings += tables.cut
    settings = settings.of_imu(name).model_copy(update={"columns": None})
    urdf = description_beside(folder, settings)
    return Recording(path, samples, reference, joints, settings, tuple(warnings), urdf=urdf)


def imus_of(path: Path) -> tuple[str, ...]:
    """Return the names of the IMUs that [columns] in recording.toml names; none where there is no such table."""
    columns = settings_beside(path).columns
    return () if columns is None else columns.names


def reader_of_imus(path: Path) -> Callable[[str], tuple[ImuSamples, tuple[DataWarning, ...]]]:
    """Return what reads the readings of one IMU that [columns] in recording.toml names; a table is read once."""
    tables, columns = _Tables.of_recording(path, {}), settings_beside(path).columns or ColumnsTable()

    def read(name: str) -> tuple[ImuSamples, tuple[DataWarning, ...]]:
        warnings: list[DataWarning] = []
        samples = _of_one(tables, columns, name, warnings)[1]
        return samples, (*warnings, *tables.cut)

    return read


def _of_one(
    tables: _Tables, columns: ColumnsTable, name: str, warnings: list[DataWarning]
) -> tuple[ColumnsTable, ImuSamples]:
    """Return the columns with those of one IMU as the IMU's, and its readings."""
    if name not in columns.names:
        raise RecordingError(f"{unknown_name('IMU', name, columns.names)}; choose with --imu", file=tables.folder)
    own = columns.of_imu(name)
    return own, _imu(tables, own, name if columns.imus else "imu", warnings)


def _imu(tables: _Tables, columns: ColumnsTable, name: str, warnings: list[DataWarning]) -> ImuSamples:
    own = columns.imu
    for key in ("time", "rate", "acceleration"):
        if getattr(own, key) is None:
            raise RecordingError(f"columns.{name}.{key} is missing; name the columns of the IMU", file=tables.folder)
    sheet = tables.of(own.file, name)
    rate, acceleration = parse_terms(str(own.rate), "rate"), parse_terms(str(own.acceleration), "acceleration")
    together = rate if own.acceleration_file else (*rate, *acceleration)
    sheet.check_lengths(term.name for term in (*together, *parse_time(str(own.time)).terms))
    rates, rate_unit = _vectors(sheet, rate, "rate", 3)
    stamps, known, time_unit = stamps_of(sheet, parse_time(str(own.time)))
    if own.acceleration_file:
        beside = tables.of(own.acceleration_file, name)
        forces, force_unit = _interpolated(beside, acceleration, own.acceleration_time or str(own.time), stamps)
        keep = _own_rows(sheet, rates, rate, str(own.time), columns) & np.isfinite(forces).all(axis=1)
        text = f"accelerations of {own.acceleration_file} were interpolated to the stamps of the rates"
        warnings.append(DataWarning(sheet.source.name, text))
    else:
        forces, force_unit = _vectors(sheet, acceleration, "acceleration", 3)
        keep = _own_rows(sheet, np.hstack([rates, forces]), together, str(own.time), columns)
    temperature = None
    if own.temperature is not None:
        values, unit = _vectors(sheet, parse_terms(own.temperature, "temperature"), "temperature", 1)
        temperature = np.ascontiguousarray(values[keep, 0]) - (ZERO_CELSIUS if unit == "K" else 0.0)
    _note(sheet, "IMU", keep, warnings)
    units = HeaderUnits(time_unit, rate_unit, force_unit)
    return ImuSamples(
        _counted(np.where(known, stamps, NO_STAMP), keep, str(own.time)),
        rates[keep],
        forces[keep],
        sheet.source / name,
        units,
        temperature=temperature,
        rows=np.flatnonzero(keep),
    )


def _interpolated(sheet: Sheet, terms: tuple[Term, ...], time: str, at: Stamps) -> tuple[Array, str | None]:
    """Return accelerations of another table at stamps (n,), with their unit; no numbers where that has none near."""
    values, unit = _vectors(sheet, terms, "acceleration", 3)
    stamps, known, _ = stamps_of(sheet, parse_time(time))
    good = np.flatnonzero(known & np.isfinite(values).all(axis=1))
    _, first = np.unique(stamps[good], return_index=True)
    good = good[first]
    if good.size < _FEWEST:
        raise RecordingError(f"holds {good.size} accelerations, expected {_FEWEST} or more", file=sheet.source)
    seconds, wanted = (stamps[good] - at[0]) * 1e-9, (at - at[0]) * 1e-9
    steps = np.diff(seconds)
    place = np.clip(np.searchsorted(seconds, wanted) - 1, 0, steps.size - 1)
    far = (wanted < seconds[0]) | (wanted > seconds[-1]) | (steps[place] > _APART * np.median(steps))
    out = np.column_stack([np.interp(wanted, seconds, axis) for axis in values[good].T])
    out[far] = np.nan
    return out, unit


def _reference(tables: _Tables, columns: ColumnsTable, warnings: list[DataWarning]) -> ReferencePoses | None:
    own = columns.reference
    if own.position is None and own.orientation is None:
        return None
    sheet = tables.of(own.file, "reference")
    time = own.time or (columns.imu.time if sheet is tables.of(columns.imu.file, "imu") else None)
    if time is None:
        raise RecordingError("columns.reference.time is missing; name the column of the stamps", file=tables.folder)
    stamps, known, time_unit = stamps_of(sheet, parse_time(time))
    sheet.check_lengths(term.name for term in (*_pose_terms(own), *parse_time(time).terms))
    parts: list[Array] = []
    positions, quaternions, unit = None, None, None
    if own.position is not None:
        positions, unit = _vectors(sheet, parse_terms(own.position, "length"), "length", 3)
        parts.append(positions)
    if own.orientation is not None:
        form, terms = parse_orientation(own.orientation)
        values, stated = _vectors(sheet, terms, quantity_of(form), len(terms))
        parts.append(values)
        if form == "pose matrix":
            if positions is None:
                positions, unit = positions_of(values), stated
            values = values / UNITS["length"][stated or "m"]
        try:
            quaternions = quaternions_of(form, values)
        except RecordingError as error:
            raise RecordingError(error.message, file=sheet.source) from error
    together = np.hstack(parts)
    keep = _own_rows(sheet, together, tuple(_pose_terms(own)), time, columns)
    _note(sheet, "pose", keep, warnings)
    if sheet is tables.of(columns.imu.file, "imu"):
        if time == columns.imu.time:
            keep = _where_new(together, keep, sheet, warnings)
        else:
            rows = np.flatnonzero(keep & known)
            keep[rows[1:][stamps[rows[1:]] == stamps[rows[:-1]]]] = False
    return ReferencePoses(
        "pose0",
        _counted(np.where(known, stamps, NO_STAMP), keep, time),
        None if positions is None else np.ascontiguousarray(positions[keep]),
        None if quaternions is None else np.ascontiguousarray(quaternions[keep]),
        sheet.source / "reference",
        HeaderUnits(time_unit, length=unit),
        rows=np.flatnonzero(keep),
    )


def _places_read(sheet: Sheet, columns: ColumnsTable) -> set[int]:
    """Return the columns of a table that any stream reads its values from."""
    texts = [(columns.joints.angles, "angle")]
    for imu in (columns.imu, *columns.imus.values()):
        texts += [(imu.rate, "rate"), (imu.acceleration, "acceleration")]
    triads = [parse_terms(text, quantity) for text, quantity in texts if text is not None]
    names = {term.name for terms in (*triads, _pose_terms(columns.reference)) for term in terms}
    found = set()
    for name in names:
        with suppress(RecordingError):  # a column of another file
            found.add(sheet.place(name))
    return found


def _pose_terms(own: ReferenceColumns) -> list[Term]:
    """Return the columns of the poses."""
    position = [] if own.position is None else list(parse_terms(own.position, "length"))
    return position if own.orientation is None else [*position, *parse_orientation(own.orientation)[1]]


def _where_new(values: Array, keep: NDArray[np.bool_], sheet: Sheet, warnings: list[DataWarning]) -> NDArray[np.bool_]:
    """Return the rows with new poses, where a common table repeats each pose until the next one."""
    rows = np.flatnonzero(keep)
    changed = np.append(True, (values[rows[1:]] != values[rows[:-1]]).any(axis=1))
    starts = np.flatnonzero(changed)
    every = max(1, round(float(np.median(np.diff(starts))))) if starts.size > 1 else 1
    if np.mean(~changed) < _HELD or every == 1:
        return keep
    since = np.arange(rows.size) - np.maximum.accumulate(np.where(changed, np.arange(rows.size), 0))
    new = np.zeros(values.shape[0], dtype=bool)
    # at rest the pose does not change: it is taken as often as in motion
    new[rows[since % every == 0]] = True
    warnings.append(
        DataWarning(sheet.source.name, f"each pose stands in {every} rows on average; only the first of them is used")
    )
    return new


def _joints(tables: _Tables, columns: ColumnsTable) -> JointAngles | None:
    own = columns.joints
    if own.angles is None:
        return None
    sheet = tables.of(own.file or columns.reference.file, "joints")
    time = own.time or columns.reference.time
    if time is None:
        raise RecordingError("columns.joints.time is missing; name the column of the stamps", file=tables.folder)
    terms = parse_terms(own.angles, "angle")
    sheet.check_lengths(term.name for term in (*terms, *parse_time(time).terms))
    angles, unit = _vectors(sheet, terms, "angle", len(terms))
    stamps, known, time_unit = stamps_of(sheet, parse_time(time))
    keep = _own_rows(sheet, angles, terms, time, columns)
    return JointAngles(
        _counted(np.where(known, stamps, NO_STAMP), keep, time),
        angles[keep],
        sheet.source / "joints",
        HeaderUnits(time_unit, angle=unit),
        rows=np.flatnonzero(keep),
    )


def _own_rows(
    sheet: Sheet, values: Array, terms: tuple[Term, ...], time: str, columns: ColumnsTable
) -> NDArray[np.bool_]:
    """Return the rows of a stream: those that hold some of its values (n, k), or that hold nothing at all.

    A row that holds other values, but none of the stream's, belongs to another stream of a common table. One that holds
    nothing was lost. Where rows are counted, only columns that are read show another stream: what is left out there
    would move all later rows.
    """
    clock = parse_time(time).terms
    own = {sheet.place(term.name) for term in (*terms, *clock)}
    known = set(range(len(sheet.columns))) if clock else _places_read(sheet, columns)
    length = sheet.lengths[sheet.place(terms[0].name)] if sheet.lengths else sheet.rows
    other = np.zeros(sheet.rows, dtype=bool)
    for k, column in enumerate(sheet.columns):
        if k in known - own and column.dtype.kind in "fiu" and (not sheet.lengths or sheet.lengths[k] == length):
            other |= np.isfinite(column)
    return (np.arange(sheet.rows) < length) & (~np.isnan(values).all(axis=1) | ~other)


def _vectors(sheet: Sheet, terms: tuple[Term, ...], quantity: str, count: int) -> tuple[Array, str | None]:
    """Return columns (n, k) in SI, and the unit that all of them are stated to have."""
    if len(terms) != count:
        names = ", ".join(term.name for term in terms)
        raise RecordingError(f"{len(terms)} columns of {quantity} ({names}), expected {count}", file=sheet.source)
    units = [term.unit or _own_unit(sheet, term.name, quantity) for term in terms]
    stated = {unit for unit in units if unit is not None}
    if len(stated) > 1 and None in units:
        raise RecordingError(f"state the unit of each of {', '.join(t.name for t in terms)}", file=sheet.source)
    usual = next(iter(stated)) if len(stated) == 1 else None
    factors = [term.sign * UNITS[quantity][unit or usual or next(iter(UNITS[quantity]))]
               for term, unit in zip(terms, units, strict=True)]  # fmt: skip
    values = [factor * sheet.numbers(term.name) for term, factor in zip(terms, factors, strict=True)]
    return np.column_stack(values), usual


def _own_unit(sheet: Sheet, name: str, quantity: str) -> str | None:
    """Return the unit that the header states of a column."""
    unit = sheet.units[sheet.place(name)]
    if unit is not None and unit not in UNITS[quantity]:
        raise RecordingError(
            f"column '{name}' is in [{unit}], which is no unit of {quantity}; name its unit in the mapping",
            file=sheet.source,
        )
    return unit


def stamps_of(sheet: Sheet, rule: TimeRule) -> tuple[Stamps, NDArray[np.bool_], str | None]:
    """Return stamps in ns, (n,), which rows have one, and their unit, if they have one."""
    total, known = np.zeros(sheet.rows, dtype=np.int64), np.ones(sheet.rows, dtype=bool)
    if not rule.terms:
        count = np.arange(sheet.rows)
        return np.round(count * (1e9 / float(rule.hertz or 1.0))).astype(np.int64), known, None
    stated = None
    for term in rule.terms:
        column = sheet.columns[sheet.place(term.name)]
        if column.dtype.kind in "OUS":
            part, good = _of_dates(sheet, term.name, column, alone=len(rule.terms) == 1)
        else:
            stated = None if rule.hertz else term.unit or _own_unit(sheet, term.name, "time") or "s"
            if stated == "date":
                raise RecordingError(
                    f"column '{term.name}' holds numbers, not dates; state their unit", file=sheet.source
                )
            factor = 1e9 / rule.hertz if rule.hertz else UNITS["time"][str(stated)]
            part, good = _in_nanoseconds(column, factor, sheet, term.name)
        total, known = total + part, known & good
    return total, known, stated if len(rule.terms) == 1 else None


def _counted(stamps: Stamps, keep: NDArray[np.bool_], time: str) -> Stamps:
    """Return the stamps of the rows of a stream; where rows are counted, only its own are."""
    return stamps[keep] if parse_time(time).terms else stamps[: int(keep.sum())]


def _in_nanoseconds(column: NDArray[Any], factor: float, sheet: Sheet, name: str) -> tuple[Stamps, NDArray[np.bool_]]:
    good = np.isfinite(column) if column.dtype.kind == "f" else np.ones(column.size, dtype=bool)
    if not (np.abs(column[good].astype(np.float64)) * factor < 9e18).all():
        raise RecordingError(f"column '{name}' is not a possible time in its unit; state the unit", file=sheet.source)
    if column.dtype.kind != "f" and factor == int(factor):
        return column.astype(np.int64) * int(factor), good
    return in_nanoseconds(np.where(good, column, 0.0).astype(np.float64), factor), good


def _of_dates(sheet: Sheet, name: str, column: NDArray[Any], *, alone: bool) -> tuple[Stamps, NDArray[np.bool_]]:
    """Return the nanoseconds of dates (ISO 8601, with slashes, or 31.12.2026), or of times of a day.

    Times of a day that stand `alone` may pass midnight; beside a date the date says it.
    """
    texts = [_as_iso(str(cell)) for cell in column]
    good = np.array([bool(text) for text in texts])
    only_time = all("-" not in text for text in texts)
    try:
        ns = np.array(
            [np.datetime64(f"1970-01-01T{text}" if only_time else text, "ns") if text else np.datetime64(0, "ns")
             for text in texts]
        ).astype(np.int64)  # fmt: skip
    except ValueError as error:
        raise RecordingError(f"column '{name}': {error}; expected dates such as 2026-05-01T12:00:00.25",
                             file=sheet.source) from error  # fmt: skip
    if only_time and alone:
        ns[good] += _DAY * np.append(0, np.cumsum(np.diff(ns[good]) < -_DAY // 2))
    return ns, good


def _as_iso(text: str) -> str:
    """Return a date or a time of day as ISO 8601 writes it."""
    dated = _GERMAN_DATE.sub(lambda m: f"{m[3]}-{m[2]:>02}-{m[1]:>02}", text.strip().replace("/", "-").rstrip("Z"))
    return _SHORT_HOUR.sub(r"\g<1>0\2:", dated.replace(",", ".").replace(" ", "T", 1))


def _note(sheet: Sheet, what: str, keep: NDArray[np.bool_], warnings: list[DataWarning]) -> None:
    if not keep.any():
        raise RecordingError(f"holds no row with {what} numbers", file=sheet.source)
    inside = keep[: int(np.flatnonzero(keep)[-1]) + 1] if sheet.lengths else keep
    empty = int(np.sum(~inside))
    if empty:
        first = int(np.argmin(inside)) + 1
        text = f"{empty} of {inside.size} rows hold no {what}, the first is row {first}"
        warnings.append(DataWarning(sheet.source.name, text))
