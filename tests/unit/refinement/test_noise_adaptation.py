"""Noise figures found from innovations: drawn with known factors, compared with the moments of chi-square variables."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from scipy.stats import chi2

from kreisel.fitting.fit import Fit
from kreisel.model.problem import with_correlation_time, with_readings
from kreisel.refinement.noise_adaptation import (
    NoiseFactors,
    imu_density,
    noise_factors,
    noise_warning,
    with_factors,
    within_bounds,
)

from ...small_problem import history, small_problem, with_noise

LOW, HIGH = chi2.ppf([0.02, 0.98], 3)
TRIMMED = float(np.sqrt((chi2.cdf(HIGH, 5) - chi2.cdf(LOW, 5)) / 0.96))
"""Root of the mean of chi-square over three, its largest and smallest two per cent left out: 0.965."""

U = 6000
TOLERANCE = 4.0 * 0.5 * (2.0 / 3.0 / U) ** 0.5
"""Four deviations of the root of a mean of U chi-square variables over three: 2.1 %."""


def drawn(rng, factors):
    """Innovations and corrections of a linear filter whose assumed deviations are too small by factors (4,)."""
    position, orientation, gyro, accel = factors
    R, P = rng.uniform(0.5, 2.0, (U, 9)), rng.uniform(0.1, 3.0, (U, 9))
    R[:, :3], R[:, 3:6], P[:, :3], P[:, 3:6] = R[:, :1], R[:, 3:4], P[:, :1], P[:, 3:4]
    scale = np.repeat([position, orientation, 1.0], 3)
    z = scale * rng.normal(size=(U, 9)) * np.sqrt(R + P)
    V = np.repeat(rng.uniform(0.5, 2.0, (U, 2)), 3, axis=1)
    correction = np.repeat([accel, gyro], 3) * rng.normal(size=(U, 6)) * np.sqrt(V)
    return {
        "innovation": z, "residual": R / (R + P) * z, "noise_variance": R, "correction": correction,
        "correction_variance": V, "nis": np.sum(z[:, :6] ** 2 / (R + P)[:, :6], axis=1),
    }  # fmt: skip


def factors_of(columns, fitted=0.0, *, coloured=False):
    problem = with_correlation_time(small_problem(), 1.0) if coloured else small_problem()
    return noise_factors(problem, Fit(None, None, None, history(U, **columns), fitted))


def test_each_factor_is_the_one_by_which_its_noise_is_larger():
    """Innovation times residual has the mean R where the filter's covariances are right; both grow alike."""
    found = factors_of(drawn(np.random.default_rng(0), (1.5, 0.6, 2.0, 0.8)))
    want = TRIMMED * np.array([1.5, 0.6, 1.0, 2.0, 0.8])
    want[2] = 1.0  # no standstills
    np.testing.assert_allclose(astuple(found), want, rtol=TOLERANCE)


def test_an_uncertain_prediction_makes_the_reference_no_noisier():
    """Innovations grow with P, and residuals fall: only R counts, whatever P is."""
    rng = np.random.default_rng(1)
    z, R, P = rng.normal(size=(U, 9)), np.full((U, 9), 0.01), np.full((U, 9), 4.0)
    found = factors_of({
        "innovation": z * np.sqrt(R + P), "residual": z * R / np.sqrt(R + P), "noise_variance": R,
        "correction": rng.normal(size=(U, 6)), "correction_variance": np.ones((U, 6)),
    })  # fmt: skip
    assert found.position == pytest.approx(TRIMMED, rel=TOLERANCE)


