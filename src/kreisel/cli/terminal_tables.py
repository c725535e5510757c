"""Tables for the terminal."""

from __future__ import annotations

import os
from collections.abc import Sequence
from math import isnan
from textwrap import wrap
from typing import TYPE_CHECKING

from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from kreisel.calibration.result_views import with_deviation

if TYPE_CHECKING:
    from kreisel.calibration.arm_result import ArmCalibration
    from kreisel.calibration.evidence import Injection
    from kreisel.calibration.result import Calibration
    from kreisel.calibration.result_sections import RobotErrors
    from kreisel.report.devices_page import Device


_WIDE = 104
"""Columns of a terminal in which a table of results has room."""


def wide_console() -> Console:
    """Return a console; where it is no terminal it is as wide as COLUMNS says, or 120 columns."""
    console = Console(highlight=False)
    return console if console.is_terminal or os.environ.get("COLUMNS") else Console(highlight=False, width=120)


def print_result(calibration: Calibration, warnings: Sequence[object]) -> None:
    """Print the results with standard deviations, and the verdict."""
    console, rows = wide_console(), _rows(calibration)
    for warning in warnings:
        console.print(f"· {warning}", markup=False)
    facts = calibration.recording
    title = "" if facts is None else f"{facts.name}: {facts.reference}"
    console.print(_narrow(title, rows) if console.width < _WIDE else _wide(title, rows))
    console.print("errors of the sensors; calibration.yaml holds corrections: offset = -bias, see `frames` there")
    _print_robot(console, calibration.robot)
    _print_verdict(console, calibration)


def print_static(calibration: Calibration, warnings: Sequence[object]) -> None:
    """Print the errors of sensors that were calibrated without a reference, and the verdict."""
    from kreisel.calibration.data_sheet import OF_A_REFERENCE

    console = wide_console()
    for warning in warnings:
        console.print(f"· {warning}", markup=False)
    rows = _quantity_rows(calibration, OF_A_REFERENCE)
    facts = calibration.recording
    method = "" if calibration.estimator is None else f", {calibration.estimator.name}"
    title = "" if facts is None else f"{facts.name}: standstills{method}"
    console.print(_narrow(title, rows) if console.width < _WIDE else _wide(title, rows))
    frame = "the accelerometers' frame" if calibration.axes == "imu" else "b, the axes of the tool"
    console.print(f"errors of the sensors, in {frame}; calibration.yaml holds corrections: offset = -bias")
    _print_verdict(console, calibration)


def print_arm(found: ArmCalibration) -> None:
    """Print the errors of a robot that the motion shows, what they are worth, and the verdict."""
    console = wide_console()
    for warning in found.warnings:
        console.print(f"· {warning}", markup=False)
    shown = [one for one in found.errors if one.separable]
    rows = [
        [
            one.title,
            one.unit,
            with_deviation(one.value / one.size, one.deviation / one.size),
            f"± {one.prior / one.size:.3g}",
        ]
        for one in shown
    ]
    print_rows(f"{found.robot.name}: errors that the motion shows", ("error", "unit", "estimate", "before"), rows)
    console.print(f"{len(found.errors) - len(shown)} of {len(found.errors)} errors are not distinguished from others")
    for part in found.unused:
        before, after, expected = (
            f"{1e3 * one.position:.2g} mm, {1e3 * one.orientation:.2g} mrad"
            for one in (part.before, part.after, part.expected)
        )
        console.print(
            f"poses of {part.name}, not used: {before} before, {after} after correction from {part.used} ({expected} "
            "expected)", markup=False,
        )  # fmt: skip
        if part.by_urdf is not None:
            left = f"{1e3 * part.by_urdf.position:.2g} mm, {1e3 * part.by_urdf.orientation:.2g} mrad"
            console.print(f"with robot.urdf alone: {left}", markup=False)
    _print_verdict(console, found.calibration)


_Row = tuple[str, str, list[str]]
"""What it is, its unit, and one or three values with their deviations."""


