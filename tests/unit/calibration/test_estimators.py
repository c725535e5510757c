"""Names of estimators, and that every step asks the one that is chosen."""

import numpy as np

from kreisel.calibration import calibrate as module
from kreisel.calibration.calibrate import ESTIMATORS, run_calibration
from kreisel.kalman.sigma_point_filter import SigmaPointFilter
from kreisel.model.settings import ESTIMATORS as NAMES
from kreisel.model.settings import CalibrationSettings

from ...small_problem import recorded


class Counting:
    """The sigma-point filter, with what it was asked for."""

    name = "counting"

    def __init__(self):
        self.asked, self._own = [], SigmaPointFilter()

    def __getattr__(self, what):
        def ask(*arguments, **named):
            self.asked.append(what)
            return getattr(self._own, what)(*arguments, **named)

        return ask


def test_every_name_stands_for_an_estimator():
    assert tuple(ESTIMATORS) == NAMES
    assert all(one.name == name for name, one in ESTIMATORS.items())


def test_every_step_asks_the_estimator_that_is_chosen(monkeypatch):
    """Nothing runs a filter past it: with a counting one, all fits are counted, and the result is the same."""
    counting, settings = Counting(), CalibrationSettings()
    plain = run_calibration(recorded()[1], settings, validate=True)
    monkeypatch.setitem(module.ESTIMATORS, "spkf", counting)
    found = run_calibration(recorded()[1], settings, validate=True)
    np.testing.assert_array_equal(found.calibration.covariance, plain.calibration.covariance)
    assert found.estimate.estimator is counting
    assert {"fit", "refit", "navigate"} <= set(counting.asked)
