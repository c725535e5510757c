"""The work on a batch: each recording by itself, in processes here or elsewhere; what is done is not done again."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from kreisel.batch.job_result import Run, date_of
from kreisel.batch.jobs import Job
from kreisel.batch.result_store import Store
from kreisel.errors import KreiselError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording import Recording

Result = TypeVar("Result")

Map = Callable[[Callable[[int], Run], Iterable[int]], Iterator[Run]]
"""Yields the results of a function of numbers, in any order."""


@dataclass(frozen=True)
class Batch:
    """What every worker needs: the recordings, the settings, where results go, and whether with reports."""

    jobs: Sequence[Job]
    settings: CalibrationSettings
    results: Path
    reports: bool


def calibrate_all(batch: Batch, store: Store, distribute: Map, progress: Callable[[Run], None]) -> list[Run]:
    """Calibrate all recordings that are waiting, and return the runs of all of them, by name.

    Parameters
    ----------
    distribute
        Does the work; a worker that dies costs its current recording's time only.
    progress
        Called with every run as it comes in, after it was written.
    """
    if waiting := waiting_in(batch, store):
        for run in distribute(partial(calibrate_one, batch), waiting):
            store.add(run)
            progress(run)
    return store.runs(job.key for job in batch.jobs)


def waiting_in(batch: Batch, store: Store) -> list[int]:
    """Return the numbers of recordings that are not in the store yet, or whose files are missing."""
    done = store.calibrated()
    wanted = ("calibration.yaml", "report.html") if batch.reports else ("calibration.yaml",)

    def missing(job: Job) -> bool:
        return done[job.key] and not all((batch.results / job.name / name).is_file() for name in wanted)

    return [i for i, job in enumerate(batch.jobs) if job.key not in done or missing(job)]


def calibrate_one(batch: Batch, number: int) -> Run:
    """Return what became of one recording; its result folder is written, whole or not at all."""
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
    except KreiselError as error:
        return run_of(job.key, job.name, read, str(error), None)


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


def one_after_another(function: Callable[[int], Run], numbers: Iterable[int]) -> Iterator[Run]:
    """Do the work in this process."""
    yield from map(function, numbers)
