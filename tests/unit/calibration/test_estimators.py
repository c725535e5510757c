"""Names of estimators, and that every step asks the one that is chosen."""

import json
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from kreisel.calibration import calibrate as module
from kreisel.calibration.calibrate import ESTIMATORS, run_calibration
from kreisel.estimation.belief import Belief
from kreisel.fitting.stored_state import first_belief
from kreisel.model.calibration_settings import ESTIMATORS as NAMES
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.layout import without

from ...small_problem import camera_problem, recorded


class Counting:
    """The usual estimator, with what it was asked for."""

    name, points = "counting", "derivatives"

    def __init__(self):
        self.asked, self._own = [], ESTIMATORS["ekf"]

    def __getattr__(self, what):
        def ask(*arguments, **named):
            self.asked.append(what)
            return getattr(self._own, what)(*arguments, **named)

        return ask


def test_every_name_stands_for_an_estimator():
    assert tuple(ESTIMATORS) == NAMES
    assert all(one.name == name for name, one in ESTIMATORS.items())
    schema = json.loads(files("kreisel.calibration").joinpath("result-schema.json").read_text())
    assert {*NAMES} <= {*schema["properties"]["estimator"]["properties"]["name"]["enum"]}


@pytest.mark.parametrize("estimator", ESTIMATORS.values(), ids=str)
def test_what_every_estimator_keeps_to(estimator):
    """A fit contains the stated prior once and nothing of its start: begun elsewhere, it ends at the same place."""
    problem = camera_problem()
    fit = estimator.fit(problem)
    n, history = len(problem.parameter_names), fit.history
    updates = len(problem.schedule.updates)
    assert fit.belief.factor.shape == 2 * (problem.layout.degrees,)
    np.testing.assert_array_equal(np.triu(fit.belief.factor, 1), 0.0)
    assert history.parameters.shape == history.deviations.shape == (updates, n)
    assert history.innovation.shape == (updates, 9)
    again = estimator.refit(problem, fit)
    moved = problem.layout.minus(again.belief.mean[:, None], fit.belief.mean)[:n, 0]
    deviation = again.belief.standard_deviation[:n]
    assert np.abs(moved / deviation).max() < 0.3
    factor = fit.belief.factor.copy()
    factor[:n] *= 30.0
    far = estimator.refit(problem, replace(again, belief=Belief(again.belief.mean, factor)))
    np.testing.assert_allclose(far.belief.standard_deviation[:n], deviation, rtol=0.05)
    silent = replace(problem, sensors=(replace(problem.sensor, readings=problem.sensor.readings.with_noise(1e3, 1e3)),))
    prior = first_belief(problem, problem.prior.value, problem.prior.covariance).standard_deviation[:n]
    assert (estimator.refit(silent, again, gate=np.inf).belief.standard_deviation[:n] < 1.05 * prior).all()


def test_navigation_with_known_parameters_has_none_in_its_state():
    problem = camera_problem()
    prior = replace(problem.prior, start_covariance={}, covariance={})
    alone = replace(problem, layout=without(problem.layout, problem.groups), prior=prior)
    for estimator in ESTIMATORS.values():
        fit = estimator.navigate(alone, problem.prior.start)
        assert fit.history.used.all()
        assert fit.history.parameters.shape[1] == 0


def test_every_step_asks_the_estimator_that_is_chosen(monkeypatch):
    """Nothing runs a filter past it: with a counting one, all fits are counted, and the result is the same."""
    counting, settings = Counting(), CalibrationSettings()
    plain = run_calibration(recorded()[1], settings, validate=True)
    monkeypatch.setitem(module.ESTIMATORS, "ekf", counting)
    found = run_calibration(recorded()[1], settings, validate=True)
    np.testing.assert_array_equal(found.calibration.covariance, plain.calibration.covariance)
    assert found.estimate.estimator is counting
    assert {"fit", "refit", "navigate"} <= set(counting.asked)


@pytest.mark.parametrize(("name", "points"), [("ekf", "derivatives"), ("ckf", "cubature"), ("batch", "derivatives")])
def test_a_result_says_what_its_estimator_went_by(name, points):
    calibration = run_calibration(recorded()[1], CalibrationSettings(estimator=name)).calibration
    assert calibration.accepted
    assert (calibration.estimator.name, calibration.estimator.sigma_points) == (name, points)
    schema = json.loads(files("kreisel.calibration").joinpath("result-schema.json").read_text())
    assert points in schema["properties"]["estimator"]["properties"]["sigma_points"]["enum"]


def test_a_reference_without_orientations_asks_for_sigma_points():
    """Unless the user chooses: attitudes are far off at first."""
    problem = camera_problem()
    alone = replace(problem, reference=replace(problem.reference, quaternions=None))
    assert module.estimator_for(problem) is ESTIMATORS["ekf"]
    assert module.estimator_for(alone) is ESTIMATORS["spkf"]
    chosen = replace(alone, settings=CalibrationSettings("batch"))
    assert module.estimator_for(chosen) is ESTIMATORS["batch"]
    points = replace(problem, settings=CalibrationSettings(sigma_points="unscented"))
    assert module.estimator_for(points) is ESTIMATORS["spkf"]
    assert module.estimator_for(replace(problem, settings=replace(problem.settings, passes=3))) is ESTIMATORS["ekf"]
