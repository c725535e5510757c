"""Accelerometers fitted with no assumption about them: made by hand, disturbed, and found again."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kreisel.preparation.acceleration_check import _agreement, _fit, fit_accelerations
from kreisel.preparation.preparation import AccelerationWindows
from kreisel.recording.recording import ReferencePoses

GRAVITY = 9.81
DOWN = np.array([0.6, -0.48, 0.64])
"""Direction of gravity in r: known to nobody."""

ARM, OFFSET = np.array([0.1, -0.05, 0.2]), np.array([0.3, -0.2, 0.1])
MOUNT = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix() @ np.diag([1.02, 0.97, 1.01])


def windows_of(K=MOUNT, count=200, seed=0, scale=1.0, motion=2.0, p_noise=0.0, a_noise=0.0, turns=None):
    """Windows of a motion drawn at random, as regressor (count, 3, 15) and reference (count, 3).

    With u = C a' the regressor's couplings, C its offsets and B its lever arm, a + B r = C (K a' + K k) + g.
    """
    rng = np.random.default_rng(seed)
    C = Rotation.random(count, random_state=seed).as_matrix()
    if turns is not None:
        C = Rotation.from_rotvec(turns * rng.normal(size=(count, 3))).as_matrix() @ C[0]
    B = rng.normal(0.0, 3.0, (count, 3, 3))
    a = rng.normal(0.0, motion, (count, 3))
    force = np.einsum("nji,nj->ni", C, a - GRAVITY * DOWN - B @ ARM)
    raw = np.linalg.solve(K, force.T).T - OFFSET + rng.normal(0.0, 1.0, (count, 3)) * a_noise
    couplings = np.einsum("nij,nk->nijk", C, raw).reshape(count, 3, 9)
    reference = scale * a + rng.normal(0.0, 1.0, (count, 3)) * p_noise
    return np.concatenate([couplings, C, B], axis=2), reference


@pytest.mark.parametrize(
    "axes",
    [np.eye(3), np.eye(3)[[1, 2, 0]], np.diag([1.0, 1.0, -1.0]), -np.eye(3), np.eye(3)[[1, 0, 2]]],
    ids=["in order", "cycled", "one flipped", "all flipped", "swapped"],
)
@pytest.mark.parametrize("scale", [1.0, 1000.0, 0.01])
def test_axes_signs_handedness_and_unit_need_no_assumption(axes, scale):
    K = axes @ MOUNT
    fit = _fit(*windows_of(K, scale=scale), GRAVITY)
    np.testing.assert_allclose(fit.K_a, K, atol=1e-6)
    assert fit.scale == pytest.approx((scale, scale), rel=1e-5)
    assert fit.explained == pytest.approx(1.0, abs=1e-9)
    # seen in metres, predicted and reference accelerations are the same
    x, y = 2.0, 2.0 * scale
    assert fit.agreement == pytest.approx(1.0 - (x - y) ** 2 / (x**2 + y**2), abs=0.02 if scale != 1.0 else 1e-9)


@pytest.mark.parametrize(("p_noise", "a_noise"), [(0.5, 0.0), (0.0, 0.5), (0.5, 0.5)])
@pytest.mark.parametrize("scale", [1.0, 1.3])
def test_the_true_scale_lies_between_the_bounds(p_noise, a_noise, scale):
    fits = [
        _fit(*windows_of(seed=seed, scale=scale, p_noise=p_noise, a_noise=a_noise), GRAVITY).scale for seed in range(6)
    ]
    low, high = np.mean(fits, axis=0)
    scatter = np.std(fits, axis=0) / np.sqrt(len(fits))
    assert low < scale + 3.0 * scatter[0]
    assert high > scale - 3.0 * scatter[1]
    assert 0.88 * scale < low < high < 1.2 * scale  # three deviations of the factor are 0.03


@pytest.mark.parametrize("scale", [0.9, 1.1])
def test_little_turning_shows_no_direction_of_gravity_and_no_scale(scale):
    """Offsets are as good as gravity in any direction."""
    for seed in range(4):
        little, much = (
            _fit(*windows_of(seed=seed, scale=scale, p_noise=0.05, a_noise=0.05, turns=size), GRAVITY)
            for size in (3e-3, 0.5)
        )
        assert little.scale == (0.0, np.inf)
        assert much.scale == pytest.approx((scale, scale), abs=0.02)


def test_few_windows_with_much_noise_do_not_make_the_positions_too_large():
    """The factor itself is beyond 1.06 in a quarter of them: its lower bound is three deviations lower."""
    few = {"count": 25, "motion": 0.3, "p_noise": 0.3, "a_noise": 0.02, "turns": 0.2}
    low = [_fit(*windows_of(seed=seed, **few), GRAVITY).scale[0] for seed in range(40)]
    assert max(low) < 1.0
    assert _fit(*windows_of(seed=1, **{**few, "count": 400}), GRAVITY).scale[0] > 0.7


def test_positions_that_do_not_move_show_no_scale():
    """Couplings of 0.3 m/s^2 of noise explain the positions' own 0.1 m/s^2 as well as gravity would."""
    for seed in range(6):  # half of them have a positive scale, by chance
        fit = _fit(*windows_of(seed=seed, motion=0.0, p_noise=0.1, a_noise=0.3), GRAVITY)
        assert fit.scale[0] < 0.1
        assert fit.scale[1] == np.inf
        assert not fit.signed
    assert _fit(*windows_of(), GRAVITY).signed


@pytest.mark.parametrize("seed", range(4))
def test_noise_of_poses_that_is_known_does_not_count_as_motion(seed):
    """Accelerations with motion of 1 m/s^2 and noise of 2, which would make their factor one fifth."""
    windows = windows_of(seed=seed, count=2000, motion=1.0, p_noise=2.0, a_noise=0.05)
    known, unknown = _fit(*windows, GRAVITY, 4.0), _fit(*windows, GRAVITY)
    assert unknown.agreement < 0.4
    assert unknown.scale[1] > 4.0
    assert known.agreement > 0.9
    assert known.signed
    assert known.scale[0] == pytest.approx(1.0, abs=0.15)
    assert 1.0 < known.scale[1] < 2.5
    np.testing.assert_allclose(known.K_a, MOUNT, atol=0.05)


def test_without_motion_the_couplings_are_still_found_by_gravity():
    fit = _fit(*windows_of(motion=1e-9, p_noise=0.1), GRAVITY)
    np.testing.assert_allclose(fit.K_a, MOUNT, atol=1e-6)


def test_deviations_are_those_of_windows_that_share_their_noise():
    """Noise drawn anew for each window is counted twice: errors are 1 / sqrt(2) of the deviations.

    Down-weighting costs little: gaussian residuals of length sqrt(3) sd keep 84 % of their weight at a scale of 4 sd,
    which makes deviations a tenth wider and no error much larger.
    """
    fits = [_fit(*windows_of(seed=seed, p_noise=0.3), GRAVITY) for seed in range(30)]
    ratio = np.array([(fit.K_a - MOUNT) / fit.K_a_sd for fit in fits])
    # noise in positions shrinks what they say, not the couplings; 270 errors, partly alike: 8 %
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(0.5**0.5, rel=0.2)


def test_windows_that_do_not_fit_hardly_count():
    regressor, reference = windows_of(p_noise=0.05)
    clean = _fit(regressor, reference, GRAVITY)
    reference[::10] += np.random.default_rng(1).normal(0.0, 10.0, (20, 3))
    fit = _fit(regressor, reference, GRAVITY)
    # least squares with all of them alike would be off by 0.07, and the second bound by a factor of three
    assert np.abs(fit.K_a - MOUNT).max() < 2.0 * np.abs(clean.K_a - MOUNT).max()
    assert 0.99 < fit.scale[0] < 1.0  # three deviations lower
    assert 0.995 < fit.scale[1] < 1.015  # three deviations higher


def test_readings_of_another_run_do_not_agree():
    regressor, _ = windows_of()
    _, other = windows_of(seed=9)
    assert _fit(regressor, other, GRAVITY).agreement < 0.9
    rng = np.random.default_rng(3)
    noise = np.concatenate([rng.normal(0.0, 5.0, (200, 3, 9)), regressor[:, :, 9:]], axis=2)
    # 13 of the 16 columns have nothing to do with gravity: nothing of it is explained but by chance and by offsets
    assert _fit(noise, other, GRAVITY).explained < 0.2


def test_too_few_windows_say_nothing():
    regressor, reference = windows_of(count=19)
    fit = _fit(regressor, reference, GRAVITY)
    assert fit.scale == (0.0, np.inf)
    assert np.all(np.isinf(fit.K_a_sd))
    assert (fit.explained, fit.agreement, fit.size) == (0.0, 1.0, 0.0)
    assert np.all(np.isfinite(_fit(*windows_of(count=20), GRAVITY).K_a_sd))


def test_agreement_is_one_zero_and_minus_one():
    """For f = a, for f and a with nothing in common, and for f = -a; constants do not count."""
    rng = np.random.default_rng(1)
    a, b = rng.normal(0.0, 2.0, (2, 50_000, 3))
    shift = np.array([9.81, 0.0, 3.0])
    assert _agreement(a + shift, a)[0] == pytest.approx(1.0, abs=1e-12)
    assert _agreement(-a + shift, a)[0] == pytest.approx(-1.0, abs=1e-12)
    agreement, size = _agreement(0.5 * b, a)
    # 2 f a / (f^2 + a^2): a mean product scatters by f a / sqrt(150 000)
    assert agreement == pytest.approx(0.0, abs=4.0 * 2.0 * 0.5 / 1.25 / np.sqrt(150_000))
    assert size == pytest.approx(2.0, rel=4.0 / np.sqrt(2.0 * 150_000))  # of the larger
    assert _agreement(0.5 * a, a)[0] == pytest.approx(1.0 - 0.25 / 1.25, abs=1e-12)


def test_a_recording_is_fitted_by_its_windows_and_its_gravity():
    regressor, reference = windows_of()
    windows = AccelerationWindows(regressor, reference, np.zeros((0, 3, 15)))
    poses = ReferencePoses("pose0", 10_000_000 * np.arange(500), np.zeros((500, 3)), None, Path("pose0/data.csv"))
    known = SimpleNamespace(
        accelerometer_fit=SimpleNamespace(windows=windows), site=SimpleNamespace(gravity=GRAVITY), reference=poses
    )
    fit = fit_accelerations(known)
    np.testing.assert_allclose(fit.K_a, MOUNT, atol=1e-6)
    known.site.gravity = 2.0 * GRAVITY  # gravity is the measure of everything
    np.testing.assert_allclose(fit_accelerations(known).K_a, 2.0 * MOUNT, atol=1e-6)
