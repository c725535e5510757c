"""Lines of NumPy that apply a calibration."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.inertial.effect_formulas import ArrayLanguage, of_arrays
from kreisel.inertial.effects import EFFECTS, Factor, follows_temperature
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

_NUMPY = ArrayLanguage(
    factors=lambda factor, own: {
        Factor.READING: own,
        Factor.MAGNITUDE: f"np.abs({own})",
        Factor.FORCE: "accelerations",
        Factor.SLOPE: f"derivative({own}, 1)",
        Factor.CURVATURE: f"-derivative({own}, 2)",
        Factor.TEMPERATURE: "temperature_difference",
    }[factor],
    product=" * ".join,
    power=lambda text, n: f"{text}**{n}",
    by_matrix=lambda text, matrix: f"{text} @ {matrix}.T",
    array=lambda values: _values(values),
    number=lambda value: _values([value]),
)


def _without_effects(sensors: SensorParameters) -> list[str]:
    """Return rates and accelerations corrected for effects beyond offset and matrix, as NumPy."""
    own = {"gyroscope": "rates", "accelerometer": "accelerations"}
    terms = {sensor: [raw] for sensor, raw in own.items()}
    for group, value in sensors.effects.items():
        if np.any(value):
            sensor = EFFECTS[group].sensor
            terms[sensor] += of_arrays(group, value, own[sensor], _NUMPY)
    return [" + ".join(one) for one in terms.values()]


def _values(array: Array | Sequence[float]) -> str:
    return f"np.array({json.dumps(_rounded(np.asarray(array)), separators=(', ', ': '))})"


def _rounded(array: Array) -> list[Any]:
    return [_rounded(row) if row.ndim else float(f"{row:.9g}") for row in array]
