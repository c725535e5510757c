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


class _Laps:
    """Durations of phases, each from the end of the one before."""

    def __init__(self) -> None:
        self.phases: dict[str, float] = {}
        self._at = time.perf_counter()

    def end(self, name: str) -> None:
        """End a phase."""
        now = time.perf_counter()
        self.phases[name], self._at = now - self._at, now


def main(folder: Path | None) -> None:
    """Print the table."""
    started = _Laps()
    subprocess.run([sys.executable, "-c", "import kreisel.cli.main, kreisel.calibration.calibrate"], check=True)
    started.end("start Python, imports")
    with tempfile.TemporaryDirectory() as scratch:
        measured, unit = _calibrated(folder or _simulated(Path(scratch)), Path(scratch))
    phases = started.phases | measured
    total = sum(phases.values())
    for name, seconds in phases.items():
        print(f"{name:28s} {seconds:7.3f} s {100 * seconds / total:5.1f} %")
    print(f"{'sum':28s} {total:7.3f} s; one strapdown pass {unit * 1e3:.2f} ms")


def _simulated(scratch: Path) -> Path:
    """Return the folder of a recording of ten minutes at 400 Hz."""
    from kreisel.formats.write import write
    from kreisel.simulation.cell import simulate
    from kreisel.simulation.cell_settings import Cell

    folder = scratch / "recording"
    write(simulate(Cell.model_validate({"seed": 3, "imu": {"rate": 400.0}}), folder)[1], folder)
    return folder


def _calibrated(folder: Path, scratch: Path) -> tuple[dict[str, float], float]:
    """Return the duration of each phase of a calibration, and of a strapdown pass over the same samples, s."""
    from kreisel.calibration.assembly import Assessment, assemble
    from kreisel.calibration.cross_validation import cross_validate
    from kreisel.calibration.evidence import Evidence
    from kreisel.calibration.inflation import with_unestimated_errors
    from kreisel.calibration.latitude_check import check_latitude
    from kreisel.calibration.outcome import Outcome
    from kreisel.calibration.split_halves import halves_disagreement, split_halves
    from kreisel.calibration.verdict import consistency, judge
    from kreisel.cli.threads import in_threads
    from kreisel.formats.loading import load
    from kreisel.kalman.sigma_point_filter import SigmaPointFilter
    from kreisel.model.calibration_settings import CalibrationSettings
    from kreisel.preparation.build_problem import build_problem
    from kreisel.preparation.prepare import prepare_recording
    from kreisel.refinement.iteration import StatedFigures, estimate
    from kreisel.refinement.observability import observability
    from kreisel.report.report_page import write_report

    laps = _Laps()
    recording = load(folder)
    laps.end("read and check")
    settings = CalibrationSettings()
    preparation = prepare_recording(recording, settings)
    laps.end("synchronise, start values")
    problem = build_problem(preparation, settings)
    laps.end("build the problem")
    found = with_unestimated_errors(estimate(problem, StatedFigures(reference=True, imu=True), SigmaPointFilter()))
    laps.end(f"filter, {found.passes} pass(es)")
    halves = split_halves(found, executor=in_threads)
    latitude, cross = in_threads([lambda: check_latitude(found), lambda: cross_validate(found)])
    laps.end("halves, latitude, validation")
    more = halves_disagreement(found, halves)
    found = found.adding(more.contributions, more.warnings)
    seen, facts = observability(found.problem, found.deviation), consistency(found, preparation.correlation)
    verdict = judge(found, Evidence(seen, facts, halves, latitude))
    calibration = assemble(recording, found, Assessment(seen, facts, verdict, 0.0), found.warnings)
    laps.end("judge, assemble")
    calibration.write(scratch)
    laps.end("write the result")
    outcome = Outcome(
        recording, preparation, found.problem, found, seen, facts, halves, verdict, found.warnings, calibration, cross
    )
    write_report(outcome, scratch / "report.html")
    laps.end("report")
    imu = recording.imu
    return laps.phases, yardstick.seconds(imu.rates, imu.accelerations, imu.interval)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
