"""Tables of the result itself: by axis, by pair of axes, clocks, and the device without its mounting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.calibration.outcome import Outcome
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import Measured, Timing
from kreisel.model.parameters import parameter_names
from kreisel.report.cells import Row, Table, number, pair, user_fixed
from kreisel.units import DEG, MM, MS, PPM


@dataclass(frozen=True)
class Support:
    """Which parameters were estimated, and which of them are observable."""

    fixed: tuple[str, ...]
    unobservable: frozenset[str]
    not_narrowed: frozenset[str]
    order: int

    @classmethod
    def of(cls, outcome: Outcome) -> Support:
        """Return the support of an outcome's parameters."""
        settings, seen = outcome.problem.settings, outcome.observability
        return cls(
            tuple(settings.fixed),
            frozenset(seen.unobservable),
            frozenset(seen.not_narrowed),
            settings.polynomial_order,
        )

    def word(self, groups: Sequence[str], part: slice = slice(None)) -> str:
        """Return whether a quantity that depends on groups, or on a part of one, is observable."""
        for group in (g for g in groups if g in self.fixed):
            return "no: user-fixed" if len(groups) == 1 else f"no: {group.split('_')[0]} user-fixed"
        names = [name for group in groups for name in parameter_names(group, self.order)[part]]
        observable = sum(name not in self.unobservable for name in names)
        if observable == len(names):
            return "yes"
        return "no" if observable == 0 else f"in part ({observable} of {len(names)} parameters)"

    def of_name(self, name: str) -> str:
        """Return whether one parameter is observable."""
        if name in self.not_narrowed:
            return "no"
        return "too weakly" if name in self.unobservable else "yes"


def key_tables(outcome: Outcome) -> list[Table]:
    """Return the result in the terms and units of data sheets: the sensors' errors by axis and by pair of axes."""
    calibration, support = outcome.calibration, Support.of(outcome)
    rows: dict[str, list[Row]] = {"axes": [], "pairs": []}
    for quantity in QUANTITIES:
        word = support.word(quantity.groups)
        row = _key_row(quantity.title, quantity.unit, calibration.derived[quantity.name], word)
        rows[quantity.of].append(row)
    arms, sd = calibration.sensors.lever_arms / MM, calibration.sensor_sd.lever_arms / MM
    for j, axis in enumerate("xyz"):
        word = support.word(("lever_arms",), slice(3 * j, 3 * j + 3))
        rows["axes"].append(_key_row(f"Position of accelerometer {axis} in b", "mm", Measured(arms[j], sd[j]), word))
    word = "yes" if "alignment" in outcome.problem.groups else "no: user-fixed"
    rows["axes"].append(_key_row("Gravity in r", "m/s²", calibration.alignment.gravity, word))
    head = ("Error of the sensor", "Unit")
    return [
        Table("Result by axis", (*head, "x", "y", "z", "Observable"), tuple(rows["axes"]), 2, broad=True),
        Table("Result by pair of axes", (*head, "xy", "xz", "yz", "Observable"), tuple(rows["pairs"]), 2, broad=True),
        Table(
            "Clocks", ("Quantity", "Unit", "Value", "Observable"), tuple(_timing_rows(calibration.timing, support)), 2
        ),
    ]


def device_tables(calibration: Calibration) -> list[Table]:
    """Return the device's own part of the calibration, with the mounting split off, in axes of its accelerometers."""
    triad = calibration.triads.get("imu")
    if triad is None:
        return []

    def rows(name: str, unit: str, size: float, found: Measured) -> list[Row]:
        value, sd = np.atleast_2d(found.value) / size, np.atleast_2d(found.deviation) / size
        titles = [f"{name}, row {axis}" for axis in "xyz"] if len(value) == 3 else [name]
        return [
            Row((title, unit, *(pair(v, d) if d > 0.0 else number(v, 6) for v, d in zip(own, of_own, strict=True))))
            for title, own, of_own in zip(titles, value.tolist(), sd.tolist(), strict=True)
        ]

    own = [
        *rows("Accelerometers, T", "1", 1.0, triad.accel_matrix),
        *rows("Gyros, T", "1", 1.0, triad.gyro_matrix),
        *rows("Positions", "mm", MM, triad.lever_arms),
    ]
    mount = [
        *rows("Rotation vector from s to b", "deg", DEG, triad.rotation_vector),
        *rows("Origin of s in b", "mm", MM, triad.position),
    ]
    columns = ("Device, in its own frame s", "Unit", "x", "y", "z")
    return [
        Table("The device alone", columns, tuple(own), 2, broad=True),
        Table("Its mounting on this tool", ("Mounting", *columns[1:]), tuple(mount), 2),
    ]


def _key_row(title: str, unit: str, found: Measured, word: str) -> Row:
    bare = word == "no: user-fixed"  # of several groups one may be estimated
    pairs = zip(found.value.tolist(), found.deviation.tolist(), strict=True)
    cells = [user_fixed(v) if bare or s == 0.0 else pair(v, s) for v, s in pairs]
    return Row((title, unit, *cells, word), weak=word != "yes")


def _timing_rows(timing: Timing, support: Support) -> list[Row]:
    word = support.word(("time_offset",))
    size = timing.offset / MS
    offset = user_fixed(size) if word.startswith("no: ") else pair(size, (timing.offset_sd or 0.0) / MS)
    rows = [Row(("Time offset of the reference", "ms", offset, word), weak=word != "yes")]
    if timing.skew_sd:
        word = support.word(("time_skew",))
        skew = pair(timing.skew / PPM, timing.skew_sd / PPM)
        rows.append(Row(("Ratio of the clocks, less one", "ppm", skew, word), weak=word != "yes"))
    elif timing.skew:
        skew, word = user_fixed(timing.skew / PPM), "no: user-fixed"
        rows.append(Row(("Ratio of the clocks, less one", "ppm", skew, word), weak=True))
    return rows
