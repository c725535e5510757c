"""With --json every command prints one object, whatever happens; options that contradict each other are refused."""

import json
import sys

import pytest
from typer.main import get_command

from kreisel.cli.main import app, run


def with_json():
    """Return the commands that have --json, as words."""
    for name, command in get_command(app).commands.items():
        for own, one in getattr(command, "commands", {name: command}).items():
            if any("--json" in parameter.opts for parameter in one.params):
                yield (name,) if one is command else (name, own)


COMMANDS = tuple(with_json())


@pytest.fixture
def ended(monkeypatch, capsys):
    """Return what runs a command line in this process: exit status, and the object on standard output."""

    def go(*words):
        monkeypatch.setattr(sys, "argv", ["kreisel", *map(str, words)])
        monkeypatch.setattr("kreisel.cli.main.keep_from_terminal", lambda: None)
        for name in ("set_threshold", "freeze"):
            monkeypatch.setattr(f"kreisel.cli.main.gc.{name}", lambda *_: None)
        monkeypatch.setattr("kreisel.cli.main.prepare_process", lambda: None)
        monkeypatch.setenv("PYTHONSAFEPATH", "")
        with pytest.raises(SystemExit) as status:
            run()
        out, err = capsys.readouterr()
        return status.value.code, out, err

    return go


def test_most_commands_have_it():
    assert len(COMMANDS) >= 13


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
@pytest.mark.parametrize("wrong", ["--no-such-option", "--json=3"])
def test_a_wrong_command_line_is_an_object_too(words, wrong, ended):
    code, out, err = ended(*words, "--json", wrong)
    assert code == 2
    assert json.loads(out).keys() == {"error"}
    assert json.loads(out)["error"].rstrip(".") in " ".join(err.split())


def test_a_command_or_an_argument_that_is_missing_is_an_object_too(ended):
    assert "No such command" in json.loads(ended("nothing", "--json")[1])["error"]
    assert "No such command" in json.loads(ended("study", "nothing", "--json")[1])["error"]
    code, out, _ = ended("calibrate", "--json")
    assert (code, json.loads(out)["error"].startswith("Missing argument")) == (2, True)


def test_without_it_nothing_is_printed_on_standard_output(ended):
    code, out, err = ended("info", "--no-such-option")
    assert (code, out) == (2, "")
    assert "No such option" in err


@pytest.mark.parametrize(
    "words", [words for words in COMMANDS if words not in (("doctor",), ("watch",), ("study", "methods"))], ids=" ".join
)
def test_a_missing_file_is_an_object_with_status_1(words, ended, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    more = {"batch": ["-o", "lot"], "repeat": ["none"], "apply": ["raw", "-o", "f.csv", "--fuse"]}.get(words[0], [])
    given = ["--only", "none"] if words == ("study", "robustness") else ["none"]
    code, out, err = ended(*words, *given, *more, "--json")
    assert code == 1
    assert "none" in json.loads(out)["error"]
    assert json.loads(out)["error"] in err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("calibrate", "r", "--method", "static", "--estimator", "batch"), "--estimator is for the dynamic method"),
        (("calibrate", "r", "--method", "static", "--fix", "time_skew"), "--fix is for the dynamic method"),
        (("calibrate", "r", "--method", "static", "--inject"), "--inject is for the dynamic method"),
        (("calibrate", "r", "s"), "--joint makes one calibration"),
        (("calibrate", "r", "--same", "mount"), "are for several recordings"),
        (("calibrate", "r", "--sigma-points", "unscented", "--estimator", "ekf"), "--sigma-points is for spkf"),
        (("calibrate", "r", "--skew", "--fix", "time_skew=0"), "contradict each other"),
        (("calibrate", "r", "--estimate", "gyro_asymmetry", "--fix", "gyro_asymmetry"), "contradict each other"),
        (("calibrate", "r", "s", "--joint", "--same", "mount", "--own", "mount"), "cannot be both"),
        (("static", "r", "--live", "csv://127.0.0.1:9"), "one of them"),
        (("static", "r", "--until", "accelerometer.offset=1mg"), "with --live"),
        (("watch", "r", "--dashboard"), "give one of them"),
        (("apply", "r", "raw", "-o", "f.csv"), "--json is for --fuse"),
        (("apply", "r", "raw", "-o", "f.csv", "--fuse", "--axes", "imu"), "--axes does not go with --fuse"),
        (("apply", "r", "raw", "-o", "f.csv", "--fuse", "--imu", "imu1"), "--imu does not go with --fuse"),
        (("apply", "r", "raw", "-o", "f.csv", "--fuse", "--map", "imu.time=t"), "--map does not go with --fuse"),
        (("apply", "r", "raw", "-o", "f.csv", "--fuse", "--topic", "/t"), "--topic does not go with --fuse"),
        (("apply", "r", "raw", "-o", "f.csv", "--fuse", "--seconds", "3"), "--seconds does not go with --fuse"),
        (("apply", "r", "raw", "-o", "-", "--fuse"), "-o - does not go with --fuse"),
        (("apply", "r", "-", "-o", "f.csv", "--fuse"), "- does not go with --fuse"),
        (("apply", "r", "csv://h:4000", "-o", "f.csv", "--fuse"), "csv://h:4000 does not go with --fuse"),
        (("study", "robustness", "--random", "2", "--only", "clean"), "leave out --only"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_options_that_contradict_each_other(words, said, ended, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, _ = ended(*words, "--json")
    assert code == 1
    assert said in json.loads(out)["error"]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("simulate", "--example", "-o", "r"), "leave out CELL and -o"),
        (("virtual-cell", "--robot", "rtde", "--obey", "--speed", "2"), "without --obey"),
        (("apply", "r", "t.csv", "-o", "u.csv", "--seconds", "3"), "r: "),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_those_without_json_say_so_in_one_line(words, said, ended, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = ended(*words)
    assert (code, out) == (1, "")
    assert said in err
    assert len(err.splitlines()) == 1
