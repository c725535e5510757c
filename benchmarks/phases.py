"""Where the time of ``kreisel calibrate`` goes: ``python -m benchmarks.phases [RECORDING]``.

Without a recording, ten minutes at 400 Hz of the virtual cell are made and read back from CSV. Phases are timed
in one process, one after another, as the command runs them; the filter also in strapdown passes.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from . import yardstick


def main(folder: Path | None) -> None:
    """Print the table."""
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import kreisel.cli.main, kreisel.calibration.calibrate"], check=True)
    phases = {"start Python, imports": time.perf_counter() - began}

    def lap(name: str, since: float) -> float:
        now = time.perf_counter()
        phases[name] = now - since
        return now

    from kreisel.calibration.assembly import Judged, assemble
    from kreisel.calibration.cross_validation import cross_validate
    from kreisel.calibration.evidence import Evidence
    from kreisel.calibration.inflation import with_unestimated_errors
    from kreisel.calibration.latitude_check import check_latitude
    from kreisel.calibration.outcome import Outcome
    from kreisel.calibration.split_halves import split_halves, with_disagreement
    from kreisel.calibration.verdict import consistency, judge
    from kreisel.cli.threads import side_by_side
    from kreisel.filtering.iteration import Given, estimate
    from kreisel.filtering.observability import observability
    from kreisel.formats.loading import load
    from kreisel.formats.write import write
    from kreisel.model.settings import CalibrationSettings
    from kreisel.preparation.build_problem import build_problem
    from kreisel.preparation.prepare import prepare_recording
    from kreisel.report.page import write_report
    from kreisel.simulation.cell import simulate
    from kreisel.simulation.settings import Cell

    with tempfile.TemporaryDirectory() as scratch:
        if folder is None:
            folder = Path(scratch) / "recording"
            _, recording = simulate(Cell.model_validate({"seed": 3, "imu": {"rate": 400.0}}), folder)
            write(recording, folder)
        at = time.perf_counter()
        recording = load(folder)
        at = lap("read and check", at)
        settings = CalibrationSettings()
        preparation = prepare_recording(recording, settings)
        at = lap("synchronise, start values", at)
        problem = build_problem(preparation, settings)
        at = lap("build the problem", at)
        found = with_unestimated_errors(estimate(problem, Given(reference=True, imu=True)))
        at = lap(f"filter, {found.passes} pass(es)", at)
        halves = split_halves(found, together=side_by_side)
        latitude, cross = side_by_side([
            lambda: check_latitude(found.problem, found.run), lambda: cross_validate(found),
        ])  # fmt: skip
        at = lap("halves, latitude, validation", at)
        found = with_disagreement(found, halves)
        seen, facts = observability(found.problem, found.run), consistency(found, preparation.correlation)
        verdict = judge(found, Evidence(seen, facts, halves, latitude))
        calibration = assemble(recording, found, Judged(seen, facts, verdict, 0.0), found.warnings)
        at = lap("judge, assemble", at)
        calibration.write(Path(scratch))
        at = lap("write the result", at)
        outcome = Outcome(
            recording, preparation, found.problem, found, seen, facts, halves, verdict, found.warnings, calibration,
            cross,
        )  # fmt: skip
        write_report(outcome, Path(scratch) / "report.html")
        lap("report", at)
        unit = yardstick.seconds(recording.imu.rates, recording.imu.accelerations, recording.imu.interval)
    total = sum(phases.values())
    for name, seconds in phases.items():
        print(f"{name:28s} {seconds:7.3f} s {100 * seconds / total:5.1f} %")
    print(f"{'sum':28s} {total:7.3f} s; one strapdown pass {unit * 1e3:.2f} ms")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
