"""Notebooks of the documentation run from top to bottom, as readers run them, and make the pages of the site."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")
pytest.importorskip("matplotlib")

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "docs" / "notebooks").glob("*.ipynb"))
by_name = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def cells(path):
    return json.loads(path.read_text(encoding="utf-8"))["cells"]


@by_name
def test_they_are_stored_without_results(path):
    for cell in cells(path):
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None


@by_name
def test_their_links_lead_somewhere(path):
    for cell in cells(path):
        if cell["cell_type"] == "markdown":
            for target in re.findall(r"\]\(([^)#]+)[^)]*\)", "".join(cell["source"])):
                assert (path.parent / target).exists(), target


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [pytest.param(path, id=path.stem) for path in NOTEBOOKS if path.stem != "figure-4"],  # `make site` runs all
)
def test_they_run(path, tmp_path):
    copy = Path(shutil.copy(path, tmp_path))
    command = [sys.executable, "-c", "from nbclient.cli import main; main()", "--inplace", str(copy)]
    done = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    for cell in cells(copy):
        for output in cell.get("outputs", ()):
            assert output.get("name") != "stderr", output["text"]
            if "image/png" in output.get("data", {}):
                assert len(cell["metadata"].get("alt", "")) > 50, "a picture without a description for the site"
    last = [cell for cell in cells(copy) if cell["cell_type"] == "code"][-1]
    assert last["execution_count"] == sum(cell["cell_type"] == "code" for cell in cells(copy))


def test_a_cell_shows_progress_in_one_line(tmp_path):
    lines = ["from kreisel.progress import shown\n", "with shown(True) as show:\n", "    show('pass 1', 0.5)\n"]
    cell = {"cell_type": "code", "id": "a", "metadata": {}, "outputs": [], "execution_count": None, "source": lines}
    kernel = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    path = tmp_path / "progress.ipynb"
    path.write_text(json.dumps({"cells": [cell], "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}))
    command = [sys.executable, "-c", "from nbclient.cli import main; main()", "--inplace", str(path)]
    subprocess.run(command, check=True, capture_output=True)
    (output,) = cells(path)[0]["outputs"]
    assert re.fullmatch(r"done in \d\.\d s", "".join(output["data"]["text/plain"]))