def test_the_first_tenth_does_not_count_and_rejected_updates_only_for_the_reference():
    clean = drawn(np.random.default_rng(2), (1.0, 1.0, 1.0, 1.0))
    spoilt = {name: column.copy() for name, column in clean.items()}
    used = np.ones(U, dtype=bool)
    used[3000:3500] = False
    for name in ("innovation", "residual", "correction"):
        spoilt[name][: U // 10] *= 100.0
    assert astuple(factors_of(spoilt | {"used": used})) == astuple(factors_of(clean | {"used": used}))
    for name in ("innovation", "residual", "correction"):
        spoilt[name][~used] *= 100.0
    before, after = (factors_of(columns | {"used": used}) for columns in (clean, spoilt))
    assert (before.gyro, before.accel) == (after.gyro, after.accel)
    assert after.position > 2.0 * before.position


def test_a_few_gross_errors_are_left_out():
    columns = drawn(np.random.default_rng(3), (1.0, 1.0, 1.0, 1.0))
    plain = factors_of(columns)
    gross = columns | {"innovation": columns["innovation"].copy(), "residual": columns["residual"].copy()}
    for name in ("innovation", "residual"):
        gross[name][::100] *= 1e3
    assert factors_of(gross).position == pytest.approx(plain.position, rel=0.03)


def test_degrees_of_freedom_fitted_before_are_made_up_for():
    columns = drawn(np.random.default_rng(4), (1.0, 1.0, 1.0, 1.0))
    fitted = 0.36 * 6.0 * U  # innovations are smaller by a fifth
    ratio = np.array(astuple(factors_of(columns, fitted))) / np.array(astuple(factors_of(columns)))
    np.testing.assert_allclose(ratio, [1.25, 1.25, 1.0, 1.25, 1.25], rtol=1e-12)


def test_coloured_noise_is_as_large_as_the_mean_nis_says():
    columns = drawn(np.random.default_rng(5), (1.7, 1.7, 1.0, 1.0))
    found = factors_of(columns, coloured=True)
    # the root of a mean of U chi-square variables of six degrees of freedom
    assert found.position == found.orientation == pytest.approx(1.7, rel=4.0 * 0.5 * (2.0 / 6.0 / (0.9 * U)) ** 0.5)


def at_standstill(size, count=500):
    nis = np.zeros(U)
    rows = np.zeros(U, dtype=bool)
    rows[-count:] = True
    nis[rows] = size**2 * chi2.ppf((np.arange(count) + 0.5) / count, 9)
    return {"at_standstill": rows, "nis": nis, "degrees": np.where(rows, 9.0, 6.0)}


@pytest.mark.parametrize("size", [2.0, 5.0])
def test_standstills_grow_by_the_median_of_their_innovations(size):
    columns = drawn(np.random.default_rng(6), (1.0, 1.0, 1.0, 1.0)) | at_standstill(size)
    assert factors_of(columns).standstill == pytest.approx(size * np.sqrt(chi2.median(9) / 9.0), rel=2e-3)


def test_standstills_never_shrink_and_too_few_say_nothing():
    columns = drawn(np.random.default_rng(7), (1.0, 1.0, 1.0, 1.0))
    assert factors_of(columns | at_standstill(0.3)).standstill == 1.0
    assert factors_of(columns | at_standstill(5.0, count=5)).standstill == 1.0
    assert factors_of(columns | at_standstill(5.0, count=6)).standstill > 4.0


def test_what_is_not_measured_or_seen_too_seldom_is_left_as_it_is():
    columns = drawn(np.random.default_rng(8), (3.0, 3.0, 3.0, 3.0))
    for name in ("innovation", "residual", "noise_variance"):
        columns[name][:, 3:6] = np.nan
    found = factors_of(columns)
    assert found.orientation == 1.0
    assert found.position > 2.5
    few = np.arange(U) >= U - 14
    rejected = factors_of(columns | {"used": few})
    assert (rejected.gyro, rejected.accel) == (1.0, 1.0)
    assert factors_of(columns | {"used": np.arange(U) >= U - 15}).gyro > 2.0


def test_factors_agree_within_a_fifth():
    assert NoiseFactors(1.19, 0.84, 1.0, 1.1, 0.9).agree()
    for name in ("position", "orientation", "standstill", "gyro", "accel"):
        assert not NoiseFactors(**{name: 1.21}).agree()
        assert not NoiseFactors(**{name: 0.83}).agree()


def test_given_figures_are_kept_unless_they_are_clearly_too_small():
    found = NoiseFactors(1.9, 0.2, 2.1, 2.1, 0.5)
    assert astuple(found.contradicted(reference=False, imu=False)) == astuple(found)
    assert astuple(found.contradicted(reference=True, imu=False)) == (1.0, 1.0, 2.1, 2.1, 0.5)
    assert astuple(found.contradicted(reference=False, imu=True)) == (1.9, 0.2, 2.1, 2.1, 1.0)


def test_noise_stays_within_the_bounds_of_the_problem():
    problem = small_problem()
    gyro, accel = imu_density(problem)
    problem = with_noise(
        problem, imu_bounds=((0.5 * gyro, 3.0 * gyro), (0.7 * accel, 4.0 * accel)),
        min_reference=(0.1 * problem.noise.reference.position, 0.2 * problem.noise.reference.orientation),
    )  # fmt: skip
    small = within_bounds(problem, NoiseFactors(0.01, 0.01, 1.0, 0.01, 0.01))
    np.testing.assert_allclose(astuple(small), [0.1, 0.2, 1.0, 0.5, 0.7], rtol=1e-12)
    large = within_bounds(problem, NoiseFactors(50.0, 50.0, 50.0, 50.0, 50.0))
    np.testing.assert_allclose(astuple(large), [50.0, 50.0, 50.0, 3.0, 4.0], rtol=1e-12)
    usual = NoiseFactors(1.5, 1.5, 1.5, 1.5, 1.5)
    np.testing.assert_allclose(astuple(within_bounds(problem, usual)), astuple(usual), rtol=1e-12)


def test_multiplied_noise_is_that_many_times_as_large():
    problem = small_problem()
    found = with_factors(problem, NoiseFactors(2.0, 3.0, 5.0, 7.0, 11.0))
    before, after = problem.noise.reference, found.noise.reference
    assert after.position == pytest.approx(2.0 * before.position)
    assert after.orientation == pytest.approx(3.0 * before.orientation)
    assert after.standstill_orientation == pytest.approx(5.0 * before.standstill_orientation)
    assert after.velocity == pytest.approx(5.0 * before.velocity)
    np.testing.assert_allclose(imu_density(found), np.array([7.0, 11.0]) * imu_density(problem), rtol=1e-12)
    assert found.noise.min_reference == problem.noise.min_reference


def test_densities_are_the_stated_ones_and_rms_over_unlike_axes():
    problem = small_problem()
    stated = (0.15 * np.pi / 180.0 / 60.0, 0.1e-3 * 9.80665)  # 0.15 deg/sqrt(h), 0.1 mg/sqrt(Hz)
    np.testing.assert_allclose(imu_density(problem), stated, rtol=1e-12)
    noise = problem.sensor.readings.noise.copy()
    noise[:2] = [[1.0, 4.0, 4.0], [0.0, 0.0, 12.0]]  # squares of densities
    unlike = with_readings(problem, replace(problem.sensor.readings, noise=noise))
    np.testing.assert_allclose(imu_density(unlike), [3.0**0.5, 2.0], rtol=1e-12)


def test_the_warning_states_the_figures_in_use():
    problem = with_factors(small_problem(), NoiseFactors(4.0, 6.0, 3.0, 1.0, 1.0))
    found, used = (noise_warning(problem, given=given) for given in (False, True))
    assert found.subject == used.subject == "noise"
    figures = "reference 2 mm and 3 mrad on the path, 0.3 mm and 0.3 mrad at standstill; gyro 4.36e-05 rad/s"
    assert figures in found.message
    assert figures in used.message
    assert "contradict" in used.message
    assert "contradict" not in found.message


def test_what_was_not_measured_has_no_factor():
    """Variances are zero there; the others still count, and nothing is divided by zero."""
    columns = drawn(np.random.default_rng(0), (1.5, 0.6, 2.0, 0.8))
    columns["noise_variance"][:, 3:6] = columns["residual"][:, 3:6] = 0.0
    columns["noise_variance"][: U // 2, :3] = columns["residual"][: U // 2, :3] = 0.0
    found = factors_of(columns)
    assert found.orientation == 1.0
    assert found.position == pytest.approx(1.5 * TRIMMED, rel=2.0 * TOLERANCE)
