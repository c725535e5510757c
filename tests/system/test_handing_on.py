"""A lot of units from the command line: calibrated, judged, certified, corrected and exported, as a maker does it."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

fcntl = pytest.importorskip("fcntl")

LIMITS = "[limits]\ngyro_scale_error_ppm = 1e5\n"


def run(*arguments, **options):
    command = [sys.executable, "-m", "kreisel.cli.main", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300, **options)


@pytest.fixture(scope="module")
def lot(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("lot")
    (folder / "limits.toml").write_text(LIMITS)
    done = run("batch", folder / "in", "-o", folder / "out", "--simulate", 2, "--seconds", 30, "--jobs", 1,
               "--limits", folder / "limits.toml", "--json")  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["units"] == 2
    return folder


def test_the_table_has_every_unit(lot):
    rows = list(csv.DictReader((lot / "out" / "table.csv").read_text().splitlines()))
    assert [row["unit"] for row in rows] == ["0001", "0002"]
    assert "conforms" in (lot / "out" / "batch.html").read_text()


def test_what_is_done_is_not_done_again_and_two_batches_do_not_mix(lot):
    again = run("batch", lot / "in", "-o", lot / "out", "--jobs", 1)
    assert again.stdout.startswith("2 of 2 are done already")
    with (lot / "out" / ".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        busy = run("batch", lot / "in", "-o", lot / "out", "--jobs", 1)
    assert busy.returncode == 1
    assert "another batch is at work there" in busy.stderr


def test_results_do_not_go_into_a_recording(lot):
    done = run("batch", lot / "in", "-o", lot / "in" / "unit-0001")
    assert done.returncode == 1
    assert "is a recording; give another folder" in done.stderr


def test_a_history_needs_dates(lot):
    done = run("history", "0001", "--db", lot / "out" / "results.db", "-o", lot / "history.html")
    assert done.returncode == 1
    assert "has 0 accepted calibrations with a date" in done.stderr
    unknown = run("history", "9", "--db", lot / "out" / "results.db", "-o", lot / "history.html")
    assert "no unit '9'" in unknown.stderr
    assert "0001, 0002" in unknown.stderr


def test_a_result_is_certified_applied_and_exported(lot, tmp_path):
    result, raw = lot / "out" / "results" / "unit-0001", lot / "in" / "unit-0001"
    done = run("certificate", result, "-o", tmp_path / "c.html", "--limits", lot / "limits.toml")
    assert done.returncode == 0, done.stderr
    assert "conforms" in (tmp_path / "c.html").read_text()
    assert run("apply", result, raw, "-o", tmp_path / "corrected.csv").returncode == 0
    text = (raw / "imu0" / "data.csv").read_text()
    piped = run("apply", result, "-", "-o", "-", input=text)
    assert piped.stdout == (tmp_path / "corrected.csv").read_text()
    assert run("apply", result, raw / "imu0" / "data.csv", "-o", "-").stdout == piped.stdout
    for more in (["--map", "imu.time=t"], ["--imu", "imu1"], ["--seconds", 3]):
        assert run("apply", result, raw, "-o", "-", *more).returncode == 1
    done = run("export", result, "--to", "c", "-o", tmp_path / "imu.h")
    assert done.returncode == 0, done.stderr
    assert "imu_push" in (tmp_path / "imu.h").read_text()


@pytest.mark.parametrize(("stream", "said"), [("stdin", "standard input"), ("stdout", "standard output")])
def test_closed_streams_are_told(lot, stream, said):
    closing = {"stdin": "<&-", "stdout": ">&-"}[stream]
    result = lot / "out" / "results" / "unit-0001"
    command = f'"{sys.executable}" -m kreisel.cli.main apply "{result}" - -o - {closing}'
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False, input="")
    assert done.returncode == 1
    assert f"{said} is closed" in done.stderr
