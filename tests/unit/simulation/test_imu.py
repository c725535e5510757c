"""The simulated device: its sensor model, its filters, its noise; and the Allan deviation that shows them.

Tolerances of Allan deviations are four standard deviations: M clusters of three sensors give a relative one of
1 / sqrt(2 * 3 * (M - 1)), overlapping clusters taken for no better than separate ones.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from kreisel.inertial.noise_figures import GRADES, Grade, high_frequency_density, noise
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell, Imu
from kreisel.simulation.device_errors import draw_effects, offset_drift, temperature_of
from kreisel.simulation.imu import disturbed, draw_noise, draw_sensors, filtered, ideal_readings

from ...navigation import corrected
from ...oracle.allan import allan_deviation

RATE = 200.0
QUIET = Grade(gyro_noise_density=0.0, accel_noise_density=0.0, gyro_offset_sd=0.0, accel_offset_sd=0.0)


def relative_tolerance(samples, clusters, sensors=3):
    return 4.0 / np.sqrt(2.0 * sensors * (samples / np.asarray(clusters) - 1.0))


def pooled(deviations):
    return np.sqrt(np.mean(deviations**2, axis=-1))


def inside_chi_square(values, sd):
    """Whether the values' root mean square is one that a normal variable of this deviation shows, but for 1e-6."""
    n = np.size(values)
    low, high = chi2.ppf([5e-7, 1.0 - 5e-7], n)
    return low < np.sum(np.square(values)) / sd**2 < high


# Sensor model


def random_sensors(rng, order):
    def matrix():
        return Rotation.random(rng=rng).as_matrix() @ (np.eye(3) + rng.normal(0.0, 0.02, (3, 3)))

    def polynomial(offset, bend):
        return np.vstack([rng.normal(0.0, offset, (1, 3)), *(rng.normal(0.0, s, (1, 3)) for s in bend[: order - 1])])

    k_w, k_a = polynomial(0.01, (5e-3, 1e-3)), polynomial(0.3, (3e-4, 1e-5))
    return SensorParameters(matrix(), k_w, matrix(), k_a, rng.normal(0.0, 0.05, (3, 3)))


@pytest.mark.parametrize("order", [1, 2, 3])
def test_corrected_readings_are_what_they_were_made_from(order):
    rng = np.random.default_rng(order)
    for _ in range(20):
        sensors = random_sensors(rng, order)
        omega, alpha, force = (rng.uniform(-limit, limit, (200, 3)) for limit in (5.0, 40.0, 30.0))
        w, a = ideal_readings(omega, alpha, force, sensors)
        # rounding of numbers up to 40 in a few tens of operations
        for found, true in zip(corrected(np.arange(200.0), w, a, sensors, alpha), (omega, force), strict=True):
            np.testing.assert_allclose(found, true, rtol=0, atol=1e-12)


def test_an_accelerometer_off_the_axis_feels_the_turn():
    """On the x axis, turning about z: -omega^2 r outward, alpha r sideways; the device is upside down about x."""
    flip = np.diag([1.0, -1.0, -1.0])
    zero = np.zeros((1, 3))
    sensors = SensorParameters(flip, zero, flip, zero, np.tile([0.1, 0.0, 0.0], (3, 1)))
    omega, alpha, force = np.array([[0, 0, 2.0]]), np.array([[0, 0, 5.0]]), np.array([[0, 0, 9.81]])
    w, a = ideal_readings(omega, alpha, force, sensors)
    np.testing.assert_allclose(w, [[0.0, 0.0, -2.0]], rtol=0, atol=1e-15)
    np.testing.assert_allclose(a, [[-0.4, -0.5, -9.81]], rtol=0, atol=1e-15)


