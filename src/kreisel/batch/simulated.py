"""Simulated units, to try a batch with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from kreisel.batch.job_result import Run

GRADE = "industrial-mems"


def unit_folder(folder: Path, number: int) -> Path:
    """Return the recording of a unit."""
    return folder / f"unit-{number + 1:04d}"


def simulate_unit(folder: Path, seconds: float, number: int) -> Run:
    """Write the recording of one device on an arm that knows its joint angles; every number is another device."""
    from kreisel.formats.write import write_folder
    from kreisel.recording.recording_settings import DeviceTable
    from kreisel.simulation.cell import simulate, write_truth
    from kreisel.simulation.cell_settings import Cell, Imu

    own = unit_folder(folder, number)
    cell = Cell(seed=1000 + number, seconds=seconds, imu=Imu(grade=GRADE))
    truth, recording = simulate(cell, own)
    named = DeviceTable(maker="simulated", type=GRADE, serial_number=f"{number + 1:04d}")
    settings = recording.settings.model_copy(update={"device": named})
    aside = own.with_name(f".{own.name}")
    write_folder(replace(recording, settings=settings), aside)
    write_truth(truth, aside / "truth.json")
    aside.rename(own)
    return Run(own.name, own.name, f"{number + 1:04d}", "simulated", GRADE, None, None, None)
