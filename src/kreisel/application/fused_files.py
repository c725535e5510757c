"""The calibrations of a tray applied to a recording of all its units: one table of the fused IMU comes out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from kreisel.application.corrected_files import check_usable
from kreisel.application.unit_check import check_units
from kreisel.array.array_file import ArrayResult, ArrayUnit
from kreisel.array.fused_imu import FusedImu, UnitReadings, fuse
from kreisel.array.left_out import in_words, reason_of
from kreisel.errors import KreiselError, RecordingError, SettingsError
from kreisel.formats.imus import imu_reader, imus_in
from kreisel.formats.input_formats import SUFFIXES, ReadImu, format_of
from kreisel.formats.write import write_imu_table
from kreisel.inertial.effects import follows_temperature
from kreisel.progress import Progress, of_step
from kreisel.recording.recording import Recording
from kreisel.validation.checks import check_streams


@dataclass(frozen=True)
class FusedFile:
    """What was written, the fused IMU, and what to know about the readings."""

    path: Path
    imu: FusedImu
    warnings: tuple[str, ...]


def fuse_files(
    array: ArrayResult, raw: Path, out: Path, *, imu: str | None = None, force: bool = False,
    progress: Progress | None = None,
) -> FusedFile:  # fmt: skip
    """Write angular rate and specific force of b by all units that a recording holds.

    Parameters
    ----------
    raw
        A recording folder with the readings of the units in `imu0`, `imu1` and so on, an .mcap file, or a bag.
    out
        A .csv file, or a folder for a recording.
    imu
        `all`: the units on all topics of a bag.
    force
        Use rejected calibrations, and do not check whether the readings are plausible.

    Raises
    ------
    SettingsError
        If there are no several units, or for files that hold no or one IMU.
    RecordingError
        If fewer than two units can be used, with the reasons, or if what is to be written exists.
    """
    table = _target(array, raw, out)
    names = imus_in(raw, imu)
    if not names:
        raise RecordingError(
            "holds several IMUs on topics that kreisel does not write; take them all with --imu all", file=raw
        )
    read_imu = imu_reader(raw)
    left_out, warnings = dict(array.left_out), []
    units: list[UnitReadings] = []
    for k, unit in enumerate(array.units):
        if progress is not None:
            progress("apply", k / len(array.units))
        try:
            if unit.name not in names:
                raise RecordingError("not in the recording")
            readings, found = _readings(unit, raw, read_imu, force=force)
        except KreiselError as error:
            left_out[unit.name] = reason_of(error)
            continue
        units.append(readings)
        warnings += found
    if len(units) < 2:
        raise RecordingError(
            f"{len(units)} of the units can be used, expected two or more; {in_words(left_out)}", file=raw
        )
    try:
        fused = fuse(units, of_step(progress, "bring units together"))
    except RecordingError as error:
        raise RecordingError(error.message, file=raw) from error
    fused = replace(fused, left_out=left_out | dict(fused.left_out))
    table.parent.mkdir(parents=True, exist_ok=True)
    write_imu_table(table, fused.stamps_ns, fused.rates, fused.forces)
    return FusedFile(table, fused, tuple(warnings))


def _target(array: ArrayResult, raw: Path, out: Path) -> Path:
    """Return the table to be written, after checks of what is asked for."""
    if len(array.units) < 2:
        raise SettingsError(
            f"--fuse is for several units; {array.folder} holds one, apply {array.reference.name} to it"
        )
    if not raw.exists():
        raise RecordingError("no such file or folder; --fuse is for a recording of several IMUs", file=raw)
    if format_of(raw) is None:
        raise SettingsError(
            f"--fuse is for a recording folder with imu0, imu1 and so on, an .mcap file or a bag; {raw} is none"
        )
    if out.suffix.lower() in SUFFIXES:
        raise SettingsError(f"-o {out}: --fuse writes a .csv file, or a folder")
    if out.exists():
        raise RecordingError("exists already; delete it, or give another name", file=out)
    return out if out.suffix.lower() == ".csv" else out / "imu0" / "data.csv"


def _readings(unit: ArrayUnit, raw: Path, read: ReadImu, *, force: bool) -> tuple[UnitReadings, list[str]]:
    """Return a unit's corrected readings, and what to know about them.

    Raises
    ------
    KreiselError
        If its calibration was rejected, or its readings cannot be used.
    """
    calibration = unit.calibration
    check_usable(calibration, force=force)
    imu, found = read(unit.name)
    recording = Recording(raw, imu, None, warnings=found)
    if not force:
        recording = check_streams(recording)
        warm = follows_temperature(calibration.sensors.effects)
        check_units(recording.imu, stated=False, warm=warm, counts=calibration.counts)
    caution = [calibration.verdict.caution] if calibration.verdict.caution else []
    notes = [f"{unit.name}: {text}" for text in (*caution, *map(str, recording.warnings))]
    return UnitReadings.of(unit.name, recording.imu, calibration), notes
