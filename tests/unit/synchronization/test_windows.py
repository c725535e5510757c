"""Windows: second differences and double integrals against closed forms, and where windows may lie."""

import numpy as np
import pytest

from kreisel.inertial.strapdown import prepare
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.windows import HALF_WINDOW, Windows, variance_by_noise

IMU_STEP, POSE_STEP = 0.0025, 0.012
OMEGA = 5.0
"""rad/s of a motion back and forth."""


def signal_of(t, segments=None):
    return prepare(t, np.zeros((t.size, 3)), np.zeros((t.size, 3)), segments=segments)


def windows_of(clock=Clock(0.03), seconds=10.0, step=POSE_STEP, **changed):
    tau = np.arange(0.0, seconds - 0.5, step)
    return Windows.over(signal_of(np.arange(0.0, seconds, IMU_STEP)), clock, tau, **changed)


def triangular_mean_of_sine(t, half):
    """Mean of sin(OMEGA t) with a triangular weight: the square of that with an even one."""
    return np.sin(OMEGA * t) * np.sinc(OMEGA * half / (2.0 * np.pi)) ** 2


def quadrature_error(half, step, size):
    """What straight lines between samples a step apart do to a second difference: at most step^2 / 8, at three ends."""
    return 4.0 * size * step**2 / 8.0 / half**2


def test_windows_stand_two_fifths_of_a_half_apart_inside_both_recordings():
    w = windows_of()
    np.testing.assert_allclose(np.diff(w.tau[1]), 0.4 * HALF_WINDOW, rtol=1e-9)
    assert w.half == HALF_WINDOW
    assert w.tau[0].min() >= w.reference[0]
    assert w.tau[2].max() <= w.reference[-1]
    # and none is left out, but where positions have others on one side only
    assert w.tau[2].max() > w.reference[-5] - 0.4 * HALF_WINDOW - 1e-9
    for t, tau in zip(w.t, w.tau, strict=True):
        np.testing.assert_allclose(t, 0.03 + tau, rtol=1e-14)


@pytest.mark.parametrize("start", [-3.0, 3.0])
def test_what_only_one_recorded_is_left_out(start):
    w = windows_of(Clock(start))
    assert w.t[0].min() >= w.stamps[1] - 1e-9
    assert w.t[2].max() <= w.stamps[-2] + 1e-9
    assert w.tau[0].min() < max(0.0, -start) + 2.0 * IMU_STEP + 4.0 * POSE_STEP
    assert w.tau[2].max() > min(w.reference[-1], w.stamps[-1] - start) - 0.11 - 4.0 * POSE_STEP


def test_recordings_too_short_or_apart_have_no_windows():
    for w in (windows_of(seconds=0.9), windows_of(Clock(100.0))):
        assert w.tau[1].size == 0
        assert w.second_difference(np.zeros((w.reference.size, 3))).shape == (0, 3)
        assert w.integrate(np.zeros((w.stamps.size, 2))).shape == (0, 2)


def test_half_a_window_holds_three_poses_and_the_length_asked_for():
    assert windows_of(step=0.2).half == pytest.approx(0.6)
    assert windows_of(shortest=1.5).half == 1.5


@pytest.mark.parametrize("skew", [0.0, 0.01])
def test_the_second_difference_of_positions_is_the_acceleration_in_imu_seconds(skew):
    """A smoothed parabola is a parabola; what is left are straight lines between poses."""
    w = windows_of(Clock(0.03, skew))
    t = 0.03 + (1.0 + skew) * w.reference
    a = np.array([3.0, -2.0, 0.5])
    found = w.second_difference(0.5 * t[:, None] ** 2 * a + t[:, None] * [1.0, 2.0, 3.0])
    assert np.abs(found - a).max() < quadrature_error(HALF_WINDOW, POSE_STEP, 3.0)


def test_smoothing_takes_noise_of_nine_poses_together_and_leaves_parabolas():
    """Means m of five and M of nine bend a parabola by 2 and 20 / 3 poses squared: m + 3 / 7 (m - M) not at all."""
    w = windows_of(seconds=6.0)
    draws = np.random.default_rng(0).normal(0.0, 1.0, (w.reference.size, 2000))
    found = w.second_difference(draws)[3:-3].std(axis=1) * HALF_WINDOW**2
    weights = np.zeros(9)
    weights[2:7] += 10.0 / 7.0 / 5.0
    weights -= 3.0 / 7.0 / 9.0
    between = 0.5 * (np.append(weights, 0.0) + np.append(0.0, weights))
    most, least = (np.sqrt(6.0 * np.sum(values**2)) for values in (weights, between))
    # a deviation of 2000 draws scatters by 1.6 %
    assert least * 0.93 < found.min() < found.mean() < most < found.max() * 1.07
    assert found.max() < most * 1.07


def test_sparse_poses_are_not_smoothed():
    w = windows_of(step=0.05, seconds=20.0)
    assert w.half == HALF_WINDOW  # windows begin, turn and end at poses
    p = np.sin(OMEGA * w.reference)[:, None]
    exact = -(OMEGA**2) * triangular_mean_of_sine(w.tau[1], HALF_WINDOW)
    np.testing.assert_allclose(w.second_difference(p)[:, 0], exact, atol=1e-9)


