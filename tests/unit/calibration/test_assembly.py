"""The calibration put together: directions and their deviations by drawn parameters, and every part in its place."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration import assembly
from kreisel.calibration.assembly import Assessment, assemble
from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.inertial.earth import EARTH_RATE
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.layout import group_part
from kreisel.model.parameters import SENSOR_GROUPS
from kreisel.model.problem import without_groups
from kreisel.model.site import earth_rate_r, gravity_r, north_r
from kreisel.recording.recording import DataWarning
from kreisel.refinement.observability import observability

from ...oracle import quaternions as quat
from ...small_problem import calibrated, estimate_of, moved_by, recorded, small_problem, small_run

DRAWS = 1000
"""A deviation of so many draws is good to 2.2 per cent."""


def assembled(found, *warnings):
    outcome = calibrated()
    judged = Assessment(observability(found.problem, found.deviation), outcome.consistency, outcome.verdict, 1.25)
    return assemble(recorded()[1], found, judged, warnings)


@pytest.fixture(scope="module")
def plain():
    return assembled(estimate_of(small_problem(), small_run()))


def drawn(found, value):
    """Deviations of a function of the parameters, by drawing these from their covariance."""
    problem, run = found.problem, found.run
    n = len(problem.parameter_names)
    rng = np.random.default_rng(0)
    changes = rng.normal(size=(DRAWS, n)) @ run.belief.factor[:n, :n].T
    values = np.array([value(moved_by(problem, run.parameters, change)) for change in changes])
    return np.sqrt(np.mean((values - value(run.parameters)) ** 2, axis=0))


def without_latitude():
    """The small problem and its result with the Earth's rotation as three unknowns."""
    problem = small_problem()
    parts = []
    for part in problem.layout:
        parts += [part, group_part("earth_down", 1)] if part.name == "north" else [part]
    earth = {"north": np.eye(2) / 3.0, "earth_down": np.eye(1) / 3.0}
    prior = replace(problem.prior, covariance=problem.prior.covariance | earth,
                    start_covariance=problem.prior.start_covariance | earth)  # fmt: skip
    free = replace(
        problem, layout=type(problem.layout)(parts), prior=prior, site=replace(problem.site, earth_rate_n=None)
    )
    return estimate_of(free, KalmanFilter().fit(free))


def test_directions_are_axes_of_the_level_frame():
    """Down is n's third axis, north lies among the first two; the Earth's rotation is (7)."""
    p = replace(small_run().parameters, q_rn=quat.exp(np.array([0.3, -1.0, 2.0])), north=np.array([0.6, 0.8]))
    axes = [quat.rotate(p.q_rn, e) for e in np.eye(3)]
    np.testing.assert_allclose(gravity_r(p), p.gravity * axes[2], rtol=1e-12)
    np.testing.assert_allclose(north_r(p), 0.6 * axes[0] + 0.8 * axes[1], rtol=1e-12)
    phi = np.radians(49.2571)
    want = EARTH_RATE * (np.cos(phi) * north_r(p) - np.sin(phi) * axes[2])
    np.testing.assert_allclose(earth_rate_r(small_problem().site, p), want, rtol=1e-9)
    free = replace(small_problem(), site=replace(small_problem().site, earth_rate_n=None))
    want = EARTH_RATE * (north_r(p) - 0.7 * axes[2])
    np.testing.assert_allclose(earth_rate_r(free.site, replace(p, earth_down=-0.7)), want, rtol=1e-9)


def turned(found):
    """The same result in a reference frame that stands askew."""
    p = found.run.parameters
    askew = replace(p, q_rn=quat.multiply(quat.exp(np.array([0.5, -1.1, 0.3])), p.q_rn))
    return replace(found, run=replace(found.run, parameters=askew))


def test_deviations_of_gravity_and_north_are_those_of_drawn_parameters():
    """Within about four deviations of what the draws are good to."""
    found = turned(estimate_of(small_problem(), small_run()))
    alignment = assembly._alignment(found)
    np.testing.assert_allclose(alignment.gravity.deviation, drawn(found, gravity_r), rtol=0.09)
    np.testing.assert_allclose(alignment.north.deviation, drawn(found, north_r), rtol=0.09)
    np.testing.assert_array_equal(alignment.gravity.value, gravity_r(found.run.parameters))
    assert alignment.earth_rate is None


def test_without_a_latitude_the_earths_rotation_takes_the_place_of_north():
    found = turned(without_latitude())
    result = assembly._alignment(found)
    assert result.north is None
    np.testing.assert_array_equal(result.earth_rate.value, earth_rate_r(found.problem.site, found.run.parameters))
    want = drawn(found, lambda p: earth_rate_r(found.problem.site, p))
    np.testing.assert_allclose(result.earth_rate.deviation, want, rtol=0.09)


def test_without_north_in_the_state_only_gravity_is_told():
    found = estimate_of(without_groups(small_problem(), ("north",)), small_run())
    n = found.problem.layout.degrees
    run = replace(found.run, belief=replace(found.run.belief, factor=np.eye(n)))
    alignment = assembly._alignment(replace(found, run=run))
    assert alignment.north is alignment.earth_rate is None


def test_gravity_held_altogether_is_exact():
    found = estimate_of(without_groups(small_problem(), ("alignment", "gravity")), small_run())
    assert not assembly._gravity_deviation(found).any()
    tilted = estimate_of(without_groups(small_problem(), ("gravity",)), small_run())
    run = replace(tilted.run, belief=replace(tilted.run.belief, factor=1e-3 * np.eye(tilted.problem.layout.degrees)))
    deviation = assembly._gravity_deviation(replace(tilted, run=run))
    # of a vector of 9.81 m/s^2 that tilts by a milliradian about either level axis
    assert np.linalg.norm(deviation) == pytest.approx(2**0.5 * 1e-3 * run.parameters.gravity, rel=1e-5)


