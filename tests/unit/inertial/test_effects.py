"""Effects beyond offset and matrix: what they add to the readings, by the letter of their equations."""

import numpy as np
import pytest

from kreisel.inertial.effects import EFFECTS, added, features_of, groups_of, places_of
from kreisel.inertial.strapdown import prepare, raw_readings

T = np.arange(300) / 200.0
W = np.column_stack([np.sin(3.0 * T), np.cos(2.0 * T + 0.5), 0.7 * np.sin(5.0 * T)])
A = np.column_stack([4.0 * np.cos(2.0 * T), 9.8 + 2.0 * np.sin(3.0 * T), 3.0 * np.sin(4.0 * T + 1.0)])
A_SLOPE = np.column_stack([-8.0 * np.sin(2.0 * T), 6.0 * np.cos(3.0 * T), 12.0 * np.cos(4.0 * T + 1.0)])
A_CURVATURE = np.column_stack([-16.0 * np.cos(2.0 * T), -18.0 * np.sin(3.0 * T), -48.0 * np.sin(4.0 * T + 1.0)])
TEMPERATURE_CHANGE = 3.0 * T - 1.0
RAW = raw_readings(T, W, A, temperature_difference=TEMPERATURE_CHANGE)

W_SLOPE = np.column_stack([3.0 * np.cos(3.0 * T), -2.0 * np.sin(2.0 * T + 0.5), 3.5 * np.cos(5.0 * T)])
W_CURVATURE = np.column_stack([-9.0 * np.sin(3.0 * T), -4.0 * np.cos(2.0 * T + 0.5), -17.5 * np.sin(5.0 * T)])

G = np.arange(9.0) - 4.0
B = np.array([1.0, -2.0, 3.0])
WRITTEN_OUT = {
    "gyro_polynomial": (B, B * W**2, 0.0),
    "gyro_g_sensitivity": (G, A @ G.reshape(3, 3).T, 0.0),
    "gyro_g_squared": (G, A**2 @ G.reshape(3, 3).T, 0.0),
    "gyro_asymmetry": (B, B * np.abs(W), 0.0),
    "gyro_cubic": (B, B * W**3, 0.0),
    "gyro_axis_delay": (B, B * W_SLOPE, 0.0),
    "gyro_axis_smoothing": (B, -B * W_CURVATURE, 0.0),
    "gyro_temperature": (B, B * TEMPERATURE_CHANGE[:, None], 0.0),
    "gyro_scale_temperature": (B, B * W * TEMPERATURE_CHANGE[:, None], 0.0),
    "gyro_gauss_markov": (B, B, 0.0),
    "accel_polynomial": (B, 0.0, B * A**2),
    "accel_asymmetry": (B, 0.0, B * np.abs(A)),
    "accel_cubic": (B, 0.0, B * A**3),
    "accel_delay": (np.array([2.0]), 0.0, 2.0 * A_SLOPE),
    "accel_smoothing": (np.array([2.0]), 0.0, -2.0 * A_CURVATURE),
    "accel_axis_delay": (B, 0.0, B * A_SLOPE),
    "accel_axis_smoothing": (B, 0.0, -B * A_CURVATURE),
    "accel_temperature": (B, 0.0, B * TEMPERATURE_CHANGE[:, None]),
    "accel_scale_temperature": (B, 0.0, B * A * TEMPERATURE_CHANGE[:, None]),
    "accel_gauss_markov": (B, 0.0, B),
}


@pytest.mark.parametrize("group", EFFECTS)
def test_each_adds_what_its_equation_says(group):
    """Derivatives over five samples of 5 ms, of w = 5 rad/s at most: (w 5 ms)^4 / 30 relative.

    Twice that for the second, and `_UNCORRELATED` (w 5 ms)^4: together 0.59 times 3.9e-7.
    """
    value, rates, accelerations = WRITTEN_OUT[group]
    found = added(RAW, {group: value})
    for one, want in zip(found, (rates, accelerations), strict=True):
        size = 1.0 + np.abs(want).max()
        np.testing.assert_allclose(one[6:-6], np.broadcast_to(want, W.shape)[6:-6], rtol=0, atol=2.4e-7 * size)


def test_effects_add_up_and_zeros_add_nothing():
    values = {group: value for group, (value, _, _) in WRITTEN_OUT.items()}
    each = [added(RAW, {group: value}) for group, value in values.items()]
    for one, parts in zip(added(RAW, values), zip(*each, strict=True), strict=True):
        np.testing.assert_allclose(one, sum(parts), rtol=1e-13)
    for one in added(RAW, {group: 0.0 * value for group, value in values.items()}):
        assert not one.any()


@pytest.mark.parametrize("sensor", ["gyroscope", "accelerometer"])
def test_features_times_the_parameters_at_their_places_are_what_is_added(sensor):
    sizes = {group: value.size for group, (value, _, _) in WRITTEN_OUT.items()}
    own = np.concatenate([WRITTEN_OUT[group][0] for group in groups_of(sizes, sensor)])
    places = places_of(sizes, sensor)
    by_places = np.where(places < 0, 0.0, own[places])
    found = features_of(RAW, sizes, sensor).T @ by_places
    want = added(RAW, {group: value for group, (value, _, _) in WRITTEN_OUT.items()})[sensor == "accelerometer"]
    np.testing.assert_allclose(found, want, rtol=0, atol=1e-12 * np.abs(want).max())


def test_a_polynomial_has_three_features_for_each_power():
    assert features_of(RAW, {"gyro_polynomial": 6}, "gyroscope").shape == (6, T.size)
    np.testing.assert_allclose(features_of(RAW, {"gyro_polynomial": 6}, "gyroscope")[3:], W.T**3, rtol=1e-14)


def test_derivatives_do_not_reach_across_a_gap():
    """A step of the readings at a gap is no slope on either side of it."""
    late = np.where(np.arange(300) >= 150, 1.0, 0.0)
    stepped = A + 100.0 * late[:, None]
    signal = prepare(T + late, W, stepped, segments=((0, 149), (150, 299)), applied={"accel_delay": np.array([1.0])})
    change = signal.accelerations - stepped
    assert np.abs(change).max() < 1.1 * np.abs(A_SLOPE).max()


@pytest.mark.parametrize("samples", [12, 25])
def test_the_noise_of_curvatures_is_not_that_of_the_integral(samples):
    """White noise of variance one: the covariance of the two integrals between two updates, impulse by impulse."""
    n, first = 100, 40
    t = np.arange(n) / 200.0
    integral, curvature = np.empty(n), np.empty(n)
    for k in range(n):
        impulse = np.zeros((n, 3))
        impulse[k] = 1.0
        raw = raw_readings(t, impulse, impulse)
        # integrals over intervals by the rates' quadrature
        for out, values in ((integral, impulse), (curvature, raw.curvatures("accelerometer"))):
            out[k] = prepare(t, values, values).integrals[first : first + samples, 0].sum()
    correlation = integral @ curvature / np.sqrt((integral @ integral) * (curvature @ curvature))
    assert abs(correlation) < 1e-4
