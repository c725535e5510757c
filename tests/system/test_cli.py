"""The command line as a user meets it: files, exit statuses, what goes where."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import kreisel
from kreisel.formats.write import write_folder

from ..small_cell import simulate


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cell") / "recording"
    _, recording = simulate(np.random.default_rng(5), 60.0, folder)
    write_folder(recording, folder)
    return folder


def run(*arguments):
    command = [sys.executable, "-m", "kreisel.cli.main", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)


def test_calibrate_writes_a_result_folder(cell, tmp_path):
    out = tmp_path / "out"
    done = run("calibrate", cell, "-o", out, "--inject")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # progress only to a terminal
    assert "verdict: accepted" in done.stdout
    assert "injected errors" in done.stdout
    assert {p.name for p in out.iterdir()} == {"calibration.yaml", "report.html", "estimates.csv", "covariance.npz"}
    calibration = kreisel.Calibration.load(out)
    assert calibration.accepted
    rows = np.genfromtxt(out / "estimates.csv", delimiter=",", skip_header=1)
    assert rows.shape[1] == 1 + 2 * len(calibration.names)
    with np.load(out / "covariance.npz") as data:
        assert data["covariance"].shape == 2 * (len(calibration.names),)


def test_json_is_one_object_on_standard_output(cell):
    done = run("calibrate", cell, "--json")
    document = json.loads(done.stdout)
    assert document["schema"] == "kreisel/calibration/2"
    parts = "gyroscope accelerometer timing alignment derived consistency verdict formula frames estimator recording"
    assert set(parts.split()) <= document.keys()
    for sensor in ("gyroscope", "accelerometer", "timing", "alignment"):
        assert document["standard_deviation"][sensor].keys() == document[sensor].keys()


def test_ekf_and_fixed_groups(cell):
    fast = json.loads(run("calibrate", cell, "--json", "--estimator", "ekf", "--fix", "lever_arms").stdout)
    assert fast["estimator"]["name"] == "ekf"
    assert np.all(np.array(fast["standard_deviation"]["accelerometer"]["lever_arms"]) == 0.0)


def test_quadratic_terms_are_found_to_be_nothing(cell):
    document = json.loads(run("calibrate", cell, "--json", "--polynomial-order", "2").stdout)
    for sensor in ("gyroscope", "accelerometer"):
        value = np.array(document[sensor]["polynomial"]["2"])
        deviation = np.array(document["standard_deviation"][sensor]["polynomial"]["2"])
        assert np.all(np.abs(value) < 4.0 * deviation)


def test_usage_errors_have_status_two(cell):
    assert run("calibrate").returncode == 2
    assert run("calibrate", cell, "--no-such-option").returncode == 2


@pytest.mark.parametrize(
    ("arguments", "telling"),
    [
        (["--estimator", "magic"], "ekf, spkf"),
        (["--fix", "magic"], "lever_arms"),
        (["--reference", "magic"], "pose0"),
        (["--size-effect", "magic"], "fox2005"),
        (["--polynomial-order", "9"], "1 to 5"),
        (["-o", __file__], "give a folder"),
    ],
)
def test_wrong_choices_list_the_right_ones(cell, arguments, telling):
    done = run("calibrate", cell, *arguments)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert telling in done.stderr
    assert "Traceback" not in done.stderr


def test_info_and_convert(cell, tmp_path):
    facts = json.loads(run("info", cell, "--json").stdout)
    assert facts["imu"]["rate Hz"] == pytest.approx(200.0)
    assert facts["together"]["correlation of rates"] > 0.99
    mcap = tmp_path / "cell.mcap"
    assert run("convert", cell, mcap).returncode == 0
    a, b = kreisel.load(cell), kreisel.load(mcap)
    np.testing.assert_array_equal(a.imu.rates, b.imu.rates)
    # loading makes quaternions unit length once more
    np.testing.assert_allclose(a.reference.quaternions, b.reference.quaternions, rtol=0, atol=1e-15)
    assert Path(mcap).stat().st_size < 4e6
