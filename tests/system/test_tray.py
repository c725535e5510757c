"""Several IMUs of one folder: a loose unit, one that does not move with the others, an array moved by hand."""

import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from ruamel.yaml import YAML

from kreisel.array.tray import calibrate_tray
from kreisel.calibration.device_axes import linearised
from kreisel.calibration.result import Calibration
from kreisel.errors import RecordingError
from kreisel.formats.write import write, write_imu
from kreisel.geometry.interpolation import slerp
from kreisel.geometry.rotation import exp, matrix, multiply
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording_settings import read_settings
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import parse_cell

from ..rigid_array import readings_at, recorded, shaken

CELL = """
seed = 4
seconds = 70

[imu]
grade = "industrial-mems"
slip_deg = 0.0573

[tray]
units = 5
slipping = 1
clock_offset = 1.0
clock_drift_ppm = 20.0
turned_deg = [180.0, 0.0, 0.0]
"""


def run(*arguments):
    command = [sys.executable, "-m", "kreisel.cli.main", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)


@pytest.mark.slow
def test_a_tray_with_a_loose_and_a_foreign_unit(tmp_path):
    (tmp_path / "CELL.toml").write_text(CELL)
    recording, out = tmp_path / "recording", tmp_path / "out"
    assert run("simulate", tmp_path / "CELL.toml", "-o", recording).returncode == 0
    rows = (recording / "imu4" / "data.csv").read_text().splitlines()
    backwards = [f"{a.split(',', 1)[0]},{b.split(',', 1)[1]}" for a, b in zip(rows[1:], rows[:0:-1], strict=True)]
    (recording / "imu4" / "data.csv").write_text("\n".join([rows[0], *backwards]) + "\n")
    with (recording / "recording.toml").open("a") as file:
        file.write('\n[device2]\nserial_number = "0042"\n')
    done = run("calibrate", recording, "-o", out, "--json")
    assert done.returncode == 3, done.stderr
    found = json.loads(done.stdout)
    assert list(found["imus"]) == ["imu0", "imu1", "imu2", "imu3"]
    assert "does not turn as imu0 does" in found["left_out"]["imu4"]
    verdicts = {name: one["verdict"] for name, one in found["imus"].items()}
    assert [name for name, one in verdicts.items() if not one["accepted"]] == ["imu1"]
    turned = re.match(r"it turned on its mount by ([0-9.]+) mrad, (\d+) s", verdicts["imu1"]["reasons"][0])
    slip = json.loads((recording / "imu1" / "truth.json").read_text())["slip"]
    assert float(turned[1]) == pytest.approx(1.0, abs=0.1)
    assert float(turned[2]) == pytest.approx(slip["time"], abs=5.0)
    assert found["imus"]["imu2"]["recording"]["device"]["serial_number"] == "0042"
    page = (out / "report.html").read_text()
    assert "0042" in page
    assert "imu4 is not used" in page
    for k in (0, 2, 3):
        truth = json.loads((recording / (f"imu{k}/truth.json" if k else "truth.json")).read_text())
        calibration = Calibration.load(out / f"imu{k}")
        apart = calibration.sensors.K_a - truth["accelerometer"]["cross_coupling"]
        assert np.abs(apart / calibration.sensor_sd.K_a).max() < 4.5
        apart = calibration.sensors.lever_arms - truth["accelerometer"]["lever_arms"]
        assert np.abs(apart / calibration.sensor_sd.lever_arms).max() < 4.5
        timing = calibration.timing
        assert abs(timing.offset - truth["time_offset"]) < 4.5 * timing.offset_sd
    array = YAML(typ="safe").load((out / "array.yaml").read_text())
    frames = [linearised(_true_sensors(recording, name), "imu") for name in ("imu0", "imu2")]
    place = frames[0].rotation.T @ (frames[1].origin - frames[0].origin)
    own = array["imus"]["imu2"]
    assert np.abs((own["position"] - place) / own["standard_deviation"]["position"]).max() < 4.5
    assert np.abs(np.array(own["rotation"]) - frames[0].rotation.T @ frames[1].rotation).max() < 3e-4
    for options in (("--inject",), ("--fix", "gyro_offset"), ("--only", "gyroscope"), ("--size-effect", "fox2005")):
        done = run("calibrate", recording, *options)
        assert done.returncode == 1
        assert done.stderr.count("\n") == 1
        assert "--imu" in done.stderr or "leave out" in done.stderr


@pytest.mark.slow
def test_of_two_units_it_cannot_be_said_which_one_turned(tmp_path):
    imu, tray = {"grade": "industrial-mems", "slip_deg": 0.1}, {"units": 2, "slipping": 1}
    cell = parse_cell({"seed": 6, "seconds": 60.0, "imu": imu, "tray": tray}, tmp_path)
    made = {f"imu{k}": simulate(cell, tmp_path, unit=k)[1] for k in range(2)}
    outcome = calibrate_tray(made.__getitem__, list(made), CalibrationSettings())
    for unit in outcome.units:
        assert not unit.calibration.accepted
        reason = unit.calibration.verdict.reasons[-1]
        turned = re.match(r"it or the other unit turned on its mount, by ([0-9.]+) mrad", reason)
        assert float(turned[1]) == pytest.approx(1.745, abs=0.3)
    assert [unit.share[0] for unit in outcome.units] == pytest.approx([0.5, 0.5], abs=0.02)


