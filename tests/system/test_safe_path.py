"""Commands that are started in a folder of anybody's files do not run modules that lie there."""

import json
import os
import subprocess
import sys
from threading import Timer

import pytest

SHADOWED = ("uvicorn", "pickle", "struct", "typer", "ctypes", "multiprocessing", "distributed")


@pytest.fixture(scope="module")
def kreisel(tmp_path_factory):
    """The program as it is installed: a script in another folder, so that the working folder is not in its path."""
    script = tmp_path_factory.mktemp("bin") / "kreisel"
    script.write_text("from kreisel.cli.main import run\n\nif __name__ == '__main__':\n    run()\n")
    return [sys.executable, str(script)]


@pytest.fixture
def folder(tmp_path):
    """A folder with modules that leave a file when they are run."""
    for name in SHADOWED:
        (tmp_path / f"{name}.py").write_text(
            f"open('ran_{name}', 'w').close()\nraise SystemExit('{name}.py was run')\n"
        )
    return tmp_path


def ran(folder):
    return [path.name for path in folder.glob("ran_*")]


def environment():
    return {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}


def run(folder, command, *arguments):
    command = [*command, *map(str, arguments)]
    return subprocess.run(
        command, cwd=folder, env=environment(), capture_output=True, text=True, check=False, timeout=120
    )


def test_as_a_module(folder):
    done = run(folder, [sys.executable, "-m", "kreisel.cli.main"], "krl", "-o", "program")
    assert done.returncode == 0, done.stderr
    assert ran(folder) == []


def test_processes_of_the_cell_and_of_the_page(kreisel, folder):
    cell = subprocess.Popen(
        [*kreisel, "virtual-cell", "--robot", "rtde", "--imu", "csv", "--seconds", "20"],
        cwd=folder, env=environment(), stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    watchdog = Timer(60.0, cell.kill)  # a cell whose processes die before they answer waits for them
    watchdog.start()
    try:
        imu = json.loads(cell.stdout.readline())["imu"]
        done = run(folder, kreisel, "record", "--imu", imu, "-o", "run", "--seconds", "2", "--dashboard", "--port", "0")
    finally:
        watchdog.cancel()
        cell.terminate()
        cell.wait()
        cell.stdout.close()
    assert done.returncode == 0, done.stderr
    assert "was run" not in done.stderr
    assert ran(folder) == []


def test_workers_of_a_batch(kreisel, folder):
    pytest.importorskip("distributed")
    done = run(folder, kreisel, "batch", "lot", "-o", "out", "--simulate", "2", "--seconds", "30")
    assert "2 units: " in done.stdout, done.stderr
    assert ran(folder) == []
