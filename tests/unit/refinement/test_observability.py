"""What a motion shows: made-up deviations against priors, each on either side of its bound."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.model.problem import without_groups
from kreisel.refinement.nominal_values import with_nominal_values
from kreisel.refinement.observability import observability

from ...small_problem import small_problem, small_run

WEAK = "accel_cross_coupling"


def deviations(problem, **share):
    """Deviations (degrees,) that are a share of the prior's; a thousandth for groups that are not named."""
    out = np.full(problem.layout.degrees, 1e-6)
    for group in problem.groups:
        out[problem.layout[group]] = share.get(group, 1e-3) * problem.prior.width[group]
    return out


def seen(problem, deviation):
    """Return what is said of a run with these deviations."""
    return observability(problem, deviation)


def names(problem, group):
    d = problem.layout[group]
    return problem.parameter_names[d]


def test_deviations_before_and_after_are_told_for_every_parameter():
    problem = small_problem()
    deviation = deviations(problem, gyro_offset=0.2)
    found = seen(problem, deviation)
    n = len(problem.parameter_names)
    assert found.names == problem.parameter_names
    np.testing.assert_allclose(found.posterior, deviation[:n], rtol=1e-12)
    before = dict(zip(found.names, found.prior, strict=True))
    assert before["gyroscope.offset[1]"] == pytest.approx(20.0 * np.pi / 180.0 / 3600.0)  # as stated: 20 deg/h
    assert before["accelerometer.lever_arms[2,0]"] == 0.1  # as usual, m
    assert found.unobservable == found.not_narrowed == ()


@pytest.mark.parametrize("group", ["gyro_cross_coupling", "lever_arms", "time_offset"])
def test_a_parameter_that_keeps_more_than_half_of_its_prior_is_not_shown(group):
    problem = small_problem()
    deviation = deviations(problem, **{group: 0.01})
    at = problem.layout[group].start
    width = float(problem.prior.width[group][0])
    deviation[at] = 0.51 * width
    found = seen(problem, deviation)
    assert found.unobservable == found.not_narrowed == (names(problem, group)[0],)


@pytest.mark.parametrize(
    ("group", "useful"),
    [("gyro_cross_coupling", 3e-3), ("accel_cross_coupling", 5e-3), ("lever_arms", 0.03), ("time_offset", 2e-3)],
)
def test_a_parameter_that_is_narrowed_may_still_be_of_no_use(group, useful):
    problem = small_problem()
    deviation = deviations(problem)
    at = problem.layout[group].start
    for sd, want in ((0.99 * useful, ()), (1.01 * useful, (names(problem, group)[0],))):
        deviation[at] = sd
        found = seen(problem, deviation)
        assert found.unobservable == want
        assert found.not_narrowed == ()


@pytest.mark.parametrize("group", ["gravity", "north", "alignment", "accel_offset"])
def test_what_is_known_before_may_stay_as_uncertain_as_it_was(group):
    """Some groups always; offsets where their deviation is stated, as here."""
    problem = small_problem()
    deviation = deviations(problem)
    deviation[problem.layout[group]] = 1.0 * np.minimum(problem.prior.width[group], 0.09)
    assert seen(problem, deviation).unobservable == ()
    if group == "accel_offset":
        unstated = replace(problem, prior=replace(problem.prior, stated=()))
        deviation[problem.layout[group]] = 0.51 * problem.prior.width[group]
        assert seen(unstated, deviation).not_narrowed == tuple(f"accelerometer.offset[{i}]" for i in range(3))


def test_a_stated_offset_that_is_too_uncertain_to_be_of_use_is_named_all_the_same():
    problem = small_problem()
    deviation = deviations(problem)
    deviation[problem.layout["accel_offset"]] = 0.11  # m/s^2; a tenth is of use
    found = seen(problem, deviation)
    assert found.unobservable == tuple(f"accelerometer.offset[{i}]" for i in range(3))
    assert found.not_narrowed == ()


def test_a_matrix_that_is_hardly_observable_keeps_its_nominal_value_and_its_uncertainty_is_propagated():
    """Against a filter with that matrix fixed, whose result is moved by a drawn error of it."""
    problem, run = small_problem(), small_run()
    d, n = problem.layout["accel_cross_coupling"], len(problem.parameter_names)
    assert with_nominal_values(problem, run)[0] is run  # this motion shows it
    wide = replace(problem, prior=replace(problem.prior, width=problem.prior.width | {WEAK: np.array([1e-6])}))
    found, errors = with_nominal_values(wide, run)
    np.testing.assert_allclose(found.parameters.stored(WEAK), problem.prior.nominal.stored(WEAK), atol=1e-12)
    np.testing.assert_allclose(found.belief.standard_deviation[d], 0.015, rtol=1e-6)
    # conditioning by the information matrix, which shares no step with the gain
    information = np.linalg.inv(run.belief.covariance[:n, :n])
    rest = np.setdiff1d(np.arange(n), np.r_[d])
    conditioned = np.linalg.inv(information[np.ix_(rest, rest)])
    slope = -conditioned @ information[np.ix_(rest, np.r_[d])]
    expected = conditioned + 0.015**2 * slope @ slope.T
    np.testing.assert_allclose(found.belief.covariance[np.ix_(rest, rest)], expected, rtol=2e-3, atol=1e-14)
    # another error of the result moves the rest by what is left of it once the matrix is known
    np.testing.assert_allclose(errors[np.ix_(rest, np.r_[d])], -slope, rtol=2e-3, atol=1e-9)
    np.testing.assert_allclose(errors[d], 0.0, atol=1e-12)


def test_fixed_groups_are_not_spoken_of():
    fixed = without_groups(small_problem(), ("lever_arms",))
    found = seen(fixed, deviations(fixed))
    assert not any(name.startswith("accelerometer.lever_arms") for name in (*found.names, *found.unobservable))
