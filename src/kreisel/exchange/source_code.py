"""Source code that applies a calibration: for C and C++, for Rust, for MATLAB and Octave."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel._version import __version__
from kreisel.calibration.device_axes import AXES
from kreisel.errors import SettingsError
from kreisel.exchange.exported import Exported, Wanted
from kreisel.geometry.rotation import Array
from kreisel.inertial.effects import EFFECTS, follows_temperature
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.inertial.slopes import LONGEST_GAP

_RESERVED = frozenset({
    "break", "case", "catch", "classdef", "continue", "do", "else", "elseif", "end", "for", "function", "global", "if",
    "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "until", "while",
})  # fmt: skip
"""Words of MATLAB and Octave; in the other languages the name is the beginning of others only."""


@dataclass(frozen=True)
class Language:
    """What differs between languages.

    Attributes
    ----------
    template
        Name of the template.
    real
        Returns a number as the language writes it.
    absolute
        Returns the absolute value of an expression.
    """

    template: str
    real: Callable[[float], str]
    absolute: Callable[[str], str]


def _plain(x: float) -> str:
    return repr(float(x))


C = Language("imu.h", lambda x: f"(real){_plain(x)}", lambda x: f"({x} < 0 ? -{x} : {x})")
RUST = Language("imu.rs", _plain, lambda x: f"(if {x} < 0.0 {{ -{x} }} else {{ {x} }})")
MATLAB = Language("imu.m", _plain, lambda x: f"abs({x})")


def export_c(wanted: Wanted) -> Exported:
    """Return a header for C99 and C++, in double or single precision.

    Raises
    ------
    SettingsError
        For a name that cannot be one, or the printed form of the size effect.
    """
    return _exported(wanted, C)


def export_rust(wanted: Wanted) -> Exported:
    """Return a module for Rust, without std; errors as for `export_c`."""
    return _exported(wanted, RUST)


def export_matlab(wanted: Wanted) -> Exported:
    """Return a function for MATLAB and Octave; errors as for `export_c`. Its file must have the function's name."""
    done = _exported(wanted, MATLAB)
    return Exported(done.files, done.held, notes=(f"save it as {wanted.name}.m",))


def _exported(wanted: Wanted, language: Language) -> Exported:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    name, calibration = wanted.name, wanted.calibration
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,40}", name) or name in _RESERVED:
        raise SettingsError(
            f"--name {name}: expected a name of small letters, digits and underscores, such as imu_left"
        )
    if calibration.size_effect is not SizeEffect.COMPLETED:
        raise SettingsError(
            f"the size effect '{calibration.size_effect.value}' is for comparisons; calibrate with the completed form"
        )
    environment = Environment(
        loader=PackageLoader("kreisel.exchange"), undefined=StrictUndefined, keep_trailing_newline=True
    )
    context = _context(wanted, language)
    return Exported({"": environment.get_template(language.template).render(context)}, calibration.sensors)


def _context(wanted: Wanted, language: Language) -> dict[str, Any]:
    calibration = wanted.calibration
    p, facts, real = calibration.sensors, calibration.recording, language.real
    temperature = 0.0 if facts is None or facts.temperature_c is None else facts.temperature_c
    rate = wanted.rate_hz or (facts.imu_rate_hz if facts is not None else 0.0)
    gyro, accel = _terms(p, language, "gyroscope"), _terms(p, language, "accelerometer")
    return {
        "name": wanted.name,
        "NAME": wanted.name.upper(),
        "device": _one_line("IMU" if facts is None else facts.title),
        "version": __version__,
        "axes": f"{calibration.axes}, {AXES[calibration.axes]}",
        "notes": [_one_line(note) for note in _notes(wanted)],
        "real": real,
        "temperature": temperature,
        "temperature_c": temperature,
        "needs_temperature": follows_temperature(p.others),
        "gap_ns": round(1e9 * max(LONGEST_GAP, 5.0 / rate if rate else 0.0)),
        "gyro": gyro,
        "accel": accel,
        "K_omega": _products(p.K_omega, real),
        "K_a": _products(p.K_a, real),
        "sensitive": [", ".join(map(real, row)) for row in np.linalg.inv(p.K_a).tolist()],
        "places": [", ".join(map(real, row)) for row in p.lever_arms.tolist()],
        "m": _matlab(p),
    }


def _notes(wanted: Wanted) -> list[str]:
    facts, lost = wanted.calibration.recording, wanted.calibration.verdict.unobservable
    notes = [] if facts is None or facts.digest is None else [f"Data: SHA-256 {facts.digest}."]
    return notes + ([f"Not observable, do not rely on: {', '.join(lost)}."] if lost else [])


