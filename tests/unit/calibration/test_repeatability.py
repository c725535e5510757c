"""Differences between runs: their chi-square has the distribution it must have, and shows what differs."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.linear_errors import LINEAR_ERRORS
from kreisel.calibration.repeatability import repeatability
from kreisel.calibration.result_sections import Measured
from kreisel.errors import SettingsError
from kreisel.estimation.uncertainty_budget import Budget, Source

from ...small_problem import calibrated


def runs(rng, count, factor=1.0):
    """Return calibrations whose derived quantities and lever arms scatter by their deviations times a factor."""
    one = calibrated().calibration
    out = []
    for _ in range(count):
        derived = {
            name: Measured(m.value + factor * m.deviation * rng.normal(size=3), m.deviation)
            for name, m in one.derived.items()
        }
        arms = one.sensors.lever_arms + factor * one.sensor_sd.lever_arms * rng.normal(size=(3, 3))
        out.append(replace(one, derived=derived, sensors=replace(one.sensors, lever_arms=arms), budget=None))
    return out


def test_chi_square_lies_in_its_band_as_often_as_said():
    rng, outside, total = np.random.default_rng(4), 0, 0
    for _ in range(120):
        found = repeatability(runs(rng, 4))
        outside += sum(not one.band[0] < one.chi_square < one.band[1] for one in found)
        total += len(found)
    assert 0.003 < outside / total < 0.02  # 1 % expected


def test_deviations_that_are_too_small_show():
    found = repeatability(runs(np.random.default_rng(5), 8, factor=3.0))
    assert all(one.too_large for one in found)
    assert np.mean([one.factor for one in found]) == pytest.approx(3.0, rel=0.15)


def test_the_run_that_differs_is_found_and_the_mean_is_that_of_information():
    made = runs(np.random.default_rng(6), 5)
    arms = made[3].sensors.lever_arms + 20.0 * made[3].sensor_sd.lever_arms
    made[3] = replace(made[3], sensors=replace(made[3].sensors, lever_arms=arms))
    found = {one.name: one for one in repeatability(made)}
    arm = found["lever_arm_y_mm"]
    assert arm.too_large
    assert not found["gyro_scale_error_ppm"].too_large
    assert set(np.nanargmax(np.abs(arm.scores), axis=0)) == {3}
    want = np.average(arm.values, axis=0, weights=arm.deviations**-2)
    np.testing.assert_allclose(arm.mean, want, rtol=1e-9)
    np.testing.assert_allclose(arm.mean_sd, np.sum(arm.deviations**-2, axis=0) ** -0.5)


def test_several_serial_numbers_are_no_device():
    made = runs(np.random.default_rng(7), 3)
    numbered = [
        replace(one, recording=replace(one.recording, device={"serial_number": number}, digest=number))
        for one, number in zip(made, ("1", "2", ""), strict=True)
    ]
    assert repeatability([numbered[0], numbered[2]])
    with pytest.raises(SettingsError, match="state 2 serial numbers: 1, 2; give those of one device"):
        repeatability(numbered)


def test_what_was_held_does_not_count():
    made = runs(np.random.default_rng(7), 3)
    held = {"accel_bias_mg": Measured(np.zeros(3), np.zeros(3))}
    found = {one.name: one for one in repeatability([replace(one, derived={**one.derived, **held}) for one in made])}
    assert np.isnan(found["accel_bias_mg"].chi_square)
    assert not found["accel_bias_mg"].too_large
    assert found["gyro_bias_deg_h"].chi_square > 0.0


def test_one_run_cannot_be_compared():
    with pytest.raises(SettingsError, match="two or more"):
        repeatability(runs(np.random.default_rng(8), 1))


@pytest.mark.parametrize("source", [Source.PRIOR, Source.ROBOT, Source.SENSOR])
def test_runs_do_not_reduce_what_they_have_in_common(source):
    one = calibrated().calibration
    budget = Budget.of(one.names, {"all of it": source}, np.diag(one.covariance)[:, None])
    for found in repeatability([replace(one, budget=budget)] * 4):
        reduced = 2.0 if source is Source.SENSOR else 1.0
        np.testing.assert_allclose(found.mean_sd * reduced, found.deviations[0], rtol=1e-6)


def test_half_of_the_variance_in_common_leaves_five_eighths_in_the_mean_of_four():
    one = calibrated().calibration
    half = 0.5 * np.diag(one.covariance)[:, None]
    causes = {LINEAR_ERRORS: Source.PATH, "noise": Source.PATH}
    budget = Budget.of(one.names, causes, np.hstack([half, half]))
    for found in repeatability([replace(one, budget=budget)] * 4):
        np.testing.assert_allclose(found.mean_sd**2, 0.625 * found.deviations[0] ** 2, rtol=1e-6)


def test_the_same_data_count_once():
    one = runs(np.random.default_rng(9), 2)
    same = [replace(r, recording=replace(r.recording, digest="a" * 64)) for r in one]
    with pytest.raises(SettingsError, match="same data"):
        repeatability(same)


def test_what_one_run_does_not_know_does_not_hide_what_another_one_knows():
    first, second = runs(np.random.default_rng(10), 2)
    unknown = {"accel_distances_mm": Measured(np.full(3, np.nan), np.full(3, np.nan))}
    found = {r.name: r for r in repeatability([first, replace(second, derived={**second.derived, **unknown})])}
    np.testing.assert_allclose(found["accel_distances_mm"].mean, first.derived["accel_distances_mm"].value)
