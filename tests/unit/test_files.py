"""Files that are of one result, written while the process may be killed at any moment."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import kreisel
from kreisel.calibration.result import RESULT_FILES, Calibration
from kreisel.calibration.result_document import from_document
from kreisel.cli.output import check_output
from kreisel.errors import SettingsError
from kreisel.files import finish_replacing, open_fresh, open_lock, read_bytes, read_toml, replaced_together, write_whole

NAMES = ("a.yaml", "b.html", "c.urdf")
WRITE = """
import os, signal, sys
from pathlib import Path
from kreisel.cli.output import check_output
from kreisel.files import replaced_together, open_fresh, open_lock

folder, last = Path(sys.argv[1]), int(sys.argv[2])
seen = 0

def kill(event, arguments):
    global seen
    if event in ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir") and ".kreisel" in str(arguments) or (
        event == "os.remove"
    ):
        seen += 1
        if seen > last:
            os.kill(os.getpid(), signal.SIGKILL)

sys.addaudithook(kill)
with replaced_together(folder, ("a.yaml", "b.html", "c.urdf")) as writing:
    (writing / "a.yaml").write_text("new")
    (writing / "b.html").write_text("new")
print("done")
"""
"""Writes a result and kills itself before its n-th step."""


def write(folder: Path, text: str) -> None:
    for name in NAMES:
        (folder / name).write_text(text)


def found(folder: Path) -> dict[str, str]:
    return {name: (folder / name).read_text() for name in NAMES if (folder / name).exists()}


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_killed_at_any_step_one_whole_result_is_left(tmp_path: Path) -> None:
    old, new = dict.fromkeys(NAMES, "old"), {"a.yaml": "new", "b.html": "new"}
    seen, steps = set(), 0
    while steps < 100:
        folder = tmp_path / str(steps)
        (folder / "own").mkdir(parents=True)
        (folder / "own" / "notes.txt").write_text("mine")
        (folder / "data.csv").write_text("mine")
        write(folder, "old")
        done = subprocess.run([sys.executable, "-c", WRITE, folder, str(steps)], capture_output=True, text=True)
        left = found(folder)
        assert len(set(left.values())) <= 1, f"of two results after {steps} steps: {left}"
        finish_replacing(folder, NAMES)
        assert found(folder) in (old, new), f"not whole after {steps} steps: {found(folder)}"
        seen.add(found(folder)["a.yaml"])
        assert (folder / "own" / "notes.txt").read_text() == (folder / "data.csv").read_text() == "mine"
        with replaced_together(folder, NAMES) as writing:
            (writing / "c.urdf").write_text("again")
        assert found(folder) == {"c.urdf": "again"}
        assert {path.name for path in folder.iterdir()} == {"own", "data.csv", "c.urdf"}
        if done.stdout:
            break
        steps += 1
    assert steps > 8
    assert seen == {"old", "new"}


def test_what_fails_leaves_what_was_there(tmp_path: Path) -> None:
    write(tmp_path, "old")
    with pytest.raises(ZeroDivisionError), replaced_together(tmp_path, NAMES) as writing:
        (writing / "a.yaml").write_text(str(1 / 0))
    assert found(tmp_path) == dict.fromkeys(NAMES, "old")
    assert {path.name for path in tmp_path.iterdir()} == set(NAMES)
    (tmp_path / "b.html").unlink()
    (tmp_path / "b.html").mkdir()
    with pytest.raises(IsADirectoryError), replaced_together(tmp_path, NAMES):
        pass
    assert (tmp_path / "a.yaml").read_text() == "old"


def calibration(urdf: str | None, names: tuple[str, ...] = ("a",)) -> Calibration:
    table = {"cross_coupling": np.eye(3).tolist(), "offset": [0.0] * 3, "lever_arms": np.zeros((3, 3)).tolist()}
    document = {"gyroscope": table, "accelerometer": table, "verdict": {"accepted": True}}
    return Calibration(
        **vars(from_document(document)),
        names=names,
        covariance=np.eye(1),
        prior_deviation=np.ones(1),
        estimates=np.zeros((2, 3)),
        robot_urdf=urdf,
    )


def test_a_result_leaves_nothing_of_an_earlier_one(tmp_path: Path) -> None:
    calibration("<robot/>").save(tmp_path)
    (tmp_path / "report.html").write_text("of the first")
    (tmp_path / "notes.txt").write_text("mine")
    assert {path.name for path in tmp_path.iterdir()} == {*RESULT_FILES, "notes.txt"}
    calibration(None).save(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        "calibration.yaml", "estimates.csv", "covariance.npz", "notes.txt"
    }  # fmt: skip
    assert kreisel.Calibration.load(tmp_path).names == ("a",)


def test_loading_finishes_what_was_cut_short(tmp_path: Path) -> None:
    calibration(None).save(tmp_path)
    (tmp_path / ".kreisel-written").mkdir()
    calibration(None, ("b",)).write(tmp_path / ".kreisel-written")
    assert Calibration.load(tmp_path / "calibration.yaml").names == ("b",)
    assert not (tmp_path / ".kreisel-written").exists()


def test_a_file_is_read_as_far_as_it_may_be_long(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(bytes(10))
    assert read_bytes(tmp_path / "a", 10) == bytes(10)
    with pytest.raises(OSError, match="longer than 9 bytes"):
        read_bytes(tmp_path / "a", 9)


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "recording.toml")
    with pytest.raises(OSError, match="not a regular file"):
        read_bytes(tmp_path / "recording.toml")


def test_a_fresh_file_never_follows_a_link(tmp_path):
    """Somebody else may have put one where a partial file is written."""
    (tmp_path / "precious").write_text("kept")
    part = tmp_path / "x.part"
    part.symlink_to(tmp_path / "precious")
    with open_fresh(part, 0o600) as file:
        file.write(b"new")
    assert (tmp_path / "precious").read_text() == "kept"
    assert part.read_bytes() == b"new"
    assert not part.is_symlink()
    assert part.stat().st_mode & 0o777 == 0o600
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        open_fresh(tmp_path / "folder")


def test_a_lock_never_follows_a_link(tmp_path):
    (tmp_path / "precious").write_text("kept")
    (tmp_path / ".lock").symlink_to(tmp_path / "precious")
    with pytest.raises(OSError, match=r"\.lock"):
        open_lock(tmp_path / ".lock")
    (tmp_path / ".lock").unlink()
    with open_lock(tmp_path / ".lock"), open_lock(tmp_path / ".lock"):
        assert (tmp_path / ".lock").is_file()
    assert (tmp_path / "precious").read_text() == "kept"


def test_the_output_is_tried_under_a_name_that_nobody_knows(tmp_path):
    (tmp_path / "precious").write_text("kept")
    (tmp_path / ".kreisel-probe").symlink_to(tmp_path / "precious")
    check_output(tmp_path)
    assert (tmp_path / "precious").read_text() == "kept"
    assert sorted(path.name for path in tmp_path.iterdir()) == [".kreisel-probe", "precious"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read: No such file or directory"),
        (b"a = ", "not valid TOML: .*; write a = 1"),
        (b"a = '\xff'", r"not UTF-8 text \(byte 5\); save it in UTF-8"),
        (b"a = " + 5000 * b"[", "not valid TOML: .*; write a = 1"),
    ],
)
def test_a_file_that_is_no_toml_raises_the_error_that_is_asked_for(tmp_path, content, message):
    file = tmp_path / "own.toml"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(SettingsError, match=message):
        read_toml(file, "write a = 1", SettingsError)


def test_toml_is_read_with_a_byte_order_mark_and_any_ends_of_lines(tmp_path):
    file = tmp_path / "own.toml"
    file.write_bytes(b"\xef\xbb\xbfa = 1\r\n[b]\rc = 'd'\n")
    assert read_toml(file, "", SettingsError) == {"a": 1, "b": {"c": "d"}}


def test_a_file_is_replaced_once_all_of_it_is_written(tmp_path, monkeypatch):
    out = tmp_path / "new" / "x.json"
    write_whole(out, "first\n")
    assert out.read_bytes() == b"first\n"

    def fail(self, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(OSError, match="x.json"):
        write_whole(out, b"second")
    assert [p.name for p in out.parent.iterdir()] == ["x.json"]
    assert out.read_bytes() == b"first\n"
    with pytest.raises(IsADirectoryError):
        write_whole(tmp_path / "new", "x")
