"""What the compiled filter reads of a problem, put together again and compared with the problem."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel._kernels import filter_arguments
from kreisel.fitting.stored_state import stored_state
from kreisel.inertial.earth import EARTH_RATE
from kreisel.inertial.effects import EFFECTS
from kreisel.kalman.kernel_inputs import filter_model, filter_record, filter_steps
from kreisel.model.assumed_noise import GaussMarkov, PoseError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import GROUPS, REFERENCE_GROUPS
from kreisel.model.problem import with_correlation_time, without_groups

from ...small_problem import small_problem, with_drifts, with_noise

NOTHING = np.zeros((20, 6, 0))
"""No errors of the reported poses."""

ORDER = {
    "gyro": ("gyro_cross_coupling", "gyro_offset"),
    "accel": ("accel_cross_coupling", "accel_offset", "lever_arms"),
    "around": ("alignment", "north", "gravity", "time_offset", "time_skew", "earth_down"),
    "robot": ("robot_placement", "robot_gears", "robot_compliance", "robot_zeros"),
}


@pytest.mark.parametrize("held", [(), ("lever_arms", "gravity"), ("gyro_cross_coupling", "gyro_offset", "north")])
def test_rows_give_the_parameters_of_a_state_and_what_is_known_of_the_others(held):
    problem = without_groups(small_problem(), held)
    known = replace(problem.prior.start, north=np.array([7.0, 8.0]), gravity=9.0, skew=1e-3)
    x = stored_state(problem, problem.prior.start) + np.arange(problem.layout.size)
    model = filter_model(problem, known)
    for name, groups in ORDER.items():
        rows = getattr(model, name)
        found = np.where(rows.source >= 0, x[rows.source], rows.known)
        in_state = [x[problem.layout.stored(g)] if g in problem.layout else known.stored(g) for g in groups]
        np.testing.assert_array_equal(found, np.concatenate(in_state))
    assert {*(g for groups in ORDER.values() for g in groups), *EFFECTS, *REFERENCE_GROUPS} == set(GROUPS)


@pytest.mark.parametrize("held", [(), ("accel_offset",), ("gyro_cross_coupling", "gyro_offset")])
def test_the_first_degrees_of_freedom_are_those_of_the_sensors(held):
    """Changed one by one, and those found that change a parameter of the gyros, or of the accelerometers."""
    problem = without_groups(small_problem(), held)
    model, layout = filter_model(problem, problem.prior.start), problem.layout
    x = stored_state(problem, problem.prior.start)
    changed = layout.plus(x, np.eye(layout.degrees)) != x[:, None]
    gyro, accel = (
        [i for group in groups if group in layout for i in np.r_[layout.stored(group)]]
        for groups in (ORDER["gyro"], ORDER["accel"])
    )
    assert model.gyro_degrees == changed[gyro].any(axis=0).sum()
    assert changed[gyro].any(axis=0)[: model.gyro_degrees].all()
    assert model.sensor_degrees == model.gyro_degrees + changed[accel].any(axis=0).sum()
    assert changed[accel].any(axis=0)[model.gyro_degrees : model.sensor_degrees].all()


def test_places_of_parts_are_those_in_the_stored_state():
    problem = without_groups(small_problem(), ("gravity",))
    model = filter_model(problem, problem.prior.start)
    x = np.arange(problem.layout.size)
    for name in ("velocity", "attitude", "standstill_orientation", "path_position"):
        assert model.stored[filter_arguments.STORED[name]] == x[problem.layout.stored(name)][0]
    without = replace(problem, layout=problem.layout.tail(9))
    np.testing.assert_array_equal(filter_model(without, problem.prior.start).stored, [0, 3, 6, -1, -1, -1, -1])
    np.testing.assert_array_equal(model.tail, problem.layout.tail(15).table)


def test_noise_on_the_path_is_split_into_white_and_coloured():
    problem = with_correlation_time(with_noise(small_problem(), pose_error=PoseError(4e-3, 3e-3, 9.0)), 1.5)
    own = problem.noise.reference
    model = filter_model(problem, problem.prior.start)
    time, position, orientation = model.coloured
    assert time == 1.5
    assert position**2 + model.noise[filter_arguments.NOISE["at_position"]] ** 2 == pytest.approx(
        own.position**2 + 16e-6, rel=1e-12
    )
    assert orientation**2 + model.noise[filter_arguments.NOISE["at_orientation"]] ** 2 == pytest.approx(
        own.orientation**2 + 9e-6, rel=1e-12
    )
    np.testing.assert_array_equal(
        model.noise[
            [
                filter_arguments.NOISE["jitter_position"],
                filter_arguments.NOISE["jitter_orientation"],
                filter_arguments.NOISE["standstill_velocity"],
            ]
        ],
        [own.jitter_position, own.jitter_orientation, own.velocity],
    )


def test_offsets_that_are_in_the_state_and_walk_are_named_by_degree_of_freedom():
    density = {"gyro_offset": 2e-5, "accel_offset": 3e-4}
    problem = with_noise(small_problem(), offset_walk=density)
    model = filter_model(problem, problem.prior.start)
    walk = np.zeros(problem.layout.degrees)
    walk[model.walking] = model.walk
    assert np.flatnonzero(walk).size == 6
    for group, size in density.items():
        np.testing.assert_array_equal(walk[problem.layout[group]], size)
    held = filter_model(without_groups(problem, ("gyro_offset",)), problem.prior.start)
    np.testing.assert_array_equal(held.walk, 3e-4)
    still = with_noise(problem, offset_walk={"gyro_offset": 0.0, "accel_offset": 3e-4})
    np.testing.assert_array_equal(filter_model(still, problem.prior.start).walk, 3e-4)
    assert filter_model(with_noise(problem, offset_walk={}), problem.prior.start).walking.size == 0


def test_drifts_fade_and_keep_their_size():
    """Density and rate of fading of a Gauss-Markov process: sqrt(2 / tau) sigma and 1 / tau."""
    problem = with_drifts(small_problem(), GaussMarkov(3e-5, 8.0))
    model = filter_model(problem, problem.prior.start)
    assert list(model.walking) == list(range(*problem.layout["gyro_gauss_markov"].indices(10**6)))
    np.testing.assert_allclose(model.walk, 1.5e-5, rtol=1e-12)
    np.testing.assert_array_equal(model.fading, 0.125)


@pytest.mark.parametrize(("form", "printed"), [("completed", False), ("fox2005", True)])
def test_the_form_of_the_size_effect_is_passed_on(form, printed):
    problem = replace(small_problem(), settings=CalibrationSettings(size_effect=form))
    model = filter_model(problem, problem.prior.start)
    assert model.printed is printed


def test_the_earths_rotation_is_that_of_the_site():
    problem = small_problem()
    model = filter_model(problem, problem.prior.start)
    assert model.level**2 + model.down**2 == pytest.approx(7.292115e-5**2, rel=1e-12)
    assert model.down < 0.0 < model.level  # north of the equator
    free = filter_model(replace(problem, site=replace(problem.site, earth_rate_n=None)), problem.prior.start)
    assert (free.level, free.down) == (EARTH_RATE, EARTH_RATE)


@pytest.mark.parametrize("estimator", ["central-difference", "unscented"])
def test_weights_give_the_moments_of_a_square_of_a_normal_variable(estimator):
    """y = x^2 of x ~ N(m, s^2) has the mean m^2 + s^2 and, of one variable, the variance 4 m^2 s^2 + 2 s^4."""
    problem = small_problem()
    kernels = {
        e: filter_model(replace(problem, settings=CalibrationSettings(sigma_points=e)), problem.prior.start).weights
        for e in ("central-difference", "unscented")
    }
    spread, mean, second, shift, centre = kernels[estimator]
    n, m, s = problem.layout.degrees, 0.3, 0.7
    moved = np.zeros((2, n))
    moved[0, 0], moved[1, 0] = ((m + k * spread * s) ** 2 - m**2 for k in (1.0, -1.0))
    both, first = moved.sum(axis=0), (moved[0] - moved[1]) / (2.0 * spread)
    to_mean = mean * both.sum()
    assert m**2 + to_mean == pytest.approx(m**2 + s**2, rel=1e-12)
    if estimator == "central-difference":  # best for normal variables: exact here
        columns = [*first, *(second * (both - 2.0 * shift * to_mean)), centre * to_mean]
        assert np.sum(np.square(columns)) == pytest.approx(4.0 * m**2 * s**2 + 2.0 * s**4, rel=1e-12)


def test_steps_are_updates_and_the_poses_they_use():
    problem = small_problem()
    updates, reference = problem.schedule.updates[10:30], problem.reference
    steps = filter_steps(problem, problem.prior.start, updates, NOTHING)
    for i, update in enumerate(updates):
        assert (steps.first[i], steps.last[i], steps.tau[i]) == (update.first, update.last, update.tau)
        assert steps.at_standstill[i] == (update.standstill is not None)
        np.testing.assert_array_equal(steps.position[i], reference.positions[update.pose])
        np.testing.assert_array_equal(steps.quaternion[i], reference.quaternions[update.pose])
    assert steps.given.tolist() == [True, True]
    assert steps.regressor.shape == (20, 6, 0)


def test_what_the_reference_does_not_show_is_not_given():
    problem = small_problem()
    blind = replace(problem, reference=replace(problem.reference, positions=None))
    steps = filter_steps(blind, problem.prior.start, problem.schedule.updates[:5], NOTHING[:5])
    assert steps.given.tolist() == [False, True]
    assert not steps.position.any()
    turned = replace(problem, reference=replace(problem.reference, quaternions=None))
    steps = filter_steps(turned, problem.prior.start, problem.schedule.updates[:5], NOTHING[:5])
    assert steps.given.tolist() == [True, False]


def test_there_is_room_in_the_record_for_every_update():
    problem = without_groups(small_problem(), ("lever_arms",))
    record = filter_record(problem, 7)
    assert record.mean.shape == (7, problem.layout.stored("time_skew").stop)  # of the navigation state nothing
    assert record.deviation.shape == (7, problem.layout["time_skew"].stop)
    assert record.whitened.shape == record.noise_variance.shape == (7, 9)
    assert record.correction.shape == (7, 6)
    assert not record.used.any()
