"""The history of updates: closed forms of linear estimation, from the covariances themselves."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from kreisel._kernels.filter_arguments import Record
from kreisel.fitting.update_history import History
from kreisel.kalman.kernel_inputs import filter_record
from kreisel.kalman.update_record import history_of, joined

from ...kernel_parts.record_update import record_update
from ...oracle import quaternions as quat
from ...small_problem import plain_run, small_problem

PRESENT = {False: np.arange(6), True: np.arange(9)}


def made_up(problem, updates, rng, present):
    """Innovations of a linear measurement with covariances P_zz, and the record the filter leaves of them."""
    u, n = len(updates), len(problem.parameter_names)
    record = filter_record(problem, u)
    record.mean[:], record.deviation[:] = rng.normal(size=record.mean.shape), rng.uniform(size=(u, n))
    record.used[:] = rng.uniform(size=u) < 0.7
    exact = []
    for i, update in enumerate(updates):
        place = present[update.standstill is not None]
        m = place.size
        H, root = rng.normal(size=(m, 6)), rng.normal(size=(m, m + 2))
        P, R = np.diag(rng.uniform(0.5, 2.0, 6)), root @ root.T
        Pzz, z = H @ P @ H.T + R, rng.normal(size=m)
        S, gain = np.linalg.cholesky(Pzz), np.full((20, m), 7.0)
        gain[[11, 12, 13, 17, 18, 19]] = P @ H.T @ np.linalg.inv(S).T
        passing = rng.normal(size=6)
        record_update(record, i, z, passing, root, S, np.linalg.solve(S, z), gain, place, used=bool(record.used[i]))
        exact.append((H, P, R, passing, Pzz, z))
    return record, exact


@pytest.fixture(scope="module")
def case():
    problem = small_problem()
    updates = problem.schedule.updates[:40]
    record, exact = made_up(problem, updates, np.random.default_rng(0), PRESENT)
    kinds = [update.standstill is not None for update in updates]
    assert any(kinds)
    assert not all(kinds)
    return problem, updates, record, exact, history_of(problem, updates, record)


def test_kinds_and_times_are_those_of_the_updates(case):
    problem, updates, record, _, found = case
    np.testing.assert_array_equal(found.at_standstill, [item.standstill is not None for item in updates])
    np.testing.assert_array_equal(found.degrees, [9 if item.standstill is not None else 6 for item in updates])
    np.testing.assert_array_equal(found.seconds, [problem.sensor.readings.stamps[item.last] for item in updates])
    np.testing.assert_array_equal(found.used, record.used)


def test_normalised_innovations_are_those_of_the_full_covariance(case):
    *_, exact, found = case
    want = [z @ np.linalg.solve(Pzz, z) for *_, Pzz, z in exact]
    np.testing.assert_allclose(found.nis, want, rtol=1e-9)


def test_log_likelihoods_are_the_normal_densities_but_for_their_constant(case):
    *_, exact, found = case
    want = [multivariate_normal(np.zeros(z.size), Pzz).logpdf(z) for *_, Pzz, z in exact]
    constant = 0.5 * found.degrees * np.log(2.0 * np.pi)
    np.testing.assert_allclose(found.log_likelihood - constant, want, rtol=1e-9)


def test_residuals_are_what_is_left_of_the_innovation_after_the_update(case):
    """z - H K z, with the gain K of the book; nan where there is no such measurement."""
    *_, exact, found = case
    for i, (H, P, R, _, Pzz, z) in enumerate(exact):
        left = z - H @ (P @ H.T @ np.linalg.solve(Pzz, z))
        m = z.size
        np.testing.assert_allclose(found.residual[i, :m], left, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(found.noise_variance[i, :m], np.diag(R), rtol=1e-14)
        np.testing.assert_array_equal(found.innovation[i, :m], z)
        for wide in (found.residual, found.noise_variance, found.innovation, found.whitened):
            assert np.isnan(wide[i, m:]).all()


def test_corrections_are_the_gains_and_their_variance_what_the_covariance_falls_by(case):
    *_, exact, found = case
    for i, (H, P, *_, Pzz, z) in enumerate(exact):
        K = P @ H.T @ np.linalg.inv(Pzz)
        np.testing.assert_allclose(found.correction[i], K @ z, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(found.correction_variance[i], np.diag(P - (np.eye(6) - K @ H) @ P), rtol=1e-8)


def test_information_on_turns_is_the_trace_of_the_inverse_over_orientation_and_none_where_rejected(case):
    *_, exact, found = case
    want = [np.trace(np.linalg.inv(Pzz)[3:6, 3:6]) for *_, Pzz, _ in exact]
    assert not found.used.all()
    np.testing.assert_allclose(found.turn_information, found.used * want, rtol=1e-8)


def test_errors_of_stamps_are_those_of_generalised_least_squares(case):
    *_, exact, found = case
    for i, (*_, passing, Pzz, z) in enumerate(exact):
        m = np.pad(passing, (0, z.size - 6))
        weight = m @ np.linalg.solve(Pzz, m)
        np.testing.assert_allclose(found.late[i], [m @ np.linalg.solve(Pzz, z) / weight, weight**-0.5], rtol=1e-9)
        np.testing.assert_array_equal(found.passing[i], passing)


@pytest.mark.parametrize(("lacking", "rows"), [("quaternions", [0, 1, 2]), ("positions", [3, 4, 5])])
def test_what_the_reference_does_not_measure_stays_nan(lacking, rows):
    problem = small_problem()
    problem = replace(problem, reference=replace(problem.reference, **{lacking: None}))
    updates = problem.schedule.updates[:40]
    present = {False: np.array(rows), True: np.array([*rows, 6, 7, 8])}
    record, exact = made_up(problem, updates, np.random.default_rng(1), present)
    found = history_of(problem, updates, record)
    for i, (*_, Pzz, z) in enumerate(exact):
        where = present[bool(found.at_standstill[i])]
        np.testing.assert_array_equal(found.innovation[i, where], z)
        assert np.isnan(np.delete(found.innovation[i], where)).all()
        turns = np.trace(np.linalg.inv(Pzz)[:3, :3]) if lacking == "positions" else 0.0
        assert found.turn_information[i] == pytest.approx(found.used[i] * turns, rel=1e-8)


def test_joined_histories_keep_their_order_and_count_tilt_from_the_last(case):
    problem, updates, record, _, whole = case
    layout = problem.layout
    first, second = (
        history_of(problem, updates[part], Record(*(column[part] for column in record)))
        for part in (slice(0, 15), slice(15, 40))
    )
    tilt = layout.stored("alignment")
    for part in (first, second, whole):  # quaternions of unit length
        part.parameters[:, tilt] /= np.linalg.norm(part.parameters[:, tilt], axis=1, keepdims=True)
    last = record.mean[-1].copy()
    last[tilt] /= np.linalg.norm(last[tilt])
    found = joined(problem, [first, second], last)
    for field in fields(History):
        if field.name != "parameters":
            np.testing.assert_array_equal(getattr(found, field.name), getattr(whole, field.name))
    assert found.parameters.shape == found.deviations.shape == (40, len(problem.parameter_names))
    want = quat.log(quat.multiply(quat.conjugate(last[tilt]), whole.parameters[:, tilt]))[:, :2]
    np.testing.assert_allclose(found.parameters[:, layout["alignment"]], want, atol=1e-12)
    np.testing.assert_allclose(found.parameters[-1, layout["alignment"]], 0.0, atol=1e-12)
    for group in ("gyro_offset", "north", "time_offset"):
        np.testing.assert_array_equal(found.parameters[:, layout[group]], record.mean[:, layout.stored(group)])


def test_the_filters_own_history_ends_with_its_result():
    problem, run = small_problem(), plain_run()
    n = len(problem.parameter_names)
    np.testing.assert_allclose(run.history.deviations[-1], run.belief.standard_deviation[:n], rtol=1e-12)
    for group in problem.groups:
        want = np.zeros(2) if group == "alignment" else run.parameters.stored(group)
        np.testing.assert_allclose(run.history.parameters[-1, problem.layout[group]], want, rtol=1e-12, atol=1e-15)
