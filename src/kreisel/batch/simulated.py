"""Simulated units, to try a batch with."""

from __future__ import annotations

from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path

from kreisel.batch.job_result import Run

GRADE = "industrial-mems"


OPERATORS = ("ada", "ben")
"""Who is said to have calibrated repeated units, in turn."""

FIRST_DAY = date(2026, 1, 5)
"""Date of the first calibration of repeated units; the next ones are months apart."""


def unit_folder(folder: Path, number: int, repeats: int = 1) -> Path:
    """Return the recording of a unit; of repeated ones, that of a run."""
    if repeats == 1:
        return folder / f"unit-{number + 1:04d}"
    return folder / f"unit-{number // repeats + 1:04d}" / f"run-{number % repeats + 1}"


def simulate_unit(folder: Path, seconds: float, repeats: int, number: int) -> Run:
    """Write the recording of one device on an arm that knows its joint angles; every number is another device.

    Parameters
    ----------
    repeats
        Recordings of each device, by operators in turn and months apart.
    """
    from kreisel.formats.write import write_folder
    from kreisel.recording.recording_settings import CertificateTable, DeviceTable
    from kreisel.simulation.cell import simulate, write_truth
    from kreisel.simulation.cell_settings import Cell, Imu

    own = unit_folder(folder, number, repeats)
    unit, run = divmod(number, repeats)
    serial = f"{unit + 1:04d}"
    cell = Cell(seed=1000 + unit, run=run, seconds=seconds, imu=Imu(grade=GRADE))
    truth, recording = simulate(cell, own)
    stated: dict[str, object] = {"device": DeviceTable(maker="simulated", type=GRADE, serial_number=serial)}
    if repeats > 1:
        day = FIRST_DAY + timedelta(days=182 * run)
        stated["certificate"] = CertificateTable(operator=OPERATORS[run % len(OPERATORS)], date=day.isoformat())
    settings = recording.settings.model_copy(update=stated)
    aside = own.with_name(f".{own.name}")
    aside.parent.mkdir(parents=True, exist_ok=True)
    write_folder(replace(recording, settings=settings), aside)
    write_truth(truth, aside / "truth.json")
    aside.rename(own)
    return Run(own.name, own.name, serial, "simulated", GRADE, None, None, None)
