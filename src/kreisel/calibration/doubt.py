"""Doubt that no innovation shows: added to what the filter believes, once it has run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.calibration.filter_run import FilterRun
from kreisel.calibration.problem import Problem
from kreisel.estimation.filter import Belief, triangularise, widen
from kreisel.geometry.rotation import skew
from kreisel.inertial.earth import EARTH_RATE
from kreisel.recording import Finding
from kreisel.units import DEG_PER_HOUR


def with_doubts(problem: Problem, run: FilterRun, belief: Belief) -> tuple[Belief, list[Finding]]:
    """Return the belief with all doubts, and what to say of each."""
    findings: list[Finding] = []
    if max(problem.frame_sd) > 0.0:
        belief = _where_frames_lie(problem, run, belief)
        length, angle = (1e3 * sd for sd in problem.frame_sd)
        said = (
            f"its errors are stated but not estimated: {length:.2g} mm and {angle:.2g} mrad were added for where base "
            "and tool may lie"
        )
        findings.append(Finding("robot", said))
    if problem.site.earth_rate_n is None and "gyro_offset" in problem.layout:
        size = EARTH_RATE / 3**0.5
        belief = widen(problem.layout, belief, "gyro_offset", size)
        said = (
            f"no latitude is given, so the Earth's rotation is left out; {size / DEG_PER_HOUR:.1f} deg/h were added "
            "to the gyro offset's standard deviation for it (site.latitude_deg in recording.toml)"
        )
        findings.append(Finding("site", said))
    return belief, findings


def _where_frames_lie(problem: Problem, run: FilterRun, belief: Belief) -> Belief:
    """Return the belief with the doubt where the base's and the tool's frame lie.

    A tool turned by a small angle turns both cross-coupling matrices and the lever arms with it, one that
    is shifted shifts the lever arms; a base turned turns gravity.
    """
    layout, sensors = problem.layout, run.parameters.sensors
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
    return replace(belief, factor=triangularise(np.hstack([belief.factor, columns])))
