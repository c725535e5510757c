"""Groups that are not estimated, and values they are held at."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.injection import inject
from kreisel.errors import SettingsError
from kreisel.model.calibration_settings import CalibrationSettings

from ...small_cell import simulate

ARMS = [[0.01, 0.02, 0.03], [0.04, 0.05, 0.06], [0.07, 0.08, 0.09]]


def test_names_alone_have_no_values() -> None:
    for given in (("lever_arms",), ["lever_arms"], {"lever_arms"}, "lever_arms", {"lever_arms": None}):
        settings = CalibrationSettings(fixed=given)
        assert settings.fixed == ("lever_arms",)
        assert settings.value_of("lever_arms") is None
    assert CalibrationSettings(estimated="robot_gears").estimated == ("robot_gears",)


def test_a_mapping_gives_values() -> None:
    settings = CalibrationSettings(fixed={"lever_arms": ARMS, "gravity": 9.81, "time_skew": None})
    assert settings.fixed == ("lever_arms", "gravity", "time_skew")
    np.testing.assert_array_equal(settings.value_of("lever_arms"), np.ravel(ARMS))
    np.testing.assert_array_equal(settings.value_of("gravity"), 9.81)
    assert settings.value_of("time_skew") is settings.value_of("gyro_offset") is None
    assert hash(settings) == hash(
        CalibrationSettings(fixed={"lever_arms": np.array(ARMS), "gravity": 9.81, "time_skew": None})
    )
    again = replace(settings, sigma_points="unscented")
    assert again.fixed_values == settings.fixed_values
    assert replace(settings, fixed=("gravity",)).fixed_values == (("gravity", (9.81,)),)
    assert CalibrationSettings(**asdict(settings)) == settings


@pytest.mark.parametrize(
    ("fixed", "said"),
    [
        ("lever_arm", "unknown group 'lever_arm'; known are: "),
        ({"lever_arm": ARMS}, "unknown group 'lever_arm'"),
        (3, "fixed = 3; expected names of groups"),
        ({"lever_arms": ARMS[0]}, "fixed['lever_arms'] has the shape (3,), expected (3, 3)"),
        ({"lever_arms": [[1.0], [1.0, 2.0]]}, "fixed['lever_arms'] is not an array of numbers"),
        ({"gyro_offset": [0.0, np.nan, 0.0]}, "fixed['gyro_offset'] = [0.0, nan, 0.0]; expected finite numbers"),
        ({"gyro_polynomial": [[0.0] * 3]}, "polynomial_order must be 2 or more"),
        ({"gravity": 981.0}, "fixed['gravity'] = 981.0; expected 9.7 to 9.9, in SI"),
        ({"gravity": [0.0, 0.0, 9.81]}, "fixed['gravity'] has the shape (3,), expected ()"),
        ({"time_skew": 1.0}, "fixed['time_skew'] = 1.0; expected -0.02 to 0.02"),
        ({"accel_cross_coupling": 57.3 * np.eye(3)}, "fixed['accel_cross_coupling'] scales readings by 57.3"),
        ({"alignment": [0.0, 0.0]}, "fixed['alignment'] cannot be given a value; fix it without one"),
        ({"robot_placement": np.zeros((7, 6))}, "fixed['robot_placement'] cannot be given a value"),
    ],
)
def test_what_makes_no_sense_is_refused(fixed: Any, said: str) -> None:
    with pytest.raises(SettingsError) as error:
        CalibrationSettings(fixed=fixed)
    assert said in str(error.value)


def test_values_are_held_and_stated_exactly() -> None:
    """Another than the true ones, so that nothing but the setting can have given them."""
    truth, recording = simulate(np.random.default_rng(5), 40.0, Path("small"), imu_rate=100.0)
    s = truth.sensors
    fixed = {
        "lever_arms": s.lever_arms + 1e-4,
        "accel_cross_coupling": s.K_a + 1e-5,
        "gyro_offset": s.k_w[0] + 1e-6,
        "time_offset": truth.time_offset + 1e-5,
        "time_skew": 2e-6,
    }
    outcome = run_calibration(recording, CalibrationSettings(fixed=fixed))
    document = outcome.calibration.document
    sd = document["standard_deviation"]
    for (sensor, key), group in {
        ("accelerometer", "lever_arms"): "lever_arms", ("accelerometer", "cross_coupling"): "accel_cross_coupling",
        ("gyroscope", "offset"): "gyro_offset",
    }.items():  # fmt: skip
        np.testing.assert_array_equal(document[sensor][key], fixed[group])
        np.testing.assert_array_equal(sd[sensor][key], 0.0)
    assert document["timing"] == {"offset": pytest.approx(fixed["time_offset"], abs=1e-12), "skew": 2e-6}
    assert sd["timing"]["offset"] == 0.0
    assert not any(name.startswith(("accelerometer.lever", "gyroscope.offset")) for name in outcome.calibration.names)
    assert np.all(np.array(sd["gyroscope"]["cross_coupling"]) > 0.0)
    error = np.array(document["gyroscope"]["cross_coupling"]) - s.K_omega
    assert np.abs(error / np.array(sd["gyroscope"]["cross_coupling"])).max() < 5.0
    injection = inject(outcome)
    assert np.abs((injection.found - injection.injected) / injection.deviation).max() < 2.0


def test_cubes_are_estimated_once():
    with pytest.raises(SettingsError, match="gyro_cubic is a part of the polynomials of order 3"):
        CalibrationSettings(polynomial_order=3, estimated=("gyro_cubic",))
    assert CalibrationSettings(polynomial_order=2, estimated=("gyro_cubic",)).estimated == ("gyro_cubic",)
    CalibrationSettings(polynomial_order=3, estimated=("gyro_cubic",), fixed=("gyro_polynomial",))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"polynomial_order": "2"}, "polynomial_order = '2'; expected a whole number"),
        ({"polynomial_order": 2.0}, "polynomial_order = 2.0; expected a whole number"),
        ({"polynomial_order": True}, "polynomial_order = True; expected a whole number"),
        ({"passes": 2.5}, "passes = 2.5; expected a whole number"),
        ({"update_interval": "0.1"}, "update_interval = '0.1'; expected a number"),
        ({"skew": "no"}, "skew = 'no'; expected True, False or None"),
        ({"estimator": "ekf", "sigma_points": "unscented"}, "are for the estimator spkf, and ekf has its own"),
    ],
)
def test_values_of_another_type_are_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingsError) as error:
        CalibrationSettings(**given)
    assert said in str(error.value)


def test_numbers_of_numpy_are_numbers() -> None:
    settings = CalibrationSettings(polynomial_order=np.int64(2), update_interval=np.float32(0.5), passes=np.int32(3))
    assert (settings.polynomial_order, settings.update_interval, settings.passes) == (2, 0.5, 3)
