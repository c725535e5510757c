"""Attitudes at every sample, of an analytic motion whose attitude is known."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from kreisel.inertial import readings as readings_module
from kreisel.inertial.readings import Readings
from kreisel.inertial.strapdown import prepare
from kreisel.preparation.attitude import (
    alignment_from_gravity,
    attitude_from_positions,
    reference_attitude,
    start_attitudes,
    with_attitude,
)
from kreisel.recording.recording import ReferencePoses
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.fits import RateFit

from ...oracle.motion import AnalyticMotion, inertial_truth, raw_readings
from ...oracle.quaternions import conjugate, exp, log, multiply, rotate

GRAVITY_R = np.array([0.3, -0.2, -9.8])
ARM = np.array([0.12, -0.05, 0.08])
PARAMETERS = {
    "K_omega": np.array([[1.01, 0.02, 0.0], [-0.02, 1.0, 0.01], [0.0, 0.01, 0.99]]),
    "k_w": np.array([[0.01, -0.02, 0.005]]),
    "K_a": np.eye(3),
    "k_a": np.zeros((1, 3)),
    "lever_arms": np.tile(ARM, (3, 1)),
}
CLOCK = Clock(0.503, 2e-4)
IMU_STEP, POSE_STEP, SECONDS = 0.005, 0.012, 60.0


def fit_of(bias=(0.0, 0.0, 0.0), K=PARAMETERS["K_omega"]):
    one = np.full((3, 3), 1e-4)
    k_w0 = np.linalg.solve(K, PARAMETERS["K_omega"] @ PARAMETERS["k_w"][0] + bias)
    return RateFit(K, k_w0, CLOCK, True, 1.0, 1e-5, one, one[0])


@pytest.fixture(scope="module")
def moved():
    """Motion, IMU seconds with readings, and reference seconds."""
    motion = AnalyticMotion(np.random.default_rng(3), 2.0, 4.0, SECONDS)
    t = np.arange(round(SECONDS / IMU_STEP)) * IMU_STEP
    raw = raw_readings(*inertial_truth(motion, t, GRAVITY_R, np.zeros(3)), PARAMETERS)
    return motion, t, raw, np.arange(0.0, SECONDS - 1.0, POSE_STEP)


def error_of(q, truth):
    """Angles between attitudes and the true ones."""
    return np.linalg.norm(log(multiply(conjugate(truth), q)), axis=1)


def test_attitudes_of_good_gyros_and_poses_are_exact(moved):
    motion, t, raw, tau = moved
    found = reference_attitude(prepare(t, *raw), fit_of(), tau, motion.attitude(CLOCK.imu_time(tau)))
    # poses are carried back to the sample before by its rate: half of 15 rad/s^2 times 5 ms squared, 2e-4, is left out;
    # its sign changes with the acceleration's, and a mean over a second takes most of it
    assert error_of(found, motion.attitude(t)).max() < 5e-5


def test_rates_are_held_to_the_reference_over_seconds(moved):
    """A bias of 0.01 rad/s would be 0.6 rad after a minute; a straight line is its own mean but at the ends."""
    motion, t, raw, tau = moved
    found = reference_attitude(prepare(t, *raw), fit_of((0.01, 0.0, 0.0)), tau, motion.attitude(CLOCK.imu_time(tau)))
    error = error_of(found, motion.attitude(t))
    inner = (t > 1.1) & (t < 58.4)
    # b turns while the error grows, 0.01 rad/s bent by 2 rad/s: half a second to either side, (1/2)^2 / 6
    assert error[inner].max() < 0.01 * 2.0 * 0.25 / 6.0 * 1.5
    # at the ends the mean lies a quarter second inside, and what lies beyond a pose half a second more
    assert error.max() < 0.01 * (0.25 + 0.6)


def test_noise_of_the_poses_is_averaged_over_a_second(moved):
    motion, t, raw, tau = moved
    noise = exp(np.random.default_rng(4).normal(0.0, 5e-3, (tau.size, 3)))
    found = reference_attitude(prepare(t, *raw), fit_of(), tau, multiply(motion.attitude(CLOCK.imu_time(tau)), noise))
    error = log(multiply(conjugate(motion.attitude(t)), found))[(t > 1.1) & (t < 58.4)]
    # 83 poses a second, and means of 83: an error of 5e-3 / sqrt(83), from 57 independent seconds and 3 axes: 8 %
    assert np.sqrt(np.mean(error**2)) == pytest.approx(5e-3 / np.sqrt(83), rel=0.25)


@pytest.mark.parametrize("axis", [0, 2])
def test_errors_may_pass_half_a_turn(axis):
    """A body at rest whose gyro drifts by 3.7 rad: attitudes stay, though the angle passes pi."""
    t = np.arange(0.0, 37.0, IMU_STEP)
    bias = 0.1 * np.eye(3)[axis]
    rest = prepare(t, np.zeros((t.size, 3)), np.zeros((t.size, 3)))
    fit = RateFit(np.eye(3), bias, Clock(0.0), False, 1.0, 1e-5, np.ones((3, 3)), np.ones(3))
    tau = np.arange(0.0, 36.99, POSE_STEP)
    q = np.tile(exp(np.array([0.3, -2.0, 1.0])), (tau.size, 1))
    found = reference_attitude(rest, fit, tau, q)
    inner = (t > 1.0) & (t < 36.0)
    assert error_of(found, q[0])[inner].max() < 1e-4


def test_positions_alone_show_the_attitude(moved):
    """Scale errors aside, one turn for each 25 s; what is left are lever arms, unless they are known."""
    motion, t, raw, tau = moved
    signal, p = prepare(t, *raw), motion.position(CLOCK.imu_time(tau))
    truth = motion.attitude(t)
    known = SimpleNamespace(K_a=np.eye(3), k_a0=np.zeros(3), lever_arm=ARM)
    plain, better = (attitude_from_positions(signal, fit_of(), tau, p, a) for a in (None, known))
    assert error_of(better, truth).max() < 0.005
    assert error_of(better, truth).max() < 0.3 * error_of(plain, truth).max()
    assert error_of(plain, truth).max() < 0.2


def test_known_offsets_and_couplings_are_taken_off(moved):
    motion, t, raw, tau = moved
    p, truth = motion.position(CLOCK.imu_time(tau)), motion.attitude(t)
    K = np.array([[0.0, 0.0, 1.1], [0.9, 0.0, 0.0], [0.0, 1.0, 0.0]])
    k = np.array([0.5, -0.4, 0.3])
    signal = prepare(t, raw[0], np.linalg.solve(K, raw[1].T).T - k)
    known = SimpleNamespace(K_a=K, k_a0=k, lever_arm=ARM)
    assert error_of(attitude_from_positions(signal, fit_of(), tau, p, known), truth).max() < 0.005


def test_every_part_of_25_seconds_turns_on_its_own(moved):
    """A drift of 0.01 rad/s about an axis of r is 0.6 rad after a minute, but 0.125 rad to either side of a mean."""
    motion, t, raw, tau = moved
    p = motion.position(CLOCK.imu_time(tau))
    known = SimpleNamespace(K_a=np.eye(3), k_a0=np.zeros(3), lever_arm=ARM)
    drifting = raw_readings(*inertial_truth(motion, t, GRAVITY_R, np.array([0.0, 0.01, 0.0])), PARAMETERS)[0]
    found = attitude_from_positions(prepare(t, drifting, raw[1]), fit_of(), tau, p, known)
    error = error_of(found, motion.attitude(t))
    # where in a part the turn is that of the drift depends on when the body accelerated
    assert error[t < 50.0].max() < 0.25
    assert error[(t > 10.0) & (t < 15.0)].max() < 0.06
    assert error[(t > 35.0) & (t < 40.0)].max() < 0.06


def reference_of(motion, tau, *, p=True, q=True):
    t = CLOCK.imu_time(tau)
    return ReferencePoses(
        "pose0", np.round(tau * 1e9).astype(np.int64),
        motion.position(t) if p else None, motion.attitude(t) if q else None, Path("pose0/data.csv"),
    )  # fmt: skip


def readings_of(t, raw):
    return Readings(t, *raw, ((0, t.size - 1),))


def test_chunks_come_with_the_poses_that_lie_in_them(moved, monkeypatch):
    monkeypatch.setattr(readings_module, "CHUNK", 2048)
    motion, t, raw, tau = moved
    reference = reference_of(motion, tau)
    seen = []
    for signal, inside, p, q in with_attitude(readings_of(t, raw).chunks(), fit_of(), reference, None):
        at = CLOCK.imu_time(inside)
        begin = t[signal.begin]
        assert (at.min() >= begin, at.max() <= begin + 2060 * 1.3 * IMU_STEP) == (True, True)
        np.testing.assert_allclose(p, motion.position(at), atol=1e-7)
        assert error_of(q, motion.attitude(signal.stamps)).max() < 1e-4
        seen.append(inside)
    assert len(seen) > 4
    np.testing.assert_allclose(np.unique(np.concatenate(seen)), tau, atol=1e-9)


def test_chunks_with_fewer_than_ten_poses_or_no_segment_are_left_out(moved):
    motion, t, raw, tau = moved
    chunk = prepare(t, *raw)
    for count, expected in ((9, 0), (10, 1)):
        reference = reference_of(motion, tau[:count])
        assert len(list(with_attitude([chunk], fit_of(), reference, None))) == expected
    torn = prepare(t, *raw, segments=())
    assert list(with_attitude([torn], fit_of(), reference_of(motion, tau), None)) == []


def test_navigation_begins_with_attitudes_from_positions(moved, monkeypatch):
    monkeypatch.setattr(readings_module, "CHUNK", 6000)
    motion, t, raw, tau = moved
    known = SimpleNamespace(K_a=np.eye(3), k_a0=np.zeros(3), lever_arm=ARM)
    samples = np.array([200, 3000, 5990, 6020, 11_800])
    preparation = SimpleNamespace(
        reference=reference_of(motion, tau, q=False), readings=readings_of(t, raw), rate_fit=fit_of(),
        accelerometer_fit=known,
    )  # fmt: skip
    found = start_attitudes(preparation, samples)
    assert error_of(found, motion.attitude(t[samples])).max() < 0.01
    preparation.reference = reference_of(motion, tau)
    np.testing.assert_array_equal(start_attitudes(preparation, samples), np.tile([1.0, 0, 0, 0], (5, 1)))


@pytest.mark.parametrize(
    ("gravity", "north"),
    [
        ([0.0, 0.0, -9.8], None), ([0.1, -3.0, -9.0], None), ([0.05, 9.8, 0.1], None), ([0.0, -9.8, 0.0], None),
        ([1.0, 2.0, 9.0], [3.0, 1.0, -2.0]),
    ],
)  # fmt: skip
def test_down_is_along_gravity_and_north_lies_level(gravity, north):
    gravity = np.array(gravity)
    q = alignment_from_gravity(gravity, None if north is None else np.array(north))
    n, e, d = (rotate(q, axis) for axis in np.eye(3))
    np.testing.assert_allclose(d, gravity / np.linalg.norm(gravity), atol=1e-14)
    np.testing.assert_allclose(np.cross(n, e), d, atol=1e-14)
    toward = np.array(north or ([0.0, 1.0, 0.0] if abs(d[1]) < 0.9 else [1.0, 0.0, 0.0]))
    assert n @ toward > 0.0
    assert abs(e @ toward) < 1e-13  # north has no part of it to the side


def test_a_robot_on_the_floor_faces_east():
    q = alignment_from_gravity(np.array([0.0, 0.0, -9.8]))
    np.testing.assert_allclose(rotate(q, np.array([0.0, 1.0, 0.0])), [1.0, 0.0, 0.0], atol=1e-15)
