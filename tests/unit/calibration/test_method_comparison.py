"""Estimators side by side: what is compared, and in which units."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.by_method import (
    ByMethod,
    differences,
    document_of,
    largest,
    parameters_in,
    scores,
)
from kreisel.calibration.method_comparison import compare_methods

from ...small_problem import recorded
from .example import calibration


def test_numbers_have_the_paths_of_the_result_file():
    document = {
        "gyroscope": {"cross_coupling": [[1.0, 2.0], [3.0, 4.0]], "polynomial": {"2": [5.0]}, "note": "text"},
        "timing": {"offset": 6, "base": None},
        "site": {"latitude": 7.0},
    }
    assert parameters_in(document) == {
        "gyroscope.cross_coupling[0,0]": 1.0, "gyroscope.cross_coupling[0,1]": 2.0,
        "gyroscope.cross_coupling[1,0]": 3.0, "gyroscope.cross_coupling[1,1]": 4.0,
        "gyroscope.polynomial.2[0]": 5.0, "timing.offset": 6.0,
    }  # fmt: skip


def test_differences_and_errors_are_in_deviations():
    one = ByMethod("a", calibration(), None, 1.0)
    sensors = one.calibration.sensors
    moved = sensors.k_w.copy()
    moved[0, 1] += 2.0 * one.calibration.sensor_sd.k_w[0, 1]
    other = ByMethod("b", replace(one.calibration, sensors=replace(sensors, k_w=moved)), None, 1.0)
    found = differences(other, one)
    assert found["gyroscope.offset[1]"] == pytest.approx(2.0, rel=1e-6)
    assert largest(found, "gyroscope.offset") == pytest.approx(2.0, rel=1e-6)
    assert largest(found, "accelerometer") == 0.0
    assert np.isnan(largest(found, "magnetometer"))
    truth = {"gyroscope.offset[1]": moved[0, 1], "gyroscope.offset[9]": 1.0}
    assert scores(one, truth) == {"gyroscope.offset[1]": pytest.approx(-2.0, rel=1e-6)}


def test_three_estimators_agree_and_one_that_fails_says_why(monkeypatch):
    found = compare_methods(recorded()[1], ("spkf", "ekf", "batch"))
    for one in found[1:]:
        assert max(map(abs, differences(one, found[0]).values())) < 0.3
        assert one.drift is not None
        assert one.drift == pytest.approx(found[0].drift, rel=0.05)
    document = document_of([*found, ByMethod("other", None, "no such thing", 0.1)])["methods"]
    assert set(document["ekf"]) == {"estimate", "standard_deviation", "accepted", "reasons", "seconds", "drift"}
    assert set(document["ekf"]["estimate"]) >= {"gyroscope.offset[0]", "timing.offset"}
    assert document["other"] == {"error": "no such thing", "seconds": 0.1}
