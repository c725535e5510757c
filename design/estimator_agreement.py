"""Table in docs/explanation/method.md: how far `batch` lies from `spkf`, and which is nearer the truth.

Clean cells, and motion of which vibration is a large part: there the noise of the readings pulls at the matrices, and
the most likely states of all updates together pull otherwise than those of a filter.

Run: python design/estimator_agreement.py --seeds 5 -o docs/data/agreement.csv
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kreisel.calibration.calibrate import ESTIMATORS, run_calibration
from kreisel.calibration.outcome import Outcome
from kreisel.errors import KreiselError
from kreisel.fitting.fit import Estimator, Fit
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.problem import Problem
from kreisel.refinement.attenuation import pull_of_noise, without_attenuation
from kreisel.simulation.cell import Truth, simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.robustness import worst_error
from kreisel.study.situations import situations
from kreisel.validation.checks import check_streams

HEADER = (
    "motion", "runs", "accepted", "pull of noise / sd", "largest difference / sd", "largest difference of deviations",
    "error / sd, spkf", "error / sd, batch",
)  # fmt: skip
SHAKEN = ("propellers", "gentle flight")
SECONDS = 120.0

SETTLED, MOST = 0.005, 12
"""Change of every parameter by a fit, in deviations, at which it has settled, and the largest number of fits. Chosen:
far below the differences that are looked for."""

SMALL = {
    "imu": {"grade": "consumer-mems"},
    "reference": {"kind": "mocap", "interval": 0.01},
    "errors": {"path_position_sd": 3e-4, "path_orientation_sd": 5e-4, "path_correlation_time": 0.0},
    "stated": {"place": False},
    "seconds": 150.0,
}  # fmt: skip


class Compared(NamedTuple):
    """One recording: whether it is accepted, and the numbers of a row of the table."""

    accepted: bool
    pull: float
    difference: float
    spread: float
    spkf: float
    batch: float


def main() -> None:
    """Simulate, fit, compare, write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="recordings of each cell")
    parser.add_argument("--only", default="", metavar="TEXT", help="cells with this in their names")
    parser.add_argument("-o", "--output", type=Path, required=True, help="a CSV file")
    arguments = parser.parse_args()
    found: dict[str, list[Compared]] = defaultdict(list)
    for seed in range(1, arguments.seeds + 1):
        for name, content in cells():
            if arguments.only not in name or (one := compared(Cell.model_validate({**content, "seed": seed}))) is None:
                continue
            found[name].append(one)
            print(f"{name}, seed {seed}:", *(f"{value:.3g}" for value in one), file=sys.stderr)
    with arguments.output.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([HEADER, *(row(name, own) for name, own in found.items())])


def cells() -> Iterator[tuple[str, dict[str, object]]]:
    """Yield the cells, with the name of the row they count in."""
    for situation in situations(SECONDS):
        if situation.name == "clean":
            yield f"clean, {situation.basis}", dict(situation.cell)
        elif situation.name in SHAKEN:
            yield f"{situation.name}, {situation.size}", dict(situation.cell)
    for share in (0.05, 0.01):
        yield f"{share:.0%} of the usual motion", {**SMALL, "motion": {"range_share": share}}


def compared(cell: Cell) -> Compared | None:
    """Return the comparison of one recording; None where it is refused, or a fit fails."""
    try:
        truth, recording = simulate(cell, Path("agreement"))
        outcome = run_calibration(check_streams(recording), CalibrationSettings())
        problem, near = outcome.estimate.problem, outcome.estimate.run
        spkf, batch = (settled(ESTIMATORS[name], problem, near) for name in ("spkf", "batch"))
    except KreiselError as error:
        print(f"left out: {error}", file=sys.stderr)
        return None
    layout, sd = problem.layout, batch[0].belief.standard_deviation
    own = problem.lasting
    difference = layout.minus(spkf[0].belief.mean[:, None], batch[0].belief.mean)[own, 0] / sd[own]
    return Compared(
        outcome.calibration.accepted,
        max(spkf[1], batch[1]),
        float(np.abs(difference).max()),
        float(np.abs(spkf[0].belief.standard_deviation[own] / sd[own] - 1.0).max()),
        *(error_of(outcome, truth, fit) for fit, _ in (spkf, batch)),
    )


def settled(estimator: Estimator, problem: Problem, near: Fit) -> tuple[Fit, float]:
    """Return the fit of an estimator that does not move any more, without attenuation, and how far that moved it."""
    layout, own = problem.layout, problem.lasting
    for _ in range(MOST):
        fit = estimator.refit(problem, near)
        sd = fit.belief.standard_deviation[own]
        moved = np.abs(layout.minus(fit.belief.mean[:, None], near.belief.mean)[own, 0] / sd).max()
        near = fit
        if moved < SETTLED:
            break
    change = pull_of_noise(problem, near, estimator)
    if change is None:
        return near, 0.0
    pull = np.abs(change / near.belief.standard_deviation[: change.size])
    return without_attenuation(problem, near, change)[0], float(pull[own].max())


def error_of(outcome: Outcome, truth: Truth, fit: Fit) -> float:
    """Return the root mean square of a fit's errors over the result's deviations."""
    return worst_error(
        replace(outcome, calibration=replace(outcome.calibration, sensors=fit.parameters.sensors)), truth
    )[2]


def row(name: str, found: list[Compared]) -> list[str]:
    """Return a row of the table."""
    spkf, batch = (float(np.sqrt(np.mean(np.square([getattr(one, of) for one in found])))) for of in ("spkf", "batch"))
    return [
        name,
        str(len(found)),
        str(sum(one.accepted for one in found)),
        f"{np.median([one.pull for one in found]):.2f}",
        f"{max(one.difference for one in found):.2f}",
        f"{max(one.spread for one in found):.1%}",
        f"{spkf:.2f}",
        f"{batch:.2f}",
    ]


if __name__ == "__main__":
    main()
