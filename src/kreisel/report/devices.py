"""Several devices on one page: errors against the truth, and the paper's figure 4."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kreisel.calibration.convergence import Convergence
from kreisel.geometry.rotation import Array
from kreisel.report import plots
from kreisel.report.plots import Figure, Plot
from kreisel.report.table import Row, Table, number
from kreisel.report.template import fill
from kreisel.report.thinning import Curve
from kreisel.study.truth_comparison import GroupError
from kreisel.units import MG

_AXES = "xyz"
_PANEL = 150
_BOUNDS = (0.1, 0.01)
"""mg: what the paper reached, and what a good cell reaches."""


@dataclass(frozen=True)
class Device:
    """One device: its name, its errors by group, the convergence of its offsets, their truth, and its own report."""

    name: str
    errors: dict[str, GroupError]
    convergence: Convergence
    true_offset: Array
    report: str


def write_devices(devices: Sequence[Device], path: Path, lead: str) -> None:
    """Write the page as one HTML file that works offline."""
    figures = [offset_figure(devices), error_figure(devices)]
    page = fill(
        "devices.html", figures,
        lead=lead, devices=devices, errors=error_table(devices), times=time_table(devices), figures=figures,
    )  # fmt: skip
    path.write_text(page, encoding="utf-8")


def error_table(devices: Sequence[Device]) -> Table:
    """Return error and standard deviation of every group for every device."""
    groups = devices[0].errors
    rows = [
        Row((
            group.title,
            group.unit,
            *(
                f"{number(d.errors[name].size)} ({number(d.errors[name].expected)}; {number(d.errors[name].ratio, 2)})"
                for d in devices
            ),
        ))
        for name, group in groups.items()
    ]  # fmt: skip
    return Table(
        "Rms error against the truth (rms standard deviation; rms of error over it)",
        ("group", "unit", *(d.name for d in devices)),
        tuple(rows),
        text=2,
    )


def time_table(devices: Sequence[Device]) -> Table:
    """Return the time after which the accelerometers' offsets stay within the bounds."""

    def cell(device: Device, bound: float) -> str:
        seconds = device.convergence.time_within(bound * MG, device.true_offset)
        return f"{seconds:.0f}" if np.isfinite(seconds) else "not reached"

    rows = tuple(Row((f"{bound:g} mg", "s", *(cell(d, bound) for d in devices))) for bound in _BOUNDS)
    title = "Time until all three accelerometer offsets stay within"
    return Table(title, ("bound", "unit", *(d.name for d in devices)), rows, text=2)


def offset_figure(devices: Sequence[Device]) -> Figure:
    """Return the paper's figure 4: offset estimates of each device over time."""
    n = len(devices)
    layout = plots.layout_of("time (min)", "", height=_PANEL * n + 60)
    data: list[Plot] = []
    for row, device in enumerate(devices):
        key = "" if row == 0 else str(row + 1)
        top = 1.0 - row * 1.07 / n
        c = device.convergence
        minutes = (c.seconds / 60.0).astype(np.float32)
        values = c.offsets / MG
        late = c.seconds > 0.15 * c.seconds[-1]
        room = 3.0 * float(np.max(c.deviations[late])) / MG
        layout[f"yaxis{key}"] = plots.axis(
            f"{device.name} (mg)",
            domain=[max(0.0, top - 1.07 / n + 0.07), top],
            range=[float(values[late].min()) - room, float(values[late].max()) + room],
            nticks=6,
        )
        for i, colour in enumerate(_AXES):
            more: Plot = {"yaxis": f"y{key}", "showlegend": False}
            spread = 2.0 * c.deviations[:, i] / MG
            data.append(
                plots.area(minutes.tolist(), (values[:, i] - spread).tolist(), (values[:, i] + spread).tolist(),
                           colour, f"{colour}/0.18", **more)
            )  # fmt: skip
            true = np.full(2, device.true_offset[i] / MG, dtype=np.float32)
            data.append(plots.line(Curve(minutes[[0, -1]], true), "truth", "muted", dash="dot", width=1.2, **more))
            curve = Curve(minutes, values[:, i].astype(np.float32))
            data.append(plots.line(curve, colour, colour, **{**more, "showlegend": row == 0}))
    layout["xaxis"]["anchor"] = f"y{n}" if n > 1 else "y"
    return Figure(
        "offsets",
        "Accelerometer offsets (corrections, k_a0) while the filter runs",
        "As figure 4 of Fox and Janocha (2005): estimates with bands of two standard deviations, truth dotted. The "
        "filter starts with the grade of the device only. Good: the bands become narrow and contain the truth.",
        plots.plot(data, layout),
        shape="wide",
    )


def error_figure(devices: Sequence[Device]) -> Figure:
    """Return the largest offset error over time, and the standard deviation, on a logarithmic scale."""
    layout = plots.layout_of("time (min)", "largest error of the three offsets (mg)")
    data: list[Plot] = []
    low, high = np.inf, -np.inf
    for colour, device in zip(_AXES, devices, strict=False):
        c = device.convergence
        minutes = (c.seconds / 60.0).astype(np.float32)
        error = np.max(np.abs(c.offsets - device.true_offset), axis=1) / MG
        deviation = np.max(c.deviations, axis=1) / MG
        data.append(plots.line(Curve(minutes, error.astype(np.float32)), device.name, colour))
        curve = Curve(minutes, deviation.astype(np.float32))
        data.append(plots.line(curve, "sd", colour, dash="dot", showlegend=False))
        low, high = min(low, np.log10(deviation[-1]) - 1.0), max(high, np.log10(max(error[0], deviation[0])))
    for bound in _BOUNDS:
        ends = np.array([0.0, max(float(d.convergence.seconds[-1]) for d in devices) / 60.0], dtype=np.float32)
        curve = Curve(ends, np.full(2, bound, dtype=np.float32))
        data.append(plots.line(curve, f"{bound:g} mg", "line", dash="dash", width=1.0, showlegend=False))
    layout["yaxis"] = {**layout["yaxis"], **plots.logarithmic(float(low), float(high))}
    return Figure(
        "errors",
        "Speed of convergence",
        "Largest of the three errors (lines), largest standard deviation (dotted); dashed: 0.1 mg, the paper's, and "
        "0.01 mg. Good: each line follows its dotted line.",
        plots.plot(data, layout),
        shape="wide",
    )
