"""A robot calibrated by an IMU, on one page."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kreisel.calibration.arm_result import NOT_SHOWN, ArmCalibration, ArmError
from kreisel.report import plots
from kreisel.report.cells import Row, Table, number, pair
from kreisel.report.plots import Figure
from kreisel.report.reader_names import by_quantity
from kreisel.report.template import fill
from kreisel.units import MM, MRAD


def write_arm(found: ArmCalibration, path: Path) -> None:
    """Write the page as one HTML file that works offline."""
    verdict = found.calibration.verdict
    figures = [_errors(found.errors), *([_unused(found)] if found.unused else [])]
    shown = sum(one.separable for one in found.errors)
    path.write_text(
        fill(
            "study.html",
            figures,
            title=f"{found.robot.name} by IMU",
            kind="calibration of a robot by an IMU",
            heading="Result",
            verdict=verdict,
            by_quantity=by_quantity,
            lead=f"{shown} of {len(found.errors)} errors are shown by this motion",
            table_of_groups=_worth(found),
            further_tables=[_table(found.errors)],
            facts=[*(f"{warning}." for warning in found.warnings), *(f"Not shown: {one}." for one in NOT_SHOWN)],
            figures=figures,
        ),
        encoding="utf-8",
    )


def _worth(found: ArmCalibration) -> Table:
    """Return the pose errors before and after correction: on poses not used, and as the result itself expects."""
    robot = found.robot
    rows = [
        Row((f"{one.name}, not used; errors from {one.used}", *(
            f"{value.position / MM:.3g} mm, {value.orientation / MRAD:.3g} mrad"
            for value in (one.before, one.after, one.expected)
        )))
        for one in found.unused
    ]  # fmt: skip
    expected = [f"{one.position / MM:.3g} mm, {one.orientation / MRAD:.3g} mrad" for one in
                (robot.found, robot.after)]  # fmt: skip
    rows.append(Row(("all, by the result itself", expected[0], "", expected[1])))
    columns = ("Poses", "Error before", "Error after", "Expected after")
    return Table("Error of the tool's pose, without those of base and tool frames", columns, tuple(rows), broad=True)


def _table(errors: tuple[ArmError, ...]) -> Table:
    rows = tuple(
        Row((one.title, one.unit, pair(one.value / one.size, one.deviation / one.size), number(one.prior / one.size, 2),
             "yes" if one.separable else "no"), weak=not one.separable)
        for one in errors
    )  # fmt: skip
    return Table("Every error", ("Error", "Unit", "Estimate", "Deviation before", "Shown"), rows, 2, broad=True)


def _errors(errors: tuple[ArmError, ...]) -> Figure:
    """Return the errors in deviations from before, with how well they are known."""
    place = np.arange(len(errors), dtype=float)
    value, bar = (np.array([getattr(one, key) / one.prior for one in errors]) for key in ("value", "deviation"))
    shown = np.array([one.separable for one in errors])
    traces = []
    for own, name, colour in ((shown, "shown by the motion", "x"), (~shown, "not distinguished", "y")):
        texts = [one.title for one, mine in zip(errors, own, strict=True) if mine]
        traces.append(plots.markers(place[own], value[own], name, colour, size=6, error=bar[own], texts=texts))
    caption = "Each error over the standard deviation of its prior, in the order of the table. Bars: one deviation."
    x = plots.axis("number of the error in the table", range=[-1.0, float(len(errors))])
    most = 1.05 * float(np.max(np.abs(value) + bar, initial=1.0))
    panel = plots.panel(traces, plots.axis("Error / deviation before (1)", range=[-most, most]), texts=True)
    return Figure("errors", "Errors of the arm", caption, plots.plot(x, panel), shape="wide")


def _unused(found: ArmCalibration) -> Figure:
    """Return the position error on poses not used, before and after."""
    place = np.arange(len(found.unused), dtype=float)
    traces = [
        plots.markers(place, np.array([getattr(one, key).position / MM for one in found.unused]), name, colour, size=9)
        for key, name, colour in (("before", "before", "y"), ("after", "after", "x"), ("expected", "expected", "z"))
    ]
    caption = "Root mean square before correction, after it, and as expected after it. Good: after is far below before."
    most = max(part.position / MM for one in found.unused for part in (one.before, one.after, one.expected))
    drawn = plots.plot(
        plots.axis(
            "part of the data", range=[-0.5, len(found.unused) - 0.5],
            ticks=[place.tolist(), [one.name for one in found.unused]],
        ),
        plots.panel(traces, plots.axis("Position error (mm)", range=[0.0, 1.1 * most])),
    )  # fmt: skip
    return Figure("unused", "Position error on poses not used", caption, drawn)