def _one_line(text: str) -> str:
    """Return a text that ends no comment, whatever the user's fields hold."""
    plain = "".join(character if character.isprintable() else " " for character in text)
    return plain.replace("*/", "* /").replace("\\", "/").replace("??/", "? ?/")


def _products(K: Array, real: Callable[[float], str]) -> list[str]:
    return [" + ".join(f"{real(value)} * x[{j}]" for j, value in enumerate(row)) for row in K.tolist()]


def _terms(p: SensorParameters, language: Language, sensor: str) -> list[str]:
    """Return for each axis the sum of raw reading, effects and offset.

    Over arrays w, a, da, dda and `temperature_difference`.
    """
    own, offset = ("w", p.k_w[0]) if sensor == "gyroscope" else ("a", p.k_a[0])
    sums = [[f"{own}[{j}]"] for j in range(3)]
    for group, value in p.effects.items():
        flat = np.asarray(value, dtype=float).ravel()
        if EFFECTS[group].sensor != sensor or not np.any(flat):
            continue
        for j in range(3):
            sums[j] += _effect(group, flat, j, own, language)
    for j in range(3):
        sums[j].append(language.real(float(offset[j])))
    return [" + ".join(one) for one in sums]


def _effect(group: str, value: Array, j: int, own: str, language: Language) -> list[str]:
    """Return what an effect adds to the reading of axis j; see `inertial.effects`."""
    real, kind = language.real, group.split("_", 1)[1]
    x = f"{own}[{j}]"
    if kind == "polynomial":
        return [f"{real(c)} * {' * '.join([x] * (i + 2))}" for i, c in enumerate(value.reshape(-1, 3)[:, j])]
    if kind == "g_sensitivity":
        return [f"{real(c)} * a[{k}]" for k, c in enumerate(value.reshape(3, 3)[j])]
    if kind == "g_squared":
        return [f"{real(c)} * a[{k}] * a[{k}]" for k, c in enumerate(value.reshape(3, 3)[j])]
    one = {
        "asymmetry": lambda: f"{real(value[j])} * {language.absolute(x)}",
        "temperature": lambda: f"{real(value[j])} * temperature_difference",
        "scale_temperature": lambda: f"{real(value[j])} * {x} * temperature_difference",
        "delay": lambda: f"{real(value[0])} * da[{j}]",
        "smoothing": lambda: f"{real(-value[0])} * dda[{j}]",
    }
    if kind not in one:
        raise SettingsError(f"{group} is a part of the noise, and not of a calibration")
    return [one[kind]()]


def _matlab(p: SensorParameters) -> dict[str, str]:
    """Return matrices and sums over whole columns, as MATLAB writes them."""

    def matrix(values: Array) -> str:
        return "; ".join(", ".join(map(_plain, row)) for row in values.tolist())

    sums = {"gyroscope": ["w", f"[{matrix(p.k_w[:1])}]"], "accelerometer": ["a", f"[{matrix(p.k_a[:1])}]"]}
    for group, value in p.effects.items():
        flat = np.asarray(value, dtype=float).ravel()
        if np.any(flat):
            sensor = EFFECTS[group].sensor
            own = "w" if sensor == "gyroscope" else "a"
            sums[sensor] += _matlab_effect(group.split("_", 1)[1], flat, own, matrix)
    return {
        "K_omega": matrix(p.K_omega),
        "K_a": matrix(p.K_a),
        "places": matrix(p.lever_arms),
        "gyro": " + ".join(sums["gyroscope"]),
        "accel": " + ".join(sums["accelerometer"]),
    }


def _matlab_effect(kind: str, value: Array, own: str, matrix: Callable[[Array], str]) -> list[str]:
    if kind == "polynomial":
        return [f"[{matrix(row[None])}] .* {own} .^ {i + 2}" for i, row in enumerate(value.reshape(-1, 3))]
    if kind in ("g_sensitivity", "g_squared"):
        power = " .^ 2" if kind == "g_squared" else ""
        return [f"(a{power}) * [{matrix(value.reshape(3, 3))}]'"]
    row = f"[{matrix(value[None])}]"
    return [{
        "asymmetry": f"{row} .* abs({own})",
        "temperature": f"temperature_difference * {row}",
        "scale_temperature": f"{row} .* {own} .* temperature_difference",
        "delay": f"{_plain(value[0])} * slope(a)",
        "smoothing": f"{_plain(-value[0])} * curvature(a)",
    }[kind]]  # fmt: skip