def test_devices_of_a_grade_differ_as_it_says():
    rng, grade, mounting = np.random.default_rng(0), GRADES["consumer-mems"], (20.0, -40.0, 100.0)
    imu = Imu(mounting_deg=mounting, lever_arm=(0.1, 0.2, 0.3), quadratic_gyro_sd=1e-3, quadratic_accel_sd=1e-4)
    devices = [draw_sensors(rng, imu, grade) for _ in range(200)]
    mount = Rotation.from_rotvec(mounting, degrees=True).as_matrix()
    off_diagonal = ~np.eye(3, dtype=bool)
    errors = {
        "gyro": np.array([mount.T @ d.K_omega for d in devices]) - np.eye(3),
        "accel": np.array([mount.T @ d.K_a for d in devices]) - np.eye(3),
    }
    for sensor, scale in (("gyro", grade.gyro_scale_sd), ("accel", grade.accel_scale_sd)):
        assert inside_chi_square(np.diagonal(errors[sensor], axis1=1, axis2=2), scale)
        assert inside_chi_square(errors[sensor][:, off_diagonal], grade.misalignment_sd)
    assert inside_chi_square([d.k_w[0] for d in devices], grade.gyro_offset_sd)
    assert inside_chi_square([d.k_a[0] for d in devices], grade.accel_offset_sd)
    assert inside_chi_square([d.k_w[1] for d in devices], 1e-3)
    assert inside_chi_square([d.k_a[1] for d in devices], 1e-4)
    assert inside_chi_square(np.array([d.lever_arms for d in devices]) - [0.1, 0.2, 0.3], 0.02)


def test_a_faultless_device_is_only_mounted():
    imu = Imu(errors=False, mounting_deg=(10.0, 20.0, -30.0), lever_arm=(0.1, 0.0, 0.2))
    sensors = draw_sensors(np.random.default_rng(0), imu, GRADES["consumer-mems"])
    mount = Rotation.from_rotvec((10.0, 20.0, -30.0), degrees=True).as_matrix()
    np.testing.assert_allclose(sensors.K_omega, mount, rtol=0, atol=1e-15)
    np.testing.assert_allclose(sensors.K_a, mount, rtol=0, atol=1e-15)
    assert not np.any(sensors.k_w)
    assert not np.any(sensors.k_a)
    np.testing.assert_array_equal(sensors.lever_arms, np.tile([0.1, 0.0, 0.2], (3, 1)))


# Filters


def response(frequency, bandwidth, *, averaged):
    """Amplitude and phase of a sine after `filtered`, as a complex number, by least squares over whole periods."""
    t = np.arange(2000) / RATE
    angle = 2.0 * np.pi * frequency * t
    out = filtered(np.tile(np.sin(angle)[:, None], (1, 3)), RATE, bandwidth, averaged=averaged)
    assert np.ptp(out, axis=1).max() == 0.0
    late = slice(600, 1800)  # the filter has settled, the spline's end is far; 6 s: whole periods
    A = np.column_stack([np.sin(angle), np.cos(angle)])[late]
    (real, imaginary), *_ = np.linalg.lstsq(A, out[late, 0], rcond=None)
    return complex(real, imaginary)


def butterworth(frequency, bandwidth):
    s = 1j * frequency / bandwidth
    return 1.0 / (s**2 + np.sqrt(2.0) * s + 1.0)


def moving_average(frequency):
    return np.sinc(frequency / RATE) * np.exp(-1j * np.pi * frequency / RATE)


def response_tolerance(frequency, bandwidth):
    """Spline between samples, (omega h)^4 / 384; bilinear rule at 8 points each, its frequency by (omega T)^2 / 12.

    A relative change of frequency changes a response of second order by less than twice that.
    """
    angle = 2.0 * np.pi * frequency / RATE
    return angle**4 / 384.0 + (2.0 * (angle / 8.0) ** 2 / 12.0 if bandwidth else 0.0) + 1e-9


