"""Noise in motion, judged by a plain strapdown filter that shares no code with the package, in blocks not used."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

import kreisel
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.motion_noise import _nonnegative, motion_noise
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.validation.checks import check_streams

GAP = 2.0  # s
DIAGONAL = np.arange(15)
OFFSETS = (1e-3, 0.02)  # rad/s, m/s^2: by how much they may have changed


def skew(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def turn(v):
    """Rotation by a vector, by Rodrigues' formula."""
    angle = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if angle < 1e-12:
        return np.eye(3) + skew(v)
    N = skew(v / angle)
    return np.eye(3) + math.sin(angle) * N + (1.0 - math.cos(angle)) * N @ N


def earth_rate(recording, calibration):
    """Earth's rotation in the base's axes, rad/s."""
    if calibration.alignment.earth_rate is not None:
        return calibration.alignment.earth_rate.value
    if calibration.alignment.north is None:
        return np.zeros(3)
    latitude = np.radians(recording.settings.site.latitude_deg)
    up = -calibration.alignment.gravity.value / np.linalg.norm(calibration.alignment.gravity.value)
    return 7.292115e-5 * (np.cos(latitude) * calibration.alignment.north.value + np.sin(latitude) * up)


def mean_nees(recording, calibration, gyro, accel, walks, position_sd, attitude_sd):
    """Mean normalised error squared per degree of freedom of predicted poses, in the second half of gaps.

    The state: position, velocity and attitude in the base's axes, and what is left of the offsets.
    """
    imu, poses = recording.imu, recording.reference
    epoch = imu.stamps_ns[0]
    rates, forces = calibration.correct(imu.rates, imu.accelerations, imu.stamps_ns)
    t = (imu.stamps_ns - epoch) * 1e-9
    timing = calibration.timing
    at = (poses.stamps_ns - epoch) * 1e-9 + timing.offset
    g = calibration.alignment.gravity.value
    earth = earth_rate(recording, calibration)
    places = Rotation.from_quat(poses.quaternions, scalar_first=True)
    R = np.diag([position_sd**2] * 3 + [attitude_sd**2] * 3)
    H = np.zeros((6, 15))
    H[:3, :3] = H[3:, 6:9] = np.eye(3)
    usable = np.flatnonzero((at > t[1]) & (at < t[-2]))
    i = usable[0]
    p, v, C = poses.positions[i].copy(), np.zeros(3), places[i].as_matrix()
    P = np.diag(np.repeat([position_sd, 10.0, attitude_sd, *OFFSETS], 3) ** 2)
    b, c = np.zeros(3), np.zeros(3)
    densities = np.square(np.repeat([0.0, accel, gyro, walks[0], walks[1]], 3))
    now, k, updated, gaps, sums = at[i], int(np.searchsorted(t, at[i], side="right")) - 1, at[i], 0, []
    for i in usable[1:]:
        while now < at[i] - 1e-12:
            until = min(t[k + 1], at[i])
            dt = until - now
            middle = (0.5 * (now + until) - t[k]) / (t[k + 1] - t[k])
            w = (1.0 - middle) * rates[k] + middle * rates[k + 1] - C.T @ earth - b
            half = turn(0.5 * w * dt)
            f = C @ half @ ((1.0 - middle) * forces[k] + middle * forces[k + 1] - c)
            p = p + v * dt + 0.5 * (f + g) * dt**2
            v = v + (f + g) * dt
            C = C @ half @ half
            F = np.eye(15)
            F[:3, 3:6] = dt * np.eye(3)
            F[3:6, 6:9] = -dt * skew(f)
            F[3:6, 12:] = F[6:9, 9:12] = -dt * C
            P = F @ P @ F.T
            P[DIAGONAL, DIAGONAL] += densities * dt
            now = until
            if now >= t[k + 1]:
                k += 1
        unused = (now - at[usable[0]]) // 10.0 % 2 == 1
        judged = gaps >= 5 and now - updated > 0.5 * GAP and unused
        if not judged and now - updated <= GAP:
            continue
        error = np.concatenate([p - poses.positions[i], Rotation.from_matrix(C @ places[i].as_matrix().T).as_rotvec()])
        S = H @ P @ H.T + R
        if judged:
            sums.append(error @ np.linalg.solve(S, error) / 6.0)
        if now - updated > GAP:
            K = np.linalg.solve(S, H @ P).T
            change = -K @ error
            p, v, C = p + change[:3], v + change[3:6], Rotation.from_rotvec(change[6:9]).as_matrix() @ C
            b, c = b + change[9:12], c + change[12:]
            P = (np.eye(15) - K @ H) @ P
            P = 0.5 * (P + P.T)
            updated, gaps = now, gaps + 1
    return float(np.mean(sums))


@pytest.mark.recordings
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "too_sure"), [("broad_21", True), ("euroc_v1_01", True), ("sim_fog_mems_300s", False)]
)
def test_a_plain_filter_is_consistent_with_the_figures_in_motion(recordings, name, too_sure):
    recording = kreisel.load(recordings / name)
    outcome = run_calibration(recording, CalibrationSettings())
    found = motion_noise(outcome)
    noise = outcome.estimate.problem.noise.reference

    def nees(sizes):
        reference = sizes[2] * noise.position, sizes[2] * noise.orientation
        return mean_nees(recording, outcome.calibration, *sizes[:2], found.walk, *reference)

    assert 0.8 < nees(found.best.sizes) < 1.3
    if too_sure:
        assert nees(np.append(found.at_rest, 1.0)) > 2.0
    else:
        np.testing.assert_allclose(found.factor, 1.0, atol=0.35)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_noise_that_is_there_only_while_moving_is_not_diluted_by_standstills(seed):
    recording = simulate(Cell.model_validate({"seed": seed, "seconds": 300.0}), Path("cell"))[1]
    imu, generator = recording.imu, np.random.default_rng(seed)
    moving = uniform_filter1d(np.linalg.norm(imu.rates, axis=1), 21) > 0.005
    at_rest, added = 1e-3, 5e-3  # m/s^2/sqrt(Hz)
    size = np.where(moving, math.hypot(at_rest, added), at_rest)[:, None] * imu.interval**-0.5
    shaken = replace(imu, accelerations=imu.accelerations + size * generator.normal(size=imu.accelerations.shape))
    found = motion_noise(run_calibration(check_streams(replace(recording, imu=shaken)), CalibrationSettings()))
    assert found.measured == (True, True)
    assert found.at_rest[1] == pytest.approx(math.hypot(at_rest, 0.1 * 9.81e-3), rel=0.4)
    assert 0.5 * (1.0 - moving.mean()) < found.standing < 1.0 - moving.mean()
    truth = math.hypot(math.hypot(at_rest, added), 9.81e-4)
    assert abs(math.log(found.while_moving[1] / truth)) < 4.0 * found.best.log_deviation[1]


def test_shares_are_those_of_scipys_nonnegative_least_squares():
    generator = np.random.default_rng(3)
    for _ in range(50):
        columns, values = generator.normal(size=(4, 3)), generator.normal(size=4)
        np.testing.assert_allclose(_nonnegative(columns, values), nnls(columns, values)[0], atol=1e-9)
