"""How offsets come in over time."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.convergence import Convergence, offset_convergence
from kreisel.units import MG

from ...small_problem import calibrated, recorded

TIMES = np.array([1.0, 2.0, 3.0, 4.0])


def series(*offsets):
    return Convergence(TIMES[: len(offsets)], np.array(offsets, dtype=float).reshape(-1, 3), np.ones((len(offsets), 3)))


@pytest.mark.parametrize(
    ("errors", "want"),
    [((0, 0, 0, 0), 1.0), ((9, 0, 0, 0), 2.0), ((9, 0, -9, 0), 4.0), ((0.5, 0.5, 0.5, 0.5), 1.0)],
)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_time_within_a_bound_is_that_after_the_last_excursion_of_any_axis(errors, want, axis):
    truth = np.array([1.0, -2.0, 3.0])
    found = series(*(truth + e * np.eye(3)[axis] for e in errors))
    assert found.time_within(0.5, truth) == want


def test_a_bound_that_is_not_kept_to_the_end_is_never_reached():
    assert np.isnan(series([0, 0, 0], [0, 0, 1]).time_within(0.5, np.zeros(3)))
    assert np.isnan(series().time_within(0.5, np.zeros(3)))


@pytest.fixture(scope="module")
def found():
    return offset_convergence(calibrated())


def test_offsets_come_in_from_zero_and_the_grade_to_the_truth(found):
    """The grade states 25 mg. At the first update nothing but one pose has been seen."""
    truth = recorded()[0].sensors.k_a[0]
    np.testing.assert_allclose(found.deviations[0], 25.0 * MG, rtol=0.02)
    assert np.abs(found.offsets[0]).max() < 1.0 * MG < np.abs(truth).max()
    assert np.abs((found.offsets[-1] - truth) / found.deviations[-1]).max() < 4.0
    assert found.deviations[-1].max() < 5.0 * MG
    assert found.seconds.shape == (len(calibrated().problem.schedule.updates),)


def test_errors_on_the_way_are_as_large_as_their_deviations(found):
    """Each is one draw of a normal variable: five deviations at any time would be a wonder."""
    truth = recorded()[0].sensors.k_a[0]
    assert np.abs((found.offsets - truth) / found.deviations).max() < 5.0
    assert np.all(np.diff(found.deviations, axis=0) < 1e-9)  # nothing walks here: what is known stays known


def test_without_a_grade_the_offsets_begin_with_a_third_of_a_metre_per_second_squared():
    outcome = calibrated()
    noise = replace(outcome.preparation.imu_noise, accel_offset_sd=None)
    ungraded = replace(outcome, preparation=replace(outcome.preparation, imu_noise=noise))
    np.testing.assert_allclose(offset_convergence(ungraded).deviations[0], 0.3, rtol=0.15)
