"""Revolutions counted by gravity: ratios that are put in, whatever the rates and the forces toward the axis."""

import numpy as np
import pytest

from kreisel.static.spins import _ratio, leading

G = 9.81


def spun(ratio, axis, up, revolutions=30.0, outward=0.0, n=6000):
    """Return steps by gyros, and forces, of a device that turns `ratio` times as far as its gyros say."""
    axis, up = np.asarray(axis) / np.linalg.norm(axis), np.asarray(up) / np.linalg.norm(up)
    angle = 2.0 * np.pi * revolutions * np.linspace(0.0, 1.0, n + 1) ** 2
    middle = 0.5 * (angle[1:] + angle[:-1])
    across = np.cross(axis, up)
    along = axis * (axis @ up)
    # seen from the device, what stands still turns the other way
    seen = along + (up - along) * np.cos(middle)[:, None] - across * np.sin(middle)[:, None]
    side = np.cross(axis, [0.3, 0.5, -0.8])
    force = G * seen + outward * np.gradient(angle)[1:, None] ** 2 / np.gradient(angle).max() ** 2 * side
    return np.diff(angle) / ratio, force, axis


@pytest.mark.parametrize("ratio", [1.0, 0.9, 1.04, 1.2])
@pytest.mark.parametrize("outward", [0.0, 30.0])
def test_gravity_goes_round_as_often_as_the_device(ratio, outward):
    steps, force, axis = spun(ratio, [0.2, 1.0, -0.4], [1.0, 0.3, 0.5], outward=outward)
    assert _ratio(steps, force, axis, G) == pytest.approx(ratio, abs=2e-3)


def test_an_upright_axis_shows_nothing():
    steps, force, axis = spun(1.04, [0.0, 0.0, 1.0], [0.03, 0.0, 1.0])
    assert _ratio(steps, force, axis, G) is None


def test_gravity_that_is_lost_for_some_revolutions_is_not_counted():
    steps, force, axis = spun(1.04, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    force[2000:3500] = 0.0
    assert _ratio(steps, force, axis, G) is None


def test_ways_lead_where_they_are_meant_to_and_others_stay():
    way = np.array([[100.0, 0.0, 0.0], [200.0, 0.0, 0.0]])
    M = leading(way, 1.03 * way)
    np.testing.assert_allclose(M, np.diag([1.03, 1.0, 1.0]), atol=1e-5)
