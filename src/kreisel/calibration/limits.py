"""Limits for the sensors' errors, and whether a calibration is within them, by the rule of GUM for decisions.

A quantity conforms if its value is within the limit by the expanded uncertainty (k = 2) at least, and does not conform
if it is outside by as much. Between lies the guard band: no decision.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from kreisel.calibration.data_sheet import QUANTITIES, Quantity
from kreisel.calibration.result_sections import CalibrationParts
from kreisel.errors import RecordingError, SettingsError, unknown_name
from kreisel.files import read_text
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
    """Largest absolute values of quantities, by their names in `derived`; they are of a grade, or from a file."""

    values: Mapping[str, float]
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
    limit
        Largest absolute value; None where there is none.
    decisions
        Of the three numbers; empty without a limit.
    observable
        Whether all parameters that it depends on are.
    """

    quantity: Quantity
    values: Array
    uncertainties: Array
    limit: float | None
    decisions: tuple[Decision, ...]
    observable: bool

    @property
    def decision(self) -> Decision | None:
        """Of all three together."""
        return _together(self.decisions)


def _together(decisions: Sequence[Decision]) -> Decision | None:
    most_serious_first = (Decision.FAILS, Decision.UNDECIDED, Decision.CONFORMS)
    return next((decision for decision in most_serious_first if decision in decisions), None)


def overall(found: Sequence[QuantityDecision]) -> Decision | None:
    """Return the decision on several quantities together; None where none has a limit."""
    return _together([one.decision for one in found if one.decision is not None])


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
    return Limits(
        {
            "gyro_bias_deg_h": _DEVIATIONS * grade.gyro_offset_sd / DEG_PER_HOUR,
            "gyro_scale_error_ppm": _DEVIATIONS * grade.gyro_scale_sd / PPM,
            "gyro_non_orthogonality_mrad": pair,
            "accel_bias_mg": _DEVIATIONS * grade.accel_offset_sd / MG,
            "accel_scale_error_ppm": _DEVIATIONS * grade.accel_scale_sd / PPM,
            "accel_non_orthogonality_mrad": pair,
        },
        grade=name,
    )


def read_limits(path: Path) -> Limits:
    """Return the limits in a TOML file: `[limits]` with names as in `derived`.

    Raises
    ------
    RecordingError
        If it cannot be read, or names something else; the known names are listed.
    """
    try:
        content = tomllib.loads(read_text(path))
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", file=path) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise RecordingError(f"not valid TOML: {error}; write [limits], gyro_bias_deg_h = 20.0", file=path) from error
    table = content.get("limits")
    if not isinstance(table, dict) or set(content) != {"limits"}:
        raise RecordingError("expected one table, [limits]", file=path)
    known = {quantity.name for quantity in QUANTITIES}
    if not table:
        raise RecordingError(f"no limits in [limits]; known are {', '.join(sorted(known))}", file=path)
    for name, value in table.items():
        if name not in known:
            raise RecordingError(unknown_name("quantity", name, known), file=path)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < 1e300:
            raise RecordingError(f"limits.{name} = {value!r}: expected a number above zero", file=path)
    return Limits({name: float(value) for name, value in table.items()}, file=path.name)


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
    """Return the sensors' errors with expanded uncertainties, each against its limit."""
    out = []
    for quantity in QUANTITIES:
        found = parts.derived.get(quantity.name)
        if found is None:
            continue
        U = COVERAGE * found.deviation
        limit = None if limits is None else limits.values.get(quantity.name)
        seen = not any(_concerns(quantity, name) for name in parts.verdict.unobservable)
        seen &= not any(group_named(group).owner in parts.verdict.not_usable for group in quantity.groups)
        decisions: tuple[Decision, ...] = ()
        if limit is not None:
            decisions = tuple(_decided(x, u, limit, seen=seen) for x, u in zip(found.value, U, strict=True))
        out.append(QuantityDecision(quantity, found.value, U, limit, decisions, seen))
    return out


def _concerns(quantity: Quantity, parameter: str) -> bool:
    """Return whether a parameter, by its name, is one that a quantity depends on."""
    return any(parameter.startswith(f"{group_named(group).path}[") for group in quantity.groups)


def _decided(value: float, uncertainty: float, limit: float, *, seen: bool) -> Decision:
    if not seen or not np.isfinite([value, uncertainty]).all():
        return Decision.UNDECIDED
    if abs(value) + uncertainty <= limit:
        return Decision.CONFORMS
    return Decision.FAILS if abs(value) - uncertainty > limit else Decision.UNDECIDED
