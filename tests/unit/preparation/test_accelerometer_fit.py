"""Start values of accelerometers: the oracle's motion and readings, put into windows and found again."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kreisel.inertial.strapdown import prepare
from kreisel.preparation.accelerometer_fit import acceleration_windows, fit_accelerometers, joined
from kreisel.preparation.preparation import AccelerationWindows
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.fits import RateFit

from ...oracle.motion import AnalyticMotion, inertial_truth, raw_readings
from ...oracle.quaternions import exp, matrix, rotate_back, skew

GRAVITY_R = np.array([0.3, -0.2, -9.8])
GRAVITY = float(np.linalg.norm(GRAVITY_R))
MOUNT = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix()
ARM = np.array([0.12, -0.05, 0.08])
PARAMETERS = {
    "K_omega": MOUNT @ np.diag([1.01, 0.99, 1.0]),
    "k_w": np.array([[0.01, -0.02, 0.005]]),
    "K_a": MOUNT @ np.array([[1.02, 0.01, -0.01], [0.0, 0.97, 0.005], [0.01, 0.0, 1.01]]),
    "k_a": np.array([[0.3, -0.2, 0.1]]),
    "lever_arms": np.tile(ARM, (3, 1)),
}
LAG = 0.1
"""IMU seconds of the first pose; a multiple of both intervals, so that windows begin and end at samples and poses."""

IMU_STEP, POSE_STEP, SECONDS = 0.005, 0.05, 40.0


def fit_of(clock):
    one = np.full((3, 3), 1e-4)
    return RateFit(PARAMETERS["K_omega"], PARAMETERS["k_w"][0], clock, False, 1.0, 1e-5, one, one[0])


FIT = fit_of(Clock(LAG))


@pytest.fixture(scope="module")
def moved():
    """Signal, attitudes at its samples, and poses of a motion throughout."""
    motion = AnalyticMotion(np.random.default_rng(3), 2.0, 4.0, SECONDS)
    t = np.arange(round(SECONDS / IMU_STEP)) * IMU_STEP
    rates, forces = raw_readings(*inertial_truth(motion, t, GRAVITY_R, np.zeros(3)), PARAMETERS)
    tau = np.arange(0.0, SECONDS - 1.0, POSE_STEP)
    return prepare(t, rates, forces), motion.attitude(t), tau, motion.position(LAG + tau)


@pytest.fixture(scope="module")
def windows(moved):
    signal, q, tau, p = moved
    return acceleration_windows(signal, FIT, tau, q, p, [])


def true_solution():
    K = PARAMETERS["K_a"]
    return np.concatenate([K.ravel(), K @ PARAMETERS["k_a"][0], ARM])


def test_the_true_parameters_predict_what_the_positions_show(windows):
    predicted = windows.regressor @ true_solution() + GRAVITY_R
    assert len(predicted) > 350
    assert windows.reference.std() > 0.9
    # trapezoids over 5 ms and accelerations of at most 1.2 Hz: (2 pi 1.2 0.005)^2 / 12 of 10 m/s^2
    np.testing.assert_allclose(predicted, windows.reference, atol=2e-3)
    assert windows.standstill_regressor.shape == (0, 3, 15)


def test_what_the_motion_shows_is_found(windows):
    found = fit_accelerometers(windows, FIT, GRAVITY, positions=True)
    np.testing.assert_allclose(found.K_a, PARAMETERS["K_a"], atol=1e-3)
    np.testing.assert_allclose(found.k_a0, PARAMETERS["k_a"][0], atol=5e-3)
    np.testing.assert_allclose(found.lever_arm, ARM, atol=1e-3)
    np.testing.assert_allclose(found.gravity, GRAVITY_R, atol=5e-3)
    assert np.linalg.norm(found.gravity) == pytest.approx(GRAVITY, abs=2e-3)
    assert found.residual_sd < 2e-3
    assert found.windows is windows


def test_a_faultless_sensor_makes_the_slope_one_and_positions_too_large_that_factor(windows):
    """By hand: predicted accelerations of accelerometers that are the mount, and positions of another unit."""
    R = Rotation.from_matrix(MOUNT).as_matrix()
    predicted = windows.regressor[:, :, :9] @ R.ravel()
    fit = replace(FIT, K_omega=R)
    for factor in (1.0, 1.25):
        made = replace(windows, reference=factor * (predicted - predicted.mean(axis=0)))
        slope = fit_accelerometers(made, fit, GRAVITY, positions=True).motion_slope
        assert slope == pytest.approx(factor, rel=1e-9)


def noisy(windows, sd, seed):
    noise = np.random.default_rng(seed).normal(0.0, sd, windows.reference.shape)
    return replace(windows, reference=windows.regressor @ true_solution() + GRAVITY_R + noise)


def test_deviations_are_those_of_windows_that_share_their_noise(windows):
    """Noise drawn anew for each window is counted twice: errors are 1 / sqrt(2) of the deviations.

    Windows of gaussian noise keep 84 % of their weight, which makes deviations a tenth wider.
    """
    ratio, tilts = [], []
    for seed in range(20):
        found = fit_accelerometers(noisy(windows, 0.1, seed), FIT, GRAVITY, positions=True)
        assert found.residual_sd == pytest.approx(0.1, rel=0.15)
        along = found.gravity / np.linalg.norm(found.gravity)
        tilts.append(np.cross(along, GRAVITY_R / GRAVITY) / found.tilt_sd)
        ratio.append(
            np.concatenate([
                ((found.K_a - PARAMETERS["K_a"]) / found.K_a_sd).ravel(), (found.lever_arm - ARM) / found.lever_arm_sd,
            ])
        )  # fmt: skip
    # about two axes, the larger deviation stated for both
    assert 0.4 < np.sqrt(np.mean(np.sum(np.square(tilts), axis=1))) < 1.3
    # 240 errors, partly alike: 8 %
    assert np.sqrt(np.mean(np.square(ratio))) == pytest.approx(0.5**0.5 / 1.09, rel=0.25)


def test_windows_that_do_not_fit_hardly_count(windows):
    made = noisy(windows, 0.02, 0)
    made.reference[::10] += 30.0
    found = fit_accelerometers(made, FIT, GRAVITY, positions=True)
    assert np.abs(found.K_a - PARAMETERS["K_a"]).max() < 0.01
    assert np.abs(found.lever_arm - ARM).max() < 0.01


def test_what_the_motion_does_not_show_stays_near_the_gyros_axes_and_nothing():
    """A body that stands: gravity and one column of couplings, no lever arm."""
    C = np.broadcast_to(np.eye(3), (100, 3, 3))
    raw = MOUNT.T @ -GRAVITY_R
    couplings = np.einsum("nij,k->nijk", C, raw).reshape(100, 3, 9)
    noise = np.random.default_rng(1).normal(0.0, 1e-3, (100, 3))
    still = AccelerationWindows(
        np.concatenate([couplings, C, np.zeros((100, 3, 3))], axis=2), noise, np.zeros((0, 3, 15))
    )
    found = fit_accelerometers(still, replace(FIT, K_omega=MOUNT), GRAVITY, positions=True)
    np.testing.assert_allclose(found.K_a, MOUNT, atol=1e-3)
    np.testing.assert_allclose(found.k_a0, 0.0, atol=1e-3)
    # gravity's direction is that of the readings, its size what is stated: to 1e-4 m/s^2, and 1e-4 of the mean's noise
    np.testing.assert_allclose(found.gravity, GRAVITY_R, atol=2e-3)
    assert np.linalg.norm(found.gravity) == pytest.approx(GRAVITY, abs=3e-4)
    np.testing.assert_allclose(found.lever_arm_sd, 0.3, rtol=1e-6)
    # of nine couplings six are as open as before, 0.2 each; three have gravity and offsets in common with the data
    assert 6.0 * 0.2**2 < np.sum(found.K_a_sd**2) < 9.0 * 0.2**2


def test_a_stated_gravity_is_taken_for_the_size_of_what_is_seen():
    """Readings of a body that stands are a percent too small: the couplings give way, not gravity."""
    C = matrix(exp(np.random.default_rng(2).normal(0.0, 1.2, (200, 3))))
    raw = np.einsum("nji,j->ni", C, -0.99 * GRAVITY_R)
    couplings = np.einsum("nij,nk->nijk", C, raw).reshape(200, 3, 9)
    noise = np.random.default_rng(1).normal(0.0, 1e-3, (200, 3))
    windows = AccelerationWindows(
        np.concatenate([couplings, C, np.zeros((200, 3, 3))], axis=2), noise, np.zeros((0, 3, 15))
    )
    found = fit_accelerometers(windows, replace(FIT, K_omega=np.eye(3)), GRAVITY, positions=True)
    np.testing.assert_allclose(found.K_a, np.eye(3) / 0.99, atol=1e-3)
    assert np.linalg.norm(found.gravity) == pytest.approx(GRAVITY, abs=3e-4)


def test_the_mean_over_a_standstill_is_that_of_its_samples(moved):
    signal, q, tau, _ = moved
    windows = acceleration_windows(signal, FIT, tau, q, None, [(3.0, 4.0), (7.001, 7.5), (-1.0, 2.0), (39.0, 50.0)])
    assert windows.standstill_regressor.shape == (2, 3, 15)  # those inside
    omega = signal.rates @ PARAMETERS["K_omega"].T + PARAMETERS["K_omega"] @ PARAMETERS["k_w"][0]
    alpha = signal.slopes @ PARAMETERS["K_omega"].T
    for found, (start, stop) in zip(windows.standstill_regressor, ((3.0, 4.0), (7.001, 7.5)), strict=True):
        inside = (signal.stamps >= start) & (signal.stamps < stop)
        C = matrix(q[inside])
        a = signal.accelerations[inside]
        W = skew(omega[inside])
        columns = [np.einsum("nij,nk->nijk", C, a).reshape(-1, 3, 9), C, -C @ (skew(alpha[inside]) + W @ W)]
        np.testing.assert_allclose(found, np.concatenate(columns, axis=2).mean(axis=0), atol=1e-9)


def test_without_positions_windows_are_of_six_seconds_and_nothing_runs_away(moved):
    signal, q, tau, _ = moved
    windows = acceleration_windows(signal, FIT, tau, q, None, [])
    assert np.all(windows.reference == 0.0)
    assert len(windows.reference) == pytest.approx((SECONDS - 1.0 - 6.0) / 1.2, abs=1.5)
    # a mean acceleration over 3 s halves is a second difference of positions within a metre or so, over 9 s^2
    predicted = windows.regressor @ true_solution() + GRAVITY_R
    assert np.linalg.norm(predicted, axis=1).max() < 0.5


def test_without_positions_standstills_show_couplings_offsets_and_gravity():
    """Windows know accelerations to be zero on average only, to 0.3 m/s^2 here; standstills know them to 1 mm/s^2."""
    rng = np.random.default_rng(2)
    q = exp(rng.normal(0.0, 1.2, (80, 3)))
    C, K = matrix(q), PARAMETERS["K_a"]
    raw = np.linalg.solve(K, rotate_back(q, np.broadcast_to(-GRAVITY_R, (80, 3))).T).T - PARAMETERS["k_a"]
    raw = raw + rng.normal(0.0, 1.0, raw.shape) * np.repeat([0.3, 1e-3], 40)[:, None]
    couplings = np.einsum("nij,nk->nijk", C, raw).reshape(80, 3, 9)
    regressor = np.concatenate([couplings, C, np.zeros((80, 3, 3))], axis=2)
    windows = AccelerationWindows(regressor[:40], np.zeros((40, 3)), regressor[40:])
    found = fit_accelerometers(windows, FIT, GRAVITY, positions=False)
    # alone, the windows would show them to 0.3 / sqrt(40), 0.05 m/s^2; 400 times their weight leaves a tenth of that
    np.testing.assert_allclose(found.K_a, K, atol=2e-3)
    np.testing.assert_allclose(found.k_a0, PARAMETERS["k_a"][0], atol=0.01)
    np.testing.assert_allclose(found.gravity, GRAVITY_R, atol=0.01)
    assert found.motion_slope == 1.0


def test_chunks_are_joined_one_behind_the_other(windows):
    parts = [
        AccelerationWindows(windows.regressor[a:b], windows.reference[a:b], np.full((n, 3, 15), float(n)))
        for a, b, n in ((0, 100, 1), (100, 101, 0), (101, None, 2))
    ]
    whole = joined(parts)
    np.testing.assert_array_equal(whole.regressor, windows.regressor)
    np.testing.assert_array_equal(whole.reference, windows.reference)
    np.testing.assert_array_equal(whole.standstill_regressor[:, 0, 0], [1.0, 2.0, 2.0])
