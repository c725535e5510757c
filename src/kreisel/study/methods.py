"""Estimators side by side in the virtual cell: how far from the truth they may start, what their deviations are worth.

Every run is a recording, calibrated by each estimator from first values that are wrong by a known amount. Only the
usual parameters are estimated, and nothing is judged: what is compared is the estimators alone.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.calibration.calibrate import ESTIMATORS
from kreisel.errors import KreiselError
from kreisel.fitting.fit import Estimator, Fit
from kreisel.fitting.stored_state import stored_state
from kreisel.geometry.rotation import exp, matrix
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.prepare import prepare_recording
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.situations import BASES
from kreisel.study.stored_trials import begin_folder, whole_rows
from kreisel.study.truth import judged, true_parameters
from kreisel.units import DEG
from kreisel.validation.checks import check_streams

METHODS = tuple(name for name in ESTIMATORS if name != "cdkf")
"""Estimators that are compared: `cdkf` is `spkf` under another name."""

DEVICES, REFERENCES = ("consumer-mems", "fog-mems", "ring-laser"), ("joints", "mocap")
FIRST_ERRORS = ((1.0, 0.005), (10.0, 0.05))
"""Deviations of the first mounts (deg) and scale factors, from the true ones."""

MOTIONS = {"rich": 1.0, "weak": 0.1}
"""Shares of the joints' ranges that the motion uses."""

MAX_PASSES, SETTLED = 8, 0.2
"""Passes after which a run ends, and change of every parameter, in deviations, below which it ends before."""

LOST = 10.0
"""Rms of error over deviation from which a run counts as failed. Chosen: no estimate that is near the truth has it."""

_SEEDS = 10_000
"""Numbers of runs: place of the cell times this, plus the seed."""


@dataclass(frozen=True)
class MethodRow:
    """One recording by one estimator.

    Attributes
    ----------
    device, reference, first, motion
        The cell: grade, basic cell, first errors in deg and percent, and motion.
    method, seed
        The estimator, and the run.
    worst, ratio
        Largest and rms error over deviation; nan where it failed.
    passes, seconds
        Passes or iterations' fits until nothing moved, and what they took.
    failure
        Why there is no result; empty where there is.
    """

    device: str
    reference: str
    first: str
    motion: str
    method: str
    seed: int
    worst: float
    ratio: float
    passes: int
    seconds: float
    failure: str = ""

    @property
    def failed(self) -> bool:
        """Whether the estimator ended elsewhere than at the truth."""
        return bool(self.failure) or not self.ratio < LOST


CELLS = tuple(product(DEVICES, REFERENCES, FIRST_ERRORS, MOTIONS))


def numbers(seeds: int) -> list[int]:
    """Return the numbers of all runs, seed by seed."""
    return [place * _SEEDS + seed for seed in range(1, seeds + 1) for place in range(len(CELLS))]


def run_numbered(seconds: float, number: int) -> tuple[MethodRow, ...]:
    """Return a row for each estimator; they depend on the number alone, but for the time."""
    place, seed = divmod(number, _SEEDS)
    device, reference, (angle, share), motion = CELLS[place]
    content: dict[str, Any] = {table: dict(values) for table, values in BASES[reference].items()}
    content["imu"] = {"grade": device, "gyro_g_sensitivity_sd": 0.0, "gyro_g_squared_sd": 0.0}
    content["motion"] = {"range_share": MOTIONS[motion]}
    cell = Cell.model_validate({**content, "seed": seed, "seconds": seconds})
    truth, recording = simulate(cell, Path(f"{device}-{reference}-{motion}-{seed}"))
    recording = check_streams(recording)
    settings = CalibrationSettings()
    problem = build_problem(prepare_recording(recording, settings), settings)
    first = wrong_by(problem, angle * DEG, share, np.random.default_rng((seed, place)))
    which, _ = judged(problem)
    rows = []
    for name in METHODS:
        known = (device, reference, f"{angle:g} deg, {100.0 * share:g} %", motion, name, seed)
        began = time.perf_counter()
        try:
            fit, passes = settled(first, ESTIMATORS[name])
        except KreiselError as failed:
            rows.append(MethodRow(*known, np.nan, np.nan, 0, time.perf_counter() - began, str(failed)))
            continue
        seconds_taken = time.perf_counter() - began
        true = true_parameters(truth, recording, problem, fit.parameters)
        error = problem.layout.minus(fit.belief.mean[:, None], stored_state(problem, true))[which, 0]
        score = error / fit.belief.standard_deviation[which]
        worst, ratio = float(np.abs(score).max()), float(np.sqrt(np.mean(score**2)))
        rows.append(MethodRow(*known, worst, ratio, passes, seconds_taken))
    return tuple(rows)


def wrong_by(problem: Problem, angle: float, share: float, rng: np.random.Generator) -> Problem:
    """Return the problem whose first matrices are wrong by a rotation and scale factors, and say so.

    angle, share: deviations of each component of the rotation vector, rad, and of each scale factor.
    """
    prior, sensors = problem.prior, problem.prior.start.sensors
    turn = matrix(exp(angle * rng.normal(size=3)))
    moved = {
        name: turn @ getattr(sensors, name) @ np.diag(1.0 + share * rng.normal(size=3)) for name in ("K_omega", "K_a")
    }
    start: CellParameters = replace(prior.start, sensors=replace(sensors, **moved))
    wide = (angle**2 + share**2) * np.eye(9)
    own = {g: wide for g in ("gyro_cross_coupling", "accel_cross_coupling") if g in problem.layout}
    return replace(problem, prior=replace(prior, start=start, start_covariance=prior.start_covariance | own))


