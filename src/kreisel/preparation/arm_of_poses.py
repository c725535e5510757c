"""The arm of a recording without joint angles, stated or shown by the poses, and its joint angles from the poses."""

from __future__ import annotations

import numpy as np

from kreisel.errors import RobotError, unknown_name
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import DataWarning, ReferencePoses
from kreisel.recording.recording_settings import RobotTable
from kreisel.robot.arm_library import LIBRARY, Tool
from kreisel.robot.description import Arm, parse_arm
from kreisel.robot.identification import Identified, identified, steady_wrist, straight_tool
from kreisel.robot.joint_path import joint_path

NO_MODEL = "none"
"""Value of `robot.model` with which no arm is looked for."""

_NOTHING: tuple[None, Array, list[DataWarning]] = (None, np.zeros((0, 0)), [])


def arm_of_poses(
    table: RobotTable, urdf: str | None, reference: ReferencePoses, *, arm: bool
) -> tuple[Arm | None, Array, list[DataWarning]]:
    """Return the arm, its joint angles at every pose (m, joints), and warnings; no arm where none is known.

    Raises
    ------
    RobotError
        If the arm that the user states is unknown, or does not reach the poses.
    """
    found, angles, warnings = _arm(table, urdf, reference) if arm else _NOTHING
    tool = [key for key in ("tool_position", "tool_quaternion") if getattr(table, key) is not None]
    if tool and table.model in (None, NO_MODEL):
        message = f"robot.{tool[0]} in recording.toml is not used: it is the tool of an arm that robot.model names"
        warnings = [*warnings, DataWarning("robot", message)]
    return found, angles, warnings


def _arm(table: RobotTable, urdf: str | None, reference: ReferencePoses) -> tuple[Arm | None, Array, list[DataWarning]]:
    p, q = reference.positions, reference.quaternions
    if p is None or q is None or table.model == NO_MODEL:
        return _NOTHING
    if table.model is not None:
        arm = _stated(table, table.model, p, q)
        return arm, joint_path(arm, p, q), []
    if urdf is not None:
        arm = parse_arm(urdf, table.tcp, table.urdf or "robot.urdf")
        try:
            return arm, joint_path(arm, p, q), []
        except RobotError as error:
            return (
                None,
                np.zeros((0, 0)),
                [DataWarning("robot", f"joint angles cannot be computed from the poses: {error}")],
            )
    return _shown(p, q)


def _stated(table: RobotTable, model: str, p: Array, q: Array) -> Arm:
    """Return the arm of the library that the user names, with the tool stated, or the straight one that poses show."""
    if model not in LIBRARY:
        raise RobotError(f"{unknown_name('robot.model', model, (*LIBRARY, NO_MODEL))}; or add the arm's robot.urdf")
    own, tool = LIBRARY[model], None
    if table.tool_position is not None or table.tool_quaternion is not None:
        none = Tool()
        stated = np.array(table.tool_quaternion or none.quaternion)
        tool = Tool(table.tool_position or none.position, tuple((stated / np.linalg.norm(stated)).tolist()))
    elif (wrist := steady_wrist(p, q)) is not None:
        tool = straight_tool(own, wrist)
    if tool is None:
        raise RobotError(
            f"{own.title}: state its tool on the flange, robot.tool_position (m) and robot.tool_quaternion, in "
            "recording.toml: the poses do not show it, because axes 2 and 3 do not stand still while the tool turns"
        )
    return parse_arm(own.urdf(tool), "tool0", model)


def _shown(p: Array, q: Array) -> tuple[Arm | None, Array, list[DataWarning]]:
    """Return the arm that the poses show, if it is one and reaches them."""
    wrist = steady_wrist(p, q)
    found = () if wrist is None else identified(wrist)
    reached: list[tuple[Identified, Arm, Array]] = []
    for one in found:
        arm = parse_arm(one.arm.urdf(one.tool), "tool0", one.arm.name)
        try:
            reached.append((one, arm, joint_path(arm, p, q)))
        except RobotError:
            continue
    if not reached:
        return _NOTHING
    if len(reached) > 1:
        names = ", ".join(one.arm.name for one, *_ in reached)
        message = f"the poses could be those of several arms ({names}); robot.model in recording.toml states which"
        return None, np.zeros((0, 0)), [DataWarning("robot", message)]
    ((one, arm, angles),) = reached
    radius, height = one.wrist.tolist()
    message = (
        f"the poses are those of an {one.arm.title} with a straight tool of {1e3 * one.tool.position[2]:.1f} mm: in "
        f"{100.0 * one.share:.0f} % of the motion its wrist stands at {radius:.4f} m and {height:.4f} m, with axes 2 "
        f"and 3 at whole angles. Joint angles are computed from the poses "
        f'(robot.model = "{NO_MODEL}" in recording.toml prevents it)'
    )
    return arm, angles, [DataWarning("robot", message)]
