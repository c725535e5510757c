"""Many cells outside the model: whether accepted results are right, rejected ones were wrong, and causes are named.

Rules for the truth, where an effect leaves it open:

- Judged are the sensors' matrices, offsets and lever arms, by the model's own definition: omega = K (w' + k_0 + …),
  with all terms that the device has. Time offset, alignment and further terms are not judged: a low-pass of both
  sensors, or a late reference, belongs to the time offset.
- Where the result lists a parameter as not observable, or holds it, it is not judged.
- Offsets that change during the recording have the mean over it as their true value, flicker noise of the grade
  included, because that is the offset the device has in this run. Where the cell's settings let offsets drift, step,
  walk or warm up, an offset counts as wrong by the smaller of its distances from this mean and from the last value.
- An error without a name has no linear part over its recording. Of a result's further terms, less those that the
  device has, the linear part over the recording counts with offsets and matrices: it is what the two have in common.
- After a slip of the mount there are two truths, before and after it; the result counts as wrong by the smaller of its
  worst errors against either.
"""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.outcome import Outcome
from kreisel.errors import KreiselError, SettingsError
from kreisel.formats.write import write
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.simulation.cell import Truth, simulate, write_truth
from kreisel.simulation.cell_settings import Cell
from kreisel.study.linear_part import with_linear_part
from kreisel.study.situations import Situation, random_situation, situations
from kreisel.study.stored_trials import begin_folder, whole_rows
from kreisel.study.truth import further_terms
from kreisel.validation.checks import check_streams

_SEEDS = 10_000
"""More than there are seeds: a run's number is that of its situation times this, plus its seed."""

WRONG, GROSSLY_WRONG, GOOD = 4.0, 6.0, 3.0
"""Standard deviations beyond which an accepted result is wrong, and within which a rejected one was good."""

REJECTED_RIGHTLY = ("slipping mount", "stated latitude", "stated gravity")
"""Situations without one truth, or with a statement that decides the result: rejecting them is never needless."""

VERDICTS = ("accepted", "rejected", "refused", "crashed")


@dataclass(frozen=True)
class Row:
    """Outcome of one run.

    Attributes
    ----------
    name, size, basis, seed
        The situation, and the cell's seed.
    verdict
        accepted, rejected, refused (an error with its message), or crashed (any other exception).
    worst, parameter
        Largest error over its standard deviation, and the parameter's name; NaN where there is no result.
    ratio
        Rms of error over standard deviation.
    reasons, named
        Reasons against the result, or the message; causes that the result names.
    seconds
        Duration of the calibration.
    """

    name: str
    size: str
    basis: str
    seed: int
    verdict: str
    worst: float = np.nan
    parameter: str = ""
    ratio: float = np.nan
    reasons: tuple[str, ...] = ()
    named: tuple[str, ...] = ()
    seconds: float = 0.0

    @property
    def key(self) -> tuple[str, str, str]:
        """Which situation it is."""
        return self.name, self.size, self.basis


def run_situation(situation: Situation, seed: int) -> Row:
    """Return the outcome of one run; it depends on situation and seed alone."""
    place = (situation.name, situation.size, situation.basis, seed)
    try:
        truth, recording = simulate(_cell(situation, seed), Path(folder_name(situation, seed)))
    except KreiselError as error:  # a fault of the situation itself
        return Row(*place, "crashed", reasons=(f"simulation: {error}",))
    began = time.perf_counter()
    try:
        outcome = run_calibration(check_streams(recording), CalibrationSettings())
    except KreiselError as error:
        return Row(*place, "refused", reasons=(str(error),), seconds=time.perf_counter() - began)
    except Exception as error:  # what must never happen is counted, and the study goes on
        text = f"{type(error).__name__}: {error}"
        return Row(*place, "crashed", reasons=(text,), seconds=time.perf_counter() - began)
    seconds = time.perf_counter() - began
    worst, parameter, ratio = worst_error(outcome, truth, linear="unlisted" in situation.cell)
    verdict = outcome.verdict
    said = "accepted" if verdict.accepted else "rejected"
    return Row(*place, said, worst, parameter, ratio, verdict.reasons, named_causes(outcome), seconds)


