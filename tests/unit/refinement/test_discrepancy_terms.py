"""Generic terms: what is taken out of them, their means over updates, and data corrected by them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from kreisel.geometry.rotation import conjugate, log, matrix, multiply
from kreisel.model.problem import with_readings, without_groups
from kreisel.refinement.discrepancy_terms import DiscrepancyTerms
from kreisel.refinement.sample_groups import STEP
from kreisel.refinement.term_functions import signs

from ...small_problem import camera_problem


@cache
def terms():
    return DiscrepancyTerms(camera_problem())


def amplitudes(name, function=0, row=0, size=1.0):
    """Return amplitudes of which one function of a family, in one of its rows, has a size."""
    number = [family.name for family in terms().families].index(name)
    own = np.flatnonzero(terms().family == number)
    each = own.size // len(terms().families[number].rows)
    out = np.zeros(terms().family.size)
    out[own[row * each + function]] = size
    return out


def test_there_are_families_of_sensors_and_reference():
    names = {family.name for family in terms().families}
    assert {
        "gyroscope.rate",
        "accelerometer.jerk",
        "reference.position_by_attitude",
        "reference.stamps_by_time",
    } <= names
    assert not any(family.owner == "robot" for family in terms().families)  # no joint angles
    assert terms().family.size == terms().weight.size == terms().terms(camera_problem().schedule).count


def test_terms_serve_what_has_the_same_data_and_sensors():
    problem = camera_problem()
    readings = problem.sensor.readings
    assert terms().serves(problem)
    assert terms().serves(with_readings(problem, readings.with_noise(2.0, 1.0)))
    assert not terms().serves(with_readings(problem, readings.with_values(rates=2.0 * readings.rates)))
    assert not terms().serves(replace(problem, reference=problem.reference.part(slice(0, -1))))
    assert not terms().serves(without_groups(problem, ("gyro_offset",)))
    same = terms().terms(problem.schedule)
    assert terms().terms(problem.schedule) is same
    assert terms().terms(replace(problem.schedule)) is not same


@pytest.mark.parametrize(
    ("name", "has"),
    [
        ("gyroscope.rate", ["rates"]),
        ("gyroscope.acceleration", ["rates", "accelerations"]),
        ("accelerometer.jerk", ["rates", "accelerations"]),
    ],
)
def test_readings_are_corrected_by_nothing_that_the_usual_model_has(name, has):
    problem = camera_problem()
    changed = terms().corrected(problem, amplitudes(name, 2, 1, 1e-3)).sensor.readings
    readings = problem.sensor.readings
    added = (changed.rates - readings.rates) + (changed.accelerations - readings.accelerations)
    assert not added[:, [0, 2]].any()
    assert np.sqrt(np.mean(added[:, 1] ** 2)) == pytest.approx(1e-3, rel=0.05)
    usual = np.hstack([np.ones((len(added), 1)), *(getattr(readings, one) for one in has)])
    usual /= np.sqrt(np.mean(usual**2, axis=0))
    # the functions are of readings averaged over a few samples, the products here of single ones
    assert np.max(np.abs(usual.T @ added[:, 1])) / len(added) < 0.05 * 1e-3


def test_a_field_in_the_cell_is_level_and_keeps_what_looks_like_an_error_of_the_axes():
    """The gyros' rows get one sum of the level directions of r, as the poses have them, whatever the readings are."""
    problem = camera_problem()
    changed = terms().corrected(problem, amplitudes("gyroscope.attitude", 3, 0, 1e-3)).sensor.readings
    added = (changed.rates - problem.sensor.readings.rates)[:, 0]
    t, tau = problem.sensor.readings.stamps, problem.reference.seconds
    q = problem.reference.quaternions[np.abs(problem.prior.start.clock.imu_time(tau)[:, None] - t).argmin(axis=0)]
    level = np.einsum("nij,i->nj", matrix(q), matrix(problem.prior.start.q_rn)[:, 1])
    np.testing.assert_allclose(added, 1e-3 * level[:, 1] / np.sqrt(np.mean(level[:, 1] ** 2)), atol=2e-5)


def test_what_exceeds_a_range_is_added_near_its_end_alone():
    problem = camera_problem()
    before = problem.sensor.readings.accelerations[:, 1]
    own = amplitudes("accelerometer.range", 0, 1, 1e-3)
    added = (terms().corrected(problem, own).sensor.readings.accelerations - problem.sensor.readings.accelerations)[
        :, 1
    ]
    high = before > before.max() - 0.1 * np.ptp(before)
    assert 0 < np.mean(added > 0.0) < 0.1
    assert not added[~high].any()
    assert added.min() >= 0.0


def test_a_step_at_zero_is_an_offset_with_the_sign_of_the_reading():
    problem, step = camera_problem(), 1e-3
    readings = problem.sensor.readings
    before = readings.rates[:, 2]
    corrected = terms().corrected(problem, amplitudes("gyroscope.sign", 0, 2, 0.5 * step))
    added = corrected.sensor.readings.rates[:, 2] - before
    far = np.abs(before) > 0.05
    assert np.mean(far) > 0.3
    assert np.mean(added[np.abs(before) < 1e-3] == 0.0) > 0.9
    size = 0.5 * step / np.sqrt(np.mean(added != 0.0))
    np.testing.assert_allclose(added[far], size * np.sign(before[far]), rtol=0.02)


