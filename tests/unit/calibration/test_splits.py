"""Subsets of a recording's parts: what they say is what fits of them say, and what differs is named."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.lack_of_fit import lack_of_fit
from kreisel.calibration.splits import compare_splits, quantities
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.problem import part_of

from ...small_problem import estimate_of, recorded

SETTINGS = CalibrationSettings(passes=2)
"""Nothing else is looked for."""


@cache
def usual():
    return run_calibration(recorded(120.0)[1], SETTINGS)


def test_a_subset_moves_the_estimate_to_where_its_fit_lies():
    """The first half against a fit of it: Newton's step of its score, with the prior."""
    found = usual().estimate
    problem, run = found.problem, found.run
    lack = lack_of_fit(estimate_of(problem, run))
    constant = lack.blocks.parameters
    ends = lack.blocks.ends
    first = ends <= ends[len(ends) // 2]
    P = run.belief.covariance[np.ix_(constant, constant)]
    rest = lack.blocks.information[~first].sum(axis=0), lack.blocks.score[~first].sum(axis=0)
    # the whole less the second half
    own = np.linalg.inv(np.linalg.inv(P) - rest[0])
    step = -own @ rest[1]
    half = KalmanFilter().refit(part_of(problem, slice(0, int(ends[len(ends) // 2]))), run)
    moved = problem.layout.minus(half.belief.mean[:, None], run.belief.mean)[constant, 0]
    deviation = half.belief.standard_deviation[constant]
    assert np.sqrt(np.mean(((step - moved) / deviation) ** 2)) < 0.15
    np.testing.assert_allclose(np.sqrt(np.diag(own)), deviation, rtol=0.05)


def test_scores_of_subsets_have_unit_variance():
    """Drawn scores of blocks, and the estimate that they give: differences are as large as is said."""
    found = usual().estimate
    lack = lack_of_fit(found)
    constant = lack.blocks.parameters
    information = lack.blocks.information
    values, vectors = np.linalg.eigh(information)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    P = found.run.belief.covariance[np.ix_(constant, constant)]
    rest = np.linalg.inv(P) - information.sum(axis=0)
    left, own = np.linalg.eigh(0.5 * (rest + rest.T))
    prior = own * np.sqrt(np.maximum(left, 0.0))
    rng, sizes = np.random.default_rng(3), []
    for _ in range(60):
        drawn = np.einsum("bij,bj->bi", roots, rng.standard_normal(lack.blocks.score.shape))
        pull = drawn.sum(axis=0) + prior @ rng.standard_normal(constant.size)
        score = drawn - information @ P @ pull
        compared = compare_splits(found, replace(lack, blocks=replace(lack.blocks, score=score)))
        sizes += [split.size**2 for split, _ in compared]
    assert np.mean(sizes) == pytest.approx(found.correlation_factor**-2, rel=0.1)


def test_an_error_that_changes_with_speed_is_found_along_it():
    recording, problem, ends = recorded(120.0)[1], usual().estimate.problem, usual().lack.blocks.ends
    imu, speed = recording.imu, quantities(problem, ends)["speed"]
    last = imu.seconds[[problem.schedule.updates[end - 1].last for end in ends]]
    of_sample = speed[np.minimum(np.searchsorted(last, imu.seconds), len(ends) - 1)]
    fast = (of_sample > np.median(speed))[:, None]
    changed = replace(recording, imu=replace(imu, rates=imu.rates * (1.0 + 4e-3 * fast)))
    outcome = run_calibration(changed, SETTINGS)
    found = [split for split in outcome.splits if split.contradicts]
    assert found[0].quantity == "speed"
    assert found[0].group == "gyro_cross_coupling"
    (warning,) = (w for w in outcome.warnings if w.subject == "splits")
    assert "changes with speed in gyroscope.cross_coupling" in warning.message
    assert any(one.cause == "disagreement: splits" for one in outcome.estimate.contributions)
    # either scale factor is contained, by less than what counts as wrong
    found, plain = outcome.calibration, usual().calibration
    for factor in (1.0, 1.0 / 1.004):
        off = np.diag(found.sensors.K_omega) - factor * np.diag(plain.sensors.K_omega)
        assert np.abs(off / np.diag(found.sensor_sd.K_omega)).max() < 3.0


def test_an_honest_recording_contradicts_itself_nowhere():
    outcome = usual()
    assert outcome.splits
    assert not any(split.contradicts for split in outcome.splits)
    assert all(one.cause != "disagreement: splits" for one in outcome.estimate.contributions)


def test_what_may_matter_is_taken_from_the_readings_and_the_poses():
    problem = usual().estimate.problem
    ends = np.array([20, 50, len(problem.schedule.updates)])
    found = quantities(problem, ends)
    updates, readings = problem.schedule.updates, problem.sensor.readings
    own = slice(updates[20].first, updates[49].last)
    rate = readings.rates[own]
    assert found["speed"][1] == pytest.approx(np.sqrt(np.mean(np.sum(rate**2, axis=1))))
    assert found["gravity along z"][1] == pytest.approx(readings.accelerations[own, 2].mean())
    assert all(value.shape == (3,) for value in found.values())