def named_causes(outcome: Outcome) -> tuple[str, ...]:
    """Return the causes that a result names, the likeliest first."""
    return tuple(cause.name for cause in outcome.verdict.causes)


def worst_error(outcome: Outcome, truth: Truth, *, linear: bool = False) -> tuple[float, str, float]:
    """Return the largest error over its standard deviation, the parameter's name, and the rms of all.

    See the module's own text for what is the truth. linear: whether further terms count by what is linear in them.
    """
    sensors = truth.sensors
    if linear:
        outcome = replace(outcome, calibration=with_linear_part(outcome, further_terms(truth)))
    scores = _scores(outcome, truth, sensors)
    if truth.slip is not None:
        after = _scores(outcome, truth, truth.slip.after(sensors))
        scores = min(scores, after, key=lambda one: max(one.values(), default=0.0))
    if not scores:
        return np.nan, "", np.nan
    name = max(scores, key=lambda parameter: scores[parameter])
    return scores[name], name, float(np.sqrt(np.mean(np.square(list(scores.values())))))


def _scores(outcome: Outcome, truth: Truth, sensors: SensorParameters) -> dict[str, float]:
    """Return error over standard deviation of every judged parameter, by its name."""
    found, sd = outcome.calibration.sensors, outcome.calibration.sensor_sd
    change = truth.offset_change
    no_change = np.zeros(3)
    gyro = (change.gyro_mean, change.gyro_end) if change else (no_change, no_change)
    accel = (change.accel_mean, change.accel_end) if change else (no_change, no_change)
    parts: dict[str, tuple[Array, Array]] = {
        "gyroscope.cross_coupling": (found.K_omega - sensors.K_omega, sd.K_omega),
        "gyroscope.offset": (_nearer(found.k_w[0] - sensors.k_w[0], gyro), sd.k_w[0]),
        "accelerometer.cross_coupling": (found.K_a - sensors.K_a, sd.K_a),
        "accelerometer.offset": (_nearer(found.k_a[0] - sensors.k_a[0], accel), sd.k_a[0]),
        "accelerometer.lever_arms": (found.lever_arms - sensors.lever_arms, sd.lever_arms),
    }
    lost, out = set(outcome.verdict.unobservable), {}
    for path, (error, deviation) in parts.items():
        for index, value in np.ndenumerate(error):
            name = f"{path}[{','.join(map(str, index))}]"
            if deviation[index] > 0.0 and name not in lost:
                out[name] = float(abs(value) / deviation[index])
    return out


def _nearer(error: Array, changes: tuple[Array, Array]) -> Array:
    """Return the smaller of the errors against an offset's mean and its last value, (3,)."""
    mean, end = (np.abs(error - change) for change in changes)
    return np.minimum(mean, end)


def _cell(situation: Situation, seed: int) -> Cell:
    return Cell.model_validate({**situation.cell, "seed": seed})


# Runs by number, for the map of a study


def random_numbers(count: int, first: int = 1) -> list[int]:
    """Return the numbers of so many runs with random physics; each is a situation of its own."""
    return [-number for number in range(first, first + count)]


def numbers(seeds: int, only: Sequence[str], seconds: float) -> list[int]:
    """Return the numbers of all runs, or of those of named situations.

    Raises
    ------
    SettingsError
        If there is no such effect; the known ones are listed.
    """
    everything = situations(seconds)
    names = list(dict.fromkeys(s.name for s in everything))
    for name in only:
        if name not in names:
            raise SettingsError(f"unknown situation '{name}'; known are: {', '.join(names)}")
    chosen = [i for i, s in enumerate(everything) if not only or s.name in only]
    # seed by seed, so that an early end has seen every situation
    return [i * _SEEDS + seed for seed in range(1, seeds + 1) for i in chosen]