@pytest.mark.parametrize("frequency", [0.5, 2.0, 10.0, 20.0, 40.0])
@pytest.mark.parametrize(("bandwidth", "averaged"), [(20.0, False), (0.0, True), (20.0, True), (8.0, True)])
def test_a_sine_is_damped_and_delayed(frequency, bandwidth, averaged):
    expected = (butterworth(frequency, bandwidth) if bandwidth else 1.0) * (
        moving_average(frequency) if averaged else 1.0
    )
    found = response(frequency, bandwidth, averaged=averaged)
    assert abs(found - expected) < response_tolerance(frequency, bandwidth)
    # the test would see the delay, or the damping, left out
    assert abs(expected - 1.0) > 3.0 * response_tolerance(frequency, bandwidth)


@pytest.mark.parametrize(("bandwidth", "averaged"), [(20.0, False), (0.0, True), (20.0, True)])
def test_group_delay_of_slow_signals(bandwidth, averaged):
    """A ramp comes late by sqrt(2) / omega_c and half a sample; the bilinear rule is exact for it."""
    t = np.arange(800) / RATE
    out = filtered(np.column_stack([t, -2.0 * t, 0.0 * t]), RATE, bandwidth, averaged=averaged)
    delay = (np.sqrt(2.0) / (2.0 * np.pi * bandwidth) if bandwidth else 0.0) + (0.5 / RATE if averaged else 0.0)
    np.testing.assert_allclose(out[400:, 0], t[400:] - delay, rtol=0, atol=1e-9)
    np.testing.assert_allclose(out[400:, 1], -2.0 * (t[400:] - delay), rtol=0, atol=1e-9)


def test_a_steady_reading_stays():
    steady = np.tile([0.3, -9.81, 2.0], (300, 1))
    np.testing.assert_allclose(filtered(steady, RATE, 15.0, averaged=True), steady, rtol=0, atol=1e-10)


def test_unlimited_readings_are_left_alone():
    values = np.random.default_rng(0).normal(size=(50, 3))
    np.testing.assert_array_equal(filtered(values, RATE, 0.0, averaged=False), values)


def test_a_reading_is_the_mean_over_the_sample_before():
    """Exact for a cubic, which the spline reproduces."""
    t = np.arange(60) / RATE
    cubic = np.polynomial.Polynomial([0.3, -2.0, 5.0, -40.0])
    out = filtered(np.tile(cubic(t)[:, None], (1, 3)), RATE, 0.0, averaged=True)
    mean = np.diff(cubic.integ()(t)) * RATE
    np.testing.assert_allclose(out[1:], np.tile(mean[:, None], (1, 3)), rtol=0, atol=1e-12)


# What a grade adds


def run(grade, rates, accelerations, seed=0, **imu):
    rng, imu = np.random.default_rng(seed), Imu(**imu)
    drift = offset_drift(rng.spawn(1)[0], imu, np.arange(len(rates)) / RATE)
    return disturbed(imu, grade, RATE, (rates, accelerations), drift, draw_noise(rng, imu, grade, len(rates), RATE))


def test_readings_end_at_the_range():
    grade = replace(QUIET, gyro_range=2.0, accel_range=30.0)
    values = np.linspace(-50.0, 50.0, 101)[:, None] * np.ones(3)
    w, a = run(grade, values, values)
    np.testing.assert_array_equal(w, np.clip(values, -2.0, 2.0))
    np.testing.assert_array_equal(a, np.clip(values, -30.0, 30.0))


def test_readings_are_rounded_to_steps():
    grade = replace(QUIET, gyro_step=0.01, accel_step=0.004)
    values = np.random.default_rng(1).uniform(-1.0, 1.0, (20_000, 3))
    for readings, step in zip(run(grade, values, values), (0.01, 0.004), strict=True):
        counts = readings / step
        np.testing.assert_allclose(counts, np.round(counts), rtol=0, atol=1e-9)
        error = readings - values
        assert np.abs(error).max() <= step / 2 + 1e-15
        # a uniform variable; its square has the relative deviation sqrt(4 / 5)
        assert np.mean(error**2) == pytest.approx(step**2 / 12, rel=4.0 * np.sqrt(0.8 / error.size))


