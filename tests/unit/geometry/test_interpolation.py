"""Attitudes and positions between samples against SciPy, straight lines and sums written out."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from kreisel.geometry.interpolation import continuous, interpolate_columns, nearest, running_mean, slerp

RNG_SEED = 3


def scipy_of(q):
    return Rotation.from_quat(np.roll(q, -1, axis=-1))


def angles_between(a, b):
    """Angles between attitudes (n, 4), whatever their signs."""
    return (scipy_of(a).inv() * scipy_of(b)).magnitude()


def some_attitudes(n):
    q = np.random.default_rng(RNG_SEED).normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def test_attitudes_between_are_those_of_scipy():
    q = some_attitudes(12)
    before, after = q[:6], q[6:]
    share = np.linspace(0.0, 1.0, 6)
    found = slerp(before, after, share)
    for a, b, s, between in zip(before, after, share, found, strict=True):
        expected = Slerp([0.0, 1.0], scipy_of(np.stack([a, b])))(s)
        assert (expected.inv() * scipy_of(between)).magnitude() < 1e-14


def test_the_sign_of_a_quaternion_does_not_change_the_way():
    q = some_attitudes(12)
    plain, flipped = slerp(q[:6], q[6:], np.full(6, 0.3)), slerp(q[:6], -q[6:], np.full(6, 0.3))
    assert angles_between(plain, flipped).max() < 1e-14


def test_one_share_serves_one_pair_and_the_rate_is_steady():
    a, b = some_attitudes(2)
    whole = angles_between(a[None], b[None])[0]
    for share in (0.0, 0.25, 0.5, 1.0):
        assert angles_between(a[None], slerp(a, b, share)[None])[0] == pytest.approx(share * whole, abs=1e-14)


def test_columns_between_uneven_times_lie_on_straight_lines():
    known, values = np.array([0.0, 1.0, 4.0]), np.array([[0.0, 5.0], [2.0, 5.0], [-1.0, 11.0]])
    found = interpolate_columns(np.array([0.0, 0.5, 2.0, 4.0]), known, values)
    np.testing.assert_allclose(found, [[0.0, 5.0], [1.0, 5.0], [1.0, 7.0], [-1.0, 11.0]], atol=1e-14)
    assert interpolate_columns(np.zeros(0), known, values).shape == (0, 2)


def test_neighbouring_quaternions_lie_close_whatever_signs_they_came_with():
    t = np.linspace(0.0, 3.0, 200)[:, None]
    smooth = np.roll(Rotation.from_rotvec(t * [2.0, -1.0, 1.5]).as_quat(canonical=False), 1, axis=1)
    smooth *= np.sign(np.concatenate([[1.0], np.cumprod(np.sign(np.sum(smooth[1:] * smooth[:-1], axis=1)))]))[:, None]
    flipped = smooth * np.random.default_rng(RNG_SEED).choice([-1.0, 1.0], (200, 1))
    found = continuous(flipped)
    np.testing.assert_array_equal(found[0], flipped[0])  # the first keeps its sign
    assert np.linalg.norm(np.diff(found, axis=0), axis=1).max() < 0.03  # a step turns by 0.04 rad, half of it here
    np.testing.assert_allclose(found, smooth * np.sign(found[0] @ smooth[0]), atol=1e-15)


@pytest.mark.parametrize("width", [1, 3, 8, 9, 50, 500])
def test_a_running_mean_is_the_mean_of_the_rows_around(width):
    x = np.random.default_rng(RNG_SEED).normal(size=(60, 2))
    reach = width // 2  # an even width takes one row more, to lie around the row
    expected = [x[max(k - reach, 0) : k + reach + 1].mean(axis=0) for k in range(60)]
    np.testing.assert_allclose(running_mean(x, width), expected, atol=1e-13)


def test_a_running_mean_leaves_a_straight_line_where_rows_lie_on_both_sides():
    line = np.outer(np.arange(40.0), [1.0, -2.0])
    found = running_mean(line, 7)
    np.testing.assert_allclose(found[3:-3], line[3:-3], atol=1e-12)
    np.testing.assert_allclose(found[0], line[:4].mean(axis=0), atol=1e-12)


def test_the_nearest_stamp_is_the_one_at_the_least_distance():
    rng = np.random.default_rng(4)
    stamps, moments = np.sort(rng.uniform(0.0, 10.0, 40)), rng.uniform(-1.0, 11.0, 200)
    by_hand = np.argmin(np.abs(moments[:, None] - stamps), axis=1)
    np.testing.assert_array_equal(nearest(stamps, moments), by_hand)
    in_ns = np.array([0, 10, 30])
    np.testing.assert_array_equal(nearest(in_ns, np.array([-5, 4, 6, 19, 21, 99])), [0, 0, 1, 1, 2, 2])
