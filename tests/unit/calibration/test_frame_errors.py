"""Errors of base and tool frame: turned and shifted cells, computed by the sensor model itself."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.frame_errors import frame_columns, repeatability_columns
from kreisel.inertial.sensor_model import correct_angular_rate, correct_specific_force
from kreisel.model.problem import without_groups

from ...oracle import quaternions as quat
from ...small_problem import moved_by, recorded, small_problem, with_noise

LENGTH, ANGLE = 1e-3, 1e-5

TURNED, SHIFTED = (0.95, 0.95, 1.2), (0.8, 0.8, 1.2)
"""Errors about and along the tool's axes: the last joint turns about z."""


@pytest.fixture(scope="module")
def columns():
    """Columns for small errors, about the true sensors, which are far from ideal."""
    return frame_columns(problem(), parameters())


def problem():
    return with_noise(small_problem(), frame_sd=(LENGTH, ANGLE))


def parameters():
    return replace(small_problem().prior.start, sensors=recorded()[0].sensors)


def moved(column):
    return moved_by(problem(), parameters(), column[: len(problem().parameter_names)])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_tool_turned_sees_the_same_motion_turned(columns, axis):
    """Corrected rates and forces at the origin of b come out turned; terms of the square of the angle are 1e-10."""
    rng = np.random.default_rng(axis)
    w, a, alpha = (rng.normal(size=(20, 3)) for _ in range(3))
    turn = quat.exp(ANGLE * TURNED[axis] * np.eye(3)[axis])
    before, after = parameters().sensors, moved(columns[:, axis]).sensors
    omega = correct_angular_rate(w, before)
    turned = correct_angular_rate(w, after)
    np.testing.assert_allclose(turned, quat.rotate(turn, omega), atol=1e-9)
    force = correct_specific_force(a, omega, alpha, before)
    found = correct_specific_force(a, turned, quat.rotate(turn, alpha), after)
    np.testing.assert_allclose(found, quat.rotate(turn, force), atol=1e-9)
    assert np.abs(turned - omega).max() > 0.4 * ANGLE


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_tool_shifted_moves_all_accelerometers_by_as_much(columns, axis):
    change = moved(columns[:, 3 + axis]).sensors.lever_arms - parameters().sensors.lever_arms
    np.testing.assert_allclose(change, np.tile(LENGTH * SHIFTED[axis] * np.eye(3)[axis], (3, 1)), atol=1e-12)


def test_a_base_turned_turns_gravity_by_the_angle_and_either_way_across_it(columns):
    down = [quat.rotate(p.q_rn, np.array([0.0, 0.0, 1.0])) for p in (parameters(), *map(moved, columns.T[6:]))]
    for turned in down[1:]:
        assert np.linalg.norm(turned - down[0]) == pytest.approx(ANGLE, rel=1e-4)
    assert (down[1] - down[0]) @ (down[2] - down[0]) == pytest.approx(0.0, abs=1e-4 * ANGLE**2)


def test_nothing_else_moves_and_without_errors_nothing_does(columns):
    layout = problem().layout
    assert columns.shape == (layout.degrees, 8)
    for part in layout:
        if part.name not in ("gyro_cross_coupling", "accel_cross_coupling", "lever_arms", "alignment"):
            assert not columns[layout[part.name]].any()
    assert not frame_columns(with_noise(small_problem(), frame_sd=(0.0, 0.0)), parameters()).any()


def test_held_groups_take_no_part(columns):
    held = without_groups(problem(), ("lever_arms", "alignment"))
    found = frame_columns(held, parameters())
    d = held.layout["gyro_cross_coupling"]
    np.testing.assert_array_equal(found[d], columns[d])
    assert not found[:, 3:].any()


def test_repeatability_acts_as_errors_of_the_frames_that_average_over_the_rests():
    problem = with_noise(small_problem(), frame_sd=(0.0, 0.0))
    noise, rests = problem.noise.reference, len(problem.schedule.standstills)
    assert rests > 3
    found = repeatability_columns(problem, parameters())
    sd = noise.standstill_position, noise.standstill_orientation
    whole = frame_columns(
        with_noise(problem, frame_sd=sd), parameters(), turned=(1.0, 1.0, 1.0), shifted=(1.0, 1.0, 1.0)
    )
    np.testing.assert_allclose(found * rests**0.5, whole)
    moving = replace(problem, schedule=replace(problem.schedule, standstills=()))
    assert not repeatability_columns(moving, parameters()).any()
    one = replace(problem, schedule=replace(problem.schedule, standstills=problem.schedule.standstills[:1]))
    seconds = np.ptp(problem.sensor.readings.stamps)
    np.testing.assert_allclose(repeatability_columns(one, parameters()), found * rests**0.5 * 10.0 / seconds)
    frames = with_noise(small_problem(), frame_sd=(1e-3, 1e-3))
    assert not repeatability_columns(frames, parameters()).any()  # part of the frames' errors
