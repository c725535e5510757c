"""Effects that data of a unit show, by a linear problem whose answer is known."""

import numpy as np
import pytest
from scipy.stats import chi2

from kreisel.array.unit_effects import candidates, limit, shown_effects

PLACES = {"gyro_polynomial": np.arange(4, 10), "accel_polynomial": np.arange(10, 16)}


def test_the_limit_is_that_of_chi_square():
    """The approximation is exact to a third of the probability, which is 0.7 of chi-square."""
    for degrees in (3, 6, 9):
        assert limit(degrees) == pytest.approx(chi2.isf(1e-4, degrees), abs=0.8)


@pytest.mark.parametrize(("size", "expected"), [(0.0, ()), (0.3, ("accel_polynomial",))])
def test_what_the_data_hold_is_found_and_nothing_else(size, expected):
    rng = np.random.default_rng(4)
    X = rng.normal(size=(400, 16))
    X[:, 4:10] += X[:, 10:16]  # each looks like the other
    y = X[:, :4] @ np.ones(4) + size * X[:, 10:16] @ np.ones(6) + rng.normal(size=400)

    def fitted(used):
        inverse = np.linalg.inv(X[:, used].T @ X[:, used])
        return inverse @ X[:, used].T @ y, inverse

    assert tuple(shown_effects(fitted, np.arange(4), PLACES, np.arange(0), np.arange(0))) == expected


def test_what_is_estimated_is_no_candidate_nor_a_part_of_it():
    assert "accel_axis_delay" in candidates({})
    found = candidates({"accel_delay": 1, "gyro_polynomial": 3})
    assert not {"accel_axis_delay", "gyro_polynomial"} & set(found)
    assert "gyro_cubic" in found
    assert "gyro_cubic" not in candidates({"gyro_polynomial": 6})
