"""A calibration applied to a file or folder of readings: the same kind comes out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kreisel.application.corrected_tables import CorrectedTable
from kreisel.application.unit_check import check_units
from kreisel.calibration.result import Calibration
from kreisel.errors import RecordingError, SettingsError
from kreisel.files import open_fresh
from kreisel.formats.folder import imus_in, is_folder, read_imu_table
from kreisel.formats.input_formats import SUFFIXES, InputFormat, format_of
from kreisel.formats.loading import mapped_recording, not_a_recording
from kreisel.formats.mapped import settings_beside
from kreisel.formats.write import write_imu_table
from kreisel.geometry.rotation import Array
from kreisel.inertial.effects import follows_temperature
from kreisel.progress import StepProgress
from kreisel.recording.recording import DataWarning, ImuSamples
from kreisel.validation.as_sampled import sampled_rows
from kreisel.validation.masking import part_of

_BLOCK = 1 << 20
"""Bytes of a table that are read at once; the header line must lie within the first of them. Chosen: ten thousand rows
of a hundred bytes: few calls for each row, and little memory for tables of any length."""

_READ_WHOLE = 1 << 30
"""Bytes of a table up to which it is read before rows are corrected, for moments of sampling. Chosen: 5 h at 400 Hz."""

TOPIC = "/imu/data_calibrated"
"""Topic of corrected readings in bags, beside the raw ones."""


@dataclass(frozen=True)
class Applied:
    """What was written: the file or folder, the number of samples, and what to know about them."""

    path: Path
    samples: int
    warnings: tuple[str, ...] = ()


def check_usable(calibration: Calibration, *, force: bool, name: str = "this calibration") -> None:
    """Raise an error for a rejected calibration.

    Raises
    ------
    SettingsError
        Unless `force` is set.
    """
    if not calibration.accepted and not force:
        reason = calibration.verdict.first_reason
        raise SettingsError(f"{name} was rejected ({reason}); --force uses it nevertheless")


def apply_to_file(
    calibration: Calibration,
    raw: Path,
    out: Path,
    *,
    imu: str | None = None,
    columns: Iterable[str] = (),
    topic: str = TOPIC,
    force: bool = False,
    progress: StepProgress | None = None,
) -> Applied:
    """Write angular rate and specific force of the readings in a file or folder.

    Parameters
    ----------
    raw
        A table (.csv), a recording folder, an .mcap file, a ROS 1 or ROS 2 bag, or a table of another shape.
    out
        A .csv file for any of them; a folder for a recording folder; for a bag or an .mcap file one of the same kind,
        a copy with a further topic.
    imu
        The IMU's folder or topic, where there are several.
    columns
        Which columns of a table of another shape hold what.
    topic
        Name of the further topic.
    force
        Do not check whether the readings are in plausible units, and of the same device.

    Raises
    ------
    RecordingError
        If the readings cannot be read or are of another device, or what is to be written exists.
    """
    if not raw.exists():
        raise RecordingError("no such file or folder; give a table, a folder, an .mcap file or a bag", file=raw)
    if out.exists():
        raise RecordingError("exists already; delete it, or give another name", file=out)
    if not force:
        _check_device(calibration, raw)
    out.parent.mkdir(parents=True, exist_ok=True)
    columns = list(columns)
    form = format_of(raw)
    if form is not None and form.is_copied and out.suffix.lower() != ".csv":
        return _to_bag(calibration, raw, out, imu, topic, force=force)
    if out.suffix.lower() in SUFFIXES:
        raise SettingsError(f"-o {out}: of {raw} a .csv file is written, or a folder; bags are copies of bags")
    mapped = mapped_recording(raw, columns) if columns or not _is_plain(raw, form) else None
    read = None if mapped is None else (mapped.imu, mapped.warnings)
    if mapped is None and form is not None and form.readings is not None:
        read = form.readings(raw, imu)
    if read is not None:
        samples, warnings = read
        if not force:
            check_units(
                samples,
                stated=mapped is not None,
                warm=follows_temperature(calibration.sensors.effects),
                counts=calibration.counts,
            )
        return _to_table(calibration, samples, out, warnings)
    table = raw
    others: tuple[str, ...] = ()
    if raw.is_dir():
        if not is_folder(raw):
            raise not_a_recording(raw)
        table = (raw if (raw / "imu0").is_dir() else raw / "mav0") / (imu or "imu0") / "data.csv"
        out = out if out.suffix.lower() == ".csv" else out / (imu or "imu0") / "data.csv"
        if imu is None and len(several := imus_in(raw)) > 1:
            others = (f"readings of imu0, the first of {len(several)} IMUs, were corrected; --imu names another",)
    done = _table_to_table(calibration, table, out, progress, force=force)
    return replace(done, warnings=(*others, *done.warnings))


def _check_device(calibration: Calibration, raw: Path) -> None:
    """Raise an error for readings of another device than the calibration's, if both have a serial number."""
    inside = raw.parent.parent if raw.name == "data.csv" and raw.parent.name.startswith("imu") else raw
    stated = settings_beside(inside).device.serial_number
    own = None if calibration.recording is None else calibration.recording.device.get("serial_number")
    if stated and own and stated != own:
        raise RecordingError(
            f"readings of the device with the serial number '{stated}', and the calibration is that of '{own}'; apply "
            "that of the same device (--force applies this one)",
            file=raw,
        )


def _is_plain(raw: Path, form: InputFormat | None) -> bool:
    """Return whether the columns need no assignment."""
    return (form is not None or _is_usual_table(raw)) and settings_beside(raw).columns is None