def settled(problem: Problem, estimator: Estimator) -> tuple[Fit, int]:
    """Return the fit of a problem after so many passes that nothing moves, and their number."""
    fit = estimator.fit(problem, gate=100.0)
    n = len(problem.parameter_names)
    for count in range(1, MAX_PASSES):
        again = estimator.refit(problem, fit, gate=100.0)
        moved = problem.layout.minus(again.belief.mean[:, None], fit.belief.mean)[:n, 0]
        fit = again
        if np.all(np.abs(moved) < SETTLED * fit.belief.standard_deviation[:n]):
            return fit, count + 1
    return fit, MAX_PASSES


# Results on disk


_HEADER = [known.name for known in fields(MethodRow)]


class MethodFile:
    """Rows in a CSV file as they come; what is there need not be run again."""

    def __init__(self, folder: Path, seconds: float) -> None:
        """Open the folder; raise SettingsError where it holds another study."""
        begin_folder(folder, {"study": "methods", "seconds": seconds}, "another study, or recordings of another length")
        self._file = folder / "methods.csv"
        self._rows = [_from_text(row) for row in whole_rows(self._file, len(_HEADER))[1:]]
        counts: dict[int, int] = {}
        for row in self._rows:
            counts[_number_of(row)] = counts.get(_number_of(row), 0) + 1
        self._rows = [row for row in self._rows if counts[_number_of(row)] == len(METHODS)]  # whole runs only
        with self._file.open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream).writerows([_HEADER, *map(_to_text, self._rows)])

    def missing(self, wanted: Iterable[int]) -> list[int]:
        """Return the numbers of runs that are not there yet."""
        done = {_number_of(row) for row in self._rows}
        return [number for number in wanted if number not in done]

    def add(self, rows: tuple[MethodRow, ...]) -> None:
        """Write the rows of a run."""
        with self._file.open("a", encoding="utf-8", newline="") as stream:
            csv.writer(stream).writerows(map(_to_text, rows))
        self._rows += rows

    def rows(self) -> list[MethodRow]:
        """Return all rows, cell by cell."""
        return sorted(self._rows, key=lambda row: (_number_of(row), METHODS.index(row.method)))


def _number_of(row: MethodRow) -> int:
    places = [(device, reference, f"{a:g} deg, {100.0 * s:g} %", m) for device, reference, (a, s), m in CELLS]
    return places.index((row.device, row.reference, row.first, row.motion)) * _SEEDS + row.seed


def _to_text(row: MethodRow) -> list[str]:
    return [str(getattr(row, name)) for name in _HEADER]


def _from_text(line: Sequence[str]) -> MethodRow:
    values: dict[str, Any] = dict(zip(_HEADER, line, strict=True))
    values |= {key: float(values[key]) for key in ("worst", "ratio", "seconds")}
    values |= {key: int(values[key]) for key in ("seed", "passes")}
    return MethodRow(**values)


# What many runs say


@dataclass(frozen=True)
class MethodSummary:
    """One estimator in some cells: runs and failures; of the others rms ratio, largest error, passes and seconds."""

    method: str
    runs: int
    failed: int
    ratio: float
    worst: float
    passes: float
    seconds: float


def summaries(rows: Sequence[MethodRow]) -> list[MethodSummary]:
    """Return the summary of each estimator."""
    return [_summary(name, [row for row in rows if row.method == name]) for name in METHODS]


def _summary(name: str, rows: Sequence[MethodRow]) -> MethodSummary:
    good = [row for row in rows if not row.failed]
    nothing = float("nan")
    return MethodSummary(
        name,
        len(rows),
        len(rows) - len(good),
        float(np.sqrt(np.mean([row.ratio**2 for row in good]))) if good else nothing,
        max((row.worst for row in good), default=nothing),
        float(np.mean([row.passes for row in good])) if good else nothing,
        float(np.median([row.seconds for row in good])) if good else nothing,
    )


COLUMNS = ("cell", "estimator", "runs", "failed", "error / sd", "largest", "passes", "s")


def table(rows: Sequence[MethodRow]) -> list[list[str]]:
    """Return the table of estimators in all cells, then in each."""
    out = [["all", *_cells(one)] for one in summaries(rows)]
    for key in dict.fromkeys((row.device, row.reference, row.first, row.motion) for row in rows):
        own = [row for row in rows if (row.device, row.reference, row.first, row.motion) == key]
        out += [[", ".join(key), *_cells(one)] for one in summaries(own)]
    return out


def _cells(one: MethodSummary) -> list[str]:
    numbers = (f"{one.ratio:.2f}", f"{one.worst:.1f}", f"{one.passes:.1f}", f"{one.seconds:.2f}")
    return [one.method, str(one.runs), str(one.failed), *numbers]
