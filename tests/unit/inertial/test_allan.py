"""Noise figures of readings at rest: of noises drawn, and of curves in closed form."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from kreisel.inertial.allan import (
    TERMS,
    allan_deviation,
    density_and_walk,
    moved,
    noise_figures,
    unrest,
    usual_clusters,
    warms_up,
)
from kreisel.inertial.allan_fit import covariance_of
from kreisel.inertial.noise_figures import noise


def test_figures_of_drawn_noise_are_found():
    """Two hours at 50 Hz; the curve's long end has few independent parts: B and K within a third, N within 2 %."""
    n, rate = 360_000, 50.0
    found = noise_figures(noise(np.random.default_rng(2), n, rate, 1e-3, 3e-4, 2e-5), 1.0 / rate)
    np.testing.assert_allclose(np.mean(found.density), 1e-3, rtol=0.02)
    np.testing.assert_allclose(np.mean(found.instability), 3e-4, rtol=0.33)
    np.testing.assert_allclose(np.sqrt(np.mean(found.walk**2)), 2e-5, rtol=0.33)
    for term, true in (("density", 1e-3), ("instability", 3e-4)):
        assert found.shown[term].all()
        assert np.abs((getattr(found, term) - true) / found.deviation[term]).max() < 3.0
    np.testing.assert_allclose(found.fitted, found.curve, rtol=0.5)


def test_two_minutes_show_white_noise_and_nothing_slower():
    found = noise_figures(noise(np.random.default_rng(1), 12_000, 100.0, 1e-3, 3e-4, 2e-5), 0.01)
    assert found.shown["density"].all()
    assert not any(found.shown[term].any() for term in TERMS if term != "density")


def test_quantisation_and_a_ramp_are_found():
    """Angles counted in steps of q have Q = q / sqrt(12), with a dither sqrt(2) of it; a ramp its slope."""
    rng = np.random.default_rng(3)
    n, interval, step, slope = 200_000, 0.01, 1e-4, 2e-6
    t = interval * np.arange(n + 1)
    angle = np.cumsum(1e-5 * rng.normal(size=(n + 1, 3)), axis=0) * interval + 0.5 * slope * t[:, None] ** 2
    counted = step * np.round(angle / step + rng.uniform(-0.5, 0.5, angle.shape))
    found = noise_figures(np.diff(counted, axis=0) / interval, interval)
    assert found.shown["quantisation"].all()
    np.testing.assert_allclose(found.quantisation, step * (2.0 / 12.0) ** 0.5, rtol=0.15)
    assert found.shown["ramp"].all()
    np.testing.assert_allclose(found.ramp, slope, rtol=0.1)


def test_warming_up_is_far_more_than_wandering():
    resting = noise(np.random.default_rng(4), 100_000, 10.0, 1e-3, 3e-4, 2e-6)
    assert not warms_up(resting).any()
    warm = resting + np.outer(2e-2 * np.exp(-np.arange(100_000) / 20_000.0), [1.0, 0.0, 0.0])
    assert warms_up(warm).tolist() == [True, False, False]


def test_random_walks_hardly_ever_seem_to_warm_up():
    rng = np.random.default_rng(6)
    seem = [warms_up(rng.normal(size=(1000, 3)).cumsum(axis=0)) for _ in range(1000)]
    assert 0.002 < np.mean(seem) < 0.009  # 0.5 % of drawn ones
    assert warms_up(np.linspace(0.0, 1.0, 1000)[:, None] * np.ones(3)).all()


def test_motion_is_told_from_noise():
    resting = noise(np.random.default_rng(5), 10_000, 100.0, 1e-3, 0.0, 0.0)
    assert moved(resting, 0.01)[0] < 10.0
    resting[5000:5200] += 0.05
    most, second = moved(resting, 0.01)
    assert most > 10.0
    assert second in (49, 50, 51)


@pytest.mark.parametrize("step", [2e-3, 8e-3])
def test_steps_of_a_converter_are_no_motion(step):
    resting = noise(np.random.default_rng(5), 10_000, 100.0, 1e-4, 0.0, 0.0)
    coarse = np.round(np.add(resting, [0.0, 0.48 * step, 0.3 * step]) / step) * step
    assert unrest(coarse, 0.01) is None
    coarse[5000:5200] += 3.0 * step
    assert "times as much" in unrest(coarse, 0.01)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
def test_white_noise_alone_has_hardly_anything_else(unit):
    found = noise_figures(unit * noise(np.random.default_rng(1), 100_000, 100.0, 1e-3, 0.0, 0.0), 0.01)
    np.testing.assert_allclose(found.density, unit * 1e-3, rtol=0.05)
    assert np.all(found.instability < 0.3 * unit * 1e-3)


