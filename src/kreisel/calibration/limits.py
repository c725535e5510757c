"""Limits for the sensors' errors, and whether a calibration is within them, by the rule of GUM for decisions.

A quantity conforms if its value is within the limit by the expanded uncertainty (k = 2) at least, and does not conform
if it is outside by as much. Between lies the guard band: no decision.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path

import numpy as np

from kreisel.calibration.data_sheet import QUANTITIES, Quantity
from kreisel.calibration.result_sections import CalibrationParts
from kreisel.errors import RecordingError, SettingsError, unknown_name
from kreisel.files import read_toml
from kreisel.geometry.rotation import Array
from kreisel.inertial.noise_figures import GRADES
from kreisel.model.groups import group_named
from kreisel.units import DEG_PER_HOUR, MG, MRAD, PPM

COVERAGE = 2.0
"""Coverage factor k of expanded uncertainties."""

_DEVIATIONS = 3.0
"""Standard deviations of a grade that its limits are."""


class Decision(StrEnum):
    """Whether a quantity is within its limit."""

    CONFORMS = "conforms"
    FAILS = "does not conform"
    UNDECIDED = "no decision"


@dataclass(frozen=True)
class Limits:
    """Largest absolute values of quantities, by their names in `derived`; they are of a grade, or from a file.

    Each has three, of its axes or pairs of axes; infinite where there is no limit.
    """

    values: Mapping[str, tuple[float, float, float]]
    grade: str | None = None
    file: str | None = None


@dataclass(frozen=True)
class QuantityDecision:
    """A quantity against its limit.

    Attributes
    ----------
    quantity
        Of three numbers.
    values, uncertainties : (3,)
        Value, and expanded uncertainty (k = 2).
    limits : (3,)
        Largest absolute values; infinite where there is none.
    decisions
        Of the three numbers; None for one without a limit.
    observable
        Whether all parameters that it depends on are.
    """

    quantity: Quantity
    values: Array
    uncertainties: Array
    limits: Array
    decisions: tuple[Decision | None, ...]
    observable: bool

    @property
    def limited(self) -> bool:
        """Whether one of the three numbers has a limit."""
        return bool(np.isfinite(self.limits).any())

    @property
    def decision(self) -> Decision | None:
        """Of all three together; None without limits."""
        return _together(self.decisions)

    @property
    def share(self) -> float:
        """The largest share of a limit that value and uncertainty take, 1 at the limit; nan without limits."""
        shares = (np.abs(self.values) + self.uncertainties) / self.limits
        shares = shares[np.isfinite(self.limits) & np.isfinite(shares)]
        return float(shares.max()) if shares.size else float("nan")


def _together(decisions: Sequence[Decision | None]) -> Decision | None:
    most_serious_first = (Decision.FAILS, Decision.UNDECIDED, Decision.CONFORMS)
    return next((decision for decision in most_serious_first if decision in decisions), None)


def overall(found: Sequence[QuantityDecision]) -> Decision | None:
    """Return the decision on several quantities together; None where none has a limit."""
    return _together([one.decision for one in found])


def limits_of_grade(name: str) -> Limits:
    """Return the limits of a grade: three standard deviations of its errors from device to device.

    Raises
    ------
    SettingsError
        For an unknown grade.
    """
    if name not in GRADES:
        raise SettingsError(unknown_name("grade", name, GRADES))
    grade = GRADES[name]
    pair = _DEVIATIONS * 2.0**0.5 * grade.misalignment_sd / MRAD  # two axes, each with an error of its own
    limits = {
        "gyro_bias_deg_h": _DEVIATIONS * grade.gyro_offset_sd / DEG_PER_HOUR,
        "gyro_scale_error_ppm": _DEVIATIONS * grade.gyro_scale_sd / PPM,
        "gyro_non_orthogonality_mrad": pair,
        "accel_bias_mg": _DEVIATIONS * grade.accel_offset_sd / MG,
        "accel_scale_error_ppm": _DEVIATIONS * grade.accel_scale_sd / PPM,
        "accel_non_orthogonality_mrad": pair,
    }
    return Limits({name: (value, value, value) for name, value in limits.items()}, grade=name)


def read_limits(path: Path) -> Limits:
    """Return the limits in a TOML file: `[limits]` with names as in `derived`, a number or one for each axis.

    Raises
    ------
    RecordingError
        If it cannot be read, or names something else; the known names are listed.
    """
    content = read_toml(path, "write [limits], gyro_bias_deg_h = 20.0", partial(RecordingError, file=path))
    table = content.get("limits")
    if not isinstance(table, dict) or set(content) != {"limits"}:
        raise RecordingError("expected one table, [limits]", file=path)
    known = {quantity.name for quantity in QUANTITIES}
    if not table:
        raise RecordingError(f"no limits in [limits]; known are {', '.join(sorted(known))}", file=path)
    for name in table:
        if name not in known:
            raise RecordingError(unknown_name("quantity", name, known), file=path)
    return Limits({name: _three(name, value, path) for name, value in table.items()}, file=path.name)


def _three(name: str, value: object, path: Path) -> tuple[float, float, float]:
    """Return the limits of a quantity's three numbers."""
    own = value if isinstance(value, list) else [value] * 3
    try:
        limits = [float(x) for x in own if isinstance(x, int | float) and not isinstance(x, bool) and x > 0.0]
    except OverflowError:
        limits = []
    if len(own) == len(limits) == 3 and np.isfinite(limits).any():
        x, y, z = limits
        return x, y, z
    raise RecordingError(
        f"limits.{name} = {value!r:.40}: expected a number above zero, or three, inf for an axis without a limit",
        file=path,
    )


