"""Trays of units in `kreisel batch`: a row, a result folder and a decision for each unit, and pages of the trays."""

import csv
import json
import subprocess
import sys

import pytest

from kreisel.batch.jobs import jobs_in
from kreisel.model.calibration_settings import CalibrationSettings

CELL = """
seed = 8
seconds = 60

[imu]
grade = "industrial-mems"
rate = 100
slip_deg = {slip}

[tray]
units = 3
slipping = 2
clock_offset = 1.0
clock_drift_ppm = 20.0
"""

SETTINGS = """
[certificate]
operator = "{operator}"
date = "{date}"

[device]
type = "cube"
serial_number = "A0"

[device1]
type = "cube"
serial_number = "A1"

[device2]
type = "cube"
"""

pytestmark = pytest.mark.slow


def run(*arguments):
    command = [sys.executable, "-m", "kreisel.cli.main", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)


@pytest.fixture(scope="module")
def lot(tmp_path_factory):
    """Two trays of the same three units; on the first one a unit turned, of the second one a unit cannot be read."""
    folder = tmp_path_factory.mktemp("trays")
    for k, slip in enumerate((0.0573, 0.0)):
        (folder / "CELL.toml").write_text(CELL.format(slip=slip))
        recording = folder / "in" / f"day-{k}" / "tray"
        assert run("simulate", folder / "CELL.toml", "-o", recording, "--run", k).returncode == 0
        with (recording / "recording.toml").open("a") as file:
            file.write(SETTINGS.format(operator="ab"[k], date=f"202{5 + k}-05-01"))
    (recording / "imu2" / "data.csv").write_text("#timestamp [ns],w_x\n")
    (folder / "limits.toml").write_text("[limits]\naccel_bias_mg = 1e3\n")
    done = run("batch", folder / "in", "-o", folder / "out", "--jobs", 2, "--limits", folder / "limits.toml", "--json")
    assert done.returncode == 1, done.stderr
    found = json.loads(done.stdout)
    assert found["units"] == 4  # A0 and A1 were calibrated twice
    assert found["outcomes"] == {"conforms": 2, "rejected": 1, "failed": 1}
    assert found["not_good"] == {"failed": ["day-1/tray/imu2"], "rejected": ["day-0/tray/imu2"]}
    return folder


def test_every_unit_has_a_row_a_document_and_a_folder(lot):
    rows = list(csv.DictReader((lot / "out" / "table.csv").read_text().splitlines()))
    assert [row["recording"] for row in rows] == [f"day-{k}/tray/imu{unit}" for k in range(2) for unit in range(3)]
    assert [row["unit"] for row in rows] == ["A0", "A1", "day-0/tray/imu2", "A0", "A1", "day-1/tray/imu2"]
    results = lot / "out" / "results"
    documents = [json.loads((results / row["recording"] / "unit.json").read_text()) for row in rows]
    assert [one["outcome"] for one in documents] == [row["outcome"] for row in rows]
    assert "turned on its mount" in documents[2]["reasons"][0]
    assert "imu2/data.csv" in documents[5]["reasons"][0]
    for row, document in zip(rows, documents, strict=True):
        folder = results / row["recording"]
        assert (folder / document["report"]).is_file()
        assert (folder / "calibration.yaml").is_file() == (row["outcome"] != "failed")
    page = (lot / "out" / "batch.html").read_text()
    for k in range(2):
        for name in ("report.html", "mean/report.html"):
            assert (results / f"day-{k}" / "tray" / name).is_file()
            assert f'href="results/day-{k}/tray/{name}"' in page


def test_units_are_calibrated_as_by_calibrate(lot):
    recording, out = lot / "in" / "day-0" / "tray", lot / "alone"
    done = run("calibrate", recording, "-o", out, "--no-validate", "--limits", lot / "limits.toml")
    assert done.returncode == 3, done.stderr
    for name in ("array.yaml", "mean/calibration.yaml", "imu1/calibration.yaml", "imu2/calibration.yaml"):
        found, expected = (_content(base / name) for base in (lot / "out" / "results" / "day-0" / "tray", out))
        assert found == expected


def _content(file):
    """Return the lines of a result without the time that its computation took."""
    return [line for line in file.read_text().splitlines() if "seconds:" not in line]


def test_a_tray_is_done_again_as_a_whole(lot):
    options = ("batch", lot / "in", "-o", lot / "out", "--jobs", 1)
    assert run(*options).stdout.startswith("6 of 6 are done already")
    (lot / "out" / "results" / "day-1" / "tray" / "imu1" / "calibration.yaml").unlink()
    again = run(*options)
    assert again.stdout.startswith("3 of 6 are done already")
    assert "4 units: 2 accepted, 1 rejected, 1 failed" in again.stdout
    assert (lot / "out" / "results" / "day-1" / "tray" / "imu1" / "calibration.yaml").is_file()


def test_units_of_trays_have_a_history_and_a_gauge(lot):
    database = lot / "out" / "results.db"
    done = run("history", "A1", "--db", database, "-o", lot / "history.html")
    assert done.returncode == 0, done.stderr
    assert "unit A1, 2 calibrations" in done.stdout
    assert "day-1/tray/imu1" in (lot / "history.html").read_text()
    done = run("gauge", database, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["runs"] == 4
    assert found["appraisers"] == ["a", "b"]


def test_units_in_one_file_are_a_tray_too(lot, tmp_path):
    assert run("convert", lot / "in" / "day-0" / "tray", tmp_path / "tray.mcap").returncode == 0
    (job,) = jobs_in(tmp_path, tmp_path / "out", CalibrationSettings())
    assert list(job.runs.values()) == ["tray.mcap/imu0", "tray.mcap/imu1", "tray.mcap/imu2"]
