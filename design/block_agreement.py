"""Table in docs/explanation/method.md: what blocks of a linearised fit say, against fits made again.

For each cell the first half of the blocks, and more of them up to all but one, are fitted by themselves. The scatter of
blocks, by which the covariance of a wrong model is formed, is compared with fits without each of them. Offsets are
constant, noise is white and navigation begins anew with each block there, for a fit without a block also loses what the
block says of those after it. The likelihood of all innovations is compared without and with an effect in the state.

Run: python design/block_agreement.py -o docs/data/blocks.csv
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.lack_of_fit import scatter
from kreisel.fitting.blocks import Blocks
from kreisel.fitting.fit import Fit
from kreisel.fitting.stored_state import first_belief
from kreisel.geometry.rotation import Array
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.kalman.linear_run import LinearRun
from kreisel.model.assumed_noise import PoseError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.layout import with_coloured_noise
from kreisel.model.parameters import PASSING_GROUPS
from kreisel.model.problem import Problem, part_of, with_groups, without_groups
from kreisel.refinement.effect_selection import Survey, survey
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.situations import BASES
from kreisel.validation.checks import check_streams

HEADER = (
    "cell", "blocks", "first blocks / sd", "their deviations", "scatter of blocks", "evidence", "difference",
)  # fmt: skip

CELLS = tuple(product(("joints", "poses", "mocap"), ("consumer-mems", "fog-mems", "fog")))

ESTIMATOR = KalmanFilter()

EFFECTS = ("gyro_asymmetry", "accel_asymmetry", "accel_delay", "gyro_polynomial", "gyro_g_sensitivity")


def main() -> None:
    """Simulate, fit, leave out, compare, write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, required=True, help="a CSV file")
    arguments = parser.parse_args()
    rows = []
    for name, content, settings in cells():
        rows.append([name, *row_of(Cell.model_validate({**content, "seed": arguments.seed}), settings)])
        print(*rows[-1], sep=", ", file=sys.stderr)
    with arguments.output.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([HEADER, *rows])


def cells() -> Iterator[tuple[str, dict[str, Any], CalibrationSettings]]:
    """Yield name and content of each cell, and how it is calibrated: in the last one an effect is left out."""
    for basis, grade in CELLS:
        content = {name: dict(table) for name, table in BASES[basis].items()}
        content["imu"] = {**content.get("imu", {}), "grade": grade}
        yield f"{basis}, {grade}", {**content, "seconds": 120.0}, CalibrationSettings()
    bent = {name: dict(table) for name, table in BASES["joints"].items()}
    bent["imu"] = {**bent.get("imu", {}), "gyro_asymmetry_sd": 4e-4}
    yield "joints, gyros with asymmetry", {**bent, "seconds": 120.0}, CalibrationSettings(passes=2)


