"""Source code that applies a calibration: for C and C++, for Rust, for MATLAB and Octave."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from kreisel._version import __version__
from kreisel.calibration.device_axes import AXES
from kreisel.errors import SettingsError
from kreisel.exchange.exported import Exported, ExportRequest
from kreisel.geometry.rotation import Array
from kreisel.inertial.effect_formulas import ArrayLanguage, AxisLanguage, of_arrays, of_axis
from kreisel.inertial.effects import EFFECTS, Factor, follows_temperature, reaches_further
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.inertial.slopes import LONGEST_GAP, REACH

_RESERVED = frozenset({
    "column", "cross", "derivatives", "index", "inv", "max", "min", "numel", "pinv", "real", "repmat", "size", "slope",
    "sum", "temperature", "weighted", "zeros",
    "break", "case", "catch", "classdef", "continue", "do", "else", "elseif", "end", "for", "function", "global", "if",
    "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "until", "while",
})  # fmt: skip
"""Names in the function for MATLAB and Octave, and words of these; in the other languages the name is the beginning of
others only."""


def _plain(x: float) -> str:
    return repr(float(x))


def _factor(factor: Factor, own: str, axis: int, absolute: Callable[[str], str]) -> str:
    """Return a factor over arrays w, dw, ddw, a, da, dda and `temperature_difference`."""
    return {
        Factor.READING: f"{own}[{axis}]",
        Factor.MAGNITUDE: absolute(f"{own}[{axis}]"),
        Factor.FORCE: f"a[{axis}]",
        Factor.SLOPE: f"d{own}[{axis}]",
        Factor.CURVATURE: f"(-dd{own}[{axis}])",
        Factor.TEMPERATURE: "temperature_difference",
    }[factor]


C = AxisLanguage(partial(_factor, absolute=lambda x: f"({x} < 0 ? -{x} : {x})"), lambda x: f"(real){_plain(x)}")
RUST = AxisLanguage(partial(_factor, absolute=lambda x: f"(if {x} < 0.0 {{ -{x} }} else {{ {x} }})"), _plain)


def _matrix(values: Array) -> str:
    return f"[{'; '.join(', '.join(map(_plain, row)) for row in np.atleast_2d(values).tolist())}]"


MATLAB = ArrayLanguage(
    factors=lambda factor, own: {
        Factor.READING: own,
        Factor.MAGNITUDE: f"abs({own})",
        Factor.FORCE: "a",
        Factor.SLOPE: f"slope({own})",
        Factor.CURVATURE: f"(-curvature({own}))",
        Factor.TEMPERATURE: "temperature_difference",
    }[factor],
    product=" .* ".join,
    power=lambda text, n: f"{text} .^ {n}",
    by_matrix=lambda text, matrix: f"({text}) * {matrix}'",
    array=_matrix,
    number=_plain,
)


def export_c(request: ExportRequest) -> Exported:
    """Return a header for C99 and C++, in double or single precision.

    Raises
    ------
    SettingsError
        For a name that cannot be one, or the printed form of the size effect.
    """
    return _exported(request, "imu.h", C.number, _by_axis(request, C))


def export_rust(request: ExportRequest) -> Exported:
    """Return a module for Rust, without std; errors as for `export_c`."""
    return _exported(request, "imu.rs", RUST.number, _by_axis(request, RUST))


def export_matlab(request: ExportRequest) -> Exported:
    """Return a function for MATLAB and Octave; errors as for `export_c`. Its file must have the function's name."""
    done = _exported(request, "imu.m", MATLAB.number, _by_arrays(request))
    return Exported(done.files, done.held, notes=(f"save it as {request.name}.m",))


