"""The work on a batch: each recording by itself, in processes here or elsewhere; what is done is not done again.

A recording of a tray is done as one: all of its units are written to the file of results together, or none.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

from kreisel.batch.job_result import Run, date_of
from kreisel.batch.jobs import MEAN, TRAY_FILES, Job
from kreisel.batch.result_store import Store
from kreisel.errors import reason_of
from kreisel.memory import releasing_memory
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording import Recording

Result = TypeVar("Result")


class Map(Protocol):
    """Yields the results of a function of numbers, in any order."""

    def __call__(self, function: Callable[[int], Result], numbers: Iterable[int], /) -> Iterator[Result]:
        """Do the work."""


@dataclass(frozen=True)
class Batch:
    """What every worker needs: the recordings, the settings, where results go, and whether with reports."""

    jobs: Sequence[Job]
    settings: CalibrationSettings
    results: Path
    reports: bool


def calibrate_all(batch: Batch, store: Store, distribute: Map, progress: Callable[[Run], None]) -> list[Run]:
    """Calibrate all recordings that are waiting, and return the runs of all of them, in the order of the jobs.

    Parameters
    ----------
    distribute
        Does the work; a worker that dies costs its current recording's time only.
    progress
        Called with every run as it comes in, after it was written.
    """
    if waiting := waiting_in(batch, store):
        for runs in distribute(partial(calibrate_runs, batch), waiting):
            store.add(*runs)
            for run in runs:
                progress(run)
    place = {key: i for i, key in enumerate(key for job in batch.jobs for key in job.runs)}
    return sorted(store.runs(place), key=lambda run: place[run.key])


def waiting_in(batch: Batch, store: Store) -> list[int]:
    """Return the numbers of recordings that are not in the store yet, or whose files are missing."""
    done = store.calibrated()

    def missing(job: Job) -> bool:
        return not all((batch.results / name).is_file() for name in _files(job, done, reports=batch.reports))

    return [i for i, job in enumerate(batch.jobs) if not done.keys() >= job.runs.keys() or missing(job)]


def _files(job: Job, done: Mapping[str, bool], *, reports: bool) -> list[str]:
    """Return the files of a recording whose runs are done, below the folder of results.

    done: whether each ended with a result, by key.
    """
    calibrated = [name for key, name in job.runs.items() if done[key]]
    wanted = ("calibration.yaml", "report.html") if reports and not job.imus else ("calibration.yaml",)
    files = [f"{name}/{file}" for name in calibrated for file in wanted]
    if job.imus and calibrated:
        files += [f"{job.name}/{file}" for file in (*TRAY_FILES, f"{MEAN}/calibration.yaml", f"{MEAN}/report.html")]
    return files


def calibrate_runs(batch: Batch, number: int) -> list[Run]:
    """Return what became of one recording: one run, or of a tray one for each unit."""
    from kreisel.batch.tray_runs import calibrate_units

    job = batch.jobs[number]
    with releasing_memory():
        if job.imus:
            return calibrate_units(job, batch.settings, batch.results, validate=batch.reports)
        return [calibrate_one(batch, number)]


def calibrate_one(batch: Batch, number: int) -> Run:
    """Return what became of one recording of one unit; its result folder is written, whole or not at all."""
    from kreisel.calibration.calibrate import run_calibration
    from kreisel.calibration.result import RESULT_FILES
    from kreisel.files import replaced_together
    from kreisel.formats.loading import load

    job = batch.jobs[number]
    read: Recording | None = None
    try:
        read = load(job.path)
        outcome = run_calibration(read, batch.settings, validate=batch.reports, budget=batch.reports)
        with replaced_together(batch.results / job.name, RESULT_FILES) as writing:
            outcome.calibration.write(writing)
            if batch.reports:
                from kreisel.report.report_page import write_report

                write_report(outcome, writing / "report.html")
        text = json.dumps(outcome.calibration.document)
        return run_of(job.key, job.name, read, None, text)
    except Exception as error:  # whatever it is, the other units are calibrated all the same
        return run_of(job.key, job.name, read, reason_of(error), None)


def run_of(key: str, name: str, read: Recording | None, error: str | None, text: str | None) -> Run:
    """Return what became of a recording; its device and date are those that it states."""
    device = None if read is None else read.settings.device
    certificate = {} if read is None else read.settings.certificate.model_dump(exclude_none=True)
    begin = None if read is None else int(read.imu.stamps_ns[0])
    return Run(
        key,
        name,
        (device.serial_number if device is not None else None) or name,
        (device.maker if device is not None else None) or "",
        (device.type if device is not None else None) or "",
        date_of(certificate, begin),
        error,
        text,
    )


def one_after_another(function: Callable[[int], Result], numbers: Iterable[int]) -> Iterator[Result]:
    """Do the work in this process."""
    yield from map(function, numbers)
