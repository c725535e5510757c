"""The problem put together: what the user holds, what a robot's errors leave, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import SynchronizationError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.groups import REGISTRY
from kreisel.preparation.build_problem import (
    _assumed_noise,
    _of_layout,
    _pose_error,
    _with_held_values,
    build_problem,
    frame_sd_of,
)
from kreisel.preparation.start_values import starting_point
from kreisel.preparation.state_layout import build_layout
from kreisel.recording.recording import ReferencePoses
from kreisel.recording.recording_settings import RobotTable

from ...oracle.quaternions import exp
from ...small_problem import with_fit


def with_tables(prepared, **tables):
    settings = prepared.recording.settings.model_copy(update=tables)
    return replace(prepared, recording=replace(prepared.recording, settings=settings))


def with_kind(prepared, kind, **changed):
    table = prepared.recording.settings.reference.model_copy(update={"kind": kind})
    return replace(with_tables(prepared, reference=table), **changed)


# ---------------------------------------------------------------- errors of a robot


@pytest.mark.parametrize(
    ("kind", "name", "robot"),
    [
        ("robot", "pose0", True), (None, "pose0", True), (None, "vicon0", False), (None, "leica0", False),
        ("mocap", "pose0", False), ("robot", "vicon0", True),
    ],
)  # fmt: skip
def test_frames_err_where_the_reference_is_a_robot(prepared, kind, name, robot):
    """Half of 0.5 mm and 0.5 mrad of each of the chain's errors acts like another base, half like another tool."""
    reference = replace(prepared.reference, name=name)
    made = with_kind(prepared, kind, reference=reference)
    made = replace(made, recording=replace(made.recording, reference=reference))
    assert frame_sd_of(made) == pytest.approx((5e-4 * 2**0.5,) * 2 if robot else (0.0, 0.0), rel=1e-12)


def test_frames_err_as_the_user_says_and_not_where_the_robots_errors_are_estimated(prepared):
    made = with_tables(prepared, robot=RobotTable(length_sd=2e-3, angle_sd=0.0))
    assert frame_sd_of(made) == pytest.approx((2e-3 * 2**0.5, 0.0))
    assert frame_sd_of(replace(made, robot=object())) == (0.0, 0.0)


def turning(rate, seconds=60.0, step=0.012):
    t = np.arange(0.0, seconds, step)
    q = exp(rate * t[:, None] * np.array([0.6, 0.0, 0.8]))
    return ReferencePoses("pose0", np.round(t * 1e9).astype(np.int64), None, q, Path("pose0/data.csv"))


@pytest.mark.parametrize(("rate", "time"), [(0.25, 2.0), (0.05, 10.0), (2.0, 1.0), (1e-4, 100.0), (0.0, 100.0)])
def test_a_posture_lasts_until_the_tool_has_turned_by_half_a_radian(rate, time):
    """From one to a hundred seconds. Angles are summed over 0.2 s: the last may be left out, 0.3 %."""
    error = _pose_error(turning(rate), (3e-4, 4e-4))
    assert error.time == pytest.approx(time, rel=0.005)
    # an angle acts on positions over a metre; beyond 150 postures of half a radian errors come back
    larger = max(1.0, rate * 60.0 / 75.0) ** 0.5
    assert (error.position, error.orientation) == pytest.approx((larger * 5e-4, larger * 4e-4), rel=0.005)


def test_turning_to_and_fro_counts_as_turning():
    t = np.arange(0.0, 60.0, 0.012)
    angle = 0.5 * np.sin(2.0 * np.pi * t / 8.0)  # 2 rad in 8 s
    q = exp(angle[:, None] * np.array([0.0, 0.0, 1.0]))
    reference = ReferencePoses("pose0", np.round(t * 1e9).astype(np.int64), None, q, Path("pose0/data.csv"))
    # at its ends, 0.2 s straddle the turning point: less than 2 % of the way
    assert _pose_error(reference, (1e-3, 1e-3)).time == pytest.approx(2.0, rel=0.03)


