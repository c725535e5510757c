"""Splines of poses: against their definition, finite differences, and motions they can and cannot follow."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from kreisel.geometry.pose_spline import ORDER, PoseSpline, centres, count_of, motion_at, weights
from kreisel.geometry.rotation import conjugate, exp, log, multiply

SPACING = 0.1


def spline(seed=0, count=20):
    rng = np.random.default_rng(seed)
    turns = np.cumsum(0.2 * rng.normal(size=(count, 3)), axis=0)
    q = np.array([1.0, 0.0, 0.0, 0.0])
    quaternions = [q := multiply(q, exp(d)) for d in np.diff(turns, axis=0, prepend=0.0)]
    return PoseSpline(2.0, SPACING, rng.normal(size=(count, 3)), np.array(quaternions))


TIMES = 2.0 + np.array([0.0, 0.03, 0.27, 0.5, 0.999, 1.3, 1.4999])


def test_weights_are_those_of_scipy():
    rng = np.random.default_rng(1)
    control = rng.normal(size=9)
    knots = SPACING * (np.arange(9 + ORDER) - ORDER + 1.0)
    curve = BSpline(knots, control, ORDER - 1)
    u = np.array([0.0, 0.2, 0.9])
    for span in range(4):
        w = weights(u, SPACING)
        for i in range(3):
            wanted = curve.derivative(i)(SPACING * (span + u)) if i else curve(SPACING * (span + u))
            np.testing.assert_allclose(w[i] @ control[span : span + ORDER], wanted, rtol=1e-9, atol=1e-9)


def test_rates_are_derivatives_of_attitudes():
    motion, h = motion_at(spline(), TIMES + 1e-9), 1e-5
    inner = slice(1, -1)  # differences need both sides
    before, after = (motion_at(spline(), TIMES[inner] + 1e-9 + s * h) for s in (-1, 1))
    omega = log(multiply(conjugate(before.q), after.q)) / (2 * h)
    np.testing.assert_allclose(motion.omega[inner], omega, atol=1e-6)
    np.testing.assert_allclose(motion.alpha[inner], (after.omega - before.omega) / (2 * h), atol=1e-3)
    np.testing.assert_allclose(motion.v[inner], (after.p - before.p) / (2 * h), atol=1e-5)
    np.testing.assert_allclose(motion.a[inner], (after.v - before.v) / (2 * h), atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(motion.q, axis=1), 1.0, rtol=1e-14)


@pytest.mark.parametrize("axis", range(3))
def test_derivatives_by_control_points(axis):
    own, h = spline(3), 1e-6
    motion = motion_at(own, TIMES)
    span, _ = own.span_of(TIMES)
    for i, first in enumerate(span):
        for k in range(ORDER):
            step = np.zeros((len(own.positions), 6))
            step[first + k, axis] = h
            after, before = (motion_at(own.moved(s * step), TIMES[i : i + 1]) for s in (1, -1))
            turn = log(multiply(conjugate(before.q), after.q))[0] / (2 * h)
            np.testing.assert_allclose(motion.turn[i, k, :, axis], turn, atol=1e-8)
            of_omega = (after.omega - before.omega)[0] / (2 * h)
            np.testing.assert_allclose(motion.of_omega[i, k, :, axis], of_omega, atol=1e-6)
            of_alpha = (after.alpha - before.alpha)[0] / (2 * h)
            np.testing.assert_allclose(motion.of_alpha[i, k, :, axis], of_alpha, atol=1e-4)


def test_a_steady_turn_is_followed_better_the_closer_the_points_are():
    """Control points on the motion smooth it: the error of the rate falls with the square of their distance."""
    errors = []
    for spacing in (0.2, 0.1, 0.05):
        count = count_of(2.0, spacing)
        at = centres(0.0, spacing, count)
        angle = np.sin(at)[:, None] * np.array([0.5, -0.3, 1.0])
        own = PoseSpline(0.0, spacing, np.zeros((count, 3)), exp(angle))
        np.testing.assert_allclose(own.centres, at)
        t = np.linspace(0.0, 1.99, 50)
        errors.append(np.abs(motion_at(own, t).omega[:, 2] - np.cos(t)).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)
