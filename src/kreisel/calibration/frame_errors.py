"""Effect of errors of the base and tool frames on the parameters."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array, skew
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem

_LASTS = 10.0
"""s; how long the error of a standstill lasts: a slow move of an arm to the next one."""


_TURNED, _SHIFTED = (0.95, 0.95, 1.2), (0.8, 0.8, 1.2)
"""Errors of the tool frame about and along its axes, over those of an arm's frames. Chosen: the last joint turns about
z; a zero of that joint, and of those that turn about the same direction, is seen in no pose, while errors across it
change with the joint's angle. In 480 drawn arms errors about and along z were 1.5 times those across it. In 258
calibrations of random physics without joint angles they were 1.0 and 0.9, across z 0.7 and 0.65; in 45 others about z
1.25. What poses show of an arm's size scatters by a third, as it comes from few independent errors of joints: where it
was half of the usual for the arm, errors across z were 1.8."""

_ALIKE = (1.0, 1.0, 1.0)
"""The same for errors that know no axis of the tool."""


def repeatability_columns(problem: Problem, parameters: CellParameters) -> Array:
    """Return the effect of the reference's errors at standstills on the state, one deviation each, (degrees, 8).

    The error of a standstill lasts in the move that follows, where the filter takes errors for independent. On average
    over all standstills it acts like an error of the frames, for the share of the recording that is near one. It
    matters in short recordings of a good arm or of good cameras. Where errors of an arm's frames count in full, it is
    part of them.
    """
    standstills = len(problem.schedule.standstills)
    if max(problem.noise.frame_sd) > 0.0 or standstills == 0:
        return np.zeros((problem.layout.degrees, 8))
    noise, seconds = problem.noise.reference, float(np.ptp(problem.sensor.readings.stamps))
    share = min(1.0, standstills * _LASTS / seconds) * standstills**-0.5
    frame_sd = (share * noise.standstill_position, share * noise.standstill_orientation)
    return frame_columns(problem, parameters, frame_sd, turned=_ALIKE, shifted=_ALIKE)


def axis_columns(problem: Problem, parameters: CellParameters) -> Array:
    """Return the effect of an arm that turns about other axes than it reports on the state, one deviation each, (n, k).

    Where all motion is about a few axes, one after the other, each has an error of its own, in two directions. It
    changes what readings of a rotation about this axis are turned to, and likewise what gravity is.
    """
    layout, sensors, axes = problem.layout, parameters.sensors, problem.noise.axes
    columns = []
    for group, K in (("gyro_cross_coupling", sensors.K_omega), ("accel_cross_coupling", sensors.K_a)):
        if group not in layout or not len(axes):
            continue
        to_axes = np.linalg.inv(axes.T) @ K
        for own, share in zip(axes, to_axes, strict=True):
            for across in np.linalg.svd(own[None])[2][1:]:
                column = np.zeros((layout.degrees, 1))
                turned = problem.noise.axis_sd * np.outer(across, share).ravel()
                column[layout[group], 0] = problem.columns(group, turned)
                columns.append(column)
    return np.hstack([np.zeros((layout.degrees, 0)), *columns])


def frame_columns(
    problem: Problem,
    parameters: CellParameters,
    frame_sd: tuple[float, float] | None = None,
    *,
    turned: tuple[float, float, float] = _TURNED,
    shifted: tuple[float, float, float] = _SHIFTED,
) -> Array:
    """Return the effect of errors of the base and tool frames on the state, one deviation each, (degrees, 8).

    Parameters
    ----------
    frame_sd
        Their deviations, m and rad; those of a robot whose errors cannot be estimated by default.
    turned, shifted
        Factors on the deviations of rotations about the tool's axes, and of shifts along them.

    Notes
    -----
    A small rotation of the tool frame rotates both cross-coupling matrices and the lever arms; a shift of it shifts
    the lever arms. A rotation of the base frame rotates gravity.
    """
    layout, sensors = problem.layout, parameters.sensors
    length, angle = problem.noise.frame_sd if frame_sd is None else frame_sd
    columns = np.zeros((layout.degrees, 8))
    for i, axis in enumerate(np.eye(3)):
        turn = angle * turned[i] * skew(axis)
        for group, value in (
            ("gyro_cross_coupling", turn @ sensors.K_omega),
            ("accel_cross_coupling", turn @ sensors.K_a),
            ("lever_arms", sensors.lever_arms @ turn.T),
        ):
            if group in layout:
                columns[layout[group], i] = problem.columns(group, value.ravel())
        if "lever_arms" in layout:
            columns[layout["lever_arms"], 3 + i] = problem.columns("lever_arms", np.tile(length * shifted[i] * axis, 3))
    if "alignment" in layout:
        columns[layout["alignment"], 6:] = angle * np.eye(2)
    return columns