def test_small_turns_show_a_share_of_the_errors():
    """To and fro by 0.5 rad, 0.35 rad from the mean attitude: of 2.1 with which all are reached."""
    t = np.arange(0.0, 64.0, 0.012)
    q = exp(0.5 * np.sin(2.0 * np.pi * t / 8.0)[:, None] * np.array([0.0, 0.0, 1.0]))
    reference = ReferencePoses("pose0", np.round(t * 1e9).astype(np.int64), None, q, Path("pose0/data.csv"))
    assert _pose_error(reference, (1e-3, 1e-3)).reached == pytest.approx(0.5 / 2.0**0.5 / 2.1, rel=0.03)


def test_no_robot_leaves_no_pose_error_and_positions_say_nothing_of_posture():
    assert (_pose_error(turning(0.2), (0.0, 0.0)).position, _pose_error(turning(0.2), (0.0, 0.0)).time) == (0.0, 0.0)
    blind = replace(turning(0.2), quaternions=None)
    assert _pose_error(blind, (1e-3, 1e-3)).time == 100.0


# ---------------------------------------------------------------- values that are held


def test_values_held_are_those_the_user_gave(prepared):
    start, _ = starting_point(prepared, 1)
    K, arms = np.diag([1.01, 0.99, 1.0]), np.arange(9.0).reshape(3, 3) / 100.0
    settings = CalibrationSettings(
        fixed={"gyro_cross_coupling": K, "lever_arms": arms, "gravity": 9.805, "north": None}
    )
    found = _with_held_values(start, prepared, settings)
    np.testing.assert_array_equal(found.sensors.K_omega, K)
    np.testing.assert_array_equal(found.sensors.lever_arms, arms)
    assert found.gravity == 9.805
    np.testing.assert_array_equal(found.sensors.K_a, start.sensors.K_a)
    assert (found.start, found.skew) == (start.start, start.skew)
    assert _with_held_values(start, prepared, CalibrationSettings(fixed=("lever_arms",))) is start


def test_a_held_time_offset_is_one_between_stamps(cell):
    """As the glossary has it, t_imu = t_ref + offset: the simulated clocks are 27.1 ms apart."""
    truth, prepared = cell
    problem = build_problem(prepared, CalibrationSettings(fixed={"time_offset": truth.time_offset}))
    start, imu, reference = problem.prior.start, prepared.recording.imu, prepared.reference
    assert start.start == pytest.approx(
        (reference.stamps_ns[0] - imu.stamps_ns[0]) * 1e-9 + truth.time_offset, abs=1e-9
    )
    assert start.start == pytest.approx(prepared.rate_fit.clock.start, abs=2e-3)
    assert "time_offset" not in problem.groups


# ---------------------------------------------------------------- the whole


def test_groups_without_a_prior_of_their_own_have_that_of_usual_devices():
    layout = build_layout(CalibrationSettings(), latitude=False, skew=True, standstill_error=True)
    known = {"gravity": np.array([[4e-6]])}
    found = _of_layout(known, layout)
    usual = {g.name: g.usual_sd for g in REGISTRY}
    assert set(found) == {part.name for part in layout if part.name in usual}
    assert found["gravity"][0, 0] == 4e-6
    np.testing.assert_allclose(found["lever_arms"], usual["lever_arms"] ** 2 * np.eye(9))
    np.testing.assert_allclose(found["alignment"], usual["alignment"] ** 2 * np.eye(2))


@pytest.mark.parametrize(("kind", "usual"), [("robot", 0.48), ("mocap", 0.24)])
def test_the_interval_is_that_asked_for_or_of_the_kind(prepared, kind, usual):
    made = with_kind(prepared, kind)
    for settings, interval in (
        (CalibrationSettings(), usual), (CalibrationSettings(update_interval=1.0), 1.0),
    ):  # fmt: skip
        schedule = build_problem(made, settings).schedule
        tau = np.array([update.tau for update in schedule.updates])
        assert schedule.interval == interval
        np.testing.assert_allclose(np.diff(tau)[:-1], interval, atol=0.0121)  # a pose every 12 ms


def test_too_few_updates_are_refused_with_their_number(prepared):
    settings = CalibrationSettings(update_interval=5.0)
    with pytest.raises(SynchronizationError, match=r"only 1[123] updates of 5 s .* 20 or more") as caught:
        build_problem(prepared, settings)
    assert "pose0" in str(caught.value)


