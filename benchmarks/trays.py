"""Cost and memory of trays against the number of units: ``python -m benchmarks.trays [--units 4 16 64]``.

Each tray is simulated, written to a folder and calibrated by the command, in a process of its own; one unit of the
first tray is calibrated alone for comparison. Processor time, for the machine may be shared.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

CELL = """seconds = {seconds}

[imu]
grade = "industrial-mems"

[tray]
units = {units}
clock_offset = 1.0
clock_drift_ppm = 20.0
"""


def run(*arguments: str) -> tuple[float, float]:
    """Run the command and return its processor time, s, and its largest memory, GB; 3 is a rejected unit."""
    process = subprocess.Popen([sys.executable, "-m", "kreisel.cli.main", *arguments], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 3):
        raise SystemExit(f"kreisel {' '.join(arguments)}: exit status {process.returncode}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e6


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, nargs="+", default=[4, 16, 64])
    parser.add_argument("--seconds", type=float, default=600.0)
    given = parser.parse_args()
    counts: list[int] = []
    seconds: list[float] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for units in given.units:
            (folder / "cell.toml").write_text(CELL.format(seconds=given.seconds, units=units))
            tray = str(folder / f"tray{units}")
            run("simulate", str(folder / "cell.toml"), "-o", tray)
            if not counts:
                counts, seconds = [1], [_printed(1, run("calibrate", tray, "--imu", "imu0", "-o", f"{folder}/alone"))]
            counts.append(units)
            seconds.append(_printed(units, run("calibrate", tray, "-o", f"{folder}/out{units}"), seconds[0]))
            shutil.rmtree(tray)
    for first in range(len(counts) - 1):
        growth = np.polyfit(np.log(counts[first:]), np.log(seconds[first:]), 1)[0]
        print(f"exponent of the number of units, from {counts[first]} on: {growth:.2f}")


def _printed(units: int, cost: tuple[float, float], alone: float | None = None) -> float:
    ratio = "" if alone is None else f", {cost[0] / alone:5.2f} times one"
    print(f"{units:3d} units: {cost[0]:7.1f} s of processor time{ratio}, {cost[1]:.2f} GB", flush=True)
    return cost[0]


if __name__ == "__main__":
    main()
