"""Errors that no innovation shows: added to the standard deviations once the filter has run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.calibration.filter_run import FilterRun
from kreisel.calibration.parameters import CellParameters
from kreisel.calibration.problem import Problem
from kreisel.estimation.filter import Belief, triangularise, widen
from kreisel.geometry.rotation import Array, skew
from kreisel.recording import Finding


def with_frame_errors(problem: Problem, run: FilterRun, belief: Belief, others: Array) -> tuple[Belief, list[Finding]]:
    """Return the belief with what is added for errors that are not estimated, and what to say of it.

    Parameters
    ----------
    others : (degrees, k)
        What further such errors do to the state, one deviation each.
    """
    findings: list[Finding] = []
    if max(problem.frame_sd) > 0.0:
        columns = np.hstack([frame_columns(problem, run.parameters), others])
        belief = replace(belief, factor=triangularise(np.hstack([belief.factor, columns])))
        length, angle = (1e3 * sd for sd in problem.frame_sd)
        said = (
            "its geometric errors cannot be estimated without joint angles and robot.urdf: standard deviations contain "
            f"{length:.2g} mm and {angle:.2g} mrad for base and tool frame (robot.length_sd and robot.angle_sd in "
            'recording.toml state them; for motion capture, write reference.kind = "mocap")'
        )
        findings.append(Finding("robot", said))
    if problem.lateness > 0.0 and "time_offset" in problem.layout:
        belief = widen(problem.layout, belief, "time_offset", problem.lateness)
    return belief, findings


def frame_columns(problem: Problem, parameters: CellParameters) -> Array:
    """Return what errors of the base's and the tool's frame do to the state, one deviation each, (degrees, 8).

    A tool turned by a small angle turns both cross-coupling matrices and the lever arms with it, one that
    is shifted shifts the lever arms; a base turned turns gravity.
    """
    layout, sensors = problem.layout, parameters.sensors
    length, angle = problem.frame_sd
    columns = np.zeros((layout.degrees, 8))
    for i, axis in enumerate(np.eye(3)):
        turned = angle * skew(axis)
        for group, value in (
            ("gyro_cross_coupling", turned @ sensors.K_omega),
            ("accel_cross_coupling", turned @ sensors.K_a),
            ("lever_arms", sensors.lever_arms @ turned.T),
        ):
            if group in layout:
                columns[layout[group], i] = value.ravel()
        if "lever_arms" in layout:
            columns[layout["lever_arms"], 3 + i] = np.tile(length * axis, 3)
    if "alignment" in layout:
        columns[layout["alignment"], 6:] = angle * np.eye(2)
    return columns
