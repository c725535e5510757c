"""The plain strapdown pass, the unit of run times, against closed forms."""

import numpy as np
import pytest

from kreisel._kernels.strapdown_pass import navigated, strapdown_seconds

SECONDS, INTERVAL = 2.0, 1e-4
COUNT = round(SECONDS / INTERVAL)
"""Short intervals: the pass begins with the readings of rest, and ends a part of an interval late."""


def constant(*values):
    return np.tile(values, (COUNT, 1)).astype(float)


def test_a_constant_force_gives_a_parabola():
    end = navigated(constant(0, 0, 0), constant(0.1, 0.2, 9.81), INTERVAL, np.array([0.0, 0.0, -9.51]))
    assert end == pytest.approx(1.0 + 0.5 * 0.6 * SECONDS**2, rel=1e-3)


def test_a_constant_rate_turns_the_attitude():
    end = navigated(constant(0, 0, 0.7), constant(0, 0, 9.81), INTERVAL, np.array([0.0, 0.0, -9.81]))
    assert end == pytest.approx(np.cos(0.35 * SECONDS), abs=1e-3)


def test_a_force_that_turns_with_the_body_runs_in_a_circle():
    """x'' = cos(w t), y'' = sin(w t): x + y after t."""
    w, t = 1.5, SECONDS
    end = navigated(constant(0, 0, w), constant(1, 0, 0), INTERVAL, np.zeros(3))
    along = (1.0 - np.cos(w * t)) / w**2 + (w * t - np.sin(w * t)) / w**2
    assert end == pytest.approx(along + np.cos(0.5 * w * t), abs=1e-3)


def test_its_time_is_a_time():
    assert strapdown_seconds(constant(0, 0, 0.7), constant(0, 0, 9.81), INTERVAL, 3) > 0.0
