"""Recordings whose numbers are wrong: refused in one line that helps, rejected with reasons, or handled and told."""

from dataclasses import replace
from pathlib import Path

import pytest

from kreisel.formats.write import write, write_folder
from kreisel.recording.recording_settings import RecordingSettings

from . import faults_of_poses  # noqa: F401 - adds its faults
from .breaking import FAULTS, Break, Case, Command, assert_one_line, check, command, poses, simulated
from .faults_of_readings import absurd_number, dead_gyro, degrees_per_second, too_much_without_numbers
from .faults_of_stamps import microseconds, stamp_twice


@pytest.fixture
def kreisel(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    return command(monkeypatch, capsys)


LONG = ("saturated_before_noise", "mount_that_slips")
"""Faults that do not fit any model, for which all are tried."""


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=[pytest.mark.slow] if case.name in LONG else [], id=case.name) for case in FAULTS],
)
def test_a_broken_recording(case: Case, kreisel: Command, tmp_path: Path) -> None:
    truth, recording = simulated()
    write_folder(case.fault(recording), tmp_path / "run")
    ended = kreisel("calibrate", tmp_path / "run", "--no-validate", "--json")
    check(case, ended, truth)
    assert case.status != 1 or str(tmp_path / "run") in ended.err


BARE = ("positions", "two", "accelerometers", "many_spikes", "clock", "dead", "millimetres")


@pytest.mark.parametrize(
    "case",
    [case for case in FAULTS if case.status == 1 and case.name.startswith(BARE)],
    ids=lambda case: case.name,
)
def test_unknown_noise_hides_no_fault(case: Case, kreisel: Command, tmp_path: Path) -> None:
    truth, recording = simulated()
    write_folder(replace(case.fault(recording), settings=RecordingSettings()), tmp_path / "run")
    check(case, kreisel("calibrate", tmp_path / "run", "--no-validate", "--json"), truth)


@pytest.mark.parametrize("half", ["positions", "quaternions"])
def test_half_a_reference_is_used_or_refused(half: str, kreisel: Command, tmp_path: Path) -> None:
    write_folder(poses(simulated()[1], **{half: None}), tmp_path / "run")
    ended = kreisel("calibrate", tmp_path / "run", "--no-validate", "--json")
    assert ended.status in (0, 1, 3)
    assert "unexpected" not in ended.err
    assert "Traceback" not in ended.err


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (too_much_without_numbers, ("run.mcap/imu/data_raw: message 501: of 8001 samples, 2000 without a number",)),
        (absurd_number, ("run.mcap/imu/data_raw: message 4001: w_x = 1e+300", "delete these messages")),
        (dead_gyro, ("run.mcap/imu/data_raw: dead channel: w_z",)),
        (degrees_per_second, ("[deg s^-1]", "ROS messages are in rad/s")),
        (stamp_twice, ("run.mcap/imu/data_raw: message 4001: the stamp 1019995000000 occurs twice",)),
        (microseconds, ("they look like [us]", "messages' headers")),
    ],
)
def test_a_fault_in_a_bag(fault: Break, words: tuple[str, ...], kreisel: Command, tmp_path: Path) -> None:
    write(fault(simulated()[1]), tmp_path / "run.mcap")
    ended = kreisel("calibrate", tmp_path / "run.mcap")
    assert ended.status == 1
    assert_one_line(ended.err, words)
    assert ", line " not in ended.err


@pytest.mark.parametrize("name", ["info", "convert"])
def test_other_commands_refuse_alike(name: str, kreisel: Command, tmp_path: Path) -> None:
    write_folder(absurd_number(simulated()[1]), tmp_path / "run")
    target = [tmp_path / "copy"] if name == "convert" else []
    ended = kreisel(name, tmp_path / "run", *target)
    assert ended.status == 1
    assert_one_line(ended.err, ("line 4002",))