def test_sensor_deviations_are_those_of_the_belief_in_the_form_of_the_parameters(plain):
    problem, run = small_problem(), small_run()
    deviation = dict(zip(problem.parameter_names, run.belief.standard_deviation, strict=False))
    sd = plain.sensor_sd
    for i in range(3):
        assert sd.k_w[0, i] == deviation[f"gyroscope.offset[{i}]"]
        assert sd.k_a[0, i] == deviation[f"accelerometer.offset[{i}]"]
        for j in range(3):
            assert sd.K_omega[i, j] == deviation[f"gyroscope.cross_coupling[{i},{j}]"]
            assert sd.K_a[i, j] == deviation[f"accelerometer.cross_coupling[{i},{j}]"]
            assert sd.lever_arms[i, j] == deviation[f"accelerometer.lever_arms[{i},{j}]"]
    assert plain.sensors is run.parameters.sensors


def test_a_fixed_group_is_certain():
    fixed = estimate_of(without_groups(small_problem(), ("lever_arms",)), small_run())
    np.testing.assert_array_equal(assembly._sensor_deviations(fixed).lever_arms, 0.0)


def test_the_time_offset_relates_the_stamps_themselves():
    """Stamps of one instant by both clocks, computed in whole nanoseconds."""
    recording, problem, run = recorded()[1], small_problem(), small_run()
    apart = 3_000_000_000
    late = replace(problem, reference=replace(problem.reference, stamps_ns=problem.reference.stamps_ns - apart))
    p = replace(run.parameters, skew=2e-4)
    timing = assembly._timing(recording, estimate_of(late, replace(run, parameters=p)))
    tau = 12.5
    t_ref = late.reference.stamps_ns[0] * 1e-9 + tau
    t_imu = recording.imu.stamps_ns[0] * 1e-9 + p.start + (1.0 + p.skew) * tau
    assert t_ref + timing.offset + timing.skew * tau == pytest.approx(t_imu, abs=1e-9)
    assert timing.offset_sd == run.belief.standard_deviation[problem.layout["time_offset"]][0]
    assert timing.skew_sd == run.belief.standard_deviation[problem.layout["time_skew"]][0]


def test_the_result_ends_with_the_last_row_of_the_estimates(plain):
    found = estimate_of(small_problem(), small_run(), correlation_factor=1.4)
    table, n = assembled(found).estimates, len(plain.names)
    assert table.shape == (len(small_problem().schedule.updates), 1 + 2 * n)
    at = {name: 1 + i for i, name in enumerate(plain.names)}
    np.testing.assert_array_equal(table[-1, 1 + n :], small_run().belief.standard_deviation[:n])
    np.testing.assert_allclose(table[:-1, 1 + n :], 1.4 * small_run().history.deviations[:-1], rtol=1e-14)
    assert table[-1, at["accelerometer.offset[1]"]] == plain.sensors.k_a[0, 1]
    assert table[-1, at["accelerometer.lever_arms[2,0]"]] == plain.sensors.lever_arms[2, 0]
    assert table[-1, at["timing.offset"]] == pytest.approx(plain.timing.offset, abs=1e-15)
    np.testing.assert_allclose(table[-1, [at["alignment.tilt[0]"], at["alignment.tilt[1]"]]], 0.0, atol=1e-12)
    np.testing.assert_array_equal(table[:, 0], small_run().history.seconds)
    history = small_run().history.parameters[:, small_problem().layout["time_offset"].start]
    assert np.ptp(table[:-1, at["timing.offset"]] - history[:-1]) < 1e-12


def test_covariance_and_priors_belong_to_the_names(plain):
    n = len(plain.names)
    assert plain.names == small_problem().parameter_names
    np.testing.assert_array_equal(plain.covariance, small_run().belief.covariance[:n, :n])
    np.testing.assert_array_equal(plain.covariance, plain.covariance.T)
    assert plain.prior_deviation.shape == (n,)
    assert plain.robot is plain.robot_urdf is None
    assert plain.others == {}


def test_derived_quantities_are_those_of_the_sensors_with_deviations_of_drawn_ones(plain):
    found = estimate_of(small_problem(), small_run())
    assert list(plain.derived) == [quantity.name for quantity in QUANTITIES]
    for quantity in QUANTITIES:
        measured = plain.derived[quantity.name]
        np.testing.assert_allclose(measured.value, quantity.value(plain.sensors), rtol=1e-12)
    chosen = QUANTITIES[3]  # scale-factor errors of the accelerometers
    assert set(chosen.groups) <= set(SENSOR_GROUPS)
    want = drawn(found, lambda p: chosen.value(p.sensors))
    np.testing.assert_allclose(plain.derived[chosen.name].deviation, want, rtol=0.09)


def test_facts_are_those_of_recording_and_problem():
    recording, problem = recorded()[1], small_problem()
    result = assembled(estimate_of(problem, small_run(), passes=3), DataWarning("poses", "are late"))
    facts, how = result.recording, result.estimator
    assert (facts.name, facts.reference, facts.imu_samples) == ("small", "pose0", 4001)
    assert (facts.imu_rate_hz, facts.duration_s) == (pytest.approx(100.0), pytest.approx(40.0))
    assert facts.reference_poses == len(recording.reference.positions)
    assert facts.warnings == ("poses: are late",)
    assert (how.name, how.sigma_points, how.states) == ("spkf", "central-difference", problem.layout.degrees)
    assert (how.update_interval, how.passes, how.filter_seconds) == (0.48, 3, 1.25)
    assert how.noise.position_sd == problem.noise.reference.position
    assert how.noise.standstill_orientation_sd == problem.noise.reference.standstill_orientation
