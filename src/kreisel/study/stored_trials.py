"""Trials on disk: a stored trial is not run again, and none counts twice."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.errors import SettingsError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.simulation.cell_settings import Cell
from kreisel.study.trial import Trial

_FACTS = ("trial", "nees", "nis_path", "nis_standstill", "accepted", "seconds", "failure")


class Results:
    """A folder of trials: `study.json`, `trials.csv` (a row each), `parameters.csv` (a row for each parameter).

    A trial counts if its row in `trials.csv` is complete; this row is written last. Incomplete trials of a
    killed study are removed when it is resumed.
    """

    def __init__(self, folder: Path, cell: Cell, settings: CalibrationSettings) -> None:
        """Open the folder; raise SettingsError where it holds another study."""
        self._folder = folder
        described = {"cell": cell.model_dump(mode="json"), "settings": _plain(asdict(settings))}
        begin_folder(folder, described, "a study of another cell or other settings")
        self._trials = _whole(folder / "trials.csv")
        self._rewrite()

    @property
    def done(self) -> frozenset[int]:
        """Numbers of the trials that need not be run."""
        return frozenset(self._trials)

    def add(self, trial: Trial) -> None:
        """Write a trial, unless it is stored already."""
        if trial.number in self._trials:
            return
        with (self._folder / "parameters.csv").open("a", encoding="utf-8", newline="") as file:
            rows = zip(trial.names, trial.error.tolist(), trial.deviation.tolist(), strict=True)
            csv.writer(file).writerows([trial.number, name, repr(e), repr(sd)] for name, e, sd in rows)
        facts = [
            trial.number, repr(trial.nees), repr(trial.nis_path), repr(trial.nis_standstill),
            int(trial.accepted), f"{trial.seconds:.3f}", trial.failure,
        ]  # fmt: skip
        with (self._folder / "trials.csv").open("a", encoding="utf-8", newline="") as file:
            csv.writer(file).writerow(facts)
        self._trials[trial.number] = dict(zip(_FACTS, map(str, facts), strict=True))

    def trials(self) -> list[Trial]:
        """Return all trials, by number."""
        rows: dict[int, list[tuple[str, float, float]]] = {}
        with (self._folder / "parameters.csv").open(encoding="utf-8", newline="") as file:
            for trial, name, error, deviation in list(csv.reader(file))[1:]:
                rows.setdefault(int(trial), []).append((name, float(error), float(deviation)))
        out = []
        for number, facts in sorted(self._trials.items()):
            own = rows.get(number, [])
            out.append(
                Trial(
                    number,
                    tuple(name for name, _, _ in own),
                    np.array([error for _, error, _ in own]),
                    np.array([deviation for _, _, deviation in own]),
                    float(facts["nees"]),
                    float(facts["nis_path"]),
                    float(facts["nis_standstill"]),
                    facts["accepted"] == "1",
                    float(facts["seconds"]),
                    facts["failure"],
                )
            )
        return out

    def _rewrite(self) -> None:
        """Remove the incomplete trials of a killed study."""
        file = self._folder / "parameters.csv"
        kept: list[list[str]] = []
        if file.is_file():
            with file.open(encoding="utf-8", newline="") as stream:
                kept = [row for row in csv.reader(stream) if len(row) == 4 and row[0].isdigit()]
            kept = [row for row in kept if int(row[0]) in self._trials]
        _write(file, ["trial", "parameter", "error", "standard_deviation"], kept)
        _write(self._folder / "trials.csv", list(_FACTS), [list(facts.values()) for facts in self._trials.values()])


def _whole(file: Path) -> dict[int, dict[str, str]]:
    """Return the complete rows of a table of trials, by number."""
    rows = [row for row in whole_rows(file, len(_FACTS)) if row[0].isdigit()]
    return {int(row[0]): dict(zip(_FACTS, row, strict=True)) for row in rows}


def begin_folder(folder: Path, described: dict[str, Any], other: str) -> None:
    """Make the folder of a study, or see that it is the same: study.json says which.

    Raises
    ------
    SettingsError
        If it holds another study; `other` says of what.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "study.json"
    if file.is_file() and json.loads(file.read_text(encoding="utf-8")) != described:
        raise SettingsError(f"{folder}: holds {other}; give another -o")
    file.write_text(json.dumps(described, indent=1), encoding="utf-8")


def whole_rows(file: Path, columns: int) -> list[list[str]]:
    """Return the complete rows of a CSV file, header included: a study that was killed may leave one that is not."""
    if not file.is_file():
        return []
    text = file.read_text(encoding="utf-8")
    return [row for row in csv.reader(text[: text.rfind("\n") + 1].splitlines()) if len(row) == columns]


def _write(file: Path, header: list[str], rows: list[list[str]]) -> None:
    with file.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream).writerows([header, *rows])


def _plain(settings: dict[str, Any]) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in settings.items()}