def test_a_ramp_has_its_closed_form():
    """Of a ramp of slope s the Allan deviation is s tau / sqrt(2)."""
    t = 0.01 * np.arange(10_000)
    clusters = np.array([10, 100, 1000])
    found = allan_deviation(np.outer(t, [1.0, 2.0, 3.0]), clusters)
    np.testing.assert_allclose(found, np.outer(0.01 * clusters, [1.0, 2.0, 3.0]) / np.sqrt(2.0), rtol=1e-9)


def test_clusters_end_at_a_tenth():
    assert usual_clusters(100_000)[-1] == 10_000
    assert usual_clusters(100_000)[0] == 1
    assert np.all(np.diff(usual_clusters(1000)) > 0)


def test_the_curve_is_that_of_allantools():
    """Overlapping Allan deviations of white noise, flicker noise and a walk, at every averaging time."""
    allantools = pytest.importorskip("allantools")
    rate, n = 50.0, 20_000
    values = noise(np.random.default_rng(8), n, rate, 1e-3, 3e-4, 2e-5)
    clusters = usual_clusters(n)
    own = allan_deviation(values, clusters)
    for axis in range(3):
        tau, other, *_ = allantools.oadev(values[:, axis], rate=rate, data_type="freq", taus=clusters / rate)
        np.testing.assert_allclose(tau, clusters / rate)
        np.testing.assert_allclose(own[:, axis], other, rtol=1e-9)


def test_the_covariance_of_the_curve_is_that_of_drawn_noise():
    """300 drawn recordings with white noise, flicker noise and a walk: variances within a quarter, correlations 0.2."""
    rate, n, figures = 10.0, 6000, (1e-3, 3e-4, 3e-5)
    clusters = usual_clusters(n)[::3]
    rng = np.random.default_rng(7)
    drawn = np.concatenate([allan_deviation(noise(rng, n, rate, *figures), clusters).T ** 2 for _ in range(100)])
    squares = np.array([0.0, *np.square(figures), 0.0])
    expected, seen = covariance_of(clusters, 1.0 / rate, squares, n / rate), np.cov(drawn.T)
    np.testing.assert_allclose(np.sqrt(np.diag(expected) / np.diag(seen)), 1.0, atol=0.25)
    of = [C / np.sqrt(np.outer(np.diag(C), np.diag(C))) for C in (expected, seen)]
    np.testing.assert_allclose(of[0], of[1], atol=0.2)


@pytest.mark.parametrize("corner", [10.0, 40.0, 80.0])
def test_readings_that_a_filter_smooths_have_their_noise_density(corner):
    """Butterworth's filter of second order at 200 Hz: with short averages it would be 0.07 to 0.97 of the true one."""
    rng = np.random.default_rng(0)
    smoothed = lfilter(*butter(2, corner / 100.0), noise(rng, 120_000, 200.0, 2e-4, 0.0, 0.0), axis=0)
    found = noise_figures(smoothed, 5e-3)
    assert np.abs((found.density - 2e-4) / found.deviation["density"]).max() < 3.0
    np.testing.assert_allclose(found.density, 2e-4, rtol=0.05)
    assert found.smoothed.all()
    assert found.shown["density"].all()


def test_deviations_contain_what_else_slow_noise_may_be():
    """A walk of five minutes: errors over deviations, and no other slow noise is shown."""
    scores = []
    for seed in range(12):
        found = noise_figures(noise(np.random.default_rng(seed), 15_000, 50.0, 2e-4, 0.0, 3e-4), 0.02)
        scores += list(((found.walk - 3e-4) / found.deviation["walk"])[found.shown["walk"]])
        assert not found.shown["instability"].any()
    assert len(scores) > 30
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.3


def test_white_noise_shows_no_slow_noise():
    for seed in range(20):
        found = noise_figures(np.random.default_rng(seed).normal(size=(6000, 3)), 0.01)
        assert found.shown["density"].all()
        assert not any(found.shown[term].any() for term in TERMS if term != "density")
        assert not found.slow.any()


def test_a_walk_far_above_white_noise_is_slow_noise_whatever_its_kind():
    """Half an hour; at the longest averages it is three times the white noise. Which kind it is may stay open."""
    for seed in range(6):
        found = noise_figures(noise(np.random.default_rng(seed), 36_000, 20.0, 1e-4, 0.0, 3e-6), 0.05)
        assert found.slow.sum() >= 2
        assert 0.3 * 3e-6 < density_and_walk(found)["walk"] < 3.0 * 3e-6
