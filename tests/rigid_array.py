"""IMUs on a rigid body of known motion: readings by differences of positions and attitudes."""

import numpy as np

from kreisel.geometry.rotation import conjugate, exp, log, matrix, multiply
from kreisel.recording.recording import ImuSamples

GRAVITY = np.array([0.0, 0.0, -9.81])
STEP = 1e-4


def shaken(rng, seconds=40.0, size=1.0):
    """Return functions of time: position (n, 3) and attitude (n, 4) of a body that is shaken about all axes."""
    frequencies = rng.uniform(0.5, 3.0, size=(2, 6, 3))
    phases = rng.uniform(0.0, 2.0 * np.pi, size=(2, 6, 3))
    sizes = np.array([0.02, 0.35 * size])[:, None, None] * rng.normal(size=(2, 6, 3))

    def wave(k, t):
        u = np.clip(t / 2.0, 0.0, 1.0)[:, None]
        ramp = u**4 * (35.0 - 84.0 * u + 70.0 * u**2 - 20.0 * u**3)
        return ramp * np.sum(
            sizes[k] * np.sin(frequencies[k] * 2.0 * np.pi * t[:, None, None] / 2.0 + phases[k]), axis=1
        )

    return (lambda t: wave(0, t)), (lambda t: exp(wave(1, t)))


def readings_at(position, attitude, place, axes, t):
    """Return rates and specific forces (n, 3) of an IMU at a place; axes (3, 3) turn its vectors to the body's."""

    def point(s):
        return position(s) + matrix(attitude(s)) @ place

    before, now, after = attitude(t - STEP), attitude(t), attitude(t + STEP)
    rates = log(multiply(conjugate(before), after)) / (2.0 * STEP)
    accelerations = (point(t + STEP) - 2.0 * point(t) + point(t - STEP)) / STEP**2
    forces = np.einsum("nji,nj->ni", matrix(now), accelerations - GRAVITY)
    return rates @ axes, forces @ axes


def recorded(t, rates, forces, path, *, start_ns=10**9, drift=0.0):
    """Return samples stamped by a clock of its own."""
    stamps = start_ns + np.round((1.0 + drift) * t * 1e9).astype(np.int64)
    return ImuSamples(stamps, rates, forces, path / "data.csv")
