"""Equations (1) and (2) against readings made by the oracle, which shares no code with the model."""

import numpy as np
import pytest

from kreisel.inertial.effects import EFFECTS
from kreisel.inertial.sensor_model import (
    FORMULA,
    SensorParameters,
    SizeEffect,
    correct_specific_force,
    size_effect,
)
from kreisel.model.groups import group_named

from ...navigation import corrected
from ...oracle.motion import AnalyticMotion, inertial_truth, raw_readings

GRAVITY = np.array([0.01, -0.02, -9.81])
EARTH = np.array([0.0, 4.8e-5, 5.5e-5])


def parameters(rng, order, mount=None):
    return {
        "K_omega": (np.eye(3) if mount is None else mount) + rng.normal(0, 0.02, (3, 3)),
        "k_w": np.vstack([rng.normal(0, 1e-3, (1, 3)), rng.normal(0, 2e-3, (order - 1, 3))]),
        "K_a": (np.eye(3) if mount is None else mount) + rng.normal(0, 0.02, (3, 3)),
        "k_a": np.vstack([rng.normal(0, 0.1, (1, 3)), rng.normal(0, 2e-4, (order - 1, 3))]),
        "lever_arms": rng.normal(0, 0.05, (3, 3)),
    }


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("mount", [None, np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])])
def test_corrected_readings_are_the_truth(order, mount):
    rng = np.random.default_rng(order)
    t = np.linspace(0.0, 10.0, 400)
    omega, alpha, f = inertial_truth(AnalyticMotion(rng, duration=10.0), t, GRAVITY, EARTH)
    p = parameters(rng, order, mount)
    w_raw, a_raw = raw_readings(omega, alpha, f, p)
    ours = SensorParameters(p["K_omega"], p["k_w"], p["K_a"], p["k_a"], p["lever_arms"])
    found = corrected(t, w_raw, a_raw, ours, alpha)
    np.testing.assert_allclose(found[0], omega, atol=1e-13)
    np.testing.assert_allclose(found[1], f, atol=1e-12)


def test_products_of_rates_are_five_milli_g():
    """The figure of the mission's errata: 1 rad/s on two axes and 5 cm."""
    lever_arms = np.tile([0.0, 0.05, 0.0], (3, 1))
    p = SensorParameters(np.eye(3), np.zeros((1, 3)), np.eye(3), np.zeros((1, 3)), lever_arms)
    omega, alpha = np.array([[1.0, 1.0, 0.0]]), np.zeros((1, 3))
    lost = size_effect(omega, alpha, p) - size_effect(omega, alpha, p, SizeEffect.FOX2005)  # K_a is the identity
    assert abs(lost[0, 0]) / 9.80665e-3 == pytest.approx(5.1, abs=0.05)


def test_printed_form_is_the_printed_equation():
    """Equation (2) of the paper, written out letter by letter; u_xy is the x coordinate of accelerometer y."""
    rng = np.random.default_rng(0)
    K, lever = np.eye(3) + rng.normal(0, 0.05, (3, 3)), rng.normal(0, 0.05, (3, 3))
    w, dw, raw = rng.normal(0, 1, 3), rng.normal(0, 3, 3), rng.normal(0, 9, 3)
    (uxx, uyx, uzx), (uxy, uyy, uzy), (uxz, uyz, uzz) = lever
    printed = K @ raw + np.array(
        [
            uxx * (w[2] ** 2 + w[1] ** 2) + uyx * dw[2] - uzx * dw[1],
            uyy * (w[0] ** 2 + w[2] ** 2) + uzy * dw[0] - uxy * dw[2],
            uzz * (w[0] ** 2 + w[1] ** 2) + uxz * dw[1] - uyz * dw[0],
        ]
    )
    p = SensorParameters(np.eye(3), np.zeros((1, 3)), K, np.zeros((1, 3)), lever)
    ours = correct_specific_force(raw[None], w[None], dw[None], p, SizeEffect.FOX2005)
    np.testing.assert_allclose(ours[0], printed, atol=1e-13)


def test_the_formula_names_every_effect_of_the_readings():
    paths = (group_named(group).path.split(".") for group in EFFECTS)
    names = {name for _, name in paths} - {"polynomial", "gauss_markov"}  # k_wi, and what is zero on average
    assert {name for name in names if name not in FORMULA["readings"]} == set()
