"""The unit all speeds are quoted in: one compiled strapdown pass over the same samples, plain and for one state.

Mean rate with the coning term, velocity and position by the trapezoidal rule; nothing is calibrated.
"""

import time

import numpy as np

from kreisel._kernels.compilation import kernel
from kreisel.geometry.rotation import Array


@kernel
def strapdown_pass(rates: Array, forces: Array, dt: float, gravity: Array, q: Array, v: Array, p: Array) -> None:
    """Navigate through samples (n, 3), in place: attitude q (4,), velocity and position (3,)."""
    for k in range(rates.shape[0] - 1):
        a, b = rates[k], rates[k + 1]
        c = dt * dt / 12.0
        x = 0.5 * dt * (a[0] + b[0]) + c * (a[1] * b[2] - a[2] * b[1])
        y = 0.5 * dt * (a[1] + b[1]) + c * (a[2] * b[0] - a[0] * b[2])
        z = 0.5 * dt * (a[2] + b[2]) + c * (a[0] * b[1] - a[1] * b[0])
        ux, uy, uz = turned(q, forces[k])
        h = 0.25 * (x * x + y * y + z * z)
        cosine = 1.0 - h / 2.0 + h * h / 24.0
        sinc = 0.5 * (1.0 - h / 6.0 + h * h / 120.0)
        x *= sinc
        y *= sinc
        z *= sinc
        q0, q1, q2, q3 = q[0], q[1], q[2], q[3]
        q[0] = q0 * cosine - q1 * x - q2 * y - q3 * z
        q[1] = q0 * x + q1 * cosine + q2 * z - q3 * y
        q[2] = q0 * y - q1 * z + q2 * cosine + q3 * x
        q[3] = q0 * z + q1 * y - q2 * x + q3 * cosine
        wx, wy, wz = turned(q, forces[k + 1])
        p[0] += dt * v[0] + dt * dt * ((2.0 * ux + wx) / 6.0 + 0.5 * gravity[0])
        p[1] += dt * v[1] + dt * dt * ((2.0 * uy + wy) / 6.0 + 0.5 * gravity[1])
        p[2] += dt * v[2] + dt * dt * ((2.0 * uz + wz) / 6.0 + 0.5 * gravity[2])
        v[0] += dt * (0.5 * (ux + wx) + gravity[0])
        v[1] += dt * (0.5 * (uy + wy) + gravity[1])
        v[2] += dt * (0.5 * (uz + wz) + gravity[2])


@kernel
def turned(q: Array, f: Array) -> tuple[float, float, float]:
    """Return f (3,) turned by q (4,)."""
    x = 2.0 * (q[2] * f[2] - q[3] * f[1])
    y = 2.0 * (q[3] * f[0] - q[1] * f[2])
    z = 2.0 * (q[1] * f[1] - q[2] * f[0])
    return (
        f[0] + q[0] * x + q[2] * z - q[3] * y,
        f[1] + q[0] * y + q[3] * x - q[1] * z,
        f[2] + q[0] * z + q[1] * y - q[2] * x,
    )


def seconds(rates: Array, forces: Array, interval: float, repeats: int = 7) -> float:
    """Return the time of one pass over readings (n, 3): the median of a few."""
    times = []
    for _ in range(repeats + 1):
        q, v, p = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3)
        began = time.perf_counter()
        strapdown_pass(rates, forces, interval, np.array([0.0, 0.0, -9.8]), q, v, p)
        times.append(time.perf_counter() - began)
    return float(np.median(times[1:]))
