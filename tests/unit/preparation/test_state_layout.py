"""The filter's state: what is in it for every choice, its sizes counted by hand."""

import pytest

from kreisel.model.calibration_settings import BY_CHOICE, CalibrationSettings
from kreisel.model.groups import REGISTRY
from kreisel.preparation.state_layout import build_layout

CELL = {"latitude": True, "skew": False, "standstill_error": False}
SENSORS = {
    "gyro_cross_coupling": 9, "gyro_offset": 3, "accel_cross_coupling": 9, "accel_offset": 3, "lever_arms": 9,
}  # fmt: skip
SITE = {"alignment": 2, "north": 2, "gravity": 1, "time_offset": 1}
NAVIGATION = {"velocity": 3, "position": 3, "attitude": 3}


def layout_of(settings=None, **changed):
    return build_layout(settings or CalibrationSettings(), **(CELL | changed))


def counted(layout):
    return {part.name: part.degrees for part in layout}


def test_the_least_state_holds_sensors_cell_and_navigation():
    layout = layout_of()
    assert counted(layout) == SENSORS | SITE | NAVIGATION
    assert layout.degrees == 33 + 6 + 9
    # two degrees of tilt and three of attitude are stored as quaternions
    assert layout.size == layout.degrees + 2 + 1
    assert [part.name for part in layout if part.rotation] == ["alignment", "attitude"]


def test_the_order_is_sensors_cell_robot_reference_navigation():
    settings = CalibrationSettings(estimated=BY_CHOICE, polynomial_order=2)
    layout = build_layout(
        settings, latitude=False, skew=True, standstill_error=True, path_error=(True, True), joints=6,
        gauss_markov=("gyro_gauss_markov", "accel_gauss_markov"),
    )  # fmt: skip
    names = [part.name for part in layout]
    assert names == [
        *(group.name for group in REGISTRY),
        "standstill_position", "standstill_orientation", "path_position", "path_orientation",
        "velocity", "position", "attitude",
    ]  # fmt: skip
    owners = [group.owner for group in REGISTRY]
    assert owners == sorted(owners, key=["gyroscope", "accelerometer", "cell", "reference", "robot"].index)
    assert counted(layout)["robot_placement"] == 42  # six joints and the tool
    assert (counted(layout)["robot_gears"], counted(layout)["robot_compliance"]) == (12, 6)


@pytest.mark.parametrize("order", [1, 2, 4])
def test_polynomials_have_three_terms_for_each_power_from_the_second_on(order):
    parts = counted(layout_of(CalibrationSettings(polynomial_order=order)))
    assert parts.get("gyro_polynomial", 0) == parts.get("accel_polynomial", 0) == 3 * (order - 1)
    assert ("gyro_polynomial" in parts) == (order > 1)


@pytest.mark.parametrize(
    ("changed", "added"),
    [
        ({"latitude": False}, {"earth_down": 1}),
        ({"skew": True}, {"time_skew": 1}),
        ({"standstill_error": True}, {"standstill_position": 3, "standstill_orientation": 3}),
        ({"path_error": (True, False)}, {"path_position": 3}),
        ({"path_error": (False, True)}, {"path_orientation": 3}),
        ({"joints": 7}, {"robot_placement": 48}),
    ],
)
def test_every_circumstance_adds_its_own_parts(changed, added):
    assert counted(layout_of(**changed)) == SENSORS | SITE | added | NAVIGATION


def test_groups_of_a_robot_are_estimated_by_choice_and_only_where_there_is_one():
    settings = CalibrationSettings(estimated=("robot_gears",))
    parts = counted(layout_of(settings, joints=6))
    assert (parts["robot_placement"], parts["robot_gears"]) == (42, 12)
    assert "robot_compliance" not in parts
    assert "robot_gears" not in layout_of(settings)


@pytest.mark.parametrize("group", [g.name for g in REGISTRY if not g.by_choice and g.name not in ("north",)])
def test_a_fixed_group_is_absent_and_nothing_else(group):
    settings = {"polynomial_order": 2, "fixed": (group,)}
    full = counted(layout_of(CalibrationSettings(polynomial_order=2), latitude=False, skew=True, joints=6))
    assert counted(layout_of(CalibrationSettings(**settings), latitude=False, skew=True, joints=6)) == {
        name: degrees for name, degrees in full.items() if name != group
    }


def test_the_earth_points_down_only_where_north_is_estimated():
    parts = counted(layout_of(CalibrationSettings(fixed=("north",)), latitude=False))
    assert "north" not in parts
    assert "earth_down" not in parts
