"""Whole calibrations of recordings made by the oracle: any mounting, any heading, quadratic terms, bad clocks."""

import math
from pathlib import Path

import numpy as np
import pytest

import kreisel
from kreisel.inertial.earth import earth_rate_n, normal_gravity
from kreisel.recording.recording import ImuSamples, Recording, ReferencePoses
from kreisel.recording.recording_settings import ImuTable, RecordingSettings, ReferenceTable, SiteTable

from ..oracle import quaternions as quat
from ..oracle.motion import AnalyticMotion, inertial_truth, raw_readings

GYRO, ACCEL, SD, RATE, SECONDS = 4e-5, 1e-3, 1e-3, 200.0, 120.0
OFFSET, SKEW = 0.4, 3e-4
LATITUDE = 49.0
START = 10**12


def make(seed, mount, heading=0.0, order=1):
    rng = np.random.default_rng(seed)
    motion = AnalyticMotion(rng, duration=SECONDS, peak_rate=2.5, peak_acceleration=5.0, rest=2.0)
    t = np.arange(int(SECONDS * RATE)) / RATE
    C = quat.matrix(quat.exp(np.array([0.0, 0.0, heading]))) @ np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    gravity = C @ [0.002, -0.001, 1.0]
    gravity *= normal_gravity(math.radians(LATITUDE)) / np.linalg.norm(gravity)
    omega, alpha, f = inertial_truth(motion, t, gravity, C @ earth_rate_n(math.radians(LATITUDE)))
    truth = {
        "K_omega": mount @ (np.eye(3) + rng.normal(0, 0.01, (3, 3))),
        "k_w": np.vstack([rng.normal(0, 1e-4, (1, 3)), rng.normal(0, 2e-3, (order - 1, 3))]),
        "K_a": mount @ (np.eye(3) + rng.normal(0, 0.01, (3, 3))),
        "k_a": np.vstack([rng.normal(0, 0.2, (1, 3)), rng.normal(0, 3e-4, (order - 1, 3))]),
        "lever_arms": rng.normal(0, 0.05, (3, 3)),
    }
    w, a = raw_readings(omega, alpha, f, truth)
    w = w + rng.normal(0, GYRO * math.sqrt(RATE), w.shape)
    a = a + rng.normal(0, ACCEL * math.sqrt(RATE), a.shape)
    tau = np.arange(0.0, SECONDS - 1.0, 0.012)
    at = OFFSET + (1.0 + SKEW) * tau
    tau, at = tau[at < SECONDS - 0.05], at[at < SECONDS - 0.05]
    p = motion.position(at) + rng.normal(0, SD, (at.size, 3))
    q = quat.multiply(motion.attitude(at), quat.exp(rng.normal(0, SD, (at.size, 3))))
    settings = RecordingSettings(
        imu=ImuTable(gyro_noise_density=GYRO, accel_noise_density=ACCEL),
        site=SiteTable(latitude_deg=LATITUDE),
        reference=ReferenceTable(kind="robot", position_sd=SD, orientation_sd=SD),
    )
    imu = ImuSamples(START + np.round(t * 1e9).astype(np.int64), w, a, Path("oracle/imu0/data.csv"))
    poses = ReferencePoses("pose0", START + np.round(tau * 1e9).astype(np.int64), p, q, Path("oracle/pose0/data.csv"))
    return truth, Recording(Path("oracle"), imu, poses, None, settings)


def scores(calibration, truth):
    """Error over standard deviation of every parameter, by group."""
    sd, s = calibration.document["standard_deviation"], calibration.sensors
    pairs = {
        "K_omega": (s.K_omega - truth["K_omega"], sd["gyroscope"]["cross_coupling"]),
        "k_w0": (s.k_w[0] - truth["k_w"][0], sd["gyroscope"]["offset"]),
        "K_a": (s.K_a - truth["K_a"], sd["accelerometer"]["cross_coupling"]),
        "k_a0": (s.k_a[0] - truth["k_a"][0], sd["accelerometer"]["offset"]),
        "lever_arms": (s.lever_arms - truth["lever_arms"], sd["accelerometer"]["lever_arms"]),
    }
    if len(s.k_w) > 1:
        pairs["k_w2"] = (s.k_w[1] - truth["k_w"][1], sd["gyroscope"]["polynomial"][2])
        pairs["k_a2"] = (s.k_a[1] - truth["k_a"][1], sd["accelerometer"]["polynomial"][2])
    return {name: np.ravel(error) / np.ravel(deviation) for name, (error, deviation) in pairs.items()}


MOUNTS = {
    "straight": np.eye(3),
    "upside down": np.diag([1.0, -1.0, -1.0]),
    "turned by 94 deg": quat.matrix(quat.exp(np.array([0.0, 0.0, math.radians(94.0)]))),
    "askew": quat.matrix(quat.exp(np.array([1.0, -1.5, 0.8]))),
}


@pytest.mark.parametrize("order", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("mount", list(MOUNTS))
def test_any_mounting(mount, order):
    """34 or 40 scores of normal variables: the largest is below 4.5 in all but one of 4000 cases."""
    truth, recording = make(3, MOUNTS[mount], order=order)
    calibration = kreisel.calibrate(recording, kreisel.CalibrationSettings(polynomial_order=order))
    assert calibration.accepted, calibration.document["verdict"]["reasons"]
    for group, score in scores(calibration, truth).items():
        assert np.abs(score).max() < 4.5, group
    timing = calibration.document["timing"]
    assert timing["skew"] == pytest.approx(SKEW, abs=5e-6)
    assert timing["offset"] == pytest.approx(OFFSET, abs=5e-4)


@pytest.mark.parametrize("heading", [2.0, *(pytest.param(heading, marks=pytest.mark.slow) for heading in (0.7, -1.6))])
def test_any_heading(heading):
    """The robot may face anywhere: north is found, or its uncertainty stands in the gyro offsets."""
    truth, recording = make(4, np.eye(3), heading=heading)
    calibration = kreisel.calibrate(recording)
    for group, score in scores(calibration, truth).items():
        assert np.abs(score).max() < 4.5, group


def test_quadratic_terms_are_found_without_being_asked_for():
    truth, recording = make(3, np.eye(3), order=2)
    calibration = kreisel.calibrate(recording)
    assert calibration.accepted
    for group, score in scores(calibration, truth).items():
        assert np.abs(score).max() < 4.5, group
    assert {"k_w2", "k_a2"} <= set(scores(calibration, truth))


def test_what_the_model_must_not_have_is_named():
    """Quadratic terms in the data that may not be estimated: something else has to stand for them."""
    _, recording = make(3, np.eye(3), order=2)
    fixed = (*kreisel.model.calibration_settings.BY_CHOICE, "gyro_polynomial", "accel_polynomial")
    calibration = kreisel.calibrate(recording, kreisel.CalibrationSettings(fixed=fixed))
    assert not calibration.accepted
    assert calibration.document["verdict"]["reasons"][0].startswith("gyroscope.polynomial.2[")


def test_poses_of_another_run_are_refused():
    from dataclasses import replace

    from kreisel.errors import SynchronizationError

    _, one = make(5, np.eye(3))
    _, other = make(6, np.eye(3))
    with pytest.raises(SynchronizationError, match="same run"):
        kreisel.calibrate(replace(one, reference=other.reference))
