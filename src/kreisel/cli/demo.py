"""`kreisel demo`: the paper's three devices in the virtual cell, calibrated and compared with the truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from kreisel.report.devices_page import Device

Show = Callable[[str, float], None]


def demo(
    output: Path = typer.Option(Path("demo"), "-o", "--output", help="Folder for recordings, results and reports."),
    seconds: float = typer.Option(600.0, help="Length of each simulated recording.", min=30.0, max=36000.0),
    seed: int = typer.Option(1, help="Seed of the simulation.", min=0),
) -> None:
    """Simulate the paper's three devices on a KR 125, calibrate them, and compare the results with the truth."""
    from kreisel.cli.output import check_output
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.cli.terminal_tables import print_devices
    from kreisel.inertial.noise_figures import PAPER
    from kreisel.report.devices_page import write_devices

    check_output(output)
    devices = []
    with progress_bar() as show:
        for number, (name, grade) in enumerate(PAPER.items()):
            named = _named(show, f"{name}: ")
            devices.append(_device(name, grade, seconds, seed + number, output / name, named))
        report = output / "report.html"
        lead = f"KUKA KR 125, {seconds / 60:.3g} minutes each, an arm with its own errors; all simulated"
        write_devices(devices, report, lead)
    print_devices(devices)
    typer.echo(f"open {report}; then your own: kreisel calibrate YOUR_RECORDING -o OUT")


def _named(show: Show | None, prefix: str) -> Show | None:
    return None if show is None else lambda step, share: show(prefix + step, share)


def _device(name: str, grade: str, seconds: float, seed: int, folder: Path, show: Show | None) -> Device:
    """Simulate one device, calibrate it from the files, and write its result."""
    import shutil
    from dataclasses import replace

    from kreisel.calibration.calibrate import run_calibration
    from kreisel.calibration.convergence import offset_convergence
    from kreisel.calibration.injection import inject
    from kreisel.cli.threads import in_threads
    from kreisel.formats.loading import load
    from kreisel.formats.write import write_folder
    from kreisel.model.calibration_settings import CalibrationSettings
    from kreisel.recording.recording_settings import DeviceTable
    from kreisel.report.devices_page import Device
    from kreisel.report.report_page import write_report
    from kreisel.simulation.cell import simulate, write_truth
    from kreisel.simulation.cell_settings import Cell, Imu
    from kreisel.study.truth_comparison import group_errors

    recording_folder, result = folder / "recording", folder / "result"
    truth, recording = simulate(Cell(seed=seed, seconds=seconds, imu=Imu(grade=grade)), recording_folder, show)
    if recording_folder.is_dir() and (recording_folder / "truth.json").is_file():
        shutil.rmtree(recording_folder)  # one of an earlier demo
    named = DeviceTable(maker="simulated", type=name, serial_number=str(seed))
    settings = recording.settings.model_copy(update={"device": named})
    write_folder(replace(recording, settings=settings), recording_folder)
    write_truth(truth, recording_folder / "truth.json")
    read = load(recording_folder, executor=in_threads)
    outcome = run_calibration(read, CalibrationSettings(), show, executor=in_threads, validate=True, budget=True)
    outcome.calibration.save(result)
    write_report(outcome, result / "report.html", injection=inject(outcome, show))
    errors = group_errors(outcome.calibration, truth)
    return Device(name, errors, offset_convergence(outcome), truth.sensors.k_a[0], f"{folder.name}/result/report.html")
