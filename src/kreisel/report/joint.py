"""The report of a calibration from several recordings."""

from __future__ import annotations

from pathlib import Path

from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.calibration.joint_outcome import Joint
from kreisel.calibration.parts import JointRecording, Measured
from kreisel.calibration.result import Calibration
from kreisel.report.repeatability import figure_of, table_of
from kreisel.report.snippet import snippet
from kreisel.report.table import Row, Table, by_group, held, pair
from kreisel.report.template import fill
from kreisel.units import DEG, DEG_PER_HOUR, MG, MM, MS

OWN_COLUMNS = (
    "recording", "gyro bias, deg/h", "accelerometer bias, mg", "turn, deg", "shift, mm", "time offset, ms"
)  # fmt: skip


def write_joint(joint: Joint, path: Path) -> None:
    """Write the report as one HTML file that works offline."""
    calibration = joint.calibration
    values = _values(calibration)
    figures = [figure_of(one, joint.names, values[one.name]) for one in joint.repeated]
    facts = calibration.joint
    own = () if facts is None else tuple(Row(tuple(own_cells(one))) for one in facts.recordings)
    recording = calibration.recording
    page = fill(
        "joint.html",
        figures,
        document=calibration.document,
        verdict=calibration.verdict,
        unobservable=by_group(calibration.verdict.unobservable),
        warnings=joint.warnings,
        key=_result(values),
        own=Table("Each recording's own", OWN_COLUMNS, own, broad=True),
        compared=table_of(joint.repeated, joint.names),
        figures=figures,
        snippet=snippet(
            calibration.sensors, calibration.size_effect, None if recording is None else recording.temperature_c
        ),
    )
    path.write_text(page, encoding="utf-8")


def own_cells(one: JointRecording) -> list[str]:
    """Return the cells of a recording's row: its name, and what is its own."""

    def three(found: Measured, size: float) -> str:
        return ", ".join(
            pair(v, s) if s > 0.0 else held(v)
            for v, s in zip((found.value / size).tolist(), (found.deviation / abs(size)).tolist(), strict=True)
        )

    first = not one.turn.deviation.any()
    return [
        one.name,
        three(one.gyro_offset, -DEG_PER_HOUR),
        three(one.accel_offset, -MG),
        "–" if first else three(one.turn, DEG),
        "–" if first else three(one.shift, MM),
        pair(one.timing.offset / MS, (one.timing.offset_sd or 0.0) / MS),
    ]


def _values(calibration: Calibration) -> dict[str, Measured]:
    """Return the quantities that are compared, by name."""
    arms, sd = calibration.sensors.lever_arms / MM, calibration.sensor_sd.lever_arms / MM
    return {
        **calibration.derived,
        **{f"lever_arm_{axis}_mm": Measured(arms[j], sd[j]) for j, axis in enumerate("xyz")},
    }


def _result(values: dict[str, Measured]) -> Table:
    titles = {q.name: (f"{q.title} (xy, xz, yz)" if q.of == "pairs" else q.title, q.unit) for q in QUANTITIES}
    titles |= {f"lever_arm_{axis}_mm": (f"Position of accelerometer {axis} in b", "mm") for axis in "xyz"}
    rows = []
    for name, (title, unit) in titles.items():
        found = values[name]
        cells = [pair(v, s) for v, s in zip(found.value.tolist(), found.deviation.tolist(), strict=True)]
        rows.append(Row((title, unit, *cells)))
    return Table("Result", ("Error of the sensor", "Unit", "x / xy", "y / xz", "z / yz"), tuple(rows), 2, broad=True)
