"""Layouts of the state: which parts there are, and in which order."""

import itertools

import pytest

from kreisel.estimation.state import StateLayout
from kreisel.model.groups import REGISTRY
from kreisel.model.layout import NAVIGATION, STANDSTILL_ERROR, group_part, with_coloured_noise, without

SENSORS = ("gyro_offset", "accel_offset", "alignment")
PATH = ("path_position", "path_orientation")


def layout():
    return StateLayout([*(group_part(g, 1) for g in SENSORS), *STANDSTILL_ERROR, *NAVIGATION])


def names(found):
    return [part.name for part in found]


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("joints", [0, 6])
def test_a_groups_part_has_one_degree_of_freedom_for_each_name(order, joints):
    counted = {
        "gyro_cross_coupling": 9, "gyro_offset": 3, "gyro_polynomial": 3 * (order - 1), "accel_cross_coupling": 9,
        "accel_offset": 3, "accel_polynomial": 3 * (order - 1), "lever_arms": 9, "alignment": 2, "north": 2,
        "earth_down": 1, "gravity": 1, "time_offset": 1, "time_skew": 1,
        "gyro_g_sensitivity": 9, "gyro_g_squared": 9,
        "gyro_asymmetry": 3, "accel_asymmetry": 3, "accel_delay": 1, "accel_smoothing": 1, "accel_axis_delay": 3,
        "gyro_cubic": 3, "accel_cubic": 3, "gyro_axis_delay": 3, "gyro_axis_smoothing": 3, "accel_axis_smoothing": 3,
        "gyro_temperature": 3, "gyro_scale_temperature": 3, "accel_temperature": 3, "accel_scale_temperature": 3,
        "gyro_gauss_markov": 3, "accel_gauss_markov": 3,
        "position_scale": 1, "position_heading": 1, "reference_smoothing": 1, "mount_bending": 9, "mount_deflection": 9,
        "robot_placement": 6 * (joints + 1) if joints else 0, "robot_gears": 2 * joints, "robot_compliance": joints,
        "robot_zeros": max(joints - 2, 0),
    }  # fmt: skip
    for group in REGISTRY:
        part = group_part(group.name, order, joints)
        assert part.degrees == counted[group.name]
        assert part.rotation == (group.name == "alignment")


@pytest.mark.parametrize("present", list(itertools.product([False, True], repeat=2)))
def test_coloured_noise_stands_right_before_navigation(present):
    chosen = [name for name, there in zip(PATH, present, strict=True) if there]
    found = with_coloured_noise(layout(), present)
    errors = ["standstill_position", "standstill_orientation"]
    assert names(found) == [*SENSORS, *errors, *chosen, "velocity", "position", "attitude"]
    assert found.degrees == 8 + 6 + 3 * len(chosen) + 9


def test_coloured_noise_that_is_there_already_is_not_added_twice():
    once = with_coloured_noise(layout(), (True, False))
    assert names(with_coloured_noise(once, (True, True))) == names(with_coloured_noise(layout(), (True, True)))
    assert names(with_coloured_noise(once, (False, False))) == names(layout())


def test_taking_groups_out_closes_the_gap_they_leave():
    left = without(layout(), ("accel_offset", "earth_down"))
    assert names(left) == [name for name in names(layout()) if name != "accel_offset"]
    assert left["alignment"] == slice(3, 5)
    assert left.stored("alignment") == slice(3, 7)  # a quaternion
    assert names(without(layout(), ())) == names(layout())