@pytest.mark.parametrize("fault", ["lies beside the arm", "never changes"])
def test_the_first_unit_need_not_work(tmp_path, fault):
    """Another one takes its place as the one that all are brought to; the first is named."""
    cell = {"seed": 9, "seconds": 40.0, "imu": {"grade": "industrial-mems", "rate": 100.0}, "tray": {"units": 3}}
    recording = tmp_path / "recording"
    made = [simulate(parse_cell(cell, tmp_path), tmp_path, unit=k)[1] for k in range(3)]
    imu = made[0].imu
    rates, forces = np.zeros_like(imu.rates), np.tile([0.0, 0.0, 9.81], (len(imu.rates), 1))
    if fault == "lies beside the arm":
        rng = np.random.default_rng(0)
        rates += rng.normal(0.0, 1e-3, rates.shape)
        forces += rng.normal(0.0, 1e-2, forces.shape)
    write(replace(made[0], imu=replace(imu, rates=rates, accelerations=forces)), recording)
    for k in (1, 2):
        write_imu(made[k].imu, recording / f"imu{k}")
    done = run("calibrate", recording, "-o", tmp_path / "out", "--json")
    assert done.returncode == 3, done.stderr
    found = json.loads(done.stdout)
    assert list(found["imus"]) == ["imu1", "imu2"]
    assert all(one["verdict"]["accepted"] for one in found["imus"].values())
    said = "does not turn as imu1 does" if fault == "lies beside the arm" else "dead channel"
    assert said in found["left_out"]["imu0"]


def _true_sensors(recording, name):
    truth = json.loads((recording / ("truth.json" if name == "imu0" else f"{name}/truth.json")).read_text())
    a, w = truth["accelerometer"], truth["gyroscope"]
    return SensorParameters(*map(np.array, (
        w["cross_coupling"], [w["offset"]], a["cross_coupling"], [a["offset"]], a["lever_arms"]
    )))  # fmt: skip


@pytest.mark.slow
def test_an_array_that_was_moved_by_hand(tmp_path):
    rng = np.random.default_rng(2)
    places = np.array([[0.0, 0.0, 0.0], [0.04, 0.01, 0.0], [0.0, 0.03, 0.01]])
    t = np.arange(round(130.0 * 100.0)) / 100.0
    position, attitude = _hand(rng)
    axes = [np.eye(3), matrix(exp(np.array([0.0, 0.0, 1.2]))), np.eye(3)]
    for k in range(3):
        rates, _ = readings_at(position, attitude, places[k], axes[k], t)
        # the accelerometers of one are 20 ms late
        _, forces = readings_at(position, attitude, places[k], axes[k], np.maximum(t - 0.02 * (k == 2), 0.0))
        rates = rates + 3e-3 * rng.normal(size=(1, 3)) + 1e-3 * rng.normal(size=rates.shape)
        forces = forces @ (np.eye(3) + 5e-3 * np.diag(rng.normal(size=3))) + 0.01 * rng.normal(size=forces.shape)
        write_imu(recorded(t, rates, forces, tmp_path, start_ns=10**9 * (1 + k)), tmp_path / "array" / f"imu{k}")
    done = run("array", tmp_path / "array", "-o", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["reference"] == "imu0"
    for k in (1, 2):
        own = found["imus"][f"imu{k}"]
        sd = np.array(own["standard_deviation"]["position"])
        assert np.abs((own["position"] - places[k]) / sd).max() < 4.0
        assert sd.max() < 2e-3
        assert np.abs(np.array(own["rotation"]) - axes[k]).max() < 5e-3
        assert own["clock"]["offset"] == pytest.approx(-float(k), abs=2e-4)
    rows = (tmp_path / "array" / "imu0" / "data.csv").read_text().splitlines()
    still = rows[1].split(",", 1)[1]
    frozen = [f"{row.split(',', 1)[0]},{still}" for row in rows[1:]]
    (tmp_path / "array" / "imu0" / "data.csv").write_text("\n".join([rows[0], *frozen]) + "\n")
    done = run("array", tmp_path / "array", "--json")
    assert done.returncode == 0, done.stderr
    without = json.loads(done.stdout)
    assert without["reference"] == "imu1"
    assert without["left_out"]["imu0"] == "does not turn as imu1 does: its rates never change"
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Not observable: the common scale of the gyros" in page
    alone = tmp_path / "alone"
    alone.mkdir()
    (tmp_path / "array" / "imu0").rename(alone / "imu0")
    done = run("array", alone)
    assert done.returncode == 1
    assert "has one IMU" in done.stderr


def _hand(rng):
    """Return position and attitude: twelve rests with turns between them, then shaking."""
    turns = [exp(np.zeros(3))] + [exp(rng.normal(size=3) * 1.5) for _ in range(13)]
    wave, shake = shaken(rng, 30.0, 2.0)
    begin = 7.0 * len(turns)

    def attitude(t):
        number = np.minimum((t // 7.0).astype(int), len(turns) - 2)
        u = np.clip((t - 7.0 * number - 5.0) / 2.0, 0.0, 1.0)
        u = u**4 * (35.0 - 84.0 * u + 70.0 * u**2 - 20.0 * u**3)
        still = slerp(np.array(turns)[number], np.array(turns)[number + 1], u)
        return np.where((t > begin)[:, None], multiply(still, shake(np.maximum(t - begin, 0.0))), still)

    return (lambda t: wave(np.maximum(t - begin, 0.0))), attitude


def test_tables_of_single_imus(tmp_path):
    file = tmp_path / "recording.toml"
    file.write_text('[imu]\ngrade = "fog"\n[imu2]\ngyro_noise_density = 1e-4\n[device2]\nserial_number = "7"\n')
    settings = read_settings(file)
    assert settings.of_imu("imu1").imu.grade == "fog"
    assert settings.of_imu("imu2").imu.grade is None
    assert settings.of_imu("imu2").device.serial_number == "7"
    file.write_text("[imu2]\nspeed = 3\n")
    with pytest.raises(RecordingError, match=r"imu2\.speed"):
        read_settings(file)