def test_without_noise_nothing_is_rounded_or_clipped():
    values = np.full((10, 3), 123.456789)
    w, a = run(GRADES["consumer-mems"], values, values, noise=False)
    np.testing.assert_array_equal(w, values)
    np.testing.assert_array_equal(a, values)


@pytest.mark.parametrize("own", [True, False])
def test_gyros_feel_acceleration(own):
    sensitivity = 1e-3
    grade = replace(QUIET, g_sensitivity=sensitivity if own else 7.0)
    imu = Imu() if own else Imu(gyro_g_sensitivity_sd=sensitivity)
    force, sensors = np.random.default_rng(2).normal(0.0, 9.81, (50, 3)), SensorParameters.ideal()
    found = []
    for seed in range(30):
        effects = draw_effects(np.random.default_rng(seed), imu, grade)
        w, a = ideal_readings(np.zeros((50, 3)), np.zeros((50, 3)), force, sensors, effects)
        np.testing.assert_array_equal(a, force)
        G, *_ = np.linalg.lstsq(force, w, rcond=None)
        np.testing.assert_allclose(G.T, -effects.g_sensitivity, rtol=0, atol=1e-14)
        found.append(G)
    assert inside_chi_square(found, sensitivity)
    assert not np.any(draw_effects(np.random.default_rng(0), Imu(noise=False), grade).g_sensitivity)


def test_gyros_feel_the_square_of_acceleration():
    force, sensors = np.random.default_rng(2).normal(0.0, 9.81, (50, 3)), SensorParameters.ideal()
    effects = draw_effects(np.random.default_rng(3), Imu(gyro_g_squared_sd=1e-5), QUIET)
    w, _ = ideal_readings(np.zeros((50, 3)), np.zeros((50, 3)), force, sensors, effects)
    assert np.all(effects.g_squared != 0.0)
    np.testing.assert_allclose(w, -(force**2) @ effects.g_squared.T, rtol=0, atol=1e-14)


def test_readings_follow_the_temperature():
    """(1 + s dT) x + c dT = y, with the mean temperature as the reference."""
    imu = Imu(
        temperature_rise=10.0, warm_up_time=20.0, gyro_temperature_sd=1e-3, gyro_scale_temperature_sd=1e-3,
        accel_temperature_sd=0.1, accel_scale_temperature_sd=1e-4,
    )  # fmt: skip
    effects = draw_effects(np.random.default_rng(1), imu, QUIET)
    t = np.linspace(0.0, 60.0, 50)
    temperature = temperature_of(imu, t)
    np.testing.assert_allclose(temperature[[0, -1]], [25.0, 35.0 - 10.0 * np.exp(-3.0)], rtol=1e-12)
    temperature_difference = temperature - temperature.mean()
    omega, force = np.random.default_rng(2).normal(size=(2, 50, 3))
    w, a = ideal_readings(omega, np.zeros((50, 3)), force, SensorParameters.ideal(), effects, temperature_difference)
    c_w, s_w, c_a, s_a = effects.temperature
    assert np.all(effects.temperature != 0.0)
    np.testing.assert_allclose(w + (c_w + s_w * w) * temperature_difference[:, None], omega, rtol=0, atol=1e-12)
    np.testing.assert_allclose(a + (c_a + s_a * a) * temperature_difference[:, None], force, rtol=0, atol=1e-12)
    assert temperature_of(Imu(), t) is None


def test_offsets_drift_with_temperature():
    n = 500
    w, a = run(
        QUIET, np.ones((n, 3)), np.zeros((n, 3)), noise=False, gyro_temperature_drift=0.2, accel_temperature_drift=-0.7
    )
    ramp = np.arange(n)[:, None] / (n - 1) * np.ones(3)
    np.testing.assert_allclose(w, 1.0 + 0.2 * ramp, rtol=0, atol=1e-14)
    np.testing.assert_allclose(a, -0.7 * ramp, rtol=0, atol=1e-14)


