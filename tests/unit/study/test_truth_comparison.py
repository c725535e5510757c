"""A calibration held against a truth: errors in their units, and the angle of gravity by drawn vectors."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.result_sections import Measured
from kreisel.simulation.cell import Truth
from kreisel.study.truth_comparison import GroupError, group_errors

from ...small_problem import calibrated, recorded


@pytest.fixture(scope="module")
def truth():
    small = recorded()[0]
    return Truth(small.sensors, small.time_offset, 0.0, small.gravity_r, np.zeros(3), None, None)


def test_sizes_are_root_mean_squares_in_the_unit_shown():
    error = GroupError("title", "mm", 1e3, np.array([[3e-3, 4e-3]]), np.array([[1e-3, 7e-3]]))
    assert error.size == pytest.approx(12.5**0.5)
    assert error.expected == pytest.approx(5.0)
    assert error.ratio == pytest.approx(((9.0 + 16.0 / 49.0) / 2.0) ** 0.5)


def test_an_honest_deviation_has_a_ratio_of_one():
    """Of 20000 errors drawn with their own deviations each: 1 / sqrt(40000) = 0.5 %."""
    rng = np.random.default_rng(0)
    sd = rng.uniform(0.1, 10.0, 20000)
    assert GroupError("", "", 1.0, sd * rng.normal(size=20000), sd).ratio == pytest.approx(1.0, abs=0.02)


def test_what_was_held_has_no_deviation_and_no_say_in_the_ratio():
    held = GroupError("", "", 1.0, np.array([5.0, 2.0]), np.array([0.0, 1.0]))
    assert held.ratio == 2.0
    assert np.isnan(GroupError("", "", 1.0, np.ones(3), np.zeros(3)).ratio)


def test_each_groups_error_is_found_less_true_in_its_unit(truth):
    calibration = calibrated().calibration
    known = {
        "gyro_cross_coupling": ("K_omega", (0, 1), 250e-6, "ppm", 250.0),
        "gyro_offset": ("k_w", (0, 2), 3.0 * np.pi / 180.0 / 3600.0, "deg/h", 3.0),
        "accel_cross_coupling": ("K_a", (2, 2), -1e-3, "ppm", 1000.0),
        "accel_offset": ("k_a", (0, 0), 2e-3 * 9.80665, "mg", 2.0),
        "lever_arms": ("lever_arms", (1, 2), -4e-3, "mm", 4.0),
    }
    for group, (field, place, change, unit, shown) in known.items():
        value = getattr(truth.sensors, field).copy()
        value[place] += change
        shifted = replace(calibration, sensors=replace(truth.sensors, **{field: value}))
        found = group_errors(shifted, truth)
        assert found[group].unit == unit
        assert found[group].size == pytest.approx(shown / found[group].error.size ** 0.5, rel=1e-9)
        assert found[group].error.flat[np.argmax(np.abs(found[group].error))] == pytest.approx(change)
        own = getattr(calibration.sensor_sd, field)
        np.testing.assert_array_equal(found[group].deviation, own[0] if field.startswith("k_") else own)
        assert all(not found[other].error.any() for other in known if other != group)


def test_the_error_of_gravitys_direction_is_the_angle_to_the_true_one(truth):
    calibration = calibrated().calibration
    down = truth.gravity_r / np.linalg.norm(truth.gravity_r)
    rng = np.random.default_rng(1)
    for _ in range(5):
        across = np.cross(down, rng.normal(size=3))
        across *= 1e-4 / np.linalg.norm(across)
        # longer or shorter gravity is no error of its direction
        value = 9.81 * rng.uniform(0.99, 1.01) * (down * np.cos(1e-4) + across)
        gravity = Measured(value, np.full(3, 1e-3))
        moved = replace(calibration, alignment=replace(calibration.alignment, gravity=gravity))
        found = group_errors(moved, truth)["alignment"]
        assert np.linalg.norm(found.error) == pytest.approx(1e-4, rel=0.02)
        assert found.size == pytest.approx(100.0 / 2**0.5, rel=0.02)  # urad, each of two directions
        np.testing.assert_allclose(found.deviation, 1e-3 / np.linalg.norm(truth.gravity_r), rtol=1e-9)


def test_the_time_offset_is_compared_in_milliseconds(truth):
    calibration = calibrated().calibration
    late = replace(calibration, timing=replace(calibration.timing, offset=truth.time_offset - 2e-3, offset_sd=5e-4))
    found = group_errors(late, truth)["time_offset"]
    assert (found.unit, found.size, found.expected) == ("ms", pytest.approx(2.0), pytest.approx(0.5))
    assert found.ratio == pytest.approx(4.0)


def test_a_calibration_of_a_simulated_cell_is_honest_in_every_group(truth):
    """A ratio of a single error may be small by chance; four deviations of the mean are one in 15000 for each group."""
    found = group_errors(calibrated().calibration, truth)
    assert list(found) == ["gyro_cross_coupling", "gyro_offset", "accel_cross_coupling", "accel_offset", "lever_arms",
                           "alignment", "time_offset"]  # fmt: skip
    for error in found.values():
        assert error.ratio < 4.0
