"""The path of an arm through a program on one page, before anything moves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.report import plots
from kreisel.report.cells import Row, Table
from kreisel.report.plots import Figure, Trace
from kreisel.report.template import fill
from kreisel.robot.description import Arm
from kreisel.robot.kinematics import skeleton
from kreisel.robot.program import Program

_STEPS = 40
"""Points of the tool's path in a move. Chosen: smooth on a screen."""


def write_path(
    arm: Arm, program: Program, floor: float, boxes: Sequence[Array], columns: Sequence[str],
    rows: Sequence[Sequence[str]], facts: Sequence[str], path: Path,
) -> None:  # fmt: skip
    """Write the page as one HTML file that works offline.

    Parameters
    ----------
    floor
        Its height in the base's frame, m.
    boxes : each (2, 3)
        Corners of keep-out boxes, m.
    columns, rows
        The limits and what is used of them.
    facts
        Sentences on what was checked.
    """
    rests = [skeleton(arm, angles) for angles in (program.start, *(move.target for move in program.moves))]
    tool = np.array([
        skeleton(arm, at + share * (move.target - at))[-1]
        for _, at, move in program.legs() for share in np.linspace(0.0, 1.0, _STEPS)
    ])  # fmt: skip
    figures = [
        Figure(f"view{i}", title, text, _view(rests, tool, floor, boxes, (0, second)))
        for i, (title, text, second) in enumerate((
            ("From the side", "x and z of the base; the arm at each rest, the path of the tool, the floor and the "
             "keep-out boxes. Good: nothing that stands in the cell is near a line.", 2),
            ("From above", "x and y of the base.", 1),
        ))
    ]  # fmt: skip
    path.write_text(
        fill(
            "study.html", figures, title="Path of a program", kind="nothing was moved", heading="Path of the arm",
            lead=f"{arm.name}, {len(program.moves)} moves, as they would be sent. Links are drawn between the joints; "
            "tool, cables and payload are not known to the model.",
            table_of_groups=Table("Limits, and what is used of them", tuple(columns),
                                  tuple(Row(tuple(row)) for row in rows), text=1),
            facts=[f"{fact}." for fact in facts], figures=figures,
        ),
        encoding="utf-8",
    )  # fmt: skip


def _view(
    rests: Sequence[Array], tool: Array, floor: float, boxes: Sequence[Array], axes: tuple[int, int]
) -> plots.Plot:
    first, second = axes
    points = np.vstack([*rests, tool, *boxes]) if boxes else np.vstack([*rests, tool])
    low, high = points[:, axes].min(axis=0), points[:, axes].max(axis=0)
    if second == 2:
        low[1] = min(low[1], floor)
    margin = 0.08 * float(np.max(high - low))
    data: list[Trace] = [
        plots.trail(points[:, first], points[:, second], "", "muted/0.5", width=1.2) for points in map(np.array, rests)
    ]
    data.append(plots.trail(tool[:, first], tool[:, second], "", "x", width=1.6, label="tool"))
    if second == 2:
        ends = np.array([low[0] - margin, high[0] + margin])
        data.append(plots.trail(ends, np.full(2, floor), "", "ink", width=1.5, label=f"floor, {floor:g} m"))
    for box in boxes:
        x, y = box[:, first], box[:, second]
        data.append(plots.trail(x[[0, 1, 1, 0, 0]], y[[0, 0, 1, 1, 0]], "", "alert", width=1.5, label="keep out"))
    names = "xyz"
    horizontal = plots.axis(f"{names[first]} (m)", range=[float(low[0] - margin), float(high[0] + 3 * margin)])
    vertical = plots.axis(f"{names[second]} (m)", range=[float(low[1] - margin), float(high[1] + margin)])
    return plots.plot(horizontal, plots.panel(data, vertical, height=420, equal=True))