@pytest.mark.parametrize("skew", [0.0, 0.01])
def test_integrals_are_triangularly_weighted_means(skew):
    w = windows_of(Clock(0.03, skew))
    t = w.stamps
    found = w.integrate(np.column_stack([np.ones_like(t), t, np.sin(OMEGA * t)]))
    assert w.half == pytest.approx((1.0 + skew) * HALF_WINDOW)
    middle = w.t[1]
    error = quadrature_error(w.half, IMU_STEP, 1.0)
    np.testing.assert_allclose(found[:, 0], 1.0, atol=error)
    np.testing.assert_allclose(found[:, 1], middle, atol=10.0 * error)
    np.testing.assert_allclose(found[:, 2], triangular_mean_of_sine(middle, w.half), atol=error)


def test_positions_and_accelerations_say_the_same():
    """A mean over 0.1 s would take 1.2 % of the sine from the positions."""
    w = windows_of()
    p, a = np.sin(OMEGA * (0.03 + w.reference)), -(OMEGA**2) * np.sin(OMEGA * w.stamps)
    shown, predicted = w.second_difference(p[:, None])[2:-2], w.integrate(a[:, None])[2:-2]
    np.testing.assert_allclose(shown, predicted, atol=quadrature_error(HALF_WINDOW, POSE_STEP, OMEGA**2))


@pytest.mark.parametrize("step", [0.1, 0.2, 0.4])
def test_poses_far_apart_have_the_curvature_of_the_motion(step):
    """Between them it would be that of straight lines: up to a third less."""
    w = windows_of(seconds=30.0, step=step)
    found = w.second_difference(np.sin(OMEGA * w.reference)[:, None])[:, 0]
    want = -(OMEGA**2) * triangular_mean_of_sine(w.tau[1], w.half)
    np.testing.assert_allclose(found, want, atol=1e-9 * OMEGA**2)


def test_means_hand_moments_over_in_the_order_of_time():
    w = windows_of()
    seen = []

    def integrate(before, share, out):
        moments = w.stamps[before] + share * (w.stamps[before + 1] - w.stamps[before])
        seen.append(moments)
        out[:, 0] = moments**2  # twice the double integral of one

    found = w.means(1, integrate)
    assert np.all(np.diff(seen[0]) >= 0.0)
    np.testing.assert_allclose(found, 2.0, rtol=1e-9)


def test_no_window_comes_near_a_gap_of_the_readings():
    t = np.arange(0.0, 20.0, IMU_STEP)
    first, second = int(8.0 / IMU_STEP), int(8.5 / IMU_STEP)
    keep = np.r_[0 : first + 1, second : t.size]
    signal = signal_of(t[keep], ((0, first), (first + 1, keep.size - 1)))
    tau = np.arange(0.0, 20.0, POSE_STEP)
    w = Windows.over(signal, Clock(0.0), tau)
    before, after = w.t[2] <= 7.0, w.t[0] >= 9.5  # a second away
    assert np.all(before | after)
    assert w.t[2][before].max() > 6.9
    assert w.t[0][after].min() < 9.6
    whole = Windows.over(signal_of(t), Clock(0.0), tau)
    assert whole.tau[1].size - w.tau[1].size == pytest.approx((2.5 + 2.0 * HALF_WINDOW) / (0.4 * HALF_WINDOW), abs=1.0)


def test_a_window_may_reach_across_missing_poses_but_not_begin_turn_or_end_there():
    t, tau = np.arange(0.0, 10.0, IMU_STEP), np.arange(0.0, 10.0, POSE_STEP)
    kept = tau[(tau < 4.96) | (tau > 5.1)]
    w = Windows.over(signal_of(t), Clock(0.0), kept)
    low, high = kept[kept < 4.96].max(), kept[kept > 5.1].min()
    everywhere = Windows.over(signal_of(t), Clock(0.0), tau).tau[1]
    bad = np.zeros(everywhere.size, dtype=bool)
    for shift in (-HALF_WINDOW, 0.0, HALF_WINDOW):
        bad |= (everywhere + shift > low) & (everywhere + shift < high)
    assert bad.sum() == 4
    np.testing.assert_allclose(w.tau[1], everywhere[~bad], rtol=1e-12)
    assert np.any((w.tau[0] < low) & (w.tau[2] > high))  # one lies across


def test_missing_poses_fewer_than_six_do_not_matter():
    t, tau = np.arange(0.0, 10.0, IMU_STEP), np.arange(0.0, 10.0, POSE_STEP)
    kept = np.delete(tau, np.arange(400, 404))  # a step of five
    assert (
        Windows.over(signal_of(t), Clock(0.0), kept).tau[1].size
        == Windows.over(signal_of(t), Clock(0.0), tau).tau[1].size
    )


@pytest.mark.parametrize("step", [0.011, 0.1])
def test_noise_of_positions_is_as_large_as_predicted(step):
    w = windows_of(seconds=200.0, step=step)
    draws = np.random.default_rng(2).normal(0.0, 3e-3, (w.reference.size, 20))
    # a mean between two poses has less
    assert np.mean(w.second_difference(draws) ** 2) == pytest.approx(variance_by_noise(w.reference, 3e-3), rel=0.1)
