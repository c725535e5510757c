"""Cost against duration and states, and trials a minute: ``python -m benchmarks.scaling -o FOLDER``.

Writes `scaling.html`, a plot, and prints exponents. Long recordings are ten minutes of the virtual cell over and
over. Runs without errors of the robot start at the estimates of all parameters, so that a model with fewer states
fits the data, too: a rejected update costs less than a used one. A run that rejects a tenth of them is an error.
"""

from __future__ import annotations

import argparse
import resource
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from kreisel.estimation.state import StateLayout
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.assumed_noise import PoseError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.prepare import prepare_recording
from kreisel.report import plots
from kreisel.report.plots import Figure
from kreisel.report.template import fill
from kreisel.report.thinning import Curve
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.dask import dask_map
from kreisel.study.monte_carlo import run_trial

from . import yardstick

FEWER = (
    ("gyro_cross_coupling", "accel_cross_coupling", "lever_arms"), ("lever_arms", "accel_cross_coupling"),
    ("lever_arms",), (),
)  # fmt: skip


def shortest(problem: Problem, start: CellParameters, repeats: int = 8) -> float:
    """Return the shortest time of a filter pass."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        run = run_filter(problem, start)
        times.append(time.perf_counter() - began)
        used = float(run.history.used.mean())
        if used < 0.9:
            raise SystemExit(f"{problem.layout.degrees} states: only {100.0 * used:.0f} % of the updates are used")
    return min(times)


def part(problem: Problem, minutes: float) -> Problem:
    """Return the problem's first minutes, or its updates over and over for more than there are."""
    end = problem.sensor.readings.stamps[-1]
    if minutes * 60.0 < end:
        stamps = problem.sensor.readings.stamps
        updates = tuple(u for u in problem.schedule.updates if stamps[u.last] < minutes * 60.0)
        return replace(problem, schedule=replace(problem.schedule, updates=updates))
    times = round(minutes * 60.0 / end)
    schedule = problem.schedule
    schedule = replace(schedule, updates=schedule.updates * times, attitude=np.tile(schedule.attitude, (times, 1)))
    return replace(problem, schedule=schedule)


def without_path_errors(problem: Problem) -> Problem:
    """Return the problem without coloured noise of the poses on the path."""
    layout = StateLayout([part for part in problem.layout if not part.name.startswith("path_")])
    return replace(problem, layout=layout, noise=replace(problem.noise, pose_error=PoseError()))


def trial(number: int) -> float:
    """Run one trial of a study and return its number."""
    cell = Cell.model_validate({"seed": 1, "seconds": 60.0, "imu": {"rate": 400.0}})
    run_trial(cell, CalibrationSettings(), number)
    return float(number)


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", dest="folder", type=Path, required=True)
    parser.add_argument("--trials", type=int, default=24)
    arguments = parser.parse_args()
    recording = simulate(Cell.model_validate({"seed": 3, "imu": {"rate": 400.0}}), Path("ten minutes"))[1]
    unit = yardstick.seconds(recording.imu.rates, recording.imu.accelerations, recording.imu.interval)
    alone = replace(recording, joints=None)
    settings = CalibrationSettings()
    problem = build_problem(prepare_recording(alone, settings), settings)

    start = KalmanFilter().refit(problem, KalmanFilter().fit(problem)).parameters

    minutes = np.array([1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 180.0, 600.0])
    seconds = np.array([shortest(part(problem, m), start, 2 if m > 60 else 8) for m in minutes])
    exponent = np.polyfit(np.log(minutes), np.log(seconds), 1)[0]
    for m, s in zip(minutes, seconds, strict=True):
        print(f"{m:6.0f} min {s:8.3f} s, {s / (unit * m / 10.0):6.1f} strapdown passes")
    print(f"exponent of the duration: {exponent:.2f}")

    states, multiples = [], []
    for robot, path, fixed in [*((False, True, f) for f in FEWER), (False, False, ()), (True, True, ())]:
        chosen = replace(settings, fixed=fixed)
        other = build_problem(prepare_recording(recording if robot else alone, chosen), chosen)
        other = other if path else without_path_errors(other)
        states.append(other.layout.degrees)
        multiples.append(shortest(other, other.prior.start if robot else start) / unit)
        print(f"{states[-1]:6d} states {multiples[-1]:6.1f} strapdown passes")
    states, multiples = map(list, zip(*sorted(zip(states, multiples, strict=True)), strict=True))
    growth = np.polyfit(np.log(states), np.log(multiples), 1)[0]
    print(f"exponent of the states: {growth:.2f}")

    rates = []
    for workers in (1, 2):
        ends = [time.perf_counter() for _ in dask_map(trial, range(arguments.trials), scheduler=None, workers=workers)]
        # from the first result on: starting workers is paid once
        rates.append((len(ends) - workers) / (ends[-1] - ends[workers - 1]) * 60.0)
        print(f"{workers} worker(s): {rates[-1]:.1f} trials of 60 s a minute")
    print(f"efficiency of two: {rates[1] / rates[0] / 2:.2f}")
    print(f"most memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")

    figures = [
        _figure(
            "duration", "Filter against duration", "minutes at 400 Hz", "seconds a pass", minutes, seconds, exponent
        ),
        _figure("states", "Filter against states", "states", "strapdown passes", states, multiples, growth),
    ]
    arguments.folder.mkdir(parents=True, exist_ok=True)
    page = fill("study.html", figures, title="Scaling", lead="", table_of_groups=None, facts=[], figures=figures)
    (arguments.folder / "scaling.html").write_text(page, encoding="utf-8")


def _figure(name: str, title: str, x: str, y: str, at: ArrayLike, values: ArrayLike, exponent: float) -> Figure:
    """Return a curve on logarithmic axes."""
    curve = Curve(np.asarray(at, dtype=np.float32), np.asarray(values, dtype=np.float32))
    low, high = np.log10([curve.y.min(), curve.y.max()])
    panel = plots.panel([plots.line(curve, f"exponent {exponent:.2f}", "x")], plots.logarithmic(y, low, high))
    return Figure(name, title, f"exponent {exponent:.2f}", plots.plot(plots.axis(x), panel))


if __name__ == "__main__":
    main()
