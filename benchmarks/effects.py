"""What each effect costs where there is none: ``python -m benchmarks.effects -o docs/data/effects.csv``.

A device without any effect, 150 s of the virtual cell with joint angles. One pass with the effect in the state is
compared with one without it: states, duration, and by how much the deviations of other groups grow. This is the price
of estimating an effect always; a calibration estimates it only if the data show it.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

from kreisel.fitting.fit import Fit
from kreisel.fitting.stored_state import first_belief
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.calibration_settings import BY_CHOICE, CalibrationSettings
from kreisel.model.problem import Problem, with_groups
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.prepare import prepare_recording
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.validation.checks import check_streams

OTHERS = ("gyro_cross_coupling", "gyro_offset", "accel_cross_coupling", "accel_offset", "lever_arms")
POLYNOMIALS = ("gyro_polynomial", "accel_polynomial")
REPEATS = 5


def _problem() -> Problem:
    cell = Cell.model_validate({"seed": 1, "seconds": 150.0, "imu": {"temperature_rise": 10.0}})
    _, recording = simulate(cell, Path("effects"))
    settings = CalibrationSettings()
    return build_problem(prepare_recording(check_streams(recording), settings), settings)


def _with(problem: Problem, run: Fit, groups: tuple[str, ...]) -> tuple[Problem, Fit]:
    larger = with_groups(problem, groups)
    parameters = run.parameters.with_order(larger.settings.polynomial_order)
    belief = first_belief(larger, parameters, larger.prior.covariance)
    return larger, replace(run, parameters=parameters, belief=belief)


def _timed(problem: Problem, run: Fit) -> tuple[float, Fit]:
    seconds = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        found = KalmanFilter().refit(problem, run)
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds)), found


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, help="a CSV file; printed if not given")
    arguments = parser.parse_args()
    problem = _problem()
    first = KalmanFilter().fit(problem)
    usual, base = _timed(
        problem, replace(first, belief=first_belief(problem, first.parameters, problem.prior.covariance))
    )
    print(f"without: {problem.layout.degrees} states, {1e3 * usual:.0f} ms", file=sys.stderr)
    opened = arguments.output.open("w", encoding="utf-8", newline="") if arguments.output else nullcontext(sys.stdout)
    with opened as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["error term", "states", "time of a pass", *OTHERS])
        for group in (*BY_CHOICE, *POLYNOMIALS):
            larger, begun = _with(problem, first, (group,))
            added = larger.layout.degrees - problem.layout.degrees
            seconds, found = _timed(larger, begun)
            ratios = [
                np.median(found.belief.standard_deviation[larger.layout[g]])
                / np.median(base.belief.standard_deviation[problem.layout[g]])
                for g in OTHERS
            ]
            growth = [f"{ratio - 1.0:+.1%}" for ratio in ratios]
            table.writerow([group, f"+{added}", f"{seconds / usual - 1.0:+.0%}", *growth])


if __name__ == "__main__":
    main()