def _exported(
    request: ExportRequest, template: str, number: Callable[[float], str], parameters: dict[str, Any]
) -> Exported:
    """Return a template filled; number: as the language writes it; parameters: those of the sensors, so written."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    name, calibration = request.name, request.calibration
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
    context = {**_context(request), "real": number, **parameters}
    return Exported({"": environment.get_template(template).render(context)}, calibration.sensors)


def _context(request: ExportRequest) -> dict[str, Any]:
    """Return what templates of all languages name, but for the sensors' parameters."""
    calibration, facts = request.calibration, request.calibration.recording
    temperature = 0.0 if facts is None or facts.temperature_c is None else facts.temperature_c
    rate = request.rate_hz or (facts.imu_rate_hz if facts is not None else 0.0)
    return {
        "name": request.name,
        "NAME": request.name.upper(),
        "device": _one_line("IMU" if facts is None else facts.title),
        "version": __version__,
        "axes": f"{calibration.axes}, {AXES[calibration.axes]}",
        "notes": [_one_line(note) for note in _notes(request)],
        "temperature": temperature,
        "temperature_c": temperature,
        "needs_temperature": follows_temperature(calibration.sensors.others),
        "later": REACH if reaches_further(calibration.sensors.others) else 0,
        "late_by": "six" if reaches_further(calibration.sensors.others) else "three",
        "gap_ns": round(1e9 * max(LONGEST_GAP, 5.0 / rate if rate else 0.0)),
    }


def _by_axis(request: ExportRequest, language: AxisLanguage) -> dict[str, Any]:
    """Return the parameters for a template that computes axis by axis."""
    p, real = request.calibration.sensors, language.number
    return {
        "gyro": _terms(p, language, "gyroscope"),
        "accel": _terms(p, language, "accelerometer"),
        "K_omega": _products(p.K_omega, real),
        "K_a": _products(p.K_a, real),
        "sensitive": [", ".join(map(real, row)) for row in np.linalg.inv(p.K_a).tolist()],
        "places": [", ".join(map(real, row)) for row in p.lever_arms.tolist()],
    }


def _notes(request: ExportRequest) -> list[str]:
    facts, lost = request.calibration.recording, request.calibration.verdict.unobservable
    notes = list(request.caveats)
    notes += [] if facts is None or facts.digest is None else [f"Data: SHA-256 {facts.digest}."]
    return notes + ([f"Not observable, do not rely on: {', '.join(lost)}."] if lost else [])


def _one_line(text: str) -> str:
    """Return a text that ends no comment, whatever the user's fields hold."""
    plain = "".join(character if character.isprintable() else " " for character in text)
    return plain.replace("*/", "* /").replace("\\", "/").replace("??/", "? ?/")


def _products(K: Array, real: Callable[[float], str]) -> list[str]:
    return [" + ".join(f"{real(value)} * x[{j}]" for j, value in enumerate(row)) for row in K.tolist()]


def _terms(p: SensorParameters, language: AxisLanguage, sensor: str) -> list[str]:
    """Return for each axis the sum of raw reading, effects and offset."""
    own, offset = ("w", p.k_w[0]) if sensor == "gyroscope" else ("a", p.k_a[0])
    groups = _effects_of(p, sensor)
    return [
        " + ".join([
            f"{own}[{j}]",
            *(term for group, value in groups.items() for term in of_axis(group, value, j, own, language)),
            language.number(float(offset[j])),
        ])
        for j in range(3)
    ]  # fmt: skip


def _by_arrays(request: ExportRequest) -> dict[str, Any]:
    """Return matrices, and sums over whole columns, as MATLAB writes them."""
    p = request.calibration.sensors
    sums = {
        sensor: " + ".join([
            own, _matrix(offset),
            *(term for group, value in _effects_of(p, sensor).items() for term in of_arrays(group, value, own, MATLAB)),
        ])
        for sensor, own, offset in (("gyroscope", "w", p.k_w[0]), ("accelerometer", "a", p.k_a[0]))
    }  # fmt: skip
    return {
        "K_omega": _matrix(p.K_omega),
        "K_a": _matrix(p.K_a),
        "places": _matrix(p.lever_arms),
        "gyro": sums["gyroscope"],
        "accel": sums["accelerometer"],
    }


def _effects_of(p: SensorParameters, sensor: str) -> dict[str, Array]:
    """Return the effects of a sensor that are not zero."""
    return {g: value for g, value in p.effects.items() if EFFECTS[g].sensor == sensor and np.any(value)}
