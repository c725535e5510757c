"""Places of IMUs against one of them: a table and a drawing."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kreisel.array.relative_pose import RelativePose
from kreisel.geometry.rotation import from_matrix, log
from kreisel.report import plots
from kreisel.report.cells import Row, Table, pair
from kreisel.report.plots import Figure
from kreisel.units import MM, MRAD

POSE_COLUMNS = ("unit", "x, mm", "y, mm", "z, mm", "about x, mrad", "about y, mrad", "about z, mrad")


def poses_table(reference: str, poses: Mapping[str, RelativePose]) -> Table:
    """Return the table of relative poses."""
    title = f"Places in the axes of {reference}, with standard deviations"
    return Table(title, POSE_COLUMNS, tuple(Row(tuple(cells)) for cells in pose_rows(poses)), text=1)


def pose_rows(poses: Mapping[str, RelativePose]) -> list[list[str]]:
    """Return a row for each relative pose."""
    out = []
    for name, pose in poses.items():
        sd = np.sqrt(np.diag(pose.covariance))
        turn = log(from_matrix(pose.rotation))
        values = [*(pose.position / MM), *(turn / MRAD)]
        out.append(
            [name, *(pair(float(v), float(s)) for v, s in zip(values, [*(sd[:3] / MM), *(sd[3:] / MRAD)], strict=True))]
        )
    return out


def places_figure(reference: str, poses: Mapping[str, RelativePose]) -> Figure:
    """Return where the units lie, seen along z of the reference unit."""
    x, y = (np.array([0.0, *(pose.position[k] / MM for pose in poses.values())]) for k in (0, 1))
    texts = [reference, *poses]
    room = 0.1 * max(float(np.ptp(x)), float(np.ptp(y)), 1.0)
    marks = plots.markers(x, y, "unit", "x", size=9, texts=texts)
    x_axis = plots.axis(f"x of {reference}, mm", range=[float(x.min()) - room, float(x.max()) + room])
    y_axis = plots.axis("y, mm", range=[float(y.min()) - room, float(y.max()) + room])
    caption = (
        "Where the middles of the accelerometers lie, in the axes of the first unit; deviations are in the table. "
        "Good: the drawing of the tray."
    )
    return Figure("places", "Places", caption, plots.plot(x_axis, plots.panel([marks], y_axis, equal=True)))
