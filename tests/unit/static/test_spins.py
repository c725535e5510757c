"""Revolutions counted by gravity: ratios that are put in, whatever the rates and the forces toward the axis."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.geometry.rotation import apply, conjugate, exp, multiply
from kreisel.preparation.gravity import site_of
from kreisel.recording.recording import ImuSamples
from kreisel.recording.recording_settings import SiteTable
from kreisel.static.first_values import first_values
from kreisel.static.rest_problem import RestProblem, raw_of
from kreisel.static.rest_search import find_rests
from kreisel.static.spins import _ratio, leading, uncounted

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


def test_long_turns_about_changing_axes_are_counted_by_nothing(tumbling):
    """Twenty revolutions about one axis and then as many about another, between two standstills; and two of each."""
    for revolutions, lost in ((20.0, [2]), (2.0, [])):
        problem = tumbling(revolutions)
        assert uncounted(problem, first_values(problem).sensors).tolist() == lost


@pytest.fixture(scope="module")
def tumbling():
    def problem(revolutions):
        rate, angle = 100.0, 2.0 * np.pi * revolutions
        turns = [np.array([[0.0, 2.0, 0.5]]), np.array([[1.5, 0.0, -1.0]]), angle * np.eye(3)[:2],
                 np.array([[0.0, -1.2, 0.7]]), np.array([[2.0, 0.4, 0.0]]), np.array([[-0.7, 0.9, 0.3]])]  # fmt: skip
        q, omega = [np.array([1.0, 0.0, 0.0, 0.0])], [np.zeros((300, 3))]
        attitudes = [np.tile(q[0], (300, 1))]
        for parts in turns:
            for part in parts:
                n = max(100, int(rate * np.linalg.norm(part) / 6.0))
                share = np.arange(1, n + 1) / n
                attitudes.append(multiply(q[-1], exp(part * share[:, None])))
                omega.append(np.tile(part * rate / n, (n, 1)))
                q.append(attitudes[-1][-1])
            attitudes.append(np.tile(q[-1], (300, 1)))
            omega.append(np.zeros((300, 3)))
        C, w = np.concatenate(attitudes), np.concatenate(omega)
        noise = np.random.default_rng(2).normal(0.0, 1e-3, (len(w), 3))
        forces = apply(conjugate(C), np.broadcast_to([0.0, 0.0, -G], w.shape)) + 10.0 * noise
        imu = ImuSamples(np.arange(len(w)) * 10_000_000, w + noise, forces, Path("imu0"))
        return RestProblem(imu, raw_of(imu), find_rests(imu), site_of(SiteTable())[0])

    return problem
