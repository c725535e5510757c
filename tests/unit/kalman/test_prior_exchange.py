"""The narrow prior of a pass exchanged for the stated one: the result is that of a pass from the stated prior."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.fitting.stored_state import first_belief
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.prior_exchange import narrowed_belief, with_stated_prior
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.problem import without_groups
from kreisel.preparation.build_problem import build_problem

from ...small_problem import moved_by, prepared, with_noise

WIDTH = 2.0
"""Deviations of the prior, in those of the result: so narrow that the model is linear, so wide that data matter."""


@pytest.fixture(scope="module")
def settled():
    """A problem, and a run over it that has settled."""
    problem = build_problem(prepared(60.0), CalibrationSettings())
    begun = first_belief(problem, problem.prior.start)
    run = with_stated_prior(problem, run_filter(problem, problem.prior.start, belief=begun), begun)
    for _ in range(2):
        begun = narrowed_belief(problem, run)
        run = with_stated_prior(problem, run_filter(problem, run.parameters, belief=begun), begun)
    return problem, run


@pytest.fixture(scope="module")
def stated(settled):
    """The problem with a prior about another place, of known deviations."""
    problem, run = settled
    n = len(problem.parameter_names)
    sd = run.belief.standard_deviation[:n]
    centre = moved_by(problem, run.parameters, sd * np.random.default_rng(0).normal(0.0, 1.0, n))
    widths = {g: np.diag((WIDTH * run.belief.standard_deviation[problem.layout[g]]) ** 2) for g in problem.groups}
    prior = replace(problem.prior, value=centre, covariance=widths, start_covariance=widths)
    return with_noise(replace(problem, prior=prior), rate_scatter=0.0)


@pytest.fixture(scope="module")
def direct(stated):
    """A run that begins with the stated prior itself."""
    return run_filter(stated, stated.prior.value, gate=np.inf)


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_the_beginning_of_a_pass_leaves_no_trace(settled, stated, direct, share):
    problem, run = settled
    n = len(problem.parameter_names)
    factor = first_belief(stated, run.parameters, stated.prior.covariance).factor.copy()
    factor[:n, :n] *= share
    sd = direct.belief.standard_deviation[:n]
    start = moved_by(stated, run.parameters, 0.3 * sd * np.random.default_rng(1).normal(0.0, 1.0, n))
    begun = replace(first_belief(stated, start), factor=factor)
    exchanged = with_stated_prior(stated, run_filter(stated, start, gate=np.inf, belief=begun), begun)
    off = stated.layout.minus(exchanged.belief.mean[:, None], direct.belief.mean)[:n, 0] / sd
    assert np.abs(off).max() < 0.03
    np.testing.assert_allclose(exchanged.belief.standard_deviation[:n], sd, rtol=0.01)


def test_without_the_exchange_the_beginning_is_believed(settled, stated, direct):
    """The test above could not fail if the beginning made no difference."""
    _, run = settled
    n = len(stated.parameter_names)
    belief = first_belief(stated, run.parameters, stated.prior.covariance)
    factor = belief.factor.copy()
    factor[:n, :n] *= 0.5
    plain = run_filter(stated, run.parameters, gate=np.inf, belief=replace(belief, factor=factor))
    ratio = plain.belief.standard_deviation[:n] / direct.belief.standard_deviation[:n]
    assert ratio.min() < 0.8


def test_noise_of_the_rates_is_no_information_on_the_clocks(settled):
    problem, run = settled
    begun = narrowed_belief(problem, run)
    raw = run_filter(problem, run.parameters, belief=begun)
    i = problem.layout["time_offset"].start
    quiet, noisy = (
        with_stated_prior(with_noise(problem, rate_scatter=scatter), raw, begun).belief.standard_deviation[i]
        for scatter in (0.0, 0.3)
    )
    assert noisy > 1.3 * quiet


def test_what_noise_of_the_rates_said_about_a_clock_is_taken_back(settled):
    """The time offset alone: means weighed by their information, the noise's part as if it had measured the start."""
    problem, run = settled
    problem = without_groups(problem, tuple(g for g in problem.groups if g != "time_offset"))
    scatter = 0.02
    problem = with_noise(problem, rate_scatter=scatter)
    begun = narrowed_belief(problem, run_filter(problem, run.parameters))
    place = problem.layout.stored("time_offset").start
    mean = begun.mean.copy()
    mean[place] += 2.0 * begun.standard_deviation[0]
    begun = replace(begun, mean=mean)
    raw = run_filter(problem, run.parameters, belief=begun)
    exchanged = with_stated_prior(problem, raw, begun)
    prior = first_belief(problem, problem.prior.value, problem.prior.covariance)
    at, at_start, at_prior = (b.mean[place] for b in (raw.belief, begun, prior))
    I_run, I_start, I_prior = (b.standard_deviation[0] ** -2 for b in (raw.belief, begun, prior))
    K = run.parameters.sensors.K_omega
    noise = scatter**2 * np.sum(K**2) / 3.0 * raw.history.turn_information.sum()
    kept = I_run - I_start + I_prior
    assert 0.05 * kept < noise < 0.5 * kept
    left = kept - noise
    expected = (I_run * at - (I_start + noise) * at_start + I_prior * at_prior) / left
    assert exchanged.belief.mean[place] == pytest.approx(expected, abs=1e-9 * I_run**-0.5)
    assert abs(expected - at) > 0.1 * I_run**-0.5
    # the noise remains noise of the estimate
    assert exchanged.belief.standard_deviation[0] ** 2 == pytest.approx(1.0 / left + noise / left**2, rel=1e-9)


def test_a_walking_offset_keeps_a_proper_covariance(settled):
    problem, run = settled
    walking = with_noise(problem, offset_walk={"gyro_offset": 1e-5, "accel_offset": 1e-4})
    begun = narrowed_belief(walking, run)
    found = with_stated_prior(walking, run_filter(walking, run.parameters, belief=begun), begun)
    d = problem.layout["gyro_offset"]
    assert np.all(found.belief.standard_deviation[d] > run.belief.standard_deviation[d])
    assert np.isfinite(found.belief.factor).all()


def test_the_number_of_parameters_fitted_before_is_counted(settled, monkeypatch):
    problem, run = settled
    n = len(problem.parameter_names)
    monkeypatch.setattr("kreisel.fitting.nonlinearity.MIN_INFLATION", 0.3)
    monkeypatch.setattr("kreisel.fitting.nonlinearity.MAX_INFLATION", 0.3)
    begun = narrowed_belief(problem, run)
    narrow = with_stated_prior(problem, run_filter(problem, run.parameters, belief=begun), begun)
    wide = first_belief(problem, problem.prior.start)
    first = with_stated_prior(problem, run_filter(problem, problem.prior.start, belief=wide), wide)
    assert 0.5 * n < narrow.fitted < n
    assert first.fitted < 0.2 * n
    assert narrow.excess > first.excess >= 1.0


def test_a_pass_begins_as_wide_as_the_model_is_linear(settled):
    problem, run = settled
    n = len(problem.parameter_names)
    factor = narrowed_belief(problem, run).standard_deviation[:n] / run.belief.standard_deviation[:n]
    assert 5.0 < factor.max() < 10.1
    loose = replace(run, belief=replace(run.belief, factor=100.0 * run.belief.factor))
    factor = narrowed_belief(problem, loose).standard_deviation[:n] / loose.belief.standard_deviation[:n]
    assert factor.max() < 1.0
