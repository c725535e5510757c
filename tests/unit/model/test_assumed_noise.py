"""Assumed noise: parts that are drawn together or one after the other add up to the variance they stand for."""

from dataclasses import astuple

import numpy as np
import pytest

from kreisel.model.assumed_noise import COLOURED_SHARE, AssumedNoise, PoseError, ReferenceNoise

REFERENCE = ReferenceNoise(3e-3, 4e-3, 5e-4, 6e-4, 7e-5, 8e-5, 9e-5, 1e-6)
ARM = PoseError(4e-3, 3e-3, 2.5)


def assumed(**changed):
    return AssumedNoise(REFERENCE, (0.0, 0.0), ((0.0, 1.0), (0.0, 1.0)), {}, **changed)


def test_each_factor_multiplies_the_deviations_of_its_own_kind():
    scaled = REFERENCE.scaled(position=2.0, orientation=3.0, standstill=5.0)
    np.testing.assert_allclose(
        astuple(scaled), [6e-3, 12e-3, 25e-4, 30e-4, 35e-5, 40e-5, 45e-5, 1e-6], rtol=1e-14, atol=0.0
    )


def test_noise_on_the_path_keeps_its_variance_when_most_of_it_becomes_coloured():
    coloured = assumed(correlation_time=1.5).coloured
    assert coloured.time == 1.5
    for size, stated in ((coloured.position, 3e-3), (coloured.orientation, 4e-3)):
        assert size**2 + (coloured.white_factor * stated) ** 2 == pytest.approx(stated**2, rel=1e-12)
        assert size**2 / stated**2 == pytest.approx(COLOURED_SHARE, rel=1e-12)


def test_without_a_correlation_time_only_the_arm_errs_for_long():
    coloured = assumed(pose_error=ARM).coloured
    assert (coloured.time, coloured.position, coloured.orientation, coloured.white_factor) == (2.5, 4e-3, 3e-3, 1.0)
    assert astuple(assumed().coloured) == (0.0, 0.0, 0.0, 1.0)


def test_coloured_noise_found_comes_on_top_of_the_arms():
    """Variances of independent errors add; the time constant is the one found by likelihood."""
    coloured = assumed(correlation_time=0.7, pose_error=ARM).coloured
    assert coloured.time == 0.7
    assert coloured.position**2 == pytest.approx(0.9 * 3e-3**2 + 4e-3**2, rel=1e-12)
    assert coloured.orientation**2 == pytest.approx(0.9 * 4e-3**2 + 3e-3**2, rel=1e-12)


def test_the_error_at_a_standstill_is_the_references_and_the_arms_together():
    assert assumed().standstill_error == (5e-4, 6e-4)
    position, orientation = assumed(pose_error=ARM).standstill_error
    assert position**2 == pytest.approx(5e-4**2 + 4e-3**2, rel=1e-12)
    assert orientation**2 == pytest.approx(6e-4**2 + 3e-3**2, rel=1e-12)


def test_coloured_noise_of_cameras_does_not_end_at_a_standstill():
    found = COLOURED_SHARE**0.5
    assert assumed(correlation_time=0.7, persists=True).at_rest == pytest.approx((found * 3e-3, found * 4e-3))
    assert assumed(correlation_time=0.7).at_rest == (5e-4, 6e-4)
    assert assumed(persists=True).at_rest == (5e-4, 6e-4)  # white noise says nothing of it