def test_at_rest_gyros_have_what_terms_of_the_motion_add_there():
    problem = camera_problem()
    readings, own = problem.sensor.readings, amplitudes("gyroscope.rate", 4, 1, 1e-3)
    resting = np.zeros(readings.stamps.size, dtype=bool)
    for standstill in problem.schedule.standstills:
        resting |= (readings.stamps >= standstill.start) & (readings.stamps <= standstill.stop)
    assert 0.1 < resting.mean() < 0.9
    expected = (
        terms().corrected(problem, own).sensor.readings.rates[resting, 1].mean() - readings.rates[resting, 1].mean()
    )
    assert abs(expected) > 1e-5
    np.testing.assert_allclose(terms().at_rest(own), [0.0, expected, 0.0], rtol=1e-9)
    for drift in ("gyroscope.time", "gyroscope.past_rate"):
        assert not terms().at_rest(amplitudes(drift, 2, 1, 1e-3)).any()
    assert not terms().at_rest(amplitudes("accelerometer.acceleration", 2, 1, 1e-3)).any()


def test_a_drift_keeps_what_it_has_in_common_with_the_motion():
    problem = camera_problem()
    changed = terms().corrected(problem, amplitudes("accelerometer.time", 2, 1, 1e-3)).sensor.readings
    added = (changed.accelerations - problem.sensor.readings.accelerations)[:, 1]
    t = problem.sensor.readings.stamps
    wave = np.cos(3.0 * np.pi * (t - t[0]) / np.ptp(t))
    expected = (wave - wave.mean()) / wave.std() * 1e-3
    assert np.abs(np.abs(added) - np.abs(expected)).max() < 2e-5
    assert abs(added.mean()) < 1e-5


def test_poses_are_corrected_by_nothing_that_another_frame_or_tool_point_does():
    problem = camera_problem()
    reference = problem.reference
    changed = terms().corrected(problem, amplitudes("reference.position_by_attitude", 5, 2, 1e-3)).reference
    added = changed.positions - reference.positions
    assert not added[:, :2].any()
    frames = np.hstack([np.ones((len(added), 1)), matrix(reference.quaternions).reshape(-1, 9), reference.positions])
    left = added[:, 2] - frames @ np.linalg.lstsq(frames, added[:, 2], rcond=None)[0]
    assert np.sqrt(np.mean(left**2)) == pytest.approx(np.sqrt(np.mean(added[:, 2] ** 2)), rel=1e-3)
    np.testing.assert_array_equal(changed.quaternions, reference.quaternions)


def test_stamps_that_are_late_move_poses_along_their_motion():
    problem = camera_problem()
    reference, late = problem.reference, 2e-4
    changed = terms().corrected(problem, amplitudes("reference.stamps_by_time", size=late)).reference
    tau = reference.seconds
    lateness = late * np.cos(np.pi * tau / tau[-1]) / np.sqrt(np.mean(np.cos(np.pi * tau / tau[-1]) ** 2))
    expected = np.stack([np.interp(tau + lateness, tau, column) for column in reference.positions.T], axis=1)
    rate = log(multiply(conjugate(reference.quaternions[:-1]), reference.quaternions[1:])) / np.diff(tau)[:, None]
    turned = log(multiply(conjugate(reference.quaternions), changed.quaternions))[:-1]
    for added, by_noisy_poses in (
        (changed.positions - reference.positions, expected - reference.positions),
        (turned, lateness[:-1, None] * rate),
    ):
        assert np.sum(added * by_noisy_poses) / np.sum(added**2) == pytest.approx(1.0, abs=0.03)


def test_a_term_is_the_mean_over_an_update_of_what_corrects_the_readings():
    problem = camera_problem()
    chosen = amplitudes("accelerometer.rate", 1, 0)
    added = terms().corrected(problem, chosen).sensor.readings.accelerations - problem.sensor.readings.accelerations
    found = terms().terms(problem.schedule)
    term = int(np.flatnonzero(chosen)[0])
    assert found.row[term] == 3
    for k in (10, 40, 90):
        update = problem.schedule.updates[k]
        mean = np.mean(added[update.first : update.last + 1, 0])
        assert found.functions[k, found.function[term]] == pytest.approx(mean, abs=0.15 * np.abs(added).max())
    family = int(terms().family[term])
    assert terms().size(2.0 * chosen, family) == pytest.approx(2.0 / 3**0.5, rel=0.02)
    every = np.where(terms().family == family, 1.0, 0.0)  # functions of one row that depend on each other
    added = terms().corrected(problem, every).sensor.readings.accelerations - problem.sensor.readings.accelerations
    assert terms().size(every, family) == pytest.approx(np.sqrt(np.mean(added**2)), rel=0.05)


def test_readings_are_taken_together_over_a_short_time():
    stamps = camera_problem().sensor.readings.stamps
    step = float(np.median(np.diff(stamps)))
    assert step <= STEP
    assert terms()._grid.count == pytest.approx(stamps.size * step / STEP, rel=0.05)


def test_readings_that_are_noise_have_no_sign():
    """The sign of their own noise would be correlated with it."""
    noise = np.array([0.01, 0.02, 0.0])
    own = np.array([[0.2, -0.2, 1e-9], [0.04, -0.09, -1e-9], [-0.06, 0.11, 0.0]])
    np.testing.assert_array_equal(signs(own, noise).of(np.arange(3)), [[1, -1, 1], [0, 0, -1], [-1, 1, 0]])