def _is_usual_table(raw: Path) -> bool:
    """Return whether it is a table whose header is that of a recording folder's."""
    from kreisel.formats.imu_lines import ImuLines

    if raw.is_dir():
        return False
    with raw.open("rb") as file:
        try:
            head = file.read(_BLOCK).replace(b"\r", b"\n").partition(b"\n")[0]
            ImuLines(raw).feed(head + b"\n")
        except RecordingError:
            return False
    return True


def _table_to_table(
    calibration: Calibration, table: Path, out: Path, progress: StepProgress | None, *, force: bool
) -> Applied:
    out.parent.mkdir(parents=True, exist_ok=True)
    partial = out.with_name(f"{out.name}.partial")
    try:
        with open_fresh(partial) as target:
            rows, warnings = apply_to_table(calibration, table, target.write, progress, force=force)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    partial.replace(out)
    return Applied(out, rows, warnings)


def apply_to_pipe(
    calibration: Calibration, table: Path, write: Callable[[bytes], object], *, force: bool = False
) -> tuple[str, ...]:
    """Write the rows of a table, corrected, and return what to know about them.

    Raises
    ------
    SettingsError
        For what is written to a file only: bags, folders, and tables whose columns need a mapping.
    RecordingError
        If the table cannot be read.
    """
    if not table.exists():
        raise RecordingError("no such file; give a table", file=table)
    if table.is_dir() or format_of(table) is not None or not _is_plain(table, None):
        raise SettingsError(f"-o - is for a table as kreisel writes them; of {table} give -o FILE")
    return apply_to_table(calibration, table, write, force=force)[1]


def apply_to_table(
    calibration: Calibration,
    table: Path,
    write: Callable[[bytes], object],
    progress: StepProgress | None = None,
    *,
    force: bool = False,
) -> tuple[int, tuple[str, ...]]:
    """Write the rows of a table, corrected, and return their number and what to know about them.

    Raises
    ------
    RecordingError
        If the table cannot be read.
    """
    if not table.is_file():
        raise RecordingError("no such file; expected IMU readings there", file=table)
    size = max(table.stat().st_size, 1)
    known, notes = _read_whole(calibration, table) if size < _READ_WHOLE else (None, [])
    corrected = CorrectedTable(calibration, table, check=not force, corrected=known)
    with table.open("rb") as source:
        while data := source.read(_BLOCK):
            write(corrected.feed(data))
            if progress is not None:
                progress(source.tell() / size)
        rest, cut = corrected.close()
        write(rest)
    lost = [] if cut is None else [f"{table}: the last line has no end ('{cut[-40:]}') and was left out"]
    return corrected.rows, (*corrected.notes, *notes, *lost)


def _read_whole(calibration: Calibration, table: Path) -> tuple[tuple[Array, Array] | None, list[str]]:
    """Return angular rate and specific force of every row that has numbers, and notes; None for a table with a fault.

    That is found with its line when the rows are read one by one.
    """
    try:
        read = read_imu_table(table, [])
        known = np.flatnonzero(~np.isnan(np.hstack([read.rates, read.accelerations]).sum(axis=1)))
        if known.size < len(read.rates):
            read = replace(part_of(read, known), rows=None)
        omega, f, notes = _corrected(calibration, read)
    except RecordingError:
        return None, []
    return (omega, f), notes


def _to_table(calibration: Calibration, raw: ImuSamples, out: Path, warnings: Iterable[DataWarning]) -> Applied:
    table = out if out.suffix.lower() == ".csv" else out / "imu0" / "data.csv"
    omega, f, notes = _corrected(calibration, raw)
    table.parent.mkdir(parents=True, exist_ok=True)
    write_imu_table(table, raw.stamps_ns, omega, f)
    return Applied(table, len(omega), (*map(str, warnings), *notes))


def _corrected(calibration: Calibration, raw: ImuSamples) -> tuple[Array, Array, list[str]]:
    """Return angular rate and specific force of every sample, (n, 3) each, and notes."""
    rows = sampled_rows(raw)
    own = rows.samples
    try:
        omega, f = calibration.correct(own.rates, own.accelerations, own.stamps_ns, own.temperature, check=False)
    except RecordingError as error:
        raise RecordingError(error.message, file=raw.source) from error
    notes = [f"{warning}; rows and their stamps are written as they were read" for warning in rows.warnings]
    return omega[rows.of_row], f[rows.of_row], notes


def _to_bag(calibration: Calibration, raw: Path, out: Path, imu: str | None, topic: str, *, force: bool) -> Applied:
    from kreisel.formats.bag_copy import copy_with_topic, imu_messages

    kind = raw.suffix.lower() if raw.is_file() and raw.suffix.lower() in (".mcap", ".bag") else ""
    if out.suffix.lower() != kind and not (kind == "" and out.suffix.lower() not in SUFFIXES):
        wanted = f"a name that ends in {kind}" if kind else "a folder (a ROS 2 bag)"
        raise SettingsError(f"-o {out}: of {raw} {wanted} is written, or a .csv file")
    found = imu_messages(raw, imu)
    if not force:
        check_units(
            found.samples,
            stated=False,
            warm=follows_temperature(calibration.sensors.effects),
            counts=calibration.counts,
        )
    omega, f, notes = _corrected(calibration, found.samples)
    copy_with_topic(raw, out, found, topic, found.with_readings(omega, f))
    return Applied(out, len(omega), (*map(str, found.warnings), *notes))
