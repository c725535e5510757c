"""Recordings in many attitudes with published coefficients: OpenAXES (two accelerometers) and an MPU-9150.

Webering et al. (OpenAXES) and Mikov et al. (ICINS 2020); READMEs beside the data. Both are by the method of Tedaldi,
Pretto and Menegatti (2014), which takes offsets to be constant.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.device_axes import upper_triangular
from kreisel.formats.loading import load
from kreisel.preparation.gravity import site_of
from kreisel.static.plain_method import plain_values
from kreisel.static.rest_problem import RestProblem, raw_of
from kreisel.static.rest_search import find_rests
from kreisel.static.static_result import calibrate_static
from kreisel.validation.checks import check_streams

from ..conftest import DATA

FOLDER = DATA / "static"
GRAVITY = 9.81744
"""m/s^2, as the authors of OpenAXES state."""

ADXL355 = np.array([[0.96276, 0.0015751, -0.00018891], [0.0, 0.96732, 0.000859], [0.0, 0.0, 0.97079]])
ADXL355_OFFSET = np.array([0.064447, 0.011034, 0.034253])
BMI160 = np.array([[0.95418, 0.0031573, 0.009235], [0.0, 0.96061, 0.00049713], [0.0, 0.0, 0.9501]])
BMI160_OFFSET = np.array([-0.033224, 0.080497, 0.01579])
GYRO = np.array([
    [0.97288, -0.011829, 0.010087], [0.0076747, 1.0062, 0.00029571], [-0.0063582, -0.00033403, 1.0068]
])  # fmt: skip

pytestmark = pytest.mark.recordings


def read(name):
    folder = FOLDER / name
    if not folder.is_dir():
        pytest.skip(f"no recording at {folder}; set KREISEL_DATA to the folder that holds static/")
    return check_streams(load(Path(folder)))


def test_constant_offsets_give_the_published_accelerometers():
    """They are M a - b here: the offset of equation (2) is -M^-1 b."""
    for name, M, b in (("bmi160", BMI160, BMI160_OFFSET), ("adxl355", ADXL355, ADXL355_OFFSET)):
        found = calibrate_static(read(f"openaxes_38_poses/{name}"), gravity=GRAVITY, constant_offsets=True)
        sensors = found.calibration.sensors
        np.testing.assert_allclose(np.diag(sensors.K_a), np.diag(M), atol=1e-4)
        np.testing.assert_allclose(sensors.k_a[0], -np.linalg.solve(M, b), atol=1.5e-3)


@pytest.mark.slow
def test_walking_offsets_are_confirmed_by_the_accelerometer_beside_it():
    """The BMI160's readings as a linear function of the forces by the ADXL355, and of time: no standstill's length.

    Constant offsets, as published, are wrong by up to 7e-4 in the diagonal: those of y drift by 30 mm/s^2.
    """
    beside, own = read("openaxes_38_poses/adxl355"), read("openaxes_38_poses/bmi160")
    rests = find_rests(own.imu)
    forces = np.array(
        [beside.imu.accelerations[a:b].mean(axis=0) for a, b in zip(rests.first, rests.last, strict=True)]
    )
    true = forces @ ADXL355.T - ADXL355_OFFSET
    time = (rests.seconds - rests.seconds.mean()) / 100.0
    columns = np.column_stack([true, np.ones(len(true)), time])
    slopes, _, _, _ = np.linalg.lstsq(columns, rests.forces, rcond=None)
    _, reference = upper_triangular(np.linalg.inv(slopes[:3].T))
    found = calibrate_static(own, gravity=GRAVITY)
    assert np.abs(np.diag(BMI160) - np.diag(reference)).max() > 5e-4
    difference = np.diag(found.calibration.sensors.K_a) - np.diag(reference)
    assert np.abs(difference).max() < 2.5e-4
    assert np.all(np.abs(difference) < 3.0 * np.diag(found.calibration.sensor_sd.K_a))


def test_the_published_gyro_matrix_lies_within_the_deviations():
    found = calibrate_static(read("openaxes_38_poses/bmi160"), gravity=GRAVITY)
    score = (found.calibration.sensors.K_omega - GYRO) / found.calibration.sensor_sd.K_omega
    assert np.sqrt(np.mean(score**2)) < 1.5
    assert np.abs(score).max() < 3.0


def test_the_published_method_gives_the_published_values():
    """Gyro offsets of the first standstill, and equal weights: the authors' turns are 10 mrad off, rms."""
    recording = read("openaxes_38_poses/bmi160")
    site = site_of(recording.settings.site.model_copy(update={"gravity": GRAVITY}))[0]
    found = plain_values(RestProblem(recording.imu, raw_of(recording.imu), find_rests(recording.imu), site))
    np.testing.assert_allclose(found.K_omega, GYRO, atol=3e-4)
    np.testing.assert_allclose(np.diag(found.K_a), np.diag(BMI160), atol=1e-4)
    np.testing.assert_allclose(found.k_a[0], -np.linalg.solve(BMI160, BMI160_OFFSET), atol=1.5e-3)


def test_an_mpu_9150_turned_by_hand():
    found = calibrate_static(read("mpu9150_hand_held"))
    assert found.calibration.accepted
    derived = found.calibration.derived
    np.testing.assert_allclose(derived["accel_bias_mg"].value * 9.80665e-3, [0.103, 0.097, 0.344], atol=5e-3)
    np.testing.assert_allclose(derived["accel_scale_error_ppm"].value, [3630.0, 3150.0, 6470.0], atol=1500.0)
    np.testing.assert_allclose(derived["gyro_bias_deg_h"].value / 3600.0, [1.146, -0.401, 1.261], atol=0.04)
    score = (derived["gyro_scale_error_ppm"].value - [410.0, 4570.0, 8260.0]) / derived[
        "gyro_scale_error_ppm"
    ].deviation
    assert np.abs(score).max() < 3.0


@pytest.mark.parametrize(
    "name",
    [
        "sim_turned_drifting_120s",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("sim_fog_mems_300s", "sim_inaccurate_robot_300s")),
    ],
)
def test_recordings_of_another_simulator_without_their_poses(recordings, name):
    """A robot moved these devices; the truth is known, and the standstills between the moves suffice."""
    truth = json.loads((recordings / name / "truth.json").read_text())
    found = calibrate_static(check_streams(load(recordings / name)))
    assert found.calibration.accepted
    real = [np.array(truth[sensor]["cross_coupling"]) for sensor in ("gyroscope", "accelerometer")]
    C, T = upper_triangular(real[1])
    own, sd = found.calibration.sensors, found.calibration.sensor_sd
    upper = np.triu_indices(3)
    scores = np.concatenate(
        [
            ((own.K_omega - C.T @ real[0]) / sd.K_omega).ravel(),
            (own.K_a - T)[upper] / sd.K_a[upper],
            (own.k_w[0] - truth["gyroscope"]["offset"]) / sd.k_w[0],
            (own.k_a[0] - truth["accelerometer"]["offset"]) / sd.k_a[0],
        ]
    )
    assert np.abs(scores).max() < 3.5
    assert 0.5 < np.sqrt(np.mean(scores**2)) < 1.4
    assert max(sd.K_omega.max(), sd.K_a.max()) < 2e-4
