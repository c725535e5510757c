"""The report of a calibration from several recordings."""

from __future__ import annotations

from pathlib import Path

from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.calibration.joint_outcome import Joint
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import JointRecording, Measured
from kreisel.report.cells import Row, Table, pair, user_fixed
from kreisel.report.reader_names import by_quantity
from kreisel.report.repeatability_page import figure_of, table_of
from kreisel.report.result_tables import device_tables
from kreisel.report.snippet import snippet
from kreisel.report.template import fill
from kreisel.units import DEG, DEG_PER_HOUR, MG, MM, MS

OWN_COLUMNS = ("recording", "its own", "unit", "x", "y", "z")


def write_joint(joint: Joint, path: Path) -> None:
    """Write the report as one HTML file that works offline."""
    calibration = joint.calibration
    values = _values(calibration)
    figures = [figure_of(one, joint.names, values[one.name]) for one in joint.repeated]
    facts = calibration.joint
    own = [] if facts is None else [Row(tuple(row)) for one in facts.recordings for row in own_rows(one)]
    recording = calibration.recording
    page = fill(
        "joint.html",
        figures,
        document=calibration.document,
        verdict=calibration.verdict,
        unobservable=by_quantity(calibration.verdict.unobservable),
        lost=None,
        warnings=joint.warnings,
        keys=_results(values),
        device=device_tables(calibration),
        title=recording.title if recording is not None else "IMU",
        own=Table("Each recording's own", OWN_COLUMNS, tuple(own), 3),
        compared=table_of(joint.repeated, joint.names),
        figures=figures,
        snippet=snippet(
            calibration.sensors, calibration.size_effect, None if recording is None else recording.temperature_c
        ),
    )
    path.write_text(page, encoding="utf-8")


def own_rows(one: JointRecording) -> list[list[str]]:
    """Return the rows of what a recording has of its own; only the first one has its name."""
    rows = [
        ("gyro bias", "deg/h", one.gyro_offset, -DEG_PER_HOUR),
        ("accelerometer bias", "mg", one.accel_offset, -MG),
    ]
    if one.turn.deviation.any():
        rows += [("turn of the mount", "deg", one.turn, DEG), ("shift of the mount", "mm", one.shift, MM)]
    out = []
    for title, unit, found, size in rows:
        values = zip((found.value / size).tolist(), (found.deviation / abs(size)).tolist(), strict=True)
        out.append(["", title, unit, *(pair(v, s) if s > 0.0 else user_fixed(v) for v, s in values)])
    timing = one.timing
    out.append(["", "time offset", "ms", pair(timing.offset / MS, (timing.offset_sd or 0.0) / MS), "", ""])
    out[0][0] = one.name
    return out


def _values(calibration: Calibration) -> dict[str, Measured]:
    """Return the quantities that are compared, by name."""
    arms, sd = calibration.sensors.lever_arms / MM, calibration.sensor_sd.lever_arms / MM
    return {
        **calibration.derived,
        **{f"lever_arm_{axis}_mm": Measured(arms[j], sd[j]) for j, axis in enumerate("xyz")},
    }


def _results(values: dict[str, Measured]) -> list[Table]:
    rows: dict[str, list[Row]] = {"axes": [], "pairs": []}
    shown = [(q.name, q.title, q.unit, q.of) for q in QUANTITIES]
    shown += [(f"lever_arm_{axis}_mm", f"Position of accelerometer {axis} in b", "mm", "axes") for axis in "xyz"]
    for name, title, unit, of in shown:
        found = values[name]
        cells = [pair(v, s) for v, s in zip(found.value.tolist(), found.deviation.tolist(), strict=True)]
        rows[of].append(Row((title, unit, *cells)))
    return [
        Table(f"Result by {what}", ("Error of the sensor", "Unit", *heads), tuple(rows[of]), 2, broad=True)
        for of, what, heads in (("axes", "axis", ("x", "y", "z")), ("pairs", "pair of axes", ("xy", "xz", "yz")))
    ]
