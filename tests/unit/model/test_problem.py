"""The problem: what its counts say of the state, and what changes when groups leave or noise is coloured."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.model.parameters import GROUPS
from kreisel.model.problem import with_correlation_time, without_groups

from ...small_problem import small_problem, with_noise

GONE = ("lever_arms", "gravity")


def test_counts_are_those_of_the_degrees_of_freedom_by_their_names():
    problem = small_problem()
    parameters = problem.parameter_names
    gyro = [name for name in parameters if name.startswith("gyroscope.")]
    sensors = [name for name in parameters if name.startswith(("gyroscope.", "accelerometer."))]
    assert problem.gyro_degrees == len(gyro) == 12
    assert problem.sensor_degrees == len(sensors) == 33
    assert list(parameters[: len(sensors)]) == sensors  # the sensors' come first, gyros before accelerometers
    assert (
        len(set(parameters))
        == len(parameters)
        == sum(problem.layout[g].stop - problem.layout[g].start for g in problem.groups)
    )
    assert problem.joints == 0


def test_what_changes_between_updates_stands_last_in_the_state():
    problem = small_problem()
    tail = list(problem.layout.tail(problem.changing))
    assert [p.name for p in tail] == ["path_position", "path_orientation", "velocity", "position", "attitude"]
    white = replace(problem, layout=with_correlation_time(problem, 0.0).layout)
    assert white.changing == problem.changing == 15


def test_parameters_are_named_in_the_order_of_the_state():
    problem = small_problem()
    d = problem.layout
    assert problem.parameter_names[d["gyro_cross_coupling"]][5] == "gyroscope.cross_coupling[1,2]"
    assert problem.parameter_names[d["lever_arms"]][7] == "accelerometer.lever_arms[2,1]"
    assert problem.parameter_names[d["time_offset"]] == ("timing.offset",)


def test_a_walk_gathers_density_squared_times_the_time_from_the_first_update_to_the_last():
    """The steps from sample to sample are independent: their variances add."""
    density, problem = {"gyro_offset": 2e-5, "accel_offset": 3e-4, "gyro_polynomial": 1.0}, small_problem()
    found = with_noise(problem, offset_walk=density).walked_variance
    updates, stamps = problem.schedule.updates, problem.sensor.readings.stamps
    steps = np.diff(stamps[updates[0].first : updates[-1].last + 1])
    for group in ("gyro_offset", "accel_offset"):
        np.testing.assert_allclose(found[problem.layout[group]], np.sum(density[group] ** 2 * steps), rtol=1e-9)
    others = np.ones(found.size, dtype=bool)
    others[problem.layout["gyro_offset"]] = others[problem.layout["accel_offset"]] = False
    assert not found[others].any()


def test_groups_that_leave_the_state_keep_their_nominal_values():
    problem = small_problem()
    problem = replace(problem, prior=replace(problem.prior, value=replace(problem.prior.start, gravity=9.7)))
    rest = without_groups(problem, GONE)
    assert rest.groups == tuple(g for g in problem.groups if g not in GONE)
    prior, before = rest.prior, problem.prior
    assert np.abs(before.start.stored("lever_arms") - before.nominal.stored("lever_arms")).max() > 0.0
    for group in GROUPS:
        for now, then in ((prior.start, before.start), (prior.value, before.value)):
            want = before.nominal if group in GONE else then
            np.testing.assert_array_equal(now.stored(group), want.stored(group))
    for covariance, all_of_them in (
        (prior.covariance, before.covariance), (prior.start_covariance, before.start_covariance),
    ):  # fmt: skip
        assert covariance.keys() == all_of_them.keys() - set(GONE)


@pytest.mark.parametrize(
    ("lacking", "want"),
    [((), ["path_position", "path_orientation"]), (("positions",), ["path_orientation"]),
     (("quaternions",), ["path_position"])],
)  # fmt: skip
def test_coloured_noise_is_in_the_state_for_what_the_reference_measures(lacking, want):
    problem = small_problem()
    reference = replace(problem.reference, **dict.fromkeys(lacking))
    coloured = with_correlation_time(replace(problem, reference=reference), 0.8)
    assert coloured.noise.correlation_time == coloured.noise.coloured.time == 0.8
    assert [part.name for part in coloured.layout if part.name.startswith("path")] == want
    assert coloured.changing == 9 + 3 * len(want)
