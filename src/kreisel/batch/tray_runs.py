"""A tray in a batch: its result folders, and what became of each of its units."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kreisel.batch.job_result import Run, date_of, key_of_unit
from kreisel.batch.jobs import MEAN, TRAY_FILES, Job
from kreisel.errors import reason_of
from kreisel.recording.recording import Recording
from kreisel.recording.recording_settings import RecordingSettings

if TYPE_CHECKING:
    from kreisel.array.tray_outcome import TrayOutcome
    from kreisel.model.calibration_settings import CalibrationSettings


def calibrate_units(job: Job, settings: CalibrationSettings, results: Path, *, validate: bool) -> list[Run]:
    """Return what became of the units of a tray; its result folders are written.

    Parameters
    ----------
    results
        Folder of results: `results/NAME/` is the tray's.
    validate
        Whether the mean is cross-validated.
    """
    from kreisel.array.tray import calibrate_tray
    from kreisel.array.unit_readings import first_readable, unit_reader
    from kreisel.formats.loading import load

    base: Recording | None = None
    unread: dict[str, str] = {}
    try:
        base, names = first_readable(lambda imu: load(job.path, imu=imu), job.path, job.imus, unread)
        outcome = calibrate_tray(unit_reader(base, names[0]), names, settings, validate=validate)
        outcome = replace(outcome, left_out=(*unread.items(), *outcome.left_out))
        write_tray_results(outcome, results / job.name)
        return runs_of_tray(outcome, job)
    except Exception as error:  # whatever it is, the other trays are calibrated all the same
        return [_run(job, imu, base, unread.get(imu, reason_of(error))) for imu in job.imus]


def write_tray_results(outcome: TrayOutcome, folder: Path) -> None:
    """Write a folder for each unit of a tray and for their mean, `array.yaml`, and the page of all."""
    from kreisel.calibration.result import RESULT_FILES, write_document
    from kreisel.files import replaced_together
    from kreisel.report.report_page import write_report
    from kreisel.report.tray_page import write_tray

    for unit in outcome.units:
        unit.calibration.save(folder / unit.name)
    with replaced_together(folder / MEAN, RESULT_FILES) as writing:
        outcome.mean.calibration.write(writing)
        write_report(outcome.mean, writing / "report.html")
    with replaced_together(folder, TRAY_FILES) as writing:
        write_document(outcome.array_document, writing / "array.yaml")
        _write_covariance(outcome, writing / "covariance.csv")
        np.savez_compressed(
            writing / "units_covariance.npz", names=np.array(outcome.parameter_names), covariance=outcome.joint
        )
        write_tray(outcome, writing / "report.html")


def _write_covariance(outcome: TrayOutcome, path: Path) -> None:
    """Write the covariance of all places, m and rad, with a name at the head of each column."""
    rows = [",".join(f"{value:.9g}" for value in row) for row in outcome.covariance]
    path.write_text("\n".join([",".join(outcome.place_names), *rows, ""]), encoding="utf-8")


def runs_of_tray(outcome: TrayOutcome, job: Job) -> list[Run]:
    """Return the runs of all units of a tray, in the order of the job's IMUs, with those that are left out."""
    texts = {unit.name: json.dumps(unit.calibration.document) for unit in outcome.units}
    left_out = dict(outcome.left_out)
    return [_run(job, imu, outcome.recording, left_out.get(imu), texts.get(imu)) for imu in job.imus]


def _run(job: Job, imu: str, base: Recording | None, error: str | None, text: str | None = None) -> Run:
    """Return the run of one unit; its device and its date are those that the recording states."""
    settings = RecordingSettings() if base is None else base.settings
    device, name = settings.of_imu(imu).device, f"{job.name}/{imu}"
    serials = [settings.of_imu(other).device.serial_number for other in job.imus]
    # [device] without [device1], … states one serial number for all units: it tells none of them from the others
    serial = device.serial_number if serials.count(device.serial_number) == 1 else None
    begin = None if base is None else int(base.imu.stamps_ns[0])
    date = date_of(settings.certificate.model_dump(exclude_none=True), begin)
    return Run(
        key_of_unit(job.key, imu), name, serial or name, device.maker or "", device.type or "", date, error, text
    )
