"""Rows of a study of estimators: which cells, what is kept of a run, and what many runs say."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.model.calibration_settings import ESTIMATORS
from kreisel.study.stored_trials import begin_folder, whole_rows

METHODS = tuple(name for name in ESTIMATORS if name != "cdkf")
"""Estimators that may be compared: `cdkf` is `spkf` under another name."""

DEVICES, REFERENCES = ("consumer-mems", "fog-mems", "ring-laser"), ("joints", "mocap")
FIRST_ERRORS = ((1.0, 0.005), (10.0, 0.05))
"""Deviations of the first mounts (deg) and scale factors, from the true ones."""

MOTIONS = {"rich": 1.0, "weak": 0.1}
"""Shares of the joints' ranges that the motion uses."""

LOST = 10.0
"""Rms of error over deviation from which a run counts as failed. Chosen: no estimate that is near the truth has it."""

SEEDS = 10_000
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
    def cell(self) -> tuple[str, str, str, str]:
        """Device, reference, first errors and motion."""
        return self.device, self.reference, self.first, self.motion

    @property
    def failed(self) -> bool:
        """Whether the estimator ended elsewhere than at the truth."""
        return bool(self.failure) or not self.ratio < LOST


CELLS = tuple(product(DEVICES, REFERENCES, FIRST_ERRORS, MOTIONS))


def words_of(first: tuple[float, float]) -> str:
    """Return what rows call first errors (deg, and share of the scale factors)."""
    return f"{first[0]:g} deg, {100.0 * first[1]:g} %"


def numbers(seeds: int) -> list[int]:
    """Return the numbers of all runs, seed by seed."""
    return [place * SEEDS + seed for seed in range(1, seeds + 1) for place in range(len(CELLS))]


# Results on disk


_HEADER = [known.name for known in fields(MethodRow)]


class MethodFile:
    """Rows in a CSV file as they come; what is there need not be run again."""

    def __init__(self, folder: Path, seconds: float, methods: Sequence[str] = METHODS) -> None:
        """Open the folder; raise SettingsError where it holds another study."""
        content = {"study": "methods", "seconds": seconds, "methods": list(methods)}
        begin_folder(folder, content, "another study, other estimators, or recordings of another length")
        self._file = folder / "methods.csv"
        self._rows = [_from_text(row) for row in whole_rows(self._file, len(_HEADER))[1:]]
        counts: dict[int, int] = {}
        for row in self._rows:
            counts[_number_of(row)] = counts.get(_number_of(row), 0) + 1
        self._rows = [row for row in self._rows if counts[_number_of(row)] == len(methods)]  # whole runs only
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
    places = [(device, reference, words_of(first), motion) for device, reference, first, motion in CELLS]
    return places.index(row.cell) * SEEDS + row.seed


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
    return [_summary(name, own) for name in METHODS if (own := [row for row in rows if row.method == name])]


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
    for key in dict.fromkeys(row.cell for row in rows):
        own = [row for row in rows if row.cell == key]
        out += [[", ".join(key), *_cells(one)] for one in summaries(own)]
    return out


def _cells(one: MethodSummary) -> list[str]:
    numbers = (f"{one.ratio:.2f}", f"{one.worst:.1f}", f"{one.passes:.1f}", f"{one.seconds:.2f}")
    return [one.method, str(one.runs), str(one.failed), *numbers]
