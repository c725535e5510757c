"""From a recording to a calibration: the main job, in its order."""

from __future__ import annotations

import time

import numpy as np

from kreisel.calibration.document import document
from kreisel.calibration.evidence import Evidence
from kreisel.calibration.inflation import with_unestimated_errors
from kreisel.calibration.latitude_check import check_latitude
from kreisel.calibration.outcome import Outcome
from kreisel.calibration.result import Calibration
from kreisel.calibration.split_halves import split_halves, with_disagreement
from kreisel.calibration.verdict import consistency, judge
from kreisel.filtering.compile_kernels import compile_kernels
from kreisel.filtering.estimate import Estimate
from kreisel.filtering.iteration import Given, estimate
from kreisel.filtering.observability import observability
from kreisel.geometry.rotation import Array
from kreisel.model.settings import CalibrationSettings
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.plausibility import check_start_values
from kreisel.preparation.prepare import prepare_recording
from kreisel.progress import Progress, of_step
from kreisel.recording.recording import Recording
from kreisel.robot.urdf import calibrated_urdf
from kreisel.synchronization.clock import Clock


def calibrate(recording: Recording, settings: CalibrationSettings | None = None) -> Calibration:
    """Return the calibration of a recording.

    Raises
    ------
    KreiselError
        If the recording cannot be used; the message says what, where and what to do.
    """
    return run_calibration(recording, settings or CalibrationSettings()).calibration


def run_calibration(recording: Recording, settings: CalibrationSettings, progress: Progress | None = None) -> Outcome:
    """Return the calibration of a recording with everything that led to it.

    Parameters
    ----------
    progress
        Called with the name of the step and the share of it that is done.
    """
    compile_kernels(of_step(progress, "prepare kernels"))
    if progress is not None:
        progress("synchronise", 0.0)
    preparation = prepare_recording(recording, settings)
    check_start_values(preparation)
    problem = build_problem(preparation, settings)
    began = time.perf_counter()
    table = recording.settings.reference
    stated = table.position_sd is not None or table.orientation_sd is not None
    found = with_unestimated_errors(estimate(problem, Given(stated, preparation.imu_noise.given), progress))
    seconds = time.perf_counter() - began
    halves = split_halves(found, progress)
    found = with_disagreement(found, halves)
    seen = observability(found.problem, found.run)
    facts = consistency(found)
    latitude = check_latitude(found.problem, found.run)
    verdict = judge(found, Evidence(seen, facts, halves, latitude))
    findings = (*recording.findings, *preparation.findings, *found.findings)
    content = document(recording, preparation, found, seen, facts, verdict, findings, seconds)
    n = len(seen.names)
    calibration = Calibration(
        document=content,
        names=seen.names,
        covariance=found.run.belief.covariance[:n, :n],
        prior_deviation=seen.prior,
        estimates=_estimates(recording, found, n),
        robot_urdf=_calibrated_robot(found),
    )
    return Outcome(recording, preparation, found.problem, found, seen, facts, halves, verdict, findings, calibration)


def _calibrated_robot(found: Estimate) -> str | None:
    """Return the robot's description with its errors put in, where they were estimated."""
    if found.problem.robot is None:
        return None
    return calibrated_urdf(found.problem.robot.arm, found.run.parameters.robot.placement)


def _estimates(recording: Recording, found: Estimate, n: int) -> Array:
    """Return IMU seconds, estimates and deviations at every update; the last row is the result itself."""
    history, run, layout = found.run.history, found.run, found.problem.layout
    table = np.column_stack([history.seconds, history.parameters, history.deviations * found.correlation_factor])
    for group in found.problem.groups:
        if group != "alignment":
            d = layout[group]
            table[-1, 1 + d.start : 1 + d.stop] = run.parameters.stored(group)
    if "time_offset" in layout:
        # from the first pose's IMU time to the offset between stamps, as in the result
        first = int(recording.imu.stamps_ns[0]), int(found.problem.reference.stamps_ns[0])
        table[:, 1 + layout["time_offset"].start] += Clock(0.0).offset(*first)
    table[-1, 1 + n :] = run.belief.standard_deviation[:n]
    return table
