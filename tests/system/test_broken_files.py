"""Recordings whose files are wrong, options that make no sense, and the command as a process of its own."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.formats.write import write, write_folder
from kreisel.recording.recording import Recording
from kreisel.recording.recording_settings import ImuTable, RecordingSettings

from ..small_cell import Truth
from .breaking import Break, Case, Command, Damage, assert_one_line, check, command, simulated

Good = tuple[Truth, Recording, Path]


@pytest.fixture
def kreisel(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    return command(monkeypatch, capsys)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Good:
    truth, recording = simulated()
    folder = tmp_path_factory.mktemp("good") / "run"
    write_folder(recording, folder)
    return truth, recording, folder


IMU, POSE, TOML = "imu0/data.csv", "pose0/data.csv", "recording.toml"


def rewrite(folder: Path, file: str, change: Callable[[str], str]) -> None:
    text = (folder / file).read_text(encoding="utf-8")
    (folder / file).write_text(change(text), encoding="utf-8")


def line(number: int, change: Callable[[str], str], file: str = IMU) -> Damage:
    def damage(folder: Path) -> None:
        lines = (folder / file).read_text().split("\n")
        lines[number - 1] = change(lines[number - 1])
        (folder / file).write_text("\n".join(lines))

    return damage


def columns(header: str, change: Callable[[list[str]], list[str]], file: str = POSE) -> Damage:
    """Write another header, and change every row."""

    def damage(folder: Path) -> None:
        rows = (folder / file).read_text().splitlines()[1:]
        (folder / file).write_text("\n".join([header, *(",".join(change(row.split(","))) for row in rows), ""]))

    return damage


def setting(text: str) -> Damage:
    return lambda folder: (folder / TOML).write_text(text, encoding="utf-8")


def in_seconds(text: str) -> str:
    """Return nanoseconds as seconds, with all digits."""
    return f"{text[:-9]}.{text[-9:]}"


def scaled(cells: list[str], factor: float) -> list[str]:
    return [repr(factor * float(cell)) for cell in cells]


POSE_HEADER = "#timestamp [ns],p_x [m],p_y,p_z,q_w [],q_x,q_y,q_z"

REFUSED: dict[str, tuple[Damage, tuple[str, ...]]] = {
    "no folder": (shutil.rmtree, ("no such file or folder", "give a folder")),
    "no imu0": (lambda f: shutil.rmtree(f / "imu0"), ("holds no imu0/data.csv",)),
    "no readings": (lambda f: (f / IMU).unlink(), (f"{IMU}: no such file; expected IMU readings",)),
    "no poses": (lambda f: shutil.rmtree(f / "pose0"), ("has no reference poses", "needs pose0/data.csv")),
    "folder for file": (lambda f: ((f / IMU).unlink(), (f / IMU).mkdir()), (f"{IMU}: is a folder",)),
    "link to itself": (lambda f: ((f / POSE).unlink(), (f / POSE).symlink_to("data.csv")), (f"{POSE}: is a link",)),
    "run links to itself": (lambda f: (shutil.rmtree(f), f.symlink_to(f.name)), ("no such file or folder",)),
    "settings lead nowhere": (lambda f: ((f / TOML).unlink(), (f / TOML).symlink_to("x")), (TOML, "remove it")),
    "empty": (lambda f: (f / IMU).write_text(""), (f"{IMU}: is empty", "header line")),
    "header only": (
        lambda f: rewrite(f, IMU, lambda t: t.split("\n")[0] + "\n"),
        (f"{IMU}: has a header but no rows",),
    ),
    "no header": (lambda f: rewrite(f, IMU, lambda t: t.split("\n", 1)[1]), (f"{IMU}, line 1: has no header", "write")),
    "five rows": (lambda f: rewrite(f, IMU, lambda t: "\n".join([*t.split("\n")[:6], ""])), (IMU, "5 IMU rows")),
    "garbage": (
        lambda f: (f / IMU).write_bytes(np.random.default_rng(0).bytes(4000)),
        (IMU, "binary", "copy it again"),
    ),
    "UTF-16": (lambda f: (f / IMU).write_text((f / IMU).read_text(), "utf-16"), (f"{IMU}, line 1", "save it as UTF-8")),
    "latin-1": (
        lambda f: (f / IMU).write_bytes((f / IMU).read_text().replace("rad", "°").encode("latin-1")),
        (f"{IMU}, line 1: not UTF-8", "save it in UTF-8"),
    ),
    "zeros": (lambda f: rewrite(f, POSE, lambda t: t[:9000] + 999 * "\0" + t[9999:]), (f"{POSE}, line", "zero byte")),
    "semicolons": (lambda f: rewrite(f, IMU, lambda t: t.replace(",", ";")), (f"{IMU}, line 1", "expected commas")),
    "few columns": (columns("#timestamp [ns],w_x,w_y,w_z,a_x", lambda c: c[:5], IMU), (f"{IMU}, line 1: 5 columns",)),
    "no q_z": (
        columns(POSE_HEADER[:-4], lambda c: c[:7]),
        (f"{POSE}, line 1: columns are p_x", "name each column by its axis"),
    ),
    "short row": (line(500, lambda r: r.rsplit(",", 1)[0]), (f"{IMU}, line 500: 6 values, expected 7", "repair")),
    "long row": (line(500, lambda r: r + ",1"), (f"{IMU}, line 500: 8 values, expected 7", "repair")),
    "text": (
        line(500, lambda r: re.sub(",[^,]*", ",abc", r, count=1)),
        (f"{IMU}, line 500: 'abc' in column 2 ('w_x') is not a number", "repair"),
    ),
    "blanks": (line(500, lambda r: f"  \n{r}"), (f"{IMU}, line 500: only blanks", "delete")),
    "after a comment": (line(500, lambda r: f"# note\n\n{r},1"), (f"{IMU}, line 502: 8 values",)),
    "absurd after a comment": (
        line(500, lambda r: f"# note\n\n{r.rsplit(',', 1)[0]},1e30"),
        (f"{IMU}, line 502: a_z = 1e+30", "delete"),
    ),
    "stamp too long": (line(500, lambda r: f"99999999999{r}"), (f"{IMU}, line 500", "64 bits", "repair")),
    "seconds under ns": (
        columns(POSE_HEADER, lambda c: [in_seconds(c[0]), *c[1:]]),
        (f"{POSE}, line 2: '1000.022900000'", "whole number of nanoseconds", "'#timestamp [s]'"),
    ),
    "most stamps not a number": (
        columns(POSE_HEADER.replace("ns", "s"), lambda c: ["nan" if c[0] > "101" else in_seconds(c[0]), *c[1:]]),
        (f"{POSE}, line 834: of", "without a stamp (first: line 834)", "% are missing, at most 50 %"),
    ),
    "minutes": (line(1, lambda r: r.replace("[ns]", "[min]")), (f"{IMU}, line 1", "[min]", "[ns], [us], [ms], [s]")),
    "ns under s": (line(1, lambda r: r.replace("[ns]", "[s]"), POSE), (POSE, "is the unit right? [ns]")),
    "ns under us": (
        line(1, lambda r: r.replace("[ns]", "[us]")),
        (IMU, "the header says [us], but they look like [ns]", "'#timestamp [ns]'"),
    ),
    "furlongs": (line(1, lambda r: r.replace("rad s^-1", "furlong")), (f"{IMU}, line 1", "[furlong]", "[deg/s]")),
    "names in another order": (
        line(1, lambda _: "t,ax,ay,az,gx,gy,gz"),
        (f"{IMU}, line 1: column 2 is 'ax' where w_x (rate) is expected", "order"),
    ),
    "angles": (
        columns("#timestamp [ns],p_x [m],p_y,p_z,roll,pitch,yaw", lambda c: c[:7]),
        (f"{POSE}, line 1", "roll", "convert them to quaternions"),
    ),
    "joints": (
        lambda f: ((f / "joint0").mkdir(), (f / "joint0/data.csv").write_text("#t,q_1\n1,x\n")),
        ("joint0/data.csv, line 2: 'x'", "repair"),
    ),
    "settings: key": (setting("[imu]\nnoise = 1\n"), (TOML, "unknown key 'imu.noise'", "gyro_noise_density")),
    "settings: table": (setting("[sensor]\nx = 1\n"), (TOML, "unknown table 'sensor'", "imu, prior, reference")),
    "settings: no table": (setting("imu = 3\n"), (TOML, "write [imu]")),
    "settings: text": (setting('[reference]\nposition_sd = "1"\n'), (TOML, "position_sd = '1'", "valid number")),
    "settings: true": (setting("[reference]\nposition_sd = true\n"), (TOML, "position_sd = True", "valid number")),
    "settings: negative": (setting("[reference]\nposition_sd = -0.1\n"), (TOML, "position_sd = -0.1", "greater")),
    "settings: millimetres": (setting("[reference]\nposition_sd = 0.5\n"), (TOML, "less than or equal to 0.2", "SI")),
    "settings: not a number": (setting("[site]\ngravity = nan\n"), (TOML, "gravity = nan")),
    "settings: latitude": (setting("[site]\nlatitude_deg = 200\n"), (TOML, "latitude_deg = 200", "90")),
    "settings: kind": (setting('[reference]\nkind = "vicon"\n'), (TOML, "'robot' or 'mocap'")),
    "settings: grade": (setting('[imu]\ngrade = "best"\n'), (TOML, "unknown grade 'best'", "fog-mems")),
    "settings: YAML": (setting("imu:\n  grade: fog\n"), (TOML, "not valid TOML", "line 1", "[imu]")),
    "settings: latin-1": (lambda f: (f / TOML).write_bytes(b"# M\xfcnchen\n"), (TOML, "UTF-8")),
}

HANDLED: dict[str, tuple[Damage, tuple[str, ...]]] = {
    "no robot": (lambda f: rewrite(f, TOML, lambda t: t + '[robot]\nurdf = "none.urdf"\n'), ("names none.urdf",)),
    "cut line": (lambda f: rewrite(f, IMU, lambda t: t[:-30]), ("imu0/data.csv: the last line has no end", "left out")),
    "cut number": (lambda f: rewrite(f, POSE, lambda t: t[:-4]), ("pose0/data.csv: the last line has no end",)),
    "windows": (lambda f: rewrite(f, IMU, lambda t: "\ufeff" + t.replace("\n", "\r\n")), ()),
    "empty cell": (
        line(500, lambda r: re.sub(",[^,]*", ",", r, count=1)),
        ("imu0: of", "1 without a number (w_x = nan) (first: line 500)", "left out"),
    ),
    "nan after a comment": (
        line(500, lambda r: f"# note\n\n{r.rsplit(',', 1)[0]},nan"),
        ("1 without a number (a_z = nan) (first: line 502)", "left out"),
    ),
    "stamps not a number": (
        columns(POSE_HEADER.replace("ns", "s"), lambda c: ["nan" if c[0] > "103" else in_seconds(c[0]), *c[1:]]),
        ("pose0: of", "without a stamp (first: line 2501)", "left out"),
    ),
    "commas at the ends": (lambda f: rewrite(f, IMU, lambda t: t.replace("\n", ",\n")), ()),
    "mm by unit": (
        columns(POSE_HEADER.replace("[m]", "[mm]"), lambda c: [c[0], *scaled(c[1:4], 1e3), *c[4:]]),
        ("pose0/data.csv: converted from [mm]",),
    ),
    "deg/s and g by unit": (
        columns(
            "#timestamp (ns),gyro x (deg/s),gyro y,gyro z,acc x (g),acc y,acc z",
            lambda c: [c[0], *scaled(c[1:4], 180.0 / np.pi), *scaled(c[4:], 1.0 / 9.80665)],
            IMU,
        ),
        ("imu0/data.csv: converted from [deg/s], [g]",),
    ),
    "scalar last by name": (
        columns("#timestamp [s],tx,ty,tz,qx,qy,qz,qw", lambda c: [in_seconds(c[0]), *c[1:4], *c[5:], c[4]]),
        ("quaternion columns are in the order qx, qy, qz, qw",),
    ),
    "two references": (lambda f: shutil.copytree(f / "pose0", f / "vicon0"), ("took pose0 of pose0, vicon0",)),
    "data sheet": (lambda f: (f / "imu0/sensor.yaml").write_text("gyroscope_noise_density: [1,\n"), ("sensor.yaml",)),
}


@pytest.mark.parametrize(("damage", "words"), REFUSED.values(), ids=REFUSED)
def test_damaged_files(damage: Damage, words: tuple[str, ...], good: Good, kreisel: Command, tmp_path: Path) -> None:
    shutil.copytree(good[2], tmp_path / "run")
    damage(tmp_path / "run")
    ended = kreisel("calibrate", tmp_path / "run", "--no-validate", "--json")
    assert ended.status == 1
    assert_one_line(ended.err, (str(tmp_path / "run"), *words))


@pytest.mark.parametrize(("damage", "words"), HANDLED.values(), ids=HANDLED)
def test_odd_files(damage: Damage, words: tuple[str, ...], good: Good, kreisel: Command, tmp_path: Path) -> None:
    shutil.copytree(good[2], tmp_path / "run")
    damage(tmp_path / "run")
    check(Case(damage, 0, words), kreisel("calibrate", tmp_path / "run", "--no-validate", "--json"), good[0])


def test_the_good_recording_is_accepted(good: Good, kreisel: Command) -> None:
    truth, _, folder = good
    ended = kreisel("calibrate", folder, "--no-validate", "--json")
    check(Case(simulated, 0, ()), ended, truth)
    warnings = json.loads(ended.out)["recording"]["findings"]
    # that its joint angles are missing, nothing else
    assert [said.split(" ")[0] for said in warnings] == ["robot:"]


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (("--reference", "vicon7"), ("unknown reference 'vicon7'", "pose0")),
        (("--imu", "imu7"), ("unknown IMU 'imu7'", "imu0")),
        (("--estimator", "magic"), ("unknown estimator 'magic'", "spkf")),
        (("--sigma-points", "magic"), ("unknown choice of sigma points", "unscented")),
        (("--size-effect", "magic"), ("unknown size effect", "completed")),
        (("--fix", "everything"), ("unknown group 'everything'", "lever_arms")),
        (("--update-interval", "nan"), ("update interval nan s", "0.005 to 10")),
        (("--update-interval", "10"), ("updates of 10 s", "--update-interval")),
        (("--polynomial-order", "9"), ("polynomial order 9", "1 to 5")),
    ],
)
def test_impossible_options(option: tuple[str, ...], words: tuple[str, ...], good: Good, kreisel: Command) -> None:
    ended = kreisel("calibrate", good[2], "--no-validate", *option)
    assert ended.status == 1
    assert_one_line(ended.err, words)


def test_wrong_usage_is_status_two(good: Good, kreisel: Command) -> None:
    assert kreisel("calibrate", good[2], "--passes", "many").status == 2
    assert kreisel("calibrate", good[2], "--no-such-option").status == 2


def test_an_output_that_is_a_file(good: Good, kreisel: Command, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("precious")
    ended = kreisel("calibrate", good[2], "-o", tmp_path / "out")
    assert ended.status == 1
    assert_one_line(ended.err, (str(tmp_path / "out"), "is a file", "give a folder"))
    assert (tmp_path / "out").read_text() == "precious"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read everything")
@pytest.mark.parametrize("file", [IMU, POSE, TOML])
def test_files_that_may_not_be_read(file: str, good: Good, kreisel: Command, tmp_path: Path) -> None:
    shutil.copytree(good[2], tmp_path / "run")
    (tmp_path / "run" / file).chmod(0)
    ended = kreisel("calibrate", tmp_path / "run")
    assert ended.status == 1
    assert_one_line(ended.err, (file, "Permission denied"))


def test_odd_names(good: Good, kreisel: Command, tmp_path: Path) -> None:
    odd = tmp_path / ("Prüfstand 測定 'ñ' $x " + 150 * "x")
    shutil.copytree(good[2], odd)
    check(Case(simulated, 0, ()), kreisel("calibrate", odd, "--no-validate", "--json"), good[0])
    ended = kreisel("calibrate", tmp_path / "no\nsuch\tfolder")
    assert_one_line(ended.err, ("no such file or folder",))
    ended = kreisel("calibrate", tmp_path / (300 * "x"))
    assert ended.status == 1
    assert_one_line(ended.err, ("xxx",))


def test_an_unknown_grade_in_a_bag(good: Good, kreisel: Command, tmp_path: Path) -> None:
    settings = RecordingSettings(imu=ImuTable.model_construct(grade="best"))
    write(replace(good[1], settings=settings), tmp_path / "run.mcap")
    ended = kreisel("calibrate", tmp_path / "run.mcap")
    assert ended.status == 1
    assert_one_line(ended.err, ("run.mcap", "unknown grade 'best'", "fog-mems", "run.toml"))


def test_a_cut_bag_is_used_as_far_as_it_goes(good: Good, kreisel: Command, tmp_path: Path) -> None:
    truth, recording, _ = good
    write(recording, tmp_path / "run.mcap")
    data = (tmp_path / "run.mcap").read_bytes()
    (tmp_path / "run.mcap").write_bytes(data[: len(data) * 4 // 5])
    ended = kreisel("calibrate", tmp_path / "run.mcap", "--no-validate", "--json")
    check(Case(simulated, 0, ("run.mcap: it is cut or damaged at byte",)), ended, truth)


def twice_too_fast(r: Recording) -> Recording:
    return replace(r, imu=replace(r.imu, rates=2.0 * r.imu.rates))


def absurd_number(r: Recording) -> Recording:
    rates = r.imu.rates.copy()
    rates[3000, 1] = 1e20
    return replace(r, imu=replace(r.imu, rates=rates))


def turned_round(r: Recording) -> Recording:
    return replace(r, imu=replace(r.imu, accelerations=-r.imu.accelerations))


@pytest.mark.parametrize(
    ("fault", "status", "word"),
    [
        (lambda r: r, 0, ""),
        (twice_too_fast, 3, ""),
        (absurd_number, 1, "line 3002"),
        (turned_round, 1, "specific force"),
    ],
    ids=["good", "rejected", "refused at once", "refused later"],
)
def test_the_command_itself(fault: Break, status: int, word: str, good: Good, tmp_path: Path) -> None:
    write_folder(fault(good[1]), tmp_path / "run")
    process = [sys.executable, "-m", "kreisel.cli.main", "calibrate", str(tmp_path / "run"), "--no-validate"]
    ended = subprocess.run(process, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == status
    assert ended.stderr.count("\n") == (1 if status == 1 else 0)
    assert word in ended.stderr
    assert status == 1 or "verdict" in ended.stdout
