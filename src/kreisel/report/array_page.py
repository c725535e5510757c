"""Where the IMUs of an array lie, on one page."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kreisel.array.array_outcome import ArrayOutcome
from kreisel.report.cells import Row, Table, pair
from kreisel.report.places import places_figure, poses_table
from kreisel.report.template import fill
from kreisel.units import MM, MS, PPM

COLUMNS = ("unit", "by standstills", "clipped", "distance, mm", "clock, ppm")


def write_array(outcome: ArrayOutcome, path: Path) -> None:
    """Write the page of an array as one HTML file that works offline."""
    figures = [places_figure(outcome.reference, outcome.poses)]
    shown = {
        "title": "Array of IMUs",
        "kind": "array",
        "heading": "All units",
        "lead": f"{outcome.recording.name}: {len(outcome.members)} units, {outcome.samples} samples in motion",
        "table_of_groups": Table("Units", COLUMNS, tuple(Row(tuple(cells)) for cells in unit_rows(outcome)), text=2),
        "further_tables": [poses_table(outcome.reference, outcome.poses)],
        "facts": facts_of(outcome),
        "figures": figures,
    }
    path.write_text(fill("study.html", figures, **shown), encoding="utf-8")


def unit_rows(outcome: ArrayOutcome) -> list[list[str]]:
    """Return a row for each unit."""
    out = []
    for member in outcome.members:
        state = "none" if member.calibration is None else member.calibration.verdict.headline.lower()
        pose, clock = outcome.poses.get(member.name), outcome.clocks.get(member.name)
        distance = "-"
        if pose is not None:
            along = pose.position / max(float(np.linalg.norm(pose.position)), 1e-12)
            sd = float(np.sqrt(along @ pose.covariance[:3, :3] @ along))
            distance = pair(float(np.linalg.norm(pose.position)) / MM, sd / MM)
        ratio = "-" if clock is None else pair(clock.skew / PPM, clock.skew_sd / PPM)
        out.append([member.name, state, f"{100.0 * member.clipped:.1f} %", distance, ratio])
    return out


def facts_of(outcome: ArrayOutcome) -> list[str]:
    """Return sentences on the array."""
    fit = outcome.fit
    facts = [f"{name} is not used: {reason}" for name, reason in outcome.left_out]
    facts += [f"{one.name}: {text}" for one in outcome.members for text in one.warnings]
    facts += [
        f"{one.name} is not calibrated by standstills: {one.remark}"
        for one in outcome.members
        if one.calibration is None
    ]
    if any(member.clipped for member in outcome.members):
        facts.append("Samples at which a unit is clipped, and those beside them, are not used.")
    facts.append(
        f"Accelerometers fit to {fit.residual:.2g} m/s^2; they lag the gyros by {fit.lag[0] / MS:.3f} ms. Moments of "
        f"reading differ by {fit.delay / MS:.2f} ms."
    )
    facts.append(
        f"Not observable: the common scale of the gyros. Distances are uncertain by "
        f"{100.0 * fit.scale_deviation:.2f} % for it; the deviations contain that."
    )
    return facts