def _rows(calibration: Calibration) -> list[_Row]:
    """Return the rows of the table of results."""
    rows = _quantity_rows(calibration)
    estimator = calibration.estimator
    fixed = set() if estimator is None else set(estimator.fixed)
    arms, sd = 1e3 * calibration.sensors.lever_arms, 1e3 * calibration.sensor_sd.lever_arms
    for j, axis in enumerate("xyz"):
        known = [0.0] * 3 if "lever_arms" in fixed else sd[j].tolist()
        cells = [with_deviation(v, s) for v, s in zip(arms[j].tolist(), known, strict=True)]
        rows.append((f"position of accelerometer {axis} in b", "mm", cells))
    timing = calibration.timing
    offset_sd = 0.0 if "time_offset" in fixed else timing.offset_sd or 0.0
    rows.append(("time offset of the reference", "ms", [with_deviation(1e3 * timing.offset, 1e3 * offset_sd)]))
    if timing.skew or timing.skew_sd:
        ratio = with_deviation(1e6 * timing.skew, 1e6 * (timing.skew_sd or 0.0))
        rows.append(("ratio of the clocks, less one", "ppm", [ratio]))
    return rows


def _quantity_rows(calibration: Calibration, left_out: Sequence[str] = ()) -> list[_Row]:
    """Return the rows of the sensors' errors in the terms of data sheets."""
    from kreisel.calibration.data_sheet import QUANTITIES

    rows: list[_Row] = []
    for quantity in QUANTITIES:
        if quantity.name not in left_out:
            found = calibration.derived[quantity.name]
            pairs = zip(found.value.tolist(), found.deviation.tolist(), strict=True)
            rows.append((_lower(quantity.title), quantity.unit, [with_deviation(v, s) for v, s in pairs]))
    return rows


def _wide(title: str, rows: Sequence[_Row]) -> Table:
    table = Table(title=title, title_justify="left")
    for name in ("error of the sensor", "unit", "x / xy", "y / xz", "z / yz"):
        table.add_column(name, justify="left" if name in ("error of the sensor", "unit") else "right")
    for what, unit, cells in rows:
        table.add_row(what, unit, *cells, *[""] * (3 - len(cells)))
    return table


def _narrow(title: str, rows: Sequence[_Row]) -> Table:
    """Return the table for a terminal of few columns: deviations below the values."""
    table = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0))
    for name in ("error of the sensor", "x / xy", "y / xz", "z / yz"):
        table.add_column(name, justify="left" if name == "error of the sensor" else "right")
    for what, unit, cells in rows:
        shown = [cell.replace(" ± ", "\n± ") for cell in cells]
        table.add_row(f"{what},\n  {unit}", *shown, *[""] * (3 - len(cells)))
    return table


def _lower(title: str) -> str:
    return title[0].lower() + title[1:]


def _print_robot(console: Console, robot: RobotErrors | None) -> None:
    if robot is None:
        return
    before, after = robot.before, robot.after
    console.print(
        f"robot {robot.name}: pose error {1e3 * before.position:.2g} mm, {1e3 * before.orientation:.2g} mrad before, "
        f"{1e3 * after.position:.2g} mm, {1e3 * after.orientation:.2g} mrad after correction of its errors (without "
        "those of base and tool frames)",
        markup=False,
    )


def _print_verdict(console: Console, calibration: Calibration) -> None:
    facts, verdict = calibration.consistency, calibration.verdict
    still = "" if isnan(facts.nis_standstill) else f", standstill {facts.nis_standstill:.2f}"
    console.print(
        f"normalised innovation squared (expected 1): path {facts.nis_path:.2f}{still}; rejected {facts.rejected} of "
        f"{facts.updates} updates",
        markup=False,
    )
    if verdict.unobservable:
        console.print(f"not observable, or too weakly: {', '.join(verdict.unobservable)}", markup=False)
    reasons = f" Reasons: {'; '.join(verdict.reasons)}" if verdict.reasons else ""
    console.print(f"verdict: {_lower(verdict.summary)}{reasons}", markup=False)