@pytest.mark.parametrize(
    ("asked", "fitted", "estimated"),
    [(None, True, True), (None, False, False), (True, False, True), (False, True, False)],
)
def test_the_ratio_of_the_clocks_is_estimated_as_asked_or_as_the_rates_say(prepared, asked, fitted, estimated):
    clock = replace(prepared.rate_fit.clock, skew=1e-5)
    problem = build_problem(with_fit(prepared, skewed=fitted, clock=clock), CalibrationSettings(skew=asked))
    assert ("time_skew" in problem.groups) == estimated
    assert problem.prior.start.skew == (1e-5 if estimated else 0.0)
    assert problem.schedule.clock.skew == problem.prior.start.skew


def test_the_state_has_room_for_what_the_reference_does(prepared):
    names = {part.name for part in build_problem(prepared, CalibrationSettings()).layout}
    assert {"standstill_position", "path_position", "path_orientation"} <= names
    names = {part.name for part in build_problem(with_kind(prepared, "mocap"), CalibrationSettings()).layout}
    assert not {"path_position", "path_orientation"} & names  # no arm, no errors of its posture
    never = build_problem(replace(prepared, standstills=()), CalibrationSettings())
    assert "standstill_position" not in {part.name for part in never.layout}
    angles = with_tables(prepared, robot=RobotTable(length_sd=1e-3, angle_sd=0.0))
    names = {part.name for part in build_problem(angles, CalibrationSettings()).layout}
    assert ("path_position" in names, "path_orientation" in names) == (True, False)


def test_noise_is_that_of_the_preparation(prepared):
    imu = replace(prepared.imu_noise, gyro_walk=1e-6, accel_walk=2e-5, gyro_bounds=(1e-6, 2e-5), gyro_scatter=3e-4)
    late = replace(prepared.recording, imu=replace(prepared.recording.imu, lateness=3e-3))
    made = replace(prepared, imu_noise=imu, recording=late, reference=replace(prepared.reference, lateness=4e-3))
    noise = build_problem(made, CalibrationSettings()).noise
    assert noise.reference == prepared.noise
    assert noise.min_reference == pytest.approx((0.1 * prepared.noise.position, 0.1 * prepared.noise.orientation))
    assert noise.imu_bounds[0] == (1e-6, 2e-5)
    assert noise.offset_walk == {"gyro_offset": 1e-6, "accel_offset": 2e-5}
    assert noise.rate_scatter == 3e-4
    assert noise.lateness == pytest.approx(5e-3)  # either clock's, independent of each other


def test_widths_are_what_is_known_before_any_look_at_the_data(prepared):
    noise = replace(prepared.imu_noise, gyro_offset_sd=1e-4, accel_offset_sd=None)
    site = replace(prepared.site, gravity_sd=3e-4)
    prior = build_problem(replace(prepared, imu_noise=noise, site=site), CalibrationSettings()).prior
    assert prior.stated == ("gyro_offset",)
    np.testing.assert_array_equal(prior.width["gyro_offset"], [1e-4] * 3)
    usual = {g.name: g.usual_sd for g in REGISTRY}
    for group in ("accel_offset", "lever_arms", "gyro_cross_coupling", "time_offset"):
        np.testing.assert_array_equal(prior.width[group], [usual[group]])
    np.testing.assert_array_equal(prior.width["gravity"], [3e-4])


def test_every_group_of_the_state_has_a_start_and_a_prior(prepared):
    for changed in ({}, {"polynomial_order": 2}, {"fixed": ("lever_arms", "north")}):
        problem = build_problem(prepared, CalibrationSettings(**changed))
        for part in problem.layout:
            if part.name not in problem.groups:
                continue
            for covariance in (problem.prior.start_covariance[part.name], problem.prior.covariance[part.name]):
                assert covariance.shape == (part.degrees, part.degrees)
                assert np.linalg.eigvalsh(covariance).min() > 0.0
        assert set(problem.prior.covariance) >= set(problem.groups) <= set(problem.prior.start_covariance)


@pytest.mark.parametrize(
    ("kind", "standstills", "persists"), [("mocap", 3, True), ("mocap", 6, False), ("robot", 3, False)]
)
def test_few_standstills_of_cameras_do_not_show_how_large_errors_are_there(prepared, kind, standstills, persists):
    made = with_kind(prepared, kind)
    many = (made.standstills * 6)[:standstills]
    assert _assumed_noise(replace(made, standstills=many)).persists == persists
