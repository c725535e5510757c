"""Lines of NumPy that apply a calibration."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.inertial.effects import EFFECTS, follows_temperature
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect


def snippet(sensors: SensorParameters, form: SizeEffect, temperature: float | None = None) -> str:
    """Return lines of NumPy that apply the calibration: rates, accelerations (n, 3), t (n,) to omega, f.

    temperature: that of the parameters, degrees Celsius; T (n,) is then needed, too, if there are coefficients for it.
    """
    warm = follows_temperature(sensors.others)
    lines = [
        "import numpy as np",
        *_DERIVATIVE,
        *(
            [
                f"temperature_difference = (T - {temperature or 0.0:.2f})[:, None]"
                "  # T (n,): the sensor's temperature, degC"
            ]
            * warm
        ),
        f"K_w, k_w = {_values(sensors.K_omega)}, {_values(sensors.k_w[0])}",
        f"K_a, k_a = {_values(sensors.K_a)}, {_values(sensors.k_a[0])}",
        f"r = {_values(sensors.lever_arms)}  # row j: position of accelerometer j in b, m",
        f"w, a = {', '.join(_without_effects(sensors))}",
        "omega = (w + k_w) @ K_w.T  # (n, 3), rad/s",
        "alpha = derivative(omega, 1)",
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


_DERIVATIVE = (
    "def derivative(x, order):  # of the cubic closest to the seven samples around each; t has no gaps",
    "    k = np.clip(np.arange(len(t)) - 3, 0, len(t) - 7)[:, None] + np.arange(7)",
    "    u, s = t[k] - t[:, None], np.ptp(t[k], axis=1)[:, None]",
    "    weights = np.linalg.pinv((u / s)[..., None] ** np.arange(4))[:, order] * order / s**order",
    "    return np.einsum('nk,nkj->nj', weights, x[k])",
)
"""As `inertial.slopes`, for orders 1 and 2."""

_EFFECT_FORMULAS = {
    "gyro_g_sensitivity": "accelerations @ {matrix}.T",
    "gyro_g_squared": "accelerations**2 @ {matrix}.T",
    "gyro_asymmetry": "{value} * np.abs(rates)",
    "gyro_temperature": "{value} * temperature_difference",
    "gyro_scale_temperature": "{value} * rates * temperature_difference",
    "accel_asymmetry": "{value} * np.abs(accelerations)",
    "accel_delay": "{value} * derivative(accelerations, 1)",
    "accel_smoothing": "-{value} * derivative(accelerations, 2)",
    "accel_temperature": "{value} * temperature_difference",
    "accel_scale_temperature": "{value} * accelerations * temperature_difference",
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