def run_numbered(seconds: float, number: int) -> Row:
    """Return the outcome of a run by its number."""
    return run_situation(*_numbered(seconds, number))


def _numbered(seconds: float, number: int) -> tuple[Situation, int]:
    """Return the situation and the seed of a run; those of random physics have negative numbers."""
    if number < 0:
        return random_situation(-number, seconds), -number
    index, seed = divmod(number, _SEEDS)
    return situations(seconds)[index], seed


def write_numbered(seconds: float, folder: Path, number: int) -> str:
    """Write the recording of a run by its number, with its truth and cell; return its name."""
    situation, seed = _numbered(seconds, number)
    target = folder / folder_name(situation, seed)
    if target.exists():
        return target.name
    cell = _cell(situation, seed)
    truth, recording = simulate(cell, target)
    write(recording, target)
    write_truth(truth, target / "truth.json")
    described = {"situation": asdict(situation), "seed": seed, "cell": cell.model_dump(mode="json")}
    (target / "situation.json").write_text(json.dumps(described, indent=1), encoding="utf-8")
    return target.name


def folder_name(situation: Situation, seed: int) -> str:
    """Return the name of the folder of a run's recording."""
    plain = "".join(c if c.isalnum() or c in ".-" else "_" for c in f"{situation.name}-{situation.size}")
    return f"{plain}-{situation.basis}-{seed}"


# Results on disk


class RowFile:
    """Rows in a CSV file as they come; what is there need not be run again."""

    def __init__(self, folder: Path, seconds: float) -> None:
        """Open the folder; raise SettingsError where it holds runs of another length."""
        begin_folder(
            folder, {"study": "robustness", "seconds": seconds}, "another study, or recordings of another length"
        )
        self._file = folder / "robustness.csv"
        whole = [_from_text(row) for row in whole_rows(self._file, len(_HEADER))[1:]]
        with self._file.open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream).writerows([_HEADER, *map(_to_text, whole)])
        self._rows = {(*row.key, row.seed): row for row in whole}

    def missing(self, wanted: Iterable[int], seconds: float) -> list[int]:
        """Return the numbers of runs that are not there yet."""
        out = []
        for number in wanted:
            situation, seed = _numbered(seconds, number)
            if (situation.name, situation.size, situation.basis, seed) not in self._rows:
                out.append(number)
        return out

    def add(self, row: Row) -> None:
        """Write a row, unless it is there."""
        if (*row.key, row.seed) in self._rows:
            return
        with self._file.open("a", encoding="utf-8", newline="") as stream:
            csv.writer(stream).writerow(_to_text(row))
        self._rows[*row.key, row.seed] = row

    def rows(self) -> list[Row]:
        """Return all rows, by situation."""
        return sorted(self._rows.values(), key=lambda row: (*row.key, row.seed))


_HEADER = [known.name for known in fields(Row)]


def _to_text(row: Row) -> list[str]:
    return [
        json.dumps(value) if isinstance(value, tuple) else str(value) for value in (getattr(row, n) for n in _HEADER)
    ]


def _from_text(line: Sequence[str]) -> Row:
    values: dict[str, Any] = dict(zip(_HEADER, line, strict=True))
    values |= {key: float(values[key]) for key in ("worst", "ratio", "seconds")}
    values |= {key: tuple(json.loads(values[key])) for key in ("reasons", "named")}
    return Row(**{**values, "seed": int(values["seed"])})


# What many runs say


@dataclass(frozen=True)
class Totals:
    """All runs together; shares are of the runs named, NaN where there are none.

    Attributes
    ----------
    runs, verdicts
        Number of runs, and of those with each verdict.
    wrong, grossly_wrong
        Share of accepted runs beyond 4, and beyond 6 standard deviations.
    needless
        Share of rejected runs whose errors were within 3 standard deviations; see `REJECTED_RIGHTLY`.
    noticed
        Share of runs with a cause outside the model that were not simply accepted: rejected, or a cause named.
    named_rightly
        Share of these whose first named cause is true.
    """

    runs: int
    verdicts: Mapping[str, int]
    wrong: float
    grossly_wrong: float
    needless: float
    noticed: float
    named_rightly: float


