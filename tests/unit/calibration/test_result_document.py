"""The result file: its published schema, its way there and back, and files of schema 1."""

import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from ruamel.yaml import YAML

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.data_sheet import OF_SCHEMA_1, QUANTITIES
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_document import from_document, to_document
from kreisel.errors import RecordingError, SettingsError
from kreisel.inertial.sensor_model import SizeEffect
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import check_known
from kreisel.simulation.cell import simulate as simulate_cell
from kreisel.simulation.cell_settings import Cell

from ...small_cell import simulate

SCHEMA = json.loads((files("kreisel.calibration") / "result-schema.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module", params=["plain", "order 2", "held", "robot"])
def calibration(request) -> Calibration:
    if request.param == "robot":
        cell = Cell.model_validate({"seed": 3, "seconds": 60.0, "imu": {"rate": 100.0}})
        recording = simulate_cell(cell, Path("robot"))[1]
        return run_calibration(recording, CalibrationSettings(estimated=("robot_gears",))).calibration
    recording = simulate(np.random.default_rng(5), 40.0, Path("small"), imu_rate=100.0)[1]
    settings = {
        "plain": {},
        "order 2": {"polynomial_order": 2},
        "held": {"fixed": {"lever_arms": np.zeros((3, 3)), "gyro_offset": None, "time_skew": 3e-6}},
    }[request.param]
    return run_calibration(recording, CalibrationSettings(**settings)).calibration


def plain(document):
    """Return a document as it comes out of its file."""
    return json.loads(json.dumps(document))


def test_the_file_follows_its_schema(calibration, tmp_path):
    calibration.save(tmp_path)
    written = YAML(typ="safe").load((tmp_path / "calibration.yaml").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    jsonschema.validate(plain(written), SCHEMA)


def test_the_schema_refuses_other_files(calibration):
    document = plain(calibration.document)
    for change in (
        {"schema": "kreisel/calibration/1"},
        {"verdict": {"accepted": "yes", "summary": "", "reasons": [], "unobservable": []}},
        {"timing": {"offset": 1.0}},
        {"anything": 1},
    ):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(document | change, SCHEMA)


def test_there_and_back(calibration, tmp_path):
    calibration.save(tmp_path)
    loaded = Calibration.load(tmp_path)
    assert plain(loaded.document) == plain(calibration.document)
    for name in ("K_omega", "k_w", "K_a", "k_a", "lever_arms"):
        for one, other in ((loaded.sensors, calibration.sensors), (loaded.sensor_sd, calibration.sensor_sd)):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert loaded.verdict == calibration.verdict
    assert loaded.names == calibration.names
    np.testing.assert_allclose(loaded.estimates, calibration.estimates, rtol=1e-6, atol=1e-8)
    assert loaded.robot_urdf == calibration.robot_urdf


def test_the_same_result_keeps_its_report_and_its_history(calibration, tmp_path):
    calibration.save(tmp_path)
    (tmp_path / "report.html").write_text("report")
    before = (tmp_path / "estimates.csv").read_bytes().count(b"\n")
    Calibration.load(tmp_path).save(tmp_path)
    assert (tmp_path / "report.html").read_text() == "report"
    assert (tmp_path / "estimates.csv").read_bytes().count(b"\n") == before > 1
    replace(calibration, size_effect=SizeEffect.FOX2005).save(tmp_path)
    assert not (tmp_path / "report.html").exists()


def test_a_history_of_another_result_is_not_read(calibration, tmp_path):
    calibration.save(tmp_path)
    for text in ("", "time [s]\n1\n2\n", "a\nb\n"):
        (tmp_path / "estimates.csv").write_text(text)
        assert Calibration.load(tmp_path).estimates.shape == (0, 1 + 2 * len(calibration.names))
    np.savez(tmp_path / "covariance.npz", other=np.zeros(3))
    with pytest.raises(RecordingError, match="not the arrays of a result"):
        Calibration.load(tmp_path)


def test_a_file_is_no_folder_for_a_result(calibration, tmp_path):
    (tmp_path / "x").write_text("")
    with pytest.raises(SettingsError, match="is a file; give a folder"):
        calibration.save(tmp_path / "x")


def test_schema_1_is_read(calibration, tmp_path):
    """Names and signs of some derived quantities were others."""
    document = plain(calibration.document) | {"schema": "kreisel/calibration/1"}
    back = {new: (old, sign) for old, (new, sign) in OF_SCHEMA_1.items()}
    for table in (document, document["standard_deviation"]):
        signed = 1.0 if table is document else 0.0
        table["derived"] = {
            back.get(name, (name, 1.0))[0]: [v and v * (back.get(name, ("", 1.0))[1] if signed else 1.0) for v in value]
            for name, value in table["derived"].items()
        }
    assert "offset_mg" in document["derived"]
    (tmp_path / "calibration.yaml").write_text(json.dumps(document), encoding="utf-8")
    loaded = Calibration.load(tmp_path)
    assert plain(loaded.document) == plain(calibration.document)


def test_derived_errors_have_the_sign_of_the_sensor(calibration):
    """A bias is what a sensor reads too much; K and k_0 are corrections."""
    derived, sensors = calibration.derived, calibration.sensors
    np.testing.assert_allclose(derived["accel_bias_mg"].value, -sensors.k_a[0] / 9.80665e-3)
    if "gyro_offset" in calibration.estimator.fixed:  # without a value: nobody measured or stated it
        assert np.isnan([derived["gyro_bias_deg_h"].value, derived["gyro_bias_deg_h"].deviation]).all()
        assert plain(calibration.document)["derived"]["gyro_bias_deg_h"] == [None] * 3
    else:
        np.testing.assert_allclose(derived["gyro_bias_deg_h"].value, -np.degrees(sensors.k_w[0]) * 3600.0)
    np.testing.assert_allclose(
        derived["gyro_scale_error_ppm"].value,
        1e6 * (np.linalg.norm(np.linalg.inv(sensors.K_omega), axis=1) - 1.0),
        atol=1e-6,
    )
    assert list(derived) == [quantity.name for quantity in QUANTITIES]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"verdict": {}}, "accepted"),
        ({"verdict": {"accepted": "yes"}}, "verdict.accepted is 'yes', expected true or false"),
        ({"gyroscope": {"offset": [0, 0, 0]}}, "cross_coupling"),
        ({"accelerometer": {"cross_coupling": [1, 2], "offset": [0, 0, 0]}}, "accelerometer.cross_coupling is [1, 2]"),
        ({"standard_deviation": []}, "standard_deviation is list, expected a mapping"),
        ({"timing": {"offset": "late"}}, "late"),
        ({"recording": {"name": "x"}}, "reference"),
    ],
)
def test_incomplete_files_are_refused(calibration, tmp_path, change, says):
    (tmp_path / "calibration.yaml").write_text(json.dumps(plain(calibration.document) | change), encoding="utf-8")
    with pytest.raises(RecordingError, match="incomplete") as error:
        Calibration.load(tmp_path)
    assert says in str(error.value)


def test_a_file_with_the_parameters_alone_is_enough():
    gyro = {"cross_coupling": np.eye(3).tolist(), "offset": [0, 0, 0]}
    accel = {**gyro, "lever_arms": np.zeros((3, 3)).tolist()}
    parts = from_document({"gyroscope": gyro, "accelerometer": accel, "verdict": {"accepted": True}})
    assert np.isnan(parts.sensor_sd.K_a).all()
    assert to_document(parts)["standard_deviation"]["gyroscope"]["offset"] == [None] * 3


def test_an_entry_of_a_sensor_that_is_not_known_is_refused():
    table = {"cross_coupling": [], "offset": [], "g_sensitivity": []}
    check_known({"gyroscope": table, "accelerometer": {"delay": 0.0}})
    with pytest.raises(ValueError, match=r"accelerometer\.cube is no entry that this version knows"):
        check_known({"gyroscope": table, "accelerometer": {"cube": 0.0}})
