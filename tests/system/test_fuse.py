"""`kreisel apply --fuse` as users run it: the fused table, what is printed of it, and units that are left out."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from kreisel.application.fused_files import fuse_files
from kreisel.array.array_file import load_array
from kreisel.calibration.result_sections import Verdict
from kreisel.errors import KreiselError, RecordingError, SettingsError
from kreisel.formats.write import write_imu_table

from ..moving_tray import NOISE, START_NS, Motion, devices, write_result

SECONDS = 60.0
MOTION = Motion()


def run(*arguments):
    command = [sys.executable, "-m", "kreisel.cli.main", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)


@pytest.fixture(scope="module")
def tray(tmp_path_factory):
    """Return the result folder of four units, the last one rejected, and a recording of all of them."""
    folder = tmp_path_factory.mktemp("tray")
    units = list(devices())
    verdict = Verdict(False, ("it turned on its mount",))
    units[3] = replace(units[3], calibration=replace(units[3].calibration, verdict=verdict))
    for unit in units:
        imu = unit.record(MOTION, SECONDS)
        (folder / "recording" / unit.name).mkdir(parents=True)
        write_imu_table(
            folder / "recording" / unit.name / "data.csv", imu.stamps_ns, imu.rates, imu.accelerations
        )  # fmt: skip
    write_result(folder / "result", units, {"imu7": "did not turn"})
    return folder


def table(path):
    return np.loadtxt(path, delimiter=",", skiprows=1)


def density(x):
    n = len(x) // 100 * 100
    return float(np.sqrt(0.5 * np.mean(x[:n].reshape(-1, 100, 3).mean(axis=1) ** 2)))


def test_the_fused_table_is_that_of_the_body_with_less_noise(tray, tmp_path):
    done = run("apply", tray / "result", tray / "recording", "--fuse", "-o", tmp_path / "fused.csv", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    rows = table(tmp_path / "fused.csv")
    omega, _, f = MOTION.at((rows[:, 0] - START_NS) * 1e-9)
    best = np.sum(NOISE[:3] ** -2.0, axis=0) ** -0.5
    assert density(rows[:, 1:4] - omega) == pytest.approx(best[0], rel=0.12)
    assert density(rows[:, 4:] - f) == pytest.approx(best[1], rel=0.12)
    assert list(said["imus"]) == ["imu0", "imu1", "imu2"]
    for k, sensor in enumerate(("gyro", "accel")):
        assert said["fused"]["predicted"][sensor] == pytest.approx(best[k], rel=0.1)
        assert said["fused"]["noise_density"][sensor] == pytest.approx(best[k], rel=0.15)
    assert said["left_out"]["imu7"] == "did not turn"
    assert "it turned on its mount" in said["left_out"]["imu3"]
    assert said["samples"] == len(rows)
    head, first = (tmp_path / "fused.csv").read_text().splitlines()[:2]
    one = run("apply", tray / "result" / "imu0", tray / "recording", "-o", tmp_path / "one.csv")
    assert one.returncode == 0, one.stderr
    assert (tmp_path / "one.csv").read_text().splitlines()[0] == head
    assert first.startswith(f"{START_NS},")


def test_weights_noise_and_what_is_left_out_are_printed(tray, tmp_path):
    done = run("apply", tray / "result", tray / "recording", "--fuse", "-o", tmp_path / "fused")
    assert done.returncode == 0, done.stderr
    assert len(table(tmp_path / "fused" / "imu0" / "data.csv")) > 10_000
    assert "fused, measured" in done.stdout
    assert "left out: imu3: this calibration was rejected" in done.stdout.replace("\n", " ")
    assert f"written: {tmp_path / 'fused' / 'imu0' / 'data.csv'}" in done.stderr


def test_a_rejected_calibration_is_used_by_force(tray, tmp_path):
    done = fuse_files(load_array(tray / "result"), tray / "recording", tmp_path / "fused.csv", force=True)
    assert [unit.name for unit in done.imu.units] == ["imu0", "imu1", "imu2", "imu3"]


def test_units_that_are_missing_or_cannot_be_read_are_named(tray, tmp_path):
    raw = tmp_path / "raw"
    shutil.copytree(tray / "recording", raw)
    shutil.rmtree(raw / "imu1")
    done = fuse_files(load_array(tray / "result"), raw, tmp_path / "fused.csv")
    assert done.imu.left_out["imu1"] == "not in the recording"
    assert [unit.name for unit in done.imu.units] == ["imu0", "imu2"]
    (raw / "imu0" / "data.csv").write_text("nothing\n")
    with pytest.raises(RecordingError, match=r"1 of the units can be used, expected two or more; .*imu0: .*imu1: not"):
        fuse_files(load_array(tray / "result"), raw, tmp_path / "again.csv")
    assert not (tmp_path / "again.csv").exists()


@pytest.mark.parametrize(
    ("raw", "out", "kind", "said"),
    [
        ("recording", "fused.mcap", SettingsError, "--fuse writes a .csv file, or a folder"),
        ("recording/imu0/data.csv", "fused.csv", SettingsError, "--fuse is for a recording folder"),
        ("none", "fused.csv", RecordingError, "no such file or folder"),
        ("recording", ".", RecordingError, "exists already"),
    ],
)
def test_what_cannot_be_fused_is_refused(tray, tmp_path, raw, out, kind, said):
    with pytest.raises(kind, match=said):
        fuse_files(load_array(tray / "result"), tray / raw, tmp_path / out)
    assert not list(tmp_path.iterdir())


def test_the_result_of_one_unit_is_refused(tray, tmp_path):
    [only] = devices(1)
    write_result(tmp_path / "one", [only])
    with pytest.raises(KreiselError, match="--fuse is for several units"):
        fuse_files(load_array(tmp_path / "one"), tray / "recording", tmp_path / "fused.csv")
    for arguments, said in (
        ((tray / "result" / "imu0", tray / "recording", "--fuse"), "--fuse is for the result of several IMUs"),
        ((tray / "result", tray / "recording"), "give the folder of one in it, or --fuse"),
    ):
        done = run("apply", *arguments, "-o", tmp_path / "fused.csv")
        assert (done.returncode, done.stdout) == (1, "")
        assert said in done.stderr
        assert len(done.stderr.splitlines()) == 1
