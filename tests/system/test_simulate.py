"""Cells in files, and the command that simulates them."""

import json
import subprocess
import sys
import tomllib

import numpy as np
import pytest

import kreisel
from kreisel.errors import RobotError, SettingsError
from kreisel.inertial.noise_figures import GRADES
from kreisel.robot.arm_library import LIBRARY
from kreisel.robot.kinematics import load_arm
from kreisel.robot.program import EXAMPLE
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell, Errors, example, read_cell

from ..felt import FAULTLESS, rests_of, run

UNKNOWN_ARM = (
    f"unknown robot 'kr126'; known are: {', '.join(sorted({*LIBRARY, 'kr125', 'ur10e'}))}; or give a .urdf file"
)

# Cells in files


def test_a_cell_and_its_program_lie_in_threads(tmp_path):
    (tmp_path / "moves.toml").write_text(EXAMPLE, encoding="utf-8")
    file = tmp_path / "cell.toml"
    file.write_text('seconds = 100\n[motion]\nprogram = "moves.toml"\nfirst_rest = 3\n', encoding="utf-8")
    cell = read_cell(file)
    assert (cell.seconds, cell.motion.first_rest) == (100.0, 3.0)
    _, recording = simulate(cell.model_copy(update={"errors": Errors(**FAULTLESS)}), tmp_path / "r")
    # the recording ends where the program does, in its last rest
    assert 3.0 + 1.5 + 2.0 + 1.0 < recording.imu.seconds[-1] < 30.0
    np.testing.assert_allclose(np.degrees(recording.joints.angles[0]), [0, -90, 90, 0, 30, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(recording.reference.positions[-1], [1.5, 0.4, 1.6], rtol=0, atol=1e-9)
    rests = rests_of(recording.joints.angles)
    assert len(rests) == 3
    stop = recording.joints.angles[rests[1]][0]
    np.testing.assert_allclose(np.degrees(stop), [30, -70, 80, 20, 50, 40], rtol=0, atol=1e-9)


def test_the_example_has_every_key():
    content = tomllib.loads(example())
    unset = {line.split("=")[0].lstrip("# ").strip() for line in example().splitlines() if line.startswith("# ")}
    for name, info in Cell.model_fields.items():
        assert name in content
        table = info.annotation
        if isinstance(content[name], dict):
            assert content[name].keys() | unset >= table.model_fields.keys()


@pytest.mark.parametrize(
    ("text", "telling"),
    [
        (
            "second = 10\n",
            "unknown key 'second'; known are: errors, imu, motion, reference, robot, run, seconds, seed, site",
        ),
        (
            "[site]\nlatitude = 4\n",
            "unknown key 'site.latitude'; known are: gravity_anomaly, heading_deg, height_m, latitude_deg, tilt_sd",
        ),
        ("errors = 5\n", "'errors' must be a table: write [errors]"),
        ("seconds = 5\n", "seconds = 5 is not accepted: Input should be greater than or equal to 10"),
        ("seconds = nan\n", "seconds = nan is not accepted"),
        ('[imu]\nrate = "fast"\n', "imu.rate = 'fast' is not accepted"),
        ('[imu]\ngrade = "best"\n', "unknown grade 'best'; known are: consumer-mems, fog, fog-mems, industrial-mems"),
        ("[imu]\nmounting_deg = [1, 2]\n", "imu.mounting_deg"),
        ('[reference]\nmeasures = "speed"\n', "reference.measures = 'speed' is not accepted"),
        ("seconds = \n", "not valid TOML"),
    ],
)
def test_what_is_wrong_with_a_cell_stands_in_one_line(tmp_path, text, telling):
    file = tmp_path / "cell.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError) as caught:
        read_cell(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert telling in str(caught.value)
    assert "\n" not in str(caught.value)


def test_arms_that_are_not_there_are_named():
    for robot, telling in (
        ({"model": "kr126"}, UNKNOWN_ARM),
        ({"tcp": "gripper"}, "unknown frame 'gripper'; known are: base_link"),
    ):
        with pytest.raises(RobotError, match=telling):
            run(12.0, robot=robot)


# The command


def command(*arguments):
    line = [sys.executable, "-m", "kreisel.cli.main", "simulate", *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, check=False, timeout=120)


def test_printed_examples():
    done = command("--example")
    assert (done.returncode, done.stderr) == (0, "")
    assert Cell.model_validate(tomllib.loads(done.stdout)) == Cell()
    done = command("--example-program")
    assert (done.returncode, done.stderr, done.stdout) == (0, "", EXAMPLE)


def test_a_simulated_folder_is_a_recording(tmp_path):
    cell, out = tmp_path / "cell.toml", tmp_path / "out"
    cell.write_text('seconds = 20\n[imu]\ngrade = "fog"\n', encoding="utf-8")
    done = command(cell, "-o", out, "--seed", 9, "--seconds", 12)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"{out}: 12 s, 4801 IMU samples, ")
    assert f"kreisel calibrate {out} -o OUT" in done.stdout
    truth, recording = simulate(Cell.model_validate({"seed": 9, "seconds": 12, "imu": {"grade": "fog"}}), out)
    loaded = kreisel.load(out)
    np.testing.assert_array_equal(loaded.imu.rates, recording.imu.rates)
    np.testing.assert_array_equal(loaded.reference.positions, recording.reference.positions)
    np.testing.assert_array_equal(loaded.joints.angles, recording.joints.angles)
    assert loaded.urdf == load_arm("kr125").urdf
    assert loaded.settings == recording.settings
    written = json.loads((out / "truth.json").read_text(encoding="utf-8"))
    np.testing.assert_array_equal(written["accelerometer"]["lever_arms"], truth.sensors.lever_arms)
    np.testing.assert_array_equal(written["robot"]["placement_error"], truth.arm.placement)
    assert written["time_offset"] == truth.time_offset
    # a second time: nothing is overwritten
    again = command(cell, "-o", out)
    assert again.returncode == 1
    assert "not empty" in again.stderr


@pytest.mark.parametrize(
    ("cell", "telling"),
    [
        (
            "[motion]\nspeed = 1\n",
            "unknown key 'motion.speed'; known are: first_rest, joints, kind, program, range_share, rest",
        ),
        ('[imu]\ngrade = "best"\n', f"unknown grade 'best'; known are: {', '.join(sorted(GRADES))}"),
        ('[motion]\nprogram = "moves.toml"\n', "move 1: out of reach: the arm comes no nearer than"),
        ('[robot]\nmodel = "kr126"\n', UNKNOWN_ARM),
    ],
)
def test_failures_are_one_line_and_status_one(tmp_path, cell, telling):
    (tmp_path / "moves.toml").write_text("[[move]]\nposition = [5, 0, 1]\nabc_deg = [0, 0, 0]\n", encoding="utf-8")
    file = tmp_path / "cell.toml"
    file.write_text(cell, encoding="utf-8")
    done = command(file, "-o", tmp_path / "out")
    assert done.returncode == 1
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert telling in done.stderr


def test_where_to_write_must_be_said():
    done = command()
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "-o RECORDING" in done.stderr
    assert command("--no-such-option").returncode == 2


def test_an_mcap_file_may_be_asked_for(tmp_path):
    done = command("-o", tmp_path / "x.mcap", "--seconds", 12)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "x.truth.json").is_file()
    assert kreisel.load(tmp_path / "x.mcap").imu.stamps_ns.size > 2000
