"""What a motion shows: made-up deviations against priors, each on either side of its bound."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.estimation.belief import Belief
from kreisel.filtering.history import FilterRun
from kreisel.filtering.observability import observability, unobservable_groups
from kreisel.model.problem import hold

from ...small_problem import small_problem

HOLDABLE = ("accel_cross_coupling", "lever_arms")


def deviations(problem, **share):
    """Deviations (degrees,) that are a share of the prior's; a thousandth for groups that are not named."""
    out = np.full(problem.layout.degrees, 1e-6)
    for group in problem.groups:
        out[problem.layout[group]] = share.get(group, 1e-3) * problem.prior.width[group]
    return out


def seen(problem, deviation):
    """Return what is said of a run with these deviations."""
    start = problem.prior.start
    return observability(problem, FilterRun(start, Belief(np.zeros(0), np.diag(deviation)), start, None))


def names(problem, group):
    d = problem.layout[group]
    return problem.parameter_names[d]


@pytest.mark.parametrize("group", HOLDABLE)
def test_a_group_is_to_be_held_once_half_of_it_keeps_more_than_half_of_the_prior(group):
    problem = small_problem()
    d = problem.layout[group]
    for shown, want in ((5, ()), (4, (group,))):  # of nine
        deviation = deviations(problem, **{group: 0.51})
        deviation[d.start : d.start + shown] *= 0.49 / 0.51
        assert unobservable_groups(problem, deviation) == want


def test_groups_that_are_never_held_are_not_named():
    problem = small_problem()
    everything = dict.fromkeys(problem.groups, 0.9)
    assert unobservable_groups(problem, deviations(problem, **everything)) == HOLDABLE
    assert unobservable_groups(hold(problem, HOLDABLE), deviations(problem, **everything)) == ()


def test_without_positions_lever_arms_are_left_in_the_state():
    problem = small_problem()
    problem = replace(problem, reference=replace(problem.reference, positions=None))
    assert unobservable_groups(problem, deviations(problem, lever_arms=0.9)) == ()
    assert unobservable_groups(problem, deviations(problem, accel_cross_coupling=0.9)) == ("accel_cross_coupling",)


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


def test_held_groups_are_not_shown_and_fixed_ones_not_spoken_of():
    held = hold(small_problem(), ("lever_arms",))
    found = seen(held, deviations(held))
    lever_arms = tuple(f"accelerometer.lever_arms[{i},{j}]" for i in range(3) for j in range(3))
    assert found.unobservable == found.not_narrowed == lever_arms
    assert not set(lever_arms) & set(found.names)
    fixed = replace(held, held=())
    assert seen(fixed, deviations(fixed)).unobservable == ()
