"""Free navigation through exact readings ends where the motion does; the motion is the oracle's."""

import numpy as np
import pytest

from kreisel.geometry.rotation import conjugate, log, multiply
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.inertial.strapdown import prepare

from ..navigation import navigate
from ..oracle.motion import AnalyticMotion, inertial_truth, raw_readings

GRAVITY = np.array([0.02, -0.01, -9.8094])
EARTH = np.array([1e-8, 4.76e-5, 5.52e-5])


def closure(seed, rate, parameters=None, duration=60.0):
    motion = AnalyticMotion(np.random.default_rng(seed), duration=duration)
    t = np.arange(round(duration * rate) + 1) / rate
    omega, alpha, f = inertial_truth(motion, t, GRAVITY, EARTH)
    sensors = SensorParameters.ideal()
    if parameters is not None:
        omega, f = raw_readings(omega, alpha, f, parameters)
        sensors = SensorParameters(*(parameters[k] for k in ("K_omega", "k_w", "K_a", "k_a", "lever_arms")))
    start = t[:1]
    stamps, q, _, p = navigate(
        prepare(t, omega, f),
        sensors,
        motion.attitude(start)[0],
        motion.velocity(start)[0],
        motion.position(start)[0],
        GRAVITY,
        EARTH,
        stride=192,
    )
    attitude = np.linalg.norm(log(multiply(conjugate(q), motion.attitude(stamps))), axis=1)
    position = np.linalg.norm(p - motion.position(stamps), axis=1)
    print(f"seed {seed}, {rate:g} Hz: {attitude.max():.3g} rad, {position.max():.3g} m")
    return float(attitude.max()), float(position.max())


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_sixty_seconds_at_400_hz(seed):
    """The goals are 0.01 microrad and 5 micrometres, peaks of 190 deg/s."""
    attitude, position = closure(seed, 400.0)
    assert attitude < 1e-8
    assert position < 5e-6


def test_the_order_is_six():
    coarse, fine = closure(1, 50.0, duration=20.0), closure(1, 100.0, duration=20.0)
    assert 45.0 < coarse[0] / fine[0] < 90.0
    assert 45.0 < coarse[1] / fine[1] < 90.0


def test_with_sensor_errors_and_lever_arms():
    """The lever arms need the rate's derivative from samples: of the fourth order."""
    rng = np.random.default_rng(5)
    parameters = {
        "K_omega": np.eye(3) + rng.normal(0, 0.01, (3, 3)),
        "k_w": rng.normal(0, 1e-4, (1, 3)),
        "K_a": np.eye(3) + rng.normal(0, 0.01, (3, 3)),
        "k_a": rng.normal(0, 0.1, (1, 3)),
        "lever_arms": rng.normal(0, 0.05, (3, 3)),
    }
    attitude, position = closure(1, 400.0, parameters)
    assert attitude < 1e-8
    assert position < 5e-6