def test_bandwidth_is_the_grades_unless_said_otherwise():
    grade = replace(QUIET, bandwidth=10.0)
    values = np.random.default_rng(3).normal(size=(200, 3)).cumsum(axis=0) / 10.0
    w, a = run(grade, values, 2.0 * values)
    np.testing.assert_array_equal(w, filtered(values, RATE, 10.0, averaged=False))
    np.testing.assert_array_equal(a, filtered(2.0 * values, RATE, 10.0, averaged=False))
    np.testing.assert_array_equal(run(grade, values, values, bandwidth=0.0)[0], values)
    np.testing.assert_array_equal(
        run(grade, values, values, bandwidth=30.0, averaged=True)[0], filtered(values, RATE, 30.0, averaged=True)
    )


# Noise


N = 1 << 18


def test_white_noise():
    """N / sqrt(tau)."""
    clusters = np.array([1, 10, 100, 1000, 4000])
    found = pooled(allan_deviation(noise(np.random.default_rng(0), N, RATE, 0.02, 0.0, 0.0), 1.0 / RATE, clusters))
    expected = 0.02 / np.sqrt(clusters / RATE)
    assert np.all(np.abs(found / expected - 1.0) < relative_tolerance(N, clusters))


def test_random_walk():
    """K sqrt(tau / 3); sums of discrete steps add 1 / (4 m^2) to it."""
    clusters = np.array([10, 100, 1000, 4000])
    found = pooled(allan_deviation(noise(np.random.default_rng(1), N, RATE, 0.0, 0.0, 0.03), 1.0 / RATE, clusters))
    expected = 0.03 * np.sqrt(clusters / RATE / 3.0)
    assert np.all(np.abs(found / expected - 1.0) < relative_tolerance(N, clusters) + 0.25 / clusters**2)


def test_flicker_noise_has_a_flat_allan_deviation():
    """0.664 B at all averaging times, over two decades; and proportional to B."""
    clusters = np.array([30, 100, 300, 1000, 3000])
    values = noise(np.random.default_rng(2), N, RATE, 0.0, 0.5, 0.0)
    found = pooled(allan_deviation(values, 1.0 / RATE, clusters))
    tolerance = relative_tolerance(N, clusters)
    assert np.all(np.abs(found / (np.sqrt(2.0 * np.log(2.0) / np.pi) * 0.5) - 1.0) < tolerance)
    np.testing.assert_allclose(noise(np.random.default_rng(2), N, RATE, 0.0, 1.0, 0.0), 2.0 * values, rtol=1e-12)


def test_noise_of_sensors_is_independent():
    """White noise, steps of the random walk, differences of flicker noise: correlations of 1 / sqrt(n), four times."""
    n = 100_000
    for parameters in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)):
        values = np.diff(noise(np.random.default_rng(3), n, RATE, *parameters), axis=0)[::2]
        correlation = np.corrcoef(values.T)[np.triu_indices(3, 1)]
        assert np.abs(correlation).max() < 4.0 / np.sqrt(n / 2)