def print_rows(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], text: int = 2) -> None:
    """Print a table of text that fits the terminal; the first `text` columns are not numbers.

    Where a grid has no room its lines are left out, and heads and words are wrapped; where numbers would be, what is
    not a number stands above them. Nothing is cut.
    """
    console = wide_console()
    grid = Table(title=title, title_justify="left")
    for i, name in enumerate(columns):
        grid.add_column(name, justify="left" if i < text else "right")
    for row in rows:
        grid.add_row(*map(escape, row))
    if console.measure(grid, options=console.options.update(max_width=_UNLIMITED)).maximum <= console.width:
        console.print(grid)
        return
    cells = list(zip(*rows, strict=True)) if rows else [()] * len(columns)
    least = [
        _longest([*cells[i], name], words=True) if i < text else max(_longest(cells[i]), _longest([name], words=True))
        for i, name in enumerate(columns)
    ]
    if sum(least) + len(columns) - 1 <= console.width:
        console.print(_without_lines(title, columns, rows, text, least))
    else:
        _print_stacked(console, title, columns, rows, text, least)


_UNLIMITED = 10_000
"""Columns that every table has room in."""


def _longest(texts: Sequence[str], *, words: bool = False) -> int:
    """Return the length of the longest text, or of the longest word of all."""
    parts = [part for one in texts for part in (one.split() if words else one.splitlines())]
    return max((cell_len(part) for part in parts), default=0)


def _without_lines(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], text: int, least: Sequence[int]
) -> Table:
    """Return a table without lines, whose heads and texts are wrapped, and whose numbers are not."""
    table = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0), pad_edge=False)
    for i, name in enumerate(columns):
        if i < text:
            table.add_column(name, overflow="fold", min_width=least[i])
        else:
            table.add_column("\n".join(wrap(name, least[i])), justify="right", no_wrap=True, min_width=least[i])
    for row in rows:
        table.add_row(*map(escape, row))
    return table


def _print_stacked(
    console: Console, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], text: int, least: Sequence[int]
) -> None:
    """Print numbers below the texts of their row."""
    console.print(title, style="italic", markup=False)
    numbers = [["  ", *row[text:]] for row in rows]
    table = _without_lines("", ["  ", *columns[text:]], numbers, 1, [2, *least[text:]])
    head, *lines = _lines_of(console, table, len(rows))
    console.print(", ".join(columns[:text]), style="bold", markup=False)
    console.print(head, style="bold", markup=False, soft_wrap=True)
    for row, line in zip(rows, lines, strict=True):
        console.print(", ".join(cell for cell in row[:text] if cell), markup=False)
        console.print(line, markup=False, soft_wrap=True)


def _lines_of(console: Console, table: Table, rows: int) -> list[str]:
    """Return the head of a table, which may have several lines, and the lines of its rows."""
    table.title = None
    with console.capture() as caught:
        console.print(table, soft_wrap=False)
    lines = [Text.from_ansi(line).plain.rstrip() for line in caught.get().splitlines()]
    return ["\n".join(lines[: len(lines) - rows]), *lines[len(lines) - rows :]]


def print_sentences(lines: Sequence[str]) -> None:
    """Print sentences, wrapped at words where the width is known."""
    console = wide_console()
    known = console.is_terminal or bool(os.environ.get("COLUMNS"))
    for line in lines:
        console.print(line, markup=False, soft_wrap=not known)


def print_devices(devices: Sequence[Device]) -> None:
    """Print error, standard deviation and their ratio, rms over each group, of every device."""
    rows = []
    for name, group in devices[0].errors.items():
        cells = [device.errors[name] for device in devices]
        rows.append([group.title, group.unit, *(f"{c.size:.3g} ({c.expected:.3g}; {c.ratio:.1f})" for c in cells)])
    title = "rms error compared with the truth (rms standard deviation; rms of error over it)"
    print_rows(title, ["group", "unit", *(device.name for device in devices)], rows)
    print_sentences(["the paper's accelerometer offsets were uncertain by up to 0.1 mg"])


def print_injection(injection: Injection) -> None:
    """Print injected errors and what was found."""
    rows = [
        [name, f"{a:.6g}", f"{b:.6g}", f"{(b - a) / sd:.2f}"]
        for name, a, b, sd in zip(
            injection.names, injection.injected, injection.found, injection.deviation, strict=True
        )
        if abs(a) > 1e-12
    ]
    print_rows("injected errors", ("parameter", "injected", "found", "difference / sd"), rows, 1)