def row_of(cell: Cell, settings: CalibrationSettings) -> list[str]:
    """Return the numbers of one cell as text."""
    _, recording = simulate(cell, Path("cell"))
    outcome = run_calibration(check_streams(recording), settings)
    problem = replace(outcome.problem, settings=CalibrationSettings())
    linear, said, P = linearised(problem, outcome.estimate.run)
    near = linear.near
    sensors = np.flatnonzero(said.parameters < problem.sensor_degrees)
    begun = np.linalg.inv(P) - said.information.sum(axis=0)
    far, wider = [], []
    for k in range(len(said.ends) // 2, len(said.ends)):
        distance, deviation = first_blocks(begun, said, k)
        made, own = compared(
            problem, said, ESTIMATOR.refit(part_of(problem, slice(0, int(said.ends[k - 1]))), near), near
        )
        far.append((np.abs(distance - made) / own)[sensors])
        wider.append(np.abs(deviation / own - 1.0)[sensors])
    scattered = scatters(independent(problem, said), near)
    found = survey(problem, near, lambda: linear, ESTIMATOR)
    if found is None:
        raise SystemExit("no candidates")
    said_gain, made_gain = gains(found, near)
    return [
        str(len(said.ends)),
        f"{np.max(far):.3f}",
        f"{100.0 * np.max(wider):.1f} %",
        f"{100.0 * np.max(np.abs(scattered[0] / scattered[1] - 1.0)):.1f} %",
        f"{min(said_gain):.1f} to {max(said_gain):.1f}",
        f"{np.max(np.abs(np.subtract(said_gain, made_gain))):.2f}",
    ]


def linearised(problem: Problem, near: Fit) -> tuple[LinearRun, Blocks, Array]:
    """Return a problem linearised about its fit, what blocks say, and the covariance of their parameters."""
    linear = ESTIMATOR.linearise(problem, ESTIMATOR.refit(problem, near))
    blocks = linear.blocks
    if blocks is None:
        raise SystemExit("a gate left out updates of a clean cell")
    return linear, blocks, linear.near.belief.covariance[np.ix_(blocks.parameters, blocks.parameters)]


def scatters(problem: Problem, near: Fit) -> tuple[Array, Array]:
    """Return the deviations of sensors by the scatter of blocks: by their scores, and by fits without each of them."""
    linear, said, P = linearised(problem, near)
    edges = [0, *said.ends.tolist()]
    made = said.score.copy()
    for k, (begin, end) in enumerate(pairwise(edges)):
        change = compared(problem, said, ESTIMATOR.refit(without(problem, begin, end), linear.near), linear.near)[0]
        # without a block the estimate moves by -(P^-1 - I)^-1 s
        made[k] = -(np.linalg.inv(P) - said.information[k]) @ change
    sensors = said.parameters < problem.sensor_degrees
    by_scores, by_fits = (
        np.sqrt(np.sum(scatter(one, P).influence ** 2, axis=0)) for one in (said, replace(said, score=made))
    )
    return by_scores[sensors], by_fits[sensors]


def independent(problem: Problem, blocks: Blocks) -> Problem:
    """Return the problem in which nothing passes from block to block."""
    updates = list(problem.schedule.updates)
    for k in blocks.ends[:-1].tolist():
        updates[k] = updates[k].begun_anew()
    steady = without_groups(problem, tuple(group for group in PASSING_GROUPS if group in problem.layout))
    walks = dict.fromkeys(steady.noise.offset_walk, 0.0)
    own, reference = steady.noise.pose_error, steady.noise.reference
    reference = replace(
        reference,
        position=math.hypot(reference.position, own.position),
        orientation=math.hypot(reference.orientation, own.orientation),
        standstill_position=math.hypot(reference.standstill_position, own.position),
        standstill_orientation=math.hypot(reference.standstill_orientation, own.orientation),
    )
    noise = replace(steady.noise, offset_walk=walks, gauss_markov={}, pose_error=PoseError(), reference=reference)
    layout = with_coloured_noise(steady.layout, (False, False))
    return replace(steady, noise=noise, layout=layout, schedule=replace(steady.schedule, updates=tuple(updates)))


def without(problem: Problem, begin: int, end: int) -> Problem:
    """Return the problem without some updates: navigation begins anew after them."""
    updates, attitude = list(problem.schedule.updates), problem.schedule.attitude
    later = [update.begun_anew() if k == 0 else update for k, update in enumerate(updates[end:])]
    kept = np.r_[0:begin, end : len(updates)]
    schedule = replace(problem.schedule, updates=(*updates[:begin], *later), attitude=attitude[kept])
    return replace(problem, schedule=schedule)


def compared(problem: Problem, blocks: Blocks, fit: Fit, near: Fit) -> tuple[Array, Array]:
    """Return how far a fit lies from another in the blocks' parameters, and its deviations, (n,)."""
    far = problem.layout.minus(fit.belief.mean[:, None], near.belief.mean)[blocks.parameters, 0]
    return far, fit.belief.standard_deviation[blocks.parameters]


def first_blocks(begun: Array, blocks: Blocks, count: int) -> tuple[Array, Array]:
    """Return how far the estimate by the first blocks lies from that by all, and its deviations, (n,).

    begun: information of the prior (n, n), whose score at the estimate is minus that of all blocks.
    """
    covariance = np.linalg.inv(begun + blocks.information[:count].sum(axis=0))
    return -covariance @ blocks.score[count:].sum(axis=0), np.sqrt(np.diag(covariance))


def gains(found: Survey, near: Fit) -> tuple[list[float], list[float]]:
    """Return the evidence of each effect, by the linearised fit and by the likelihood of all innovations."""
    untempered = replace(found, temper=1.0)
    chosen = [group for group in EFFECTS if group in found.groups]
    plain = likelihood(found.before, near, ())
    return (
        [untempered.gain((group,)) for group in chosen],
        [likelihood(found.before, near, (group,)) - plain for group in chosen],
    )


def likelihood(problem: Problem, near: Fit, groups: tuple[str, ...]) -> float:
    """Return the log-likelihood of all innovations of a problem with groups in the state."""
    larger = with_groups(problem, groups)
    start = near.parameters.with_order(larger.settings.polynomial_order)
    run = run_filter(larger, start, belief=first_belief(larger, larger.prior.start), gate=np.inf)
    return float(run.history.log_likelihood.sum())


if __name__ == "__main__":
    main()