def limits_named(text: str) -> Limits:
    """Return the limits of a grade, or those in a file.

    Raises
    ------
    SettingsError, RecordingError
        If it is neither.
    """
    if text in GRADES:
        return limits_of_grade(text)
    if Path(text).is_file():
        return read_limits(Path(text))
    raise SettingsError(f"--limits {text}: neither a file nor a grade ({', '.join(GRADES)})")


def judged(parts: CalibrationParts, limits: Limits | None = None) -> list[QuantityDecision]:
    """Return the sensors' errors with expanded uncertainties, each against its limit.

    Of what is exactly known, because the user stated it, the data decide nothing.
    """
    out = []
    for quantity in QUANTITIES:
        found = parts.derived.get(quantity.name)
        if found is None:
            continue
        U = COVERAGE * found.deviation
        limit = limits_of(limits, quantity)
        seen = not any(_concerns(quantity, name) for name in parts.verdict.unobservable)
        seen &= not any(group_named(group).owner in parts.verdict.not_usable for group in quantity.groups)
        decisions = tuple(
            decided(x, u, most, seen=seen and u > 0.0) for x, u, most in zip(found.value, U, limit, strict=True)
        )
        out.append(QuantityDecision(quantity, found.value, U, limit, decisions, seen))
    return out


def limits_of(limits: Limits | None, quantity: Quantity) -> Array:
    """Return the limits (3,) of a quantity, infinite where there is none."""
    return np.array((limits.values if limits is not None else {}).get(quantity.name, (np.inf,) * 3))


def _concerns(quantity: Quantity, parameter: str) -> bool:
    """Return whether a parameter, by its name, is one that a quantity depends on."""
    return any(parameter.startswith(f"{group_named(group).path}[") for group in quantity.groups)


def decided(value: float, uncertainty: float, limit: float, *, seen: bool = True) -> Decision | None:
    """Return whether a value is within a limit by its expanded uncertainty; None for an infinite limit."""
    if np.isinf(limit):
        return None
    if not seen or not np.isfinite([value, uncertainty]).all():
        return Decision.UNDECIDED
    if abs(value) + uncertainty <= limit:
        return Decision.CONFORMS
    return Decision.FAILS if abs(value) - uncertainty > limit else Decision.UNDECIDED
