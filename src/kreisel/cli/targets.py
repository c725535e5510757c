"""Accuracies to be reached, `--until accelerometer.offset=0.02mg`."""

from __future__ import annotations

import re
from collections.abc import Sequence

from kreisel.errors import SettingsError, unknown_name
from kreisel.model.groups import REGISTRY
from kreisel.units import DEG_PER_HOUR, MG, MM, MRAD, MS, PPM

_UNITS = {"mg": MG, "deg/h": DEG_PER_HOUR, "ppm": PPM, "mm": MM, "mrad": MRAD, "ms": MS}
"""Units that a target may have, in SI."""


def targets(texts: Sequence[str]) -> dict[str, float]:
    """Return standard deviations, SI, by group of parameters.

    Raises
    ------
    SettingsError
        For a text that is not GROUP=NUMBER UNIT, a group that there is not, or a unit that does not fit it.
    """
    return dict(_target(text) for text in texts)


def _target(text: str) -> tuple[str, float]:
    match = re.fullmatch(r"([a-z_.]+)\s*=\s*([0-9.eE+-]+)\s*([a-z/]*)", text.strip())
    if match is None:
        raise SettingsError(f"--until '{text}' is not GROUP=NUMBER and a unit ({', '.join(_UNITS)}), or none for SI")
    group, number, unit = match.groups()
    known = {one.path: one for one in REGISTRY if not one.passing and one.owner != "robot"}
    if group not in known:
        raise SettingsError(f"--until '{text}': {unknown_name('group', group, sorted(known))}")
    own = "ppm" if known[group].unit == "1" else known[group].unit
    if unit and (unit != own or unit not in _UNITS):
        expected = f"{own}, or none for SI" if own in _UNITS else "none: the number is in SI"
        raise SettingsError(f"--until '{text}': '{unit}' is no unit of {group}; expected {expected}")
    try:
        value = float(number)
    except ValueError as error:
        raise SettingsError(f"--until '{text}': '{number}' is not a number") from error
    if not value > 0.0:
        raise SettingsError(f"--until '{text}': expected a standard deviation above zero")
    return group, value * _UNITS.get(unit, 1.0)