def test_no_noise_is_none():
    assert not np.any(noise(np.random.default_rng(0), 100, RATE, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("name", sorted(GRADES))
def test_a_grade_at_rest_shows_its_white_noise(name):
    """Ten minutes at rest, averages over 0.1 to 1 s: N / sqrt(tau).

    Rounding is white too, step^2 / 12. Flicker noise adds (0.664 B)^2; where that is more than 4 % of the
    variance, it is not the white noise that shows.
    """
    grade = GRADES[name]
    cell = Cell.model_validate(
        {
            "seed": 7,
            "seconds": 600.0,
            "motion": {"first_rest": 600.0},
            "imu": {"grade": name},
            "reference": {"interval": 1.0},
        }
    )
    _, recording = simulate(cell, Path("rest"))
    imu = recording.imu
    assert imu.interval == pytest.approx(1.0 / grade.rate, abs=1e-9)
    assert imu.stamps_ns.size == 600 * grade.rate + 1
    for values, density, flicker, step in (
        (imu.rates, grade.gyro_noise_density, grade.gyro_bias_instability, grade.gyro_step),
        (imu.accelerations, grade.accel_noise_density, grade.accel_bias_instability, grade.accel_step),
    ):
        clusters = np.round(np.array([0.1, 0.2, 0.5, 1.0]) * grade.rate).astype(int)
        tau = clusters / grade.rate
        found = pooled(allan_deviation(values, 1.0 / grade.rate, clusters))
        expected = np.sqrt((density**2 + step**2 / 12.0 / grade.rate) / tau + (0.664 * flicker) ** 2)
        white = (0.664 * flicker) ** 2 < 0.04 * expected**2
        assert white.sum() >= 2
        assert np.all(np.abs(found / expected - 1.0)[white] < relative_tolerance(values.shape[0], clusters)[white])


def test_density_does_not_depend_on_the_rate():
    for rate in (100.0, 400.0):
        values = noise(np.random.default_rng(4), 60_000, rate, 0.01, 0.0, 0.0)
        second = allan_deviation(values, 1.0 / rate, np.array([int(rate)]))
        assert pooled(second)[0] == pytest.approx(0.01, rel=float(relative_tolerance(60_000, rate)))


# Allan deviation


def plain_allan_deviation(values, interval, m):
    """Written out: differences of neighbouring means, for every place they can begin."""
    angle = [0.0]
    for value in values:
        angle.append(angle[-1] + value * interval)
    total, count = 0.0, 0
    for k in range(len(values) - 2 * m + 1):
        first = (angle[k + m] - angle[k]) / (m * interval)
        second = (angle[k + 2 * m] - angle[k + m]) / (m * interval)
        total += (second - first) ** 2
        count += 1
    return (total / (2.0 * count)) ** 0.5


def test_allan_deviation_is_the_plain_one():
    values = np.random.default_rng(5).normal(size=(500, 3)).cumsum(axis=0)
    values += [0.0, 10.0, -3.0]
    clusters = np.array([1, 2, 7, 50, 249])
    found = allan_deviation(values, 0.02, clusters)
    for i, m in enumerate(clusters):
        for axis in range(3):
            # sums of 500 values of 20 lose 1e-13 of them
            assert found[i, axis] == pytest.approx(plain_allan_deviation(values[:, axis], 0.02, m), rel=1e-10)


def test_allan_deviation_of_a_ramp():
    """A drift R: R tau / sqrt(2)."""
    ramp = 0.3 * np.arange(1000)[:, None] * 0.01 * np.ones(3)
    found = allan_deviation(ramp, 0.01, np.array([1, 10, 400]))
    np.testing.assert_allclose(found, 0.3 * np.array([[0.01], [0.1], [4.0]]) / np.sqrt(2.0) * np.ones(3), rtol=1e-9)


def test_density_from_third_differences():
    """White noise is seen, through a motion and through shocks.

    The median of n squares of normal variables gives their deviation to 1.17 / sqrt(n); third differences
    overlap (correlations of the squares 0.56, 0.09), which makes 1.17 sqrt(2.31 / n) of it. Shocks touch 0.8 %
    of the differences, and raise the deviation by 0.9 %.
    """
    n = 20_000
    t = np.arange(n) / RATE
    values = noise(np.random.default_rng(6), n, RATE, 2e-3, 0.0, 0.0)
    values += 3.0 * np.sin(2.0 * np.pi * 0.7 * t)[:, None]
    values[::500] += 5.0
    found = high_frequency_density(values, 1.0 / RATE)
    np.testing.assert_allclose(found, 2e-3, rtol=4.0 * 1.17 * np.sqrt(2.31 / n) + 0.009)
