"""`kreisel study robustness` as a user meets it."""

import json
import subprocess
import sys

import pytest


def command(*arguments):
    line = [sys.executable, "-m", "kreisel.cli.main", "study", "robustness", "--seconds", "30", *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, check=False, timeout=300)


@pytest.mark.slow
def test_situations_are_run_once_and_reported(tmp_path):
    out = tmp_path / "out"
    chosen = ("-o", out, "--only", "nothing of the robot", "--seeds", 2)
    first = command(*chosen, "--json")
    assert first.returncode == 0, first.stderr
    document = json.loads(first.stdout)
    assert document["totals"]["runs"] == len(document["rows"]) == 2
    assert {row["seed"] for row in document["rows"]} == {1, 2}
    before = (out / "robustness.csv").read_text(encoding="utf-8")
    second = command(*chosen)
    assert second.returncode == 0, second.stderr
    assert (out / "robustness.csv").read_text(encoding="utf-8") == before  # durations, too: nothing ran
    assert "2 runs: " in second.stdout
    assert "nothing of the robot" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_recordings_are_written_instead(tmp_path):
    done = command("--only", "nothing of the robot", "--seeds", 1, "--write", tmp_path / "w", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert [p.name for p in (tmp_path / "w").iterdir()] == ["nothing_of_the_robot-all-joints-1"]
    assert not (tmp_path / "out").exists()


def test_errors_that_are_on_no_list(tmp_path):
    """Ten that nobody has looked at; half a minute each, so that few are observable well."""
    done = command("--random", 10, "--first", 101, "-o", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["totals"]["runs"] == 10
    assert document["totals"]["verdicts"]["crashed"] == 0
    accepted = [row["worst"] for row in document["rows"] if row["verdict"] == "accepted"]
    assert accepted
    assert max(accepted) < 8.0
    assert command("--random", 2, "--only", "clean", "-o", tmp_path / "out").returncode == 1


def test_unknown_effects_are_listed(tmp_path):
    done = command("--only", "magic", "-o", tmp_path / "out")
    assert done.returncode == 1
    assert "unknown situation 'magic'; known are: clean, gyro_g_sensitivity, " in done.stderr
    assert len(done.stderr.splitlines()) == 1
