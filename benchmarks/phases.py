"""Where the time of ``kreisel calibrate`` goes: ``python -m benchmarks.phases [RECORDING]``.

Without a recording, ten minutes at 400 Hz of the virtual cell are made and read back from CSV. Phases are timed
as the command runs them, in threads where it uses them; indented are the steps that a calibration reports.
"""

from __future__ import annotations

import os
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
    with tempfile.TemporaryDirectory() as scratch:
        started = _started(Path(scratch))
        measured, unit = _calibrated(folder or _simulated(Path(scratch)), Path(scratch))
    phases = started | measured
    total = sum(seconds for name, seconds in phases.items() if not name.startswith(" "))
    for name, seconds in phases.items():
        print(f"{name:28s} {seconds:7.3f} s {100 * seconds / total:5.1f} % {seconds / unit:6.0f} passes")
    print(f"{'sum':28s} {total:7.3f} s; {total / unit:.0f} strapdown passes of {unit * 1e3:.2f} ms")


def _started(scratch: Path) -> dict[str, float]:
    """Return the duration of a start from bytecode, which an installed package has."""
    kept = {**os.environ, "PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(scratch / "bytecode")}
    for _ in range(2):
        laps = _Laps()
        imports = (
            "from kreisel.cli.main import prepare_process as p; p(); import kreisel.calibration.calibrate; "
            "import gc; gc.freeze()"  # as the command ends
        )
        subprocess.run([sys.executable, "-c", imports], check=True, env=kept)
        laps.end("start Python, imports")
    return laps.phases


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
    from kreisel.calibration.calibrate import run_calibration
    from kreisel.cli.main import prepare_process
    from kreisel.cli.threads import in_threads
    from kreisel.formats.loading import load
    from kreisel.model.calibration_settings import CalibrationSettings
    from kreisel.report.report_page import write_report

    prepare_process()
    laps = _Laps()
    recording = load(folder, executor=in_threads)
    laps.end("read and check")
    steps = _Steps()
    outcome = run_calibration(recording, CalibrationSettings(), steps, executor=in_threads, validate=True, budget=True)
    laps.end("calibrate")
    outcome.calibration.write(scratch)
    laps.end("write the result")
    write_report(outcome, scratch / "report.html")
    laps.end("report")
    phases = dict(laps.phases)
    phases |= {f"  {name}": seconds for name, seconds in steps.ended().items()}
    imu = recording.imu
    return phases, yardstick.seconds(imu.rates, imu.accelerations, imu.interval)


class _Steps:
    """Durations of the steps that a calibration reports, each until the next is reported."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._at, self._step = time.perf_counter(), "start"

    def __call__(self, step: str, _share: float) -> None:
        """Note the progress of a step; those by threads are reported by whichever is last."""
        now = time.perf_counter()
        self._seconds[self._step] = self._seconds.get(self._step, 0.0) + now - self._at
        self._at, self._step = now, step

    def ended(self) -> dict[str, float]:
        """Return the durations of all steps."""
        self(self._step, 1.0)
        return self._seconds


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
