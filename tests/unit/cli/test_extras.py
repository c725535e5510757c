"""What needs an extra says so before anything is recorded, moved or written."""

import importlib.util

import pytest
from typer.testing import CliRunner

from kreisel.cli.main import app
from kreisel.errors import SettingsError


@pytest.fixture
def without(monkeypatch, tmp_path):
    """Return what runs a command in an empty folder, where packages are not installed."""
    known = importlib.util.find_spec

    def go(missing, *words):
        hidden = lambda name, *rest: None if name in missing else known(name, *rest)  # noqa: E731
        monkeypatch.setattr(importlib.util, "find_spec", hidden)
        monkeypatch.chdir(tmp_path)
        with pytest.raises(SettingsError) as error:
            CliRunner().invoke(app, list(words), catch_exceptions=False)
        assert not list(tmp_path.iterdir())
        return str(error.value)

    return go


@pytest.mark.parametrize(
    "words",
    [
        ("consistency", "--trials", "2"),
        ("accuracy", "--trials", "2"),
        ("robustness", "--only", "clean"),
        ("robustness", "--only", "clean", "--write", "recordings"),
        ("methods", "--seeds", "1"),
    ],
    ids=" ".join,
)
def test_studies_make_no_folder_without_dask(words, without):
    assert "pip install 'kreisel[study]'" in without(("distributed",), "study", *words)


@pytest.mark.parametrize("missing", ["starlette", "uvicorn", "websockets"])
@pytest.mark.parametrize(
    "words",
    [
        ("record", "--imu", "csv://127.0.0.1:9", "-o", "r.mcap", "--seconds", "1"),
        ("static", "--live", "csv://127.0.0.1:9", "-o", "out", "--seconds", "1"),
    ],
    ids=lambda words: words[0],
)
def test_nothing_is_recorded_without_the_page_that_was_asked_for(missing, words, without):
    said = without((missing,), *words, "--dashboard")
    assert said == f"the page needs an extra ({missing}): pip install 'kreisel[serve]'"
