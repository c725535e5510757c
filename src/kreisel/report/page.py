"""The page itself: one HTML file that needs only a browser."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.calibration.evidence import Injection
from kreisel.calibration.outcome import Outcome
from kreisel.filtering.effect_selection import MIN_GAIN
from kreisel.geometry.rotation import Array
from kreisel.inertial.effects import EFFECTS, follows_temperature
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.report import figures, tables
from kreisel.report.data import ReportData, extract
from kreisel.report.plots import Figure
from kreisel.report.template import fill


def write_report(
    outcome: Outcome,
    path: Path,
    *,
    injection: Injection | None = None,
) -> None:
    """Write the report of a calibration as one HTML file that works offline.

    Parameters
    ----------
    injection
        Validations; the report names the missing ones.
    """
    Path(path).write_text(render(extract(outcome, injection)), encoding="utf-8")


def render(data: ReportData) -> str:
    """Return the page."""
    drawn = _figures(data)
    return fill(
        "report.html",
        [f for part in drawn.values() for f in part],
        document=data.outcome.calibration.document,
        warnings=data.outcome.warnings,
        verdict=data.outcome.verdict,
        unobservable=tables.unobservable_by_group(data.outcome),
        not_estimated=tables.not_estimated(data.outcome),
        figures=drawn,
        min_gain=MIN_GAIN,
        snippet=snippet(
            data.outcome.calibration.sensors,
            data.outcome.calibration.size_effect,
            data.outcome.recording.imu.usual_temperature,
        ),
        **_tables(data),
    )


def _figures(data: ReportData) -> dict[str, list[Figure]]:
    groups = dict(zip(data.uncertainty.names, data.uncertainty.groups, strict=True))
    estimated = bool(data.uncertainty.names)
    return {
        "excitation": figures.excitation_figures(data.excitation),
        "residuals": figures.residual_figures(data.residuals),
        "difference": figures.difference_figures(data.difference),
        "tracks": figures.track_figures(data.uncertainty),
        "correlations": [figures.matrix_figure(data.uncertainty)] if estimated else [],
        "drift": [] if data.unseen is None else figures.drift_figures(data.unseen),
        "halves": [] if data.halves is None else [figures.halves_figure(data.halves, groups)],
    }


def _tables(data: ReportData) -> dict[str, Any]:
    groups = dict(zip(data.uncertainty.names, data.uncertainty.groups, strict=True))
    outcome = data.outcome
    return {
        "key": tables.key_table(outcome),
        "excitation_table": tables.excitation_table(data.excitation),
        "clock_table": tables.clock_table(outcome, data.excitation),
        "excitation": data.excitation,
        "nis_table": tables.nis_table(data.residuals),
        "noise_table": tables.noise_table(outcome),
        "cause_table": tables.cause_table(data.difference),
        "robot_tables": tables.robot_tables(outcome),
        "parameter_table": tables.parameter_table(data),
        "considered_table": tables.considered_table(outcome),
        "drift_table": None if data.unseen is None else tables.drift_table(data.unseen),
        "unseen": data.unseen,
        "scores": None if data.halves is None else tables.score_summary(data.halves),
        "injection_table": None if data.injection is None else tables.injection_table(data.injection, groups),
    }


def snippet(sensors: SensorParameters, form: SizeEffect, temperature: float | None = None) -> str:
    """Return lines of NumPy that apply the calibration: rates, accelerations (n, 3), t (n,) to omega, f.

    temperature: that of the parameters, degrees Celsius; T (n,) is then needed, too, if there are coefficients for it.
    """
    warm = follows_temperature(sensors.others)
    lines = [
        "import numpy as np",
        *([f"warmth = (T - {temperature or 0.0:.2f})[:, None]  # T (n,): the sensor's temperature, degC"] * warm),
        f"K_w, k_w = {_values(sensors.K_omega)}, {_values(sensors.k_w[0])}",
        f"K_a, k_a = {_values(sensors.K_a)}, {_values(sensors.k_a[0])}",
        f"r = {_values(sensors.lever_arms)}  # row j: position of accelerometer j in b, m",
        f"w, a = {', '.join(_without_effects(sensors))}",
        "omega = (w + k_w) @ K_w.T  # (n, 3), rad/s",
        "alpha = np.gradient(omega, t, axis=0)",
    ]
    if form is not SizeEffect.COMPLETED:
        return "\n".join([*lines, f"# size effect '{form.value}': use kreisel's Calibration.correct"])
    return "\n".join(
        [
            *lines,
            "W, A = omega[:, None], alpha[:, None]",
            "e = np.einsum('jk,njk->nj', np.linalg.inv(K_a), np.cross(A, r) + np.cross(W, np.cross(W, r)))",
            "f = (a + k_a - e) @ K_a.T  # (n, 3), m/s^2, at the origin of b",
        ]
    )


_EFFECT_FORMULAS = {
    "gyro_g_sensitivity": "accelerations @ {matrix}.T",
    "gyro_g_squared": "accelerations**2 @ {matrix}.T",
    "gyro_asymmetry": "{value} * np.abs(rates)",
    "gyro_temperature": "{value} * warmth",
    "gyro_scale_temperature": "{value} * rates * warmth",
    "accel_asymmetry": "{value} * np.abs(accelerations)",
    "accel_delay": "{value} * np.gradient(accelerations, t, axis=0)",
    "accel_smoothing": "-{value} * np.gradient(np.gradient(accelerations, t, axis=0), t, axis=0)",
    "accel_temperature": "{value} * warmth",
    "accel_scale_temperature": "{value} * accelerations * warmth",
}
"""What each effect adds to the readings, as NumPy; see `inertial.effects`."""


def _without_effects(sensors: SensorParameters) -> list[str]:
    """Return rates and accelerations corrected for effects beyond offset and matrix, as NumPy."""
    terms: dict[str, list[str]] = {"gyroscope": ["rates"], "accelerometer": ["accelerations"]}
    for raw, k in (("rates", sensors.k_w), ("accelerations", sensors.k_a)):
        powers = [f"{_values(k[i])} * {raw}**{i + 1}" for i in range(1, k.shape[0]) if k[i].any()]
        terms["gyroscope" if raw == "rates" else "accelerometer"] += powers
    for group, value in sensors.others.items():
        if np.any(value):
            matrix = _values(value.reshape(3, 3)) if value.size == 9 else ""
            terms[EFFECTS[group].sensor].append(_EFFECT_FORMULAS[group].format(value=_values(value), matrix=matrix))
    return [" + ".join(own) for own in terms.values()]


def _values(array: Array | Sequence[float]) -> str:
    return f"np.array({json.dumps(_rounded(np.asarray(array)), separators=(', ', ': '))})"


def _rounded(array: Array) -> list[Any]:
    return [_rounded(row) if row.ndim else float(f"{row:.9g}") for row in array]
