"""`kreisel demo`: a small simulated cell, recorded and calibrated, held against its truth."""

from __future__ import annotations

from pathlib import Path

import typer


def demo(
    output: Path = typer.Option(Path("demo"), "-o", "--output", help="Folder for recording and result."),
    seconds: float = typer.Option(120.0, help="Length of the simulated recording."),
    seed: int = typer.Option(1, help="Seed of the simulation."),
) -> None:
    """Simulate a small recording, calibrate it, and show the result against the truth."""
    import numpy as np

    from kreisel.calibration.calibrate import run_calibration
    from kreisel.calibration.settings import CalibrationSettings
    from kreisel.calibration.validation import cross_validate, split_halves
    from kreisel.cli.output import check_output
    from kreisel.cli.progress import progress_bar
    from kreisel.cli.tables import print_result, print_truth
    from kreisel.recording import load
    from kreisel.recording.write import write_folder
    from kreisel.report import write_report
    from kreisel.simulation import simulate, write_truth

    check_output(output)
    folder = output / "recording"
    with progress_bar() as show:
        truth, recording = simulate(np.random.default_rng(seed), seconds, folder)
        if not folder.exists():
            write_folder(recording, folder)
            write_truth(truth, folder / "truth.json")
        outcome = run_calibration(load(folder), CalibrationSettings(), show)
        result = output / "result"
        outcome.calibration.save(result)
        cross, halves = cross_validate(outcome.estimate, show), split_halves(outcome.estimate, show)
        write_report(outcome, result / "report.html", cross=cross, halves=halves)
    print_result(outcome)
    print_truth(outcome, truth)
    typer.echo(f"open {result}/report.html; then: kreisel calibrate YOUR_RECORDING -o OUT")
    if not outcome.verdict.accepted:
        raise typer.Exit(3)
