"""What a user may say of single parameters: names, values, deviations, and how a Gaussian follows them."""

import numpy as np
import pytest

from kreisel.errors import SettingsError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.stated_parameters import (
    known_parameters,
    parse_prior,
    parse_value,
    place_of,
    with_marginal,
    with_observed,
)


def test_names_are_paths_of_the_result_file_or_groups():
    assert place_of("gyroscope.cross_coupling[1,2]", 1) == ("gyro_cross_coupling", 5)
    assert place_of("accelerometer.polynomial.3[1]", 3) == ("accel_polynomial", 4)
    assert place_of("timing.offset", 1) == ("time_offset", 0)
    found = known_parameters({"accel_offset": ([1.0, 2.0, 3.0], 0.1), "timing.skew": (0.0, 1e-6)}, 1, "priors")
    assert found == (
        ("accelerometer.offset[0]", 1.0, 0.1), ("accelerometer.offset[1]", 2.0, 0.1),
        ("accelerometer.offset[2]", 3.0, 0.1), ("timing.skew", 0.0, 1e-6),
    )  # fmt: skip
    assert known_parameters(found, 1, "priors") == found


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"gyroscope.offset[3]": (0, 1)}, "those of gyro_offset are gyroscope.offset[0]"),
        ({"gyroscope.bias": (0, 1)}, "unknown parameter 'gyroscope.bias'; give a path of calibration.yaml"),
        ({"gyro_gauss_markov": (0, 1)}, "unknown parameter 'gyro_gauss_markov'"),
        ({"alignment.tilt[0]": (0, 1)}, "unknown parameter 'alignment.tilt[0]'"),
        ({"gyroscope.polynomial.2[0]": (0, 1)}, "needs polynomial_order 2 or more"),
        ({"gyro_polynomial": (0, 1)}, "needs polynomial_order 2 or more"),
        ({"gyro_offset": 3}, "expected (value, standard deviation)"),
        ({"gyro_offset": ([0, 0], 1)}, "has the shape (2,), expected (3,), or one number"),
        ({"gyro_offset": ("x", 1)}, "not an array of numbers"),
        ({"gyro_offset": (0, -1)}, "standard deviation -1.0; expected 1e-12 or more"),
        ({"gyro_offset": (0, float("nan"))}, "standard deviation nan"),
        ({"gyro_offset": (float("inf"), 1)}, "expected -1000 to 1000, in SI"),
        ({"gravity": (981.0, 1)}, "expected 9.7 to 9.9, in SI"),
        ({"gyroscope.cross_coupling[0,0]": (57.3, 1)}, "expected -2 to 2, in SI"),
        (["gyro_offset"], "expected a mapping"),
    ],
)
def test_what_is_wrong_is_named(given, said):
    with pytest.raises(SettingsError) as error:
        CalibrationSettings(priors=given)
    assert said in str(error.value)


def test_texts_are_read():
    assert parse_prior("1e-3 +- 2e-4", "x") == (1e-3, 2e-4)
    assert parse_prior("-1 ± 2", "x") == (-1, 2)
    assert parse_prior("[1, -2, 3] +- [4, 5, 6]", "x") == ([1, -2, 3], [4, 5, 6])
    assert parse_value("true", "x") is None
    for text in ("1", "1 + 2", "+- 2", "1 +-", "a +- b", ""):
        with pytest.raises(SettingsError, match="x = '"):
            parse_prior(text, "x")


def test_a_marginal_is_as_stated_and_the_rest_follows_by_regression():
    rng = np.random.default_rng(1)
    L = rng.normal(size=(5, 5))
    mean, P = rng.normal(size=5), L @ L.T
    index, value, sd = np.array([1, 3]), np.array([0.3, -0.2]), np.array([0.4, 0.0])
    m, Q = with_marginal(mean, P, index, value, sd)
    np.testing.assert_allclose(m[index], value)
    np.testing.assert_allclose(Q[np.ix_(index, index)], np.diag(sd**2), atol=1e-12)
    # samples of the two by their new distribution, all else by the old conditional one
    rest = np.array([0, 2, 4])
    G = P[np.ix_(rest, index)] @ np.linalg.inv(P[np.ix_(index, index)])
    conditional = P[np.ix_(rest, rest)] - G @ P[np.ix_(index, rest)]
    np.testing.assert_allclose(m[rest], mean[rest] + G @ (value - mean[index]))
    np.testing.assert_allclose(Q[np.ix_(rest, rest)], conditional + G @ np.diag(sd**2) @ G.T)
    assert (Q[3] == 0.0).all()


def test_an_observation_is_that_of_a_kalman_filter():
    rng = np.random.default_rng(2)
    L = rng.normal(size=(4, 4))
    mean, P = rng.normal(size=4), L @ L.T
    m, Q = with_observed(mean, P, np.array([2]), np.array([1.0]), np.array([0.5]))
    H = np.eye(4)[[2]]
    information = np.linalg.inv(P) + H.T @ H / 0.25
    np.testing.assert_allclose(Q, np.linalg.inv(information))
    np.testing.assert_allclose(m, Q @ (np.linalg.solve(P, mean) + H.T @ [1.0] / 0.25))
    fixed, zero = with_observed(mean, P, np.array([2]), np.array([1.0]), np.array([0.0]))
    assert fixed[2] == 1.0
    assert (zero[2] == 0.0).all()


def test_settings_keep_single_parameters_apart_from_groups():
    settings = CalibrationSettings(
        fixed={"lever_arms": None, "gyroscope.offset[1]": 1e-3, "timing.skew": 0.0},
        priors={"gyro_asymmetry": (0.0, 1e-4)},
    )
    assert settings.fixed == ("lever_arms",)
    assert ("gyroscope.offset[1]", 1e-3, 0.0) in settings.priors
    assert "gyro_asymmetry" in settings.estimated
    assert settings.skew is True
    assert CalibrationSettings(fixed="gyroscope.offset[1]").priors == (("gyroscope.offset[1]", None, 0.0),)
    with pytest.raises(SettingsError, match="gyro_offset is fixed"):
        CalibrationSettings(fixed="gyro_offset", priors={"gyroscope.offset[0]": (0.0, 1.0)})


def test_what_a_recording_states_counts_where_the_settings_say_nothing():
    settings = CalibrationSettings(fixed={"time_offset": 0.1}, priors={"gyroscope.offset[0]": (1.0, 0.5)})
    merged = settings.with_stated(
        {"time_offset": "0.2", "lever_arms": "true", "timing.skew": "0"},
        {"gyroscope.offset[0]": "2 +- 1", "gyroscope.offset[1]": "3 +- 1"},
    )
    assert dict(merged.fixed_values) == {"time_offset": (0.1,)}
    assert set(merged.fixed) == {"time_offset", "lever_arms"}
    known = {name: (value, sd) for name, value, sd in merged.priors}
    assert known == {"gyroscope.offset[0]": (1.0, 0.5), "gyroscope.offset[1]": (3.0, 1.0), "timing.skew": (0.0, 0.0)}
    for table in ({"foo": "1"}, {"gyroscope.offset[9]": "1"}, {"lever_arms": "1"}, {"lever_arms": "one"}):
        with pytest.raises(SettingsError, match=r"recording\.toml"):
            settings.with_stated(table, {})
    with pytest.raises(SettingsError, match=r"recording\.toml: prior\.gyro_offset = '1'"):
        settings.with_stated({}, {"gyro_offset": "1"})
