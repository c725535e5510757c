"""What the page of a recording shows of an estimate: the quantities of the report, with its signs and units."""

from __future__ import annotations

from kreisel.calibration.result_sections import CalibrationParts
from kreisel.geometry.rotation import Array
from kreisel.units import MM, MS

Shown = dict[str, tuple[list[float], list[float]]]
"""Values and standard deviations of quantities, by the names that `page.html` has titles for."""


def quantities_of(found: CalibrationParts | None) -> Shown:
    """Return the quantities of a calibration that are known; none without a calibration."""
    if found is None:
        return {}
    out = {name: _numbers(one.value, one.deviation) for name, one in found.derived.items()}
    for axis, place, deviation in zip("xyz", found.sensors.lever_arms, found.sensor_sd.lever_arms, strict=True):
        out[f"position_{axis}_mm"] = _numbers(place / MM, deviation / MM)
    out["time_offset_ms"] = ([found.timing.offset / MS], [(found.timing.offset_sd or 0.0) / MS])
    return {name: shown for name, shown in out.items() if all(abs(v) < float("inf") for part in shown for v in part)}


def _numbers(values: Array, deviations: Array) -> tuple[list[float], list[float]]:
    return values.tolist(), deviations.tolist()
