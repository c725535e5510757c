"""Scripts beside the package run: benchmarks and the experiments after decisions, at a tiny size."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from kreisel.formats.write import write
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments, **environment):
    # benchmarks are switched off where pytest's own variables say that they run beside other tests
    own = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")} | environment
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=ROOT, env=own, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "arguments",
    [
        ("passes.py", "1", "30"),
        ("error_budget.py", "fog", "1", "30"),
        ("accuracy_budget.py", "--seeds", "1", "--durations", "60", "--grades", "fog-mems"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_design_scripts_run(arguments):
    ended = run(f"design/{arguments[0]}", *arguments[1:])
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.count("\n") >= 2


def test_the_table_of_an_arm_is_made(recordings):
    ended = run("design/abb_arm.py", str(recordings / "abb_mpu9150_300mms_path3"))
    assert ended.returncode == 0, ended.stderr
    header, row = (line.split(",") for line in ended.stdout.splitlines())
    found = dict(zip(header, row, strict=True))
    assert found["verdict"] == "accepted"
    assert float(found["misfit with (mrad)"]) < 0.2 * float(found["misfit without (mrad)"])
    assert float(found["joint 5 (mrad)"]) == pytest.approx(-50.0, abs=5.0)


def test_batch_and_sigma_points_agree_though_noise_pulls(tmp_path):
    """The table in docs/explanation/method.md: one recording in which noise pulls by a deviation."""
    ended = run("design/estimator_agreement.py", "--seeds", "1", "--only", "5%", "-o", str(tmp_path / "table.csv"))
    assert ended.returncode == 0, ended.stderr
    header, row = (line.split(",") for line in (tmp_path / "table.csv").read_text().splitlines())
    found = dict(zip(header, row, strict=False))
    assert float(found["pull of noise / sd"]) > 1.0
    assert float(found["largest difference / sd"]) < 0.3
    assert float(found["largest difference of deviations"].rstrip("%")) < 5.0


def test_phases_are_timed(tmp_path):
    write(simulate(Cell.model_validate({"seconds": 30.0}), tmp_path / "run")[1], tmp_path / "run")
    ended = run("-m", "benchmarks.phases", str(tmp_path / "run"))
    assert ended.returncode == 0, ended.stderr
    assert "strapdown passes of" in ended.stdout


def test_trays_are_timed():
    ended = run("-m", "benchmarks.trays", "--units", "2", "--seconds", "40")
    assert ended.returncode == 0, ended.stderr
    assert "2 units:" in ended.stdout
    assert "exponent of the number of units, from 1 on" in ended.stdout


def test_peers_are_timed():
    """Those that are not installed are named and left out."""
    ended = run("-m", "benchmarks.peers", "1")
    assert ended.returncode == 0, ended.stderr
    ours = [line for line in ended.stdout.splitlines() if line.startswith("kreisel")]
    assert [line.split("  ")[0] for line in ours] == ["kreisel", "kreisel, ekf"]


def test_benchmarks_run():
    ended = run(
        "-m", "pytest", "benchmarks", "--benchmark-only", "-q", "-p", "no:cacheprovider", "-p", "no:xdist",
        KREISEL_BENCHMARK_SECONDS="30",
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout + ended.stderr
