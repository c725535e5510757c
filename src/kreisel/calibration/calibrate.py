"""From a recording to a calibration: the main job, in its order."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kreisel.calibration.build import build_problem
from kreisel.calibration.document import document
from kreisel.calibration.halves import SplitHalves, split_halves, with_disagreement
from kreisel.calibration.kernels import compile_kernels
from kreisel.calibration.latitude import check_latitude
from kreisel.calibration.observability import Observability, observability
from kreisel.calibration.plausibility import check_first_values
from kreisel.calibration.problem import Problem
from kreisel.calibration.result import Calibration
from kreisel.calibration.run import Estimate, estimate
from kreisel.calibration.settings import CalibrationSettings
from kreisel.calibration.setup import Preparation, prepare_recording
from kreisel.calibration.verdict import Consistency, Evidence, Verdict, consistency, judge
from kreisel.geometry.rotation import Array
from kreisel.recording import Finding, Recording
from kreisel.robot.urdf import calibrated_urdf
from kreisel.synchronization import Clock

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Outcome:
    """A calibration with all that led to it, for reports and further study."""

    recording: Recording
    preparation: Preparation
    problem: Problem
    estimate: Estimate
    observability: Observability
    consistency: Consistency
    halves: SplitHalves | None
    verdict: Verdict
    findings: tuple[Finding, ...]
    calibration: Calibration


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
    compile_kernels(None if progress is None else lambda share: progress("prepare kernels", share))
    if progress is not None:
        progress("synchronise", 0.0)
    preparation = prepare_recording(recording, settings)
    check_first_values(preparation)
    problem = build_problem(preparation, settings)
    began = time.perf_counter()
    table = recording.settings.reference
    found = estimate(
        problem,
        reference_given=table.position_sd is not None or table.orientation_sd is not None,
        imu_given=preparation.imu_noise.given,
        progress=progress,
    )
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
