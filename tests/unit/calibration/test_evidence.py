"""The two halves of a recording, compared parameter by parameter."""

import numpy as np

from kreisel.calibration.evidence import SplitHalves

NAMES = ("gyroscope.offset[0]", "accelerometer.offset[1]", "timing.offset", "alignment.tilt[0]")


def test_a_score_is_the_difference_in_deviations_with_its_sign():
    halves = SplitHalves(NAMES, np.array([1.0, -6.0, 0.0, 5.0]), np.array([2.0, 3.0, 1.0, 0.5]))
    np.testing.assert_array_equal(halves.score, [0.5, -2.0, 0.0, 10.0])


def test_the_worst_is_the_sensor_parameter_that_differs_most_either_way():
    halves = SplitHalves(NAMES, np.array([1.0, -6.0, 90.0, 50.0]), np.array([2.0, 3.0, 1.0, 0.5]))
    assert halves.worst() == ("accelerometer.offset[1]", 2.0)
    assert halves.worst(("gyroscope.",)) == ("gyroscope.offset[0]", 0.5)
    assert halves.worst(("timing", "alignment")) == ("alignment.tilt[0]", 100.0)


def test_without_such_parameters_there_is_no_worst():
    none = SplitHalves((), np.zeros(0), np.zeros(0))
    assert none.worst() == ("", 0.0)
    assert SplitHalves(NAMES, np.ones(4), np.ones(4)).worst(("robot.",)) == ("", 0.0)


def test_halves_that_agree_exactly_have_no_score_even_where_nothing_is_uncertain():
    assert SplitHalves(NAMES[:1], np.zeros(1), np.zeros(1)).score == 0.0
