"""A lot of units from the command line: calibrated, judged, certified, corrected and exported, as a maker does it."""

import csv
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import kreisel

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


def limits_in(folder: Path, value: float, quantity: str = "gyro_scale_error_ppm") -> Path:
    file = folder / f"{value:g}.toml"
    file.write_text(f"[limits]\n{quantity} = {value!r}\n")
    return file


def near_limit(result: Path) -> float:
    """A limit that a result is neither clearly within nor clearly beyond."""
    return float(np.abs(kreisel.Calibration.load(result).derived["gyro_scale_error_ppm"].value).max())


def test_the_exit_status_of_a_batch_is_that_of_its_worst_unit(lot, tmp_path):
    units = [lot / "out" / "results" / f"unit-000{k}" for k in (1, 2)]
    largest = max(near_limit(unit) for unit in units)
    for limit, status, outcome in ((1e-3, 3, "does not conform"), (largest, 4, "no decision"), (1e5, 0, None)):
        done = run("batch", lot / "in", "-o", lot / "out", "--jobs", 1, "--limits", limits_in(tmp_path, limit))
        assert done.returncode == status, done.stdout
        last = done.stdout.splitlines()[-1]
        assert last.startswith("written: " if outcome is None else f"not good: {outcome}: unit-000")
        if status == 3:
            assert last == "not good: does not conform: unit-0001, unit-0002"


def test_a_unit_that_cannot_be_calibrated_is_a_failure_and_comes_first(lot, tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "good").symlink_to(lot / "in" / "unit-0001")
    broken = tmp_path / "in" / "broken" / "imu0"
    broken.mkdir(parents=True)
    (broken / "data.csv").write_text("no numbers\n")
    settings = ("-o", tmp_path / "out", "--jobs", 1)
    done = run("batch", tmp_path / "in", *settings, "--limits", limits_in(tmp_path, 1e-3), "--links")
    assert done.returncode == 1
    assert done.stdout.splitlines()[-1] == "not good: failed: broken; does not conform: good"
    done = run("batch", tmp_path / "in", *settings, "--json", "--links")
    assert done.returncode == 1
    assert json.loads(done.stdout)["not_good"] == {"failed": ["broken"]}


def test_the_exit_status_of_a_certificate_and_of_a_calibration(lot, tmp_path):
    result, recording = lot / "out" / "results" / "unit-0001", lot / "in" / "unit-0001"
    for limit, status, text in (
        (1e5, 0, "conforms"),
        (near_limit(result), 4, "no decision: gyro scale-factor error"),
        (1e-3, 3, "does not conform: gyro scale-factor error"),
    ):
        limits = limits_in(tmp_path, limit)
        done = run("certificate", result, "-o", tmp_path / f"{status}.html", "--limits", limits)
        assert done.returncode == status, done.stderr
        assert done.stdout.splitlines()[-1] == f"conformity: {text}"
        assert (tmp_path / f"{status}.html").is_file()
        done = run("calibrate", recording, "--no-validate", "--limits", limits)
        assert done.returncode == status, done.stderr
        assert done.stdout.splitlines()[-1] == f"conformity: {text}"
    done = run("calibrate", recording, "--json", "--limits", limits)
    assert (done.returncode, json.loads(done.stdout)["conformity"]["decision"]) == (3, "does not conform")
    rejected = tmp_path / "rejected.yaml"
    text = (result / "calibration.yaml").read_text()
    rejected.write_text(text.replace("accepted: true", "accepted: false", 1))
    done = run("certificate", rejected, "-o", tmp_path / "none.html")
    assert done.returncode == 3
    assert "was rejected, and gets no certificate" in done.stderr
    assert not (tmp_path / "none.html").exists()


def test_a_certificate_belongs_to_its_calibration_and_its_name(lot, tmp_path):
    pytest.importorskip("minisign")
    results = [lot / "out" / "results" / f"unit-000{k}" for k in (1, 2)]
    assert run("key", "-o", tmp_path / "lab", "--no-password").returncode == 0
    for k, result in enumerate(results, start=1):
        done = run("certificate", result, "-o", tmp_path / f"{k}.html", "--key", tmp_path / "lab.key")
        assert done.returncode == 0, done.stderr
    digest = hashlib.sha256((results[0] / "calibration.yaml").read_bytes()).hexdigest()
    assert digest in (tmp_path / "1.html").read_text()

    def verified(result=None):
        more = [] if result is None else ["--calibration", result]
        return run("verify", tmp_path / "1.html", "--public-key", tmp_path / "lab.pub", *more)

    done = verified(results[0])
    assert done.returncode == 0, done.stderr
    assert "for serial number 0001" in done.stdout
    assert digest in done.stdout
    other = verified(results[1])
    assert other.returncode == 1
    assert "the serial number is '0002' there, and '0001' as signed" in other.stderr
    for suffix in (".html", ".html.minisig"):  # exchanged for the other one, with its signature
        (tmp_path / f"2{suffix}").replace(tmp_path / f"1{suffix}")
    swapped = verified()
    assert swapped.returncode == 1
    assert "was signed under the name '2.html', for serial number '0002'" in swapped.stderr


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
