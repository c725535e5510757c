"""A column with the sensor's temperature: read, converted, refused, written and corrected by."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.errors import RecordingError, SettingsError
from kreisel.formats.loading import load
from kreisel.formats.write import write
from kreisel.model.calibration_settings import CalibrationSettings

from ...small_problem import recorded


def written(tmp_path, header, values):
    recording = recorded()[1]
    folder = tmp_path / "run"
    write(replace(recording, imu=replace(recording.imu, temperature=values)), folder)
    file = folder / "imu0" / "data.csv"
    text = file.read_text()
    first = text.index("\n")
    assert text[:first].endswith(",temperature [degC]")
    file.write_text(text[:first].replace(",temperature [degC]", f",{header}") + text[first:])
    return folder


@pytest.mark.parametrize(
    ("header", "shift"), [("temperature [degC]", 0.0), ("temp", 0.0), ("imu_temp [K]", 273.15), ("Temp_C [°C]", 0.0)]
)
def test_it_is_read_in_degrees_celsius(tmp_path, header, shift):
    n = recorded()[1].imu.stamps_ns.size
    values = 20.0 + np.linspace(0.0, 5.0, n)
    imu = load(written(tmp_path, header, values + shift)).imu
    np.testing.assert_allclose(imu.temperature, values, rtol=0, atol=1e-9)
    assert imu.usual_temperature == pytest.approx(22.5)
    assert abs(imu.temperature_difference.mean()) < 1e-9


@pytest.mark.parametrize(("header", "value"), [("temp [F]", 70.0), ("temp", 300.0)])
def test_one_that_makes_no_sense_is_refused(tmp_path, header, value):
    n = recorded()[1].imu.stamps_ns.size
    values = np.full(n, 20.0)
    values[n // 2] = value
    with pytest.raises(RecordingError, match=r"data\.csv.*(temp|F\])"):
        load(written(tmp_path, header, values))


def test_one_that_is_rarely_recorded_is_interpolated(tmp_path):
    n = recorded()[1].imu.stamps_ns.size
    values = 20.0 + np.linspace(0.0, 5.0, n)
    rare = np.where(np.arange(n) % 100 == 0, values, np.nan)
    rare[-1] = values[-1]
    recording = load(written(tmp_path, "temp", rare))
    np.testing.assert_allclose(recording.imu.temperature, values, rtol=0, atol=1e-9)
    assert any("temperatures are missing; interpolated" in str(warning) for warning in recording.warnings)


def test_other_columns_are_not_temperatures(tmp_path):
    n = recorded()[1].imu.stamps_ns.size
    assert load(written(tmp_path, "pressure", np.full(n, 1e5))).imu.temperature is None


def test_coefficients_of_a_temperature_that_was_not_recorded_are_refused():
    with pytest.raises(SettingsError, match="gyro_temperature cannot be estimated: the recording has no temperature"):
        run_calibration(recorded()[1], CalibrationSettings(estimated=("gyro_temperature",)))
