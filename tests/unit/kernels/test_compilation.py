"""Where compiled kernels are kept: what was asked for, else the user's cache, else a place that can be written."""

import os
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
    with pytest.warns(RuntimeWarning, match="are not kept"):
        assert compilation.cache_folder() is None


def refusal():
    """Return what is said where no folder is taken."""
    with pytest.warns(RuntimeWarning) as said:
        assert compilation.cache_folder() is None
    return str(said[0].message)


def test_the_folder_is_made_for_its_user_alone(elsewhere, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "new" / "asked"))
    before = os.umask(0)
    try:
        folder = compilation.cache_folder()
    finally:
        os.umask(before)
    assert [path.stat().st_mode & 0o777 for path in (folder, folder.parent, folder.parent.parent)] == 3 * [0o700]


@pytest.mark.parametrize("mode", [0o755, 0o770, 0o1777])
def test_a_folder_that_others_may_use_is_never_read(elsewhere, tmp_path, monkeypatch, mode):
    """What numba keeps is run as code when it is read."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "asked"))
    compilation.cache_folder().chmod(mode)
    assert f"has mode {mode & 0o777:o}, expected 700" in refusal()


def test_a_folder_of_another_user_is_never_read(elsewhere, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "asked"))
    assert compilation.cache_folder() is not None
    monkeypatch.setattr(compilation.os, "geteuid", lambda: os.getuid() + 1)
    assert f"belongs to user {os.getuid()}, expected {os.getuid() + 1}" in refusal()


def test_a_link_to_a_folder_is_never_read(elsewhere, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "asked"))
    folder = compilation.cache_folder()
    folder.rename(tmp_path / "aside")
    folder.symlink_to(tmp_path / "aside")
    assert "is a link or a file" in refusal()


def test_a_folder_that_others_may_replace_is_never_read(elsewhere, tmp_path, monkeypatch):
    shared = tmp_path / "shared"
    shared.mkdir()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(shared / "asked"))
    shared.chmod(0o777)
    assert f"{shared} is writable by others (mode 777)" in refusal()
    shared.chmod(0o1777)  # as /tmp: only who owns a folder may move it
    assert compilation.cache_folder().parent == shared / "asked"


def test_another_place_is_taken_silently_where_there_is_one(elsewhere, tmp_path, monkeypatch):
    monkeypatch.setattr(compilation.tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    assert compilation.cache_folder().is_relative_to(tmp_path / "user")
    (tmp_path / "user").chmod(0o775)
    assert compilation.cache_folder().is_relative_to(tmp_path / "temporary")


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
