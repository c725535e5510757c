"""Errors of stamps that were put into a recording, against those that the gyros show."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from kreisel.geometry.rotation import exp, multiply
from kreisel.synchronization.stamp_errors import stamp_errors

from ...small_problem import prepared

EVERY = 6
"""Of the poses; they are then 72 ms apart, further than their stamps are wrong."""


@cache
def poses():
    return prepared().reference.part(slice(None, None, EVERY))


def found(late=0.0, turned=0.0):
    """By the gyros, with stamps that are late (m,), s, and orientations turned by rotations (m, 3)."""
    clean = poses()
    n = clean.stamps_ns.size
    stamps = clean.stamps_ns + np.round(1e9 * np.broadcast_to(late, n)).astype(np.int64)
    q = multiply(clean.quaternions, exp(np.broadcast_to(turned, (n, 3))))
    return stamp_errors(prepared().readings, replace(clean, stamps_ns=stamps, quaternions=q), prepared().rate_fit)


def test_good_stamps_have_no_errors():
    clean = found()
    assert clean.deviation == 0.0
    assert not clean.wrong.any()


@pytest.mark.parametrize("deviation", [1e-3, 5e-3])
def test_random_errors_are_as_large_as_they_are(deviation):
    rng, n = np.random.default_rng(0), poses().stamps_ns.size
    late = deviation * rng.normal(size=n)
    late[0] = 0.0
    noisy = found(late)
    # of some 350 poses in motion: 4 %, and the median of seven leaves them a tenth larger or smaller
    assert noisy.deviation == pytest.approx(deviation, rel=0.25)
    assert noisy.wrong.sum() <= 2


def test_noise_of_orientations_is_none_of_stamps():
    turned = 5e-3 * np.random.default_rng(1).normal(size=(poses().stamps_ns.size, 3))
    assert found(turned=turned).deviation == 0.0


def test_noise_that_is_larger_about_one_axis_is_none_of_stamps():
    turned = [3e-3, 3e-3, 6e-3] * np.random.default_rng(2).normal(size=(poses().stamps_ns.size, 3))
    assert found(turned=turned).deviation == 0.0


def test_a_clock_that_drifts_to_and_fro_is_none_of_stamps():
    late = 3e-3 * np.sin(2.0 * np.pi * poses().seconds / 8.0)
    assert found(late - late[0]).deviation == 0.0


def test_stamps_that_are_wrong_by_far_more_are_named():
    rng, n = np.random.default_rng(3), poses().stamps_ns.size
    late = 2e-3 * rng.normal(size=n)
    late[0] = 0.0
    gross = np.arange(20, n - 20, 23)
    late[gross] += np.resize([30e-3, -30e-3], gross.size)
    noisy = found(late)
    marked = np.flatnonzero(noisy.wrong)
    assert set(marked) <= set(gross)
    assert marked.size > 0.3 * gross.size  # the others are at standstill, or where the axis of rotation changes
    assert noisy.deviation == pytest.approx(2e-3, rel=0.25)


def test_without_orientations_nothing_is_known():
    blind = replace(poses(), quaternions=None)
    assert stamp_errors(prepared().readings, blind, prepared().rate_fit).deviation == 0.0
