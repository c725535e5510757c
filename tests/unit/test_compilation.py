"""Where compiled kernels are kept: what was asked for, else the user's cache, else a place that can be written."""

import shutil
from pathlib import Path

import numba
import pytest

from kreisel._kernels import compilation


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """Return a copy of the kernels' source that stands in for it."""
    source = tmp_path / "source"
    shutil.copytree(Path(compilation.__file__).parent, source, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(compilation, "__file__", str(source / "compilation.py"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    return source


def test_the_folder_asked_for_is_taken(elsewhere, tmp_path, monkeypatch):
    assert compilation.cache_folder().parent == tmp_path / "user"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "asked"))
    assert compilation.cache_folder().parent == tmp_path / "asked"


def test_a_change_to_any_kernel_makes_all_anew(elsewhere):
    """A kernel is compiled together with those it calls; numba looks at its own file alone."""
    before = compilation.cache_folder()
    assert compilation.cache_folder() == before
    (elsewhere / "rotation.py").write_text((elsewhere / "rotation.py").read_text() + "\n")
    assert compilation.cache_folder() != before


def test_without_a_place_in_the_users_cache_another_is_found(elsewhere, tmp_path, monkeypatch):
    (tmp_path / "user").write_text("a file, not a folder")
    monkeypatch.setattr(compilation.tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    assert compilation.cache_folder().is_relative_to(tmp_path / "temporary")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "user"))
    assert compilation.cache_folder() is None


def test_a_user_without_name_and_home_has_a_place(elsewhere, tmp_path, monkeypatch):
    def nobody():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(compilation.Path, "home", nobody)
    monkeypatch.setattr(compilation.tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    assert compilation.cache_folder().is_relative_to(tmp_path / "temporary")


def test_numba_is_left_as_it_was(monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", "somebody's")
    compilation.kernel(lambda x: x)
    assert numba.config.CACHE_DIR == "somebody's"
