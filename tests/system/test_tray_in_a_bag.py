"""Several IMUs in one MCAP file or ROS bag: calibrated as a tray, fused, located, listed, converted."""

import json
import subprocess
import sys

import numpy as np
import pytest

from kreisel.formats.imus import imus_in
from kreisel.formats.write import write
from kreisel.recording.recording import Recording

from ..moving_tray import Motion, devices, write_result
from ..unit.formats.test_bag import imu_messages, write_bag


def run(*arguments):
    command = [sys.executable, "-m", "kreisel.cli.main", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)


CELL = """
seed = 4
seconds = 60

[imu]
grade = "industrial-mems"

[tray]
units = 3
clock_offset = 1.0
"""


@pytest.mark.slow
def test_a_tray_in_an_mcap_file_is_calibrated_as_that_in_a_folder(tmp_path):
    (tmp_path / "CELL.toml").write_text(CELL)
    folder, file = tmp_path / "recording", tmp_path / "recording.mcap"
    assert run("simulate", tmp_path / "CELL.toml", "-o", folder).returncode == 0
    with (folder / "recording.toml").open("a") as toml:
        toml.write('\n[device2]\nserial_number = "0042"\n')
    done = run("convert", folder, file)
    assert done.stdout == f"written: {file}, 3 IMUs\n", done.stderr
    found = {}
    for path in (folder, file):
        done = run("calibrate", path, "--json")
        assert done.returncode == 0, done.stderr
        found[path] = json.loads(done.stdout)
    assert list(found[file]["imus"]) == ["imu0", "imu1", "imu2"]
    assert found[file]["imus"]["imu2"]["recording"]["device"] == {"serial_number": "0042"}
    assert "device" not in found[file]["imus"]["imu1"]["recording"]
    for name in ("imu1", "imu2"):
        one, same = (found[path]["array"]["imus"][name] for path in (file, folder))
        np.testing.assert_allclose(one["position"], same["position"], atol=1e-9)
    for name in ("gyroscope", "accelerometer"):
        offsets = [found[path]["imus"]["imu2"][name]["offset"] for path in found]
        np.testing.assert_allclose(*offsets, atol=1e-9)


@pytest.fixture(scope="module")
def tray(tmp_path_factory):
    """Return a folder with a result of three units and an MCAP file with their readings."""
    folder = tmp_path_factory.mktemp("tray")
    units = devices(3)
    write_result(folder / "result", units)
    imus = {unit.name: unit.record(Motion(), 40.0) for unit in units}
    write(Recording(folder, imus.pop("imu0"), None), folder / "run.mcap", imus)
    return folder


def test_units_of_an_mcap_file_are_fused_and_listed(tray, tmp_path):
    done = run("apply", tray / "result", tray / "run.mcap", "--fuse", "-o", tmp_path / "fused.csv", "--json")
    assert done.returncode == 0, done.stderr
    assert list(json.loads(done.stdout)["imus"]) == ["imu0", "imu1", "imu2"]
    done = run("info", tray / "run.mcap", "--json")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert [facts[f"imu{k}"]["samples"] for k in range(3)] == [8000, 8000, 8000]


def test_a_cut_file_still_has_its_units(tray, tmp_path):
    cut = tmp_path / "cut.mcap"
    whole = (tray / "run.mcap").read_bytes()
    cut.write_bytes(whole[: len(whole) * 9 // 10])
    done = run("apply", tray / "result", cut, "--fuse", "-o", tmp_path / "fused.csv", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert list(said["imus"]) == ["imu0", "imu1", "imu2"]
    assert "imu2: cut.mcap: it is cut or damaged" in " ".join(said["warnings"])


def test_topics_of_others_are_taken_if_all_are_asked_for(tmp_path):
    path = write_bag(tmp_path, "ros1", imu_messages("/a/imu", n=600) + imu_messages("/b/imu", n=600))
    done = run("array", path)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.endswith("or take them all, as units of one rigid tray or array, with --imu all\n")
    done = run("info", path, "--imu", "all", "--json")
    assert done.returncode == 0, done.stderr
    assert set(json.loads(done.stdout)) == {"imu0", "imu1", "findings"}
    done = run("convert", path, tmp_path / "new.mcap", "--imu", "all")
    assert done.stdout.endswith("new.mcap, 2 IMUs\n")
    assert imus_in(tmp_path / "new.mcap") == ("imu0", "imu1")
    done = run("static", path, "--imu", "all")
    assert done.returncode == 1
    assert "--imu all is for calibrate, array, convert, info and apply --fuse" in done.stderr


def test_an_array_of_topics_needs_more_than_one(tmp_path):
    path = write_bag(tmp_path, "mcap", imu_messages("/a/imu", n=1200))
    done = run("array", path)
    assert done.returncode == 1
    assert "has one IMU" in done.stderr
    done = run("calibrate", path, "--imu", "all")
    assert done.returncode == 1
    assert "holds one IMU, expected several; leave out --imu all" in done.stderr
