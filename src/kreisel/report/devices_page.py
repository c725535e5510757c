"""Several devices on one page: errors against the truth, and the paper's figure 4."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kreisel.calibration.convergence import Convergence
from kreisel.geometry.rotation import Array
from kreisel.report import plots
from kreisel.report.cells import Row, Table, number
from kreisel.report.plots import Figure, Trace
from kreisel.report.template import fill
from kreisel.report.thinning import Curve
from kreisel.study.truth_comparison import GroupError
from kreisel.units import MG

_AXES = "xyz"
_PANEL = 150  # px; chosen: half of `plots.HEIGHT`
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
    """Return error, standard deviation and their ratio of every group, in columns of each device."""
    groups = devices[0].errors
    rows = []
    for name, group in groups.items():
        cells: list[str] = []
        for device in devices:
            own = device.errors[name]
            cells += [number(own.size), number(own.expected), number(own.ratio, 2)]
        rows.append(Row((group.title, group.unit, *cells)))
    heads = [f"{device.name}: {what}" for device in devices for what in ("error", "sd", "ratio")]
    title = "Rms error against the truth, rms standard deviation, and rms of error over it (1 is expected)"
    return Table(title, ("group", "unit", *heads), tuple(rows), text=2)


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
    panels = []
    for row, device in enumerate(devices):
        c = device.convergence
        minutes = (c.seconds / 60.0).astype(np.float32)
        values = c.offsets / MG
        late = c.seconds > 0.15 * c.seconds[-1]
        room = 3.0 * float(np.max(c.deviations[late])) / MG
        data: list[Trace] = []
        for i, colour in enumerate(_AXES):
            spread = 2.0 * c.deviations[:, i] / MG
            data.append(plots.area(minutes, values[:, i] - spread, values[:, i] + spread, "", f"{colour}/0.18"))
            true = np.full(2, device.true_offset[i] / MG, dtype=np.float32)
            data.append(plots.line(Curve(minutes[[0, -1]], true), "", "muted", dash="dot", width=1.2, legend=False))
            curve = Curve(minutes, values[:, i].astype(np.float32))
            data.append(plots.line(curve, colour, colour, legend=row == len(devices) - 1))
        y = plots.axis(
            f"{device.name} (mg)", range=[float(values[late].min()) - room, float(values[late].max()) + room]
        )
        panels.append(plots.panel(data, y, height=_PANEL))
    return Figure(
        "offsets",
        "Accelerometer offsets (corrections, k_a0) while the filter runs",
        "As figure 4 of Fox and Janocha (2005): estimates with bands of two standard deviations, truth dotted. The "
        "filter starts with the grade of the device only. Good: the bands become narrow and contain the truth.",
        plots.plot(plots.axis("time (min)"), *panels),
        shape="wide",
    )


def error_figure(devices: Sequence[Device]) -> Figure:
    """Return the largest offset error over time, and the standard deviation, on a logarithmic scale."""
    data: list[Trace] = []
    low, high = np.inf, -np.inf
    for colour, device in zip(_AXES, devices, strict=False):
        c = device.convergence
        minutes = (c.seconds / 60.0).astype(np.float32)
        error = np.max(np.abs(c.offsets - device.true_offset), axis=1) / MG
        deviation = np.max(c.deviations, axis=1) / MG
        data.append(plots.line(Curve(minutes, error.astype(np.float32)), device.name, colour))
        curve = Curve(minutes, deviation.astype(np.float32))
        data.append(plots.line(curve, "sd", colour, dash="dot", legend=False))
        low, high = min(low, np.log10(deviation[-1]) - 1.0), max(high, np.log10(max(error[0], deviation[0])))
    for bound in _BOUNDS:
        ends = np.array([0.0, max(float(d.convergence.seconds[-1]) for d in devices) / 60.0], dtype=np.float32)
        curve = Curve(ends, np.full(2, bound, dtype=np.float32))
        data.append(plots.line(curve, f"{bound:g} mg", "line", dash="dash", width=1.0, legend=False))
    y = plots.logarithmic("largest error of the three offsets (mg)", float(low), float(high))
    return Figure(
        "errors",
        "Speed of convergence",
        "Largest of the three errors (lines), largest standard deviation (dotted); dashed: 0.1 mg, the paper's, and "
        "0.01 mg. Good: each line follows its dotted line.",
        plots.plot(plots.axis("time (min)"), plots.panel(data, y)),
        shape="wide",
    )
