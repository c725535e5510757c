"""Offsets that walk, and error terms that are nearly offsets: a linearisation says what a fit of them says."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import ESTIMATORS
from kreisel.inverse.inverse_filter import inverted
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.problem import with_groups
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.prepare import prepare_recording
from kreisel.refinement.named_terms import named_terms
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.validation.checks import check_streams

GROUP = "gyro_g_sensitivity"

CELL = {
    "seed": 24, "seconds": 60.0, "imu": {"grade": "consumer-mems"}, "motion": {"range_share": 0.01},
    "reference": {"kind": "mocap", "interval": 0.01},
    "errors": {"path_position_sd": 3e-4, "path_orientation_sd": 5e-4, "path_correlation_time": 0.0},
}  # fmt: skip


def prepared():
    """Return a problem of hardly any motion: what gyros make of gravity is nearly an offset, and offsets walk."""
    recording = check_streams(simulate(Cell.model_validate(CELL), Path("hardly moving"))[1])
    settings = CalibrationSettings()
    problem = build_problem(prepare_recording(recording, settings), settings)
    assert problem.noise.offset_walk["gyro_offset"] > 0.0
    return problem


def shown(larger, covariance):
    """Return what data say of the group, over its prior: eigenvalues, ascending."""
    prior = larger.prior.covariance[GROUP]
    return np.linalg.eigvalsh((np.linalg.inv(covariance) - np.linalg.inv(prior)) * prior[0, 0])


@pytest.mark.slow
def test_what_data_say_of_a_term_beside_a_walking_offset_is_what_three_ways_say():
    """Of the linearisation, of a filter with the term in its state, and of readings predicted from a spline."""
    problem, ekf = prepared(), ESTIMATORS["ekf"]
    larger = with_groups(problem, (GROUP,))
    fit = ekf.refit(larger, ekf.fit(larger))
    own = larger.layout[GROUP]
    by_filter = shown(larger, fit.belief.covariance[own, own])
    by_spline = shown(larger, inverted(larger, fit).belief.covariance[own, own])

    near = ekf.refit(problem, ekf.fit(problem))
    linear = ekf.linearise(problem, near)
    terms, combined = named_terms(problem, linear.near, (GROUP,))
    information = combined.T @ linear.about(terms).information @ combined
    by_linearisation = np.linalg.eigvalsh(information * larger.prior.covariance[GROUP][0, 0])

    np.testing.assert_allclose(by_linearisation, by_filter, rtol=0.1)
    np.testing.assert_allclose(by_spline, by_filter, rtol=0.3)  # walks are drawn by straight lines
