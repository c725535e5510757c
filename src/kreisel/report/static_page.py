"""A calibration from standstills on one page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.calibration.data_sheet import OF_A_REFERENCE, QUANTITIES
from kreisel.calibration.result_sections import CalibrationParts
from kreisel.geometry.rotation import Array, lengths, nearest_rotation
from kreisel.report import plots
from kreisel.report.cells import Row, Table, number, pair
from kreisel.report.plots import Figure
from kreisel.report.reader_names import by_quantity
from kreisel.report.report_tables import CONSIDERED, considered_row
from kreisel.report.template import fill
from kreisel.static.multi_position import StaticEstimate
from kreisel.static.rest_noise import FIGURES, as_row
from kreisel.static.static_result import StaticOutcome
from kreisel.static.turns import turns_between


def write_static(outcome: StaticOutcome, path: Path) -> None:
    """Write the page as one HTML file that works offline."""
    calibration, found = outcome.calibration, outcome.found
    facts = calibration.recording
    rests = found.problem.rests
    figures = [_lengths(found), _turns(found), _attitudes(found)]
    path.write_text(
        fill(
            "study.html",
            figures,
            title="Calibration without a reference" if facts is None else facts.title,
            kind=f"calibration from standstills, {outcome.method}",
            heading="Result",
            verdict=calibration.verdict,
            by_quantity=by_quantity,
            lead=f"{rests.count} standstills, {found.linear.turn.node.size} turns, "
            f"{rests.seconds[-1] - rests.seconds[0]:.0f} s",
            table_of_groups=_quantities(calibration),
            further_tables=[_parameters(outcome), _noise(found), _considered(found)],
            facts=[f"{warning}." for warning in outcome.warnings],
            figures=figures,
        ),
        encoding="utf-8",
    )


def _quantities(calibration: CalibrationParts) -> Table:
    rows = []
    for quantity in QUANTITIES:
        if quantity.name in OF_A_REFERENCE:
            continue
        one = calibration.derived[quantity.name]
        cells = [pair(v, sd) for v, sd in zip(one.value.tolist(), one.deviation.tolist(), strict=True)]
        rows.append(Row((quantity.title, quantity.unit, *cells)))
    frame = "the accelerometers' frame" if calibration.axes == "imu" else "axes of the tool"
    return Table(f"Errors of the sensors, in {frame}", ("Error", "Unit", "x / xy", "y / xz", "z / yz"),
                 tuple(rows), 2, broad=True)  # fmt: skip


def _parameters(outcome: StaticOutcome) -> Table:
    found, calibration = outcome.found, outcome.calibration
    weak = calibration.verdict.unobservable
    values = found.problem.values(found.parameters)[: len(calibration.names)]
    deviations = np.sqrt(np.diag(calibration.covariance))
    halves = np.full(values.size, np.nan) if outcome.halves is None else outcome.halves
    rows = [
        Row((name, pair(v, sd), number(half, 2), "no" if name in weak else "yes"), weak=name in weak)
        for name, v, sd, half in zip(calibration.names, values, deviations, halves, strict=True)
    ]
    columns = ("Parameter", "Estimate, SI", "Halves differ by, deviations", "Of use")
    return Table("Every parameter", columns, tuple(rows), broad=True)


_TITLES = {
    "force": ("Force at a standstill", "m/s²"),
    "rate": ("Rate at a standstill", "rad/s"),
    "turn": ("Turn, over the root of the integral of the squared rate", "√s"),
    "gyro_walk": ("Walk of the gyro offsets", "rad/s/√s"),
    "accel_walk": ("Walk of the accelerometer offsets", "m/s²/√s"),
    "face": ("Vertical at a standstill on a face, against its normal", "rad"),
    "whole turn": ("Heading after a whole turn", "rad"),
    "table": ("Turn by the turntable", "rad"),
    "hinge": ("Axis of the hinge after a turn", "rad"),
    "pose": ("Reported attitude at a standstill", "rad"),
}


def _noise(found: StaticEstimate) -> Table:
    kinds = (*FIGURES, *(known.kind for known in found.problem.known))
    sizes = as_row(found.noise)[0]
    rows = [Row((*_TITLES[kind], number(float(size)))) for kind, size in zip(kinds, sizes, strict=True)]
    return Table("Errors that the standstills show", ("Error", "Unit", "Size"), tuple(rows), 2)


def _considered(found: StaticEstimate) -> Table:
    rows = tuple(considered_row(effect) for effect in found.considered)
    return Table("Error terms beyond the usual model", CONSIDERED, rows, 2, broad=True)


def _time(seconds: Array) -> dict[str, Any]:
    """Return the axis of time with room at both ends."""
    room = 0.03 * float(seconds[-1] - seconds[0]) + 1.0
    return plots.axis(plots.TIME, range=[float(seconds[0]) - room, float(seconds[-1]) + room])


def _lengths(found: StaticEstimate) -> Figure:
    """Return by how much the force at each standstill differs from gravity in length, raw and calibrated."""
    rests, p = found.problem.rests, found.parameters
    raw = lengths(rests.forces) - p.gravity
    after = lengths((rests.forces + p.sensors.k_a[0]) @ p.sensors.K_a.T) - p.gravity
    traces = [
        plots.markers(rests.seconds, 1e3 * raw, "raw", "y", size=5),
        plots.markers(rests.seconds, 1e3 * after, "calibrated, offsets of the middle", "x", size=5),
    ]
    caption = "What is left once calibrated is noise, walks of the offsets, and standstills that were none."
    drawn = plots.plot(_time(rests.seconds), plots.panel(traces, plots.axis("Length less gravity (mm/s²)")))
    return Figure("lengths", "Length of the force less gravity", caption, drawn)


def _turns(found: StaticEstimate) -> Figure:
    """Return by how much each turn misses the next vertical, raw and calibrated."""
    problem, p = found.problem, found.parameters
    up = (problem.rests.forces + p.sensors.k_a[0]) @ p.sensors.K_a.T
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    at = found.linear.turn.node

    def missed(rotations: Array) -> Array:
        seen = np.einsum("mji,mj->mi", rotations, up[:-1])
        return 1e3 * lengths(np.cross(seen, up[1:]))[at]

    K = p.sensors.K_omega
    mount = nearest_rotation(np.sign(np.linalg.det(K)) * K)
    nominal = replace(p.sensors, K_omega=mount, k_w=p.sensors.k_w[:1], k_a=p.sensors.k_a[:1], others={})
    raw = turns_between(problem.imu, problem.raw, problem.rests, nominal)
    time = problem.rests.seconds[at]
    traces = [
        plots.markers(time, missed(raw.rotations), "without scale and misalignment", "y", size=5),
        plots.markers(time, missed(found.linear.turns.rotations), "calibrated", "x", size=5),
    ]
    caption = "The vertical by the gyros after each turn, from the one before it, against that by the accelerometers."
    drawn = plots.plot(_time(problem.rests.seconds), plots.panel(traces, plots.axis("Error of the vertical (mrad)")))
    return Figure("turns", "Vertical after each turn", caption, drawn)


def _attitudes(found: StaticEstimate) -> Figure:
    """Return where up was at each standstill: elevation over the xy plane against the azimuth in it."""
    up = -found.attitudes[:, 2]
    azimuth, elevation = np.degrees(np.arctan2(up[:, 1], up[:, 0])), np.degrees(np.arcsin(np.clip(up[:, 2], -1.0, 1.0)))
    order = np.argsort(azimuth)
    traces = [plots.markers(azimuth[order], elevation[order], "up", "z", size=7)]
    caption = "Gaps are attitudes to add: a filled sphere distinguishes scale factors from offsets."
    drawn = plots.plot(
        plots.axis("azimuth of up in the xy plane (deg)", range=[-185.0, 185.0]),
        plots.panel(traces, plots.axis("elevation of up (deg)", range=[-95.0, 95.0])),
    )
    return Figure("attitudes", "Attitudes", caption, drawn)