def total(rows: Sequence[Row]) -> Totals:
    """Return the totals of all runs."""
    causes = _causes()
    accepted = [row.worst for row in rows if row.verdict == "accepted"]
    rejected = [row.worst for row in rows if row.verdict == "rejected" and row.name not in REJECTED_RIGHTLY]
    present = [row for row in rows if causes.get(row.key) and row.verdict in ("accepted", "rejected")]
    noticed = [row for row in present if row.verdict == "rejected" or row.named]
    return Totals(
        len(rows),
        {verdict: sum(row.verdict == verdict for row in rows) for verdict in VERDICTS},
        _share(worst > WRONG for worst in accepted),
        _share(worst > GROSSLY_WRONG for worst in accepted),
        _share(worst <= GOOD for worst in rejected),
        len(noticed) / len(present) if present else np.nan,
        _share(rightly(row, causes[row.key]) for row in noticed),
    )


def rightly(row: Row, causes: tuple[str, ...]) -> bool:
    """Return whether the first cause that a result names is true."""
    return bool(row.named) and row.named[0] in causes


def _causes() -> dict[tuple[str, str, str], tuple[str, ...]]:
    return {(s.name, s.size, s.basis): s.causes for s in situations()}


def _share(which: Iterable[bool]) -> float:
    values = list(which)
    return float(np.mean(values)) if values else np.nan


COLUMNS = ("effect", "size", "cell", *VERDICTS, "worst if accepted", "worst if rejected", "cause named")


def table(rows: Sequence[Row]) -> list[list[str]]:
    """Return a row for each situation: counts of verdicts, worst error over standard deviation, cause named."""
    causes = _causes()
    grouped: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        grouped.setdefault(row.key, []).append(row)
    order = {key: i for i, key in enumerate(causes)}
    out = []
    for key in sorted(grouped, key=lambda key: order.get(key, len(order))):
        own = grouped[key]
        counts = [sum(row.verdict == verdict for row in own) for verdict in VERDICTS]
        worst = [max((row.worst for row in own if row.verdict == verdict), default=np.nan) for verdict in VERDICTS[:2]]
        named = _share(rightly(row, causes.get(key, ())) for row in own) if causes.get(key) else np.nan
        texts = ["" if np.isnan(value) else f"{value:.1f}" for value in worst]
        out.append([*key, *(str(n) if n else "" for n in counts), *texts, "" if np.isnan(named) else f"{named:.0%}"])
    return out


def sentences(totals: Totals) -> list[str]:
    """Return the totals in words."""
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in totals.verdicts.items())

    def percent(share: float) -> str:
        return "none" if np.isnan(share) else f"{share:.1%}"

    return [
        f"{totals.runs} runs: {verdicts}",
        f"accepted and wrong: {percent(totals.wrong)} beyond {WRONG:g} standard deviations, "
        f"{percent(totals.grossly_wrong)} beyond {GROSSLY_WRONG:g}",
        f"rejected, but within {GOOD:g} standard deviations: {percent(totals.needless)}",
        f"with a cause outside the model: {percent(totals.noticed)} rejected or named; of these, "
        f"{percent(totals.named_rightly)} with the right cause first",
    ]


def as_document(totals: Totals, rows: Sequence[Row]) -> dict[str, Any]:
    """Return totals and rows as JSON takes them: null where there is no number."""
    causes = _causes()
    listed = [{**asdict(row), "causes": causes.get(row.key, ())} for row in rows]
    return {"totals": _plain(asdict(totals)), "rows": [_plain(row) for row in listed]}


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: None if isinstance(v, float) and not np.isfinite(v) else v for key, v in values.items()}
