"""An arm that does otherwise than told, or than it reports, is noticed; what is not clear is not begun."""

import signal
import subprocess
import sys
import time

import pytest

from .test_run_faults import (
    BACK,
    LONG,
    PROMPT,
    SHORT,
    at_rest_for_long,
    confirmed,
    controller,
    ended,
    last_line,
    not_confirmed,
    stands,
    started,
)


def begun(tmp_path, simulator, *more, program=LONG + BACK):
    process = started(tmp_path, simulator, program, *more)
    simulator.wait_for_move(2)
    return process


def test_frozen_joint_angles_are_no_standstill(tmp_path):
    """Stamps advance, stops are lost, and the IMU on the flange turns."""
    with controller(deaf="all") as simulator:
        process = begun(tmp_path, simulator)
        at = time.monotonic()
        simulator.frozen = list(simulator.q)
        simulator.wait(simulator.told_to_stop)
        assert simulator.told_to_stop()[0] - at < PROMPT
        errors = ended(process, 1)
    assert "the motion was stopped" not in errors
    assert "the arm stands, whether stopped or at the end of its move" in errors or "NOT CONFIRMED" in errors
    assert "are the reported angles frozen, or is the IMU loose?" in errors


def test_a_stop_is_seen_by_joints_and_imu(tmp_path):
    with controller() as simulator:
        process = begun(tmp_path, simulator)
        process.send_signal(signal.SIGINT)
        errors = ended(process, 1)
    confirmed(tmp_path, errors, "stop requested")
    assert "and the IMU does not turn" in last_line(errors)


def test_the_offset_of_a_cheap_gyro_is_no_motion(tmp_path):
    with controller() as simulator:
        simulator.gyro_offset = 0.3  # 17 deg/s
        ended(started(tmp_path, simulator, SHORT), 0)
    assert len(simulator.moves()) == 3


def test_an_imu_that_is_not_on_the_arm_is_not_taken_for_a_witness(tmp_path):
    with controller() as simulator:
        simulator.held_imu = True
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2, angle_deg=40.0)
        process.send_signal(signal.SIGINT)
        errors = ended(process, 1)
    confirmed(tmp_path, errors, "stop requested")
    assert "by the joints alone: the IMU does not tell" in last_line(errors)


@pytest.mark.parametrize("factor", [3.0, 10.0])
def test_an_arm_that_is_faster_than_commanded_is_stopped(tmp_path, factor):
    with controller() as simulator:
        simulator.factor = factor
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        at = list(simulator.q)
        errors = ended(process, 1)
        assert stands(simulator)
        assert max(abs(a - b) for a, b in zip(simulator.q, at, strict=True)) < 0.5 * factor
    confirmed(tmp_path, errors, "rad/s of the command")


def test_joints_that_turn_one_after_another_leave_the_path(tmp_path):
    """The way between keep-out boxes is that of a move straight in joint angles."""
    with controller() as simulator:
        simulator.in_turn = True
        errors = ended(started(tmp_path, simulator), 1)
        assert stands(simulator)
    reasons = ("the arm leaves its path", "rad/s of the command")
    assert any(reason in last_line(errors) for reason in reasons)


def test_an_arm_that_turns_back_leaves_its_path(tmp_path):
    with controller() as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2, angle_deg=30.0)
        simulator.push((0, -90, 60, -60, -90, 0), speed=0.2)
        errors = ended(process, 1)
        assert stands(simulator)
    confirmed(tmp_path, errors, "the arm leaves its path")


def test_a_program_that_goes_on_at_the_target_is_not_ours(tmp_path):
    with controller() as simulator:
        process = started(
            tmp_path, simulator, LONG.replace("[150, -80, 70, -40, -60, 20]", "[10, -90, 60, -60, -90, 0]")
        )
        simulator.wait_for_move(2)
        simulator.foreign = True
        simulator.wait(simulator.told_to_stop)
        simulator.foreign = False
        errors = ended(process, 1)
    assert "the controller goes on with a program although the arm has arrived" in errors


def test_a_stop_that_does_not_brake_is_followed_by_the_next_at_once(tmp_path):
    with controller(deaf=range(9), dashboard=False) as simulator:
        process = begun(tmp_path, simulator)
        at = list(simulator.q)
        process.send_signal(signal.SIGINT)
        errors = ended(process, 1)
        assert max(abs(a - b) for a, b in zip(simulator.q, at, strict=True)) < 1.0
    confirmed(tmp_path, errors, "stop requested")


def test_a_tool_that_is_faster_than_allowed_is_stopped(tmp_path):
    with controller() as simulator:
        simulator.factor = 2.0
        errors = ended(started(tmp_path, simulator, LONG + BACK, "--tool-speed", "0.1"), 1)
        assert stands(simulator)
    assert last_line(errors).count("m/s that are allowed") + last_line(errors).count("rad/s of the command") == 1


def test_a_silent_device_is_noticed_within_a_third_of_a_second(tmp_path):
    with controller() as simulator:
        process = started(tmp_path, simulator, silence="0.2")
        simulator.wait_for_move(2)
        at = time.monotonic()
        simulator.silent = True
        simulator.wait(simulator.told_to_stop)
        assert simulator.told_to_stop()[0] - at < 0.35
        errors = ended(process, 1)
    not_confirmed(tmp_path, errors, "no joint angles for 0.2 s")


def test_a_stop_without_effect_is_not_called_a_stop(tmp_path):
    short = LONG.replace("[150, -80, 70, -40, -60, 20]", "[25, -90, 60, -60, -90, 0]")
    with controller(deaf="all") as simulator:
        process = begun(tmp_path, simulator, program=short)
        process.send_signal(signal.SIGINT)
        errors = ended(process, 1)
    assert "the motion was stopped" not in errors
    assert "the move was completed before the stop: stop requested" in last_line(errors)
    assert "it was not stopped on its way" in last_line(errors)


@pytest.mark.parametrize("state", [2, 4])  # playing, paused
def test_a_controller_that_runs_another_program_is_left_alone(tmp_path, state):
    with controller() as simulator:
        simulator.program = state
        errors = ended(started(tmp_path, simulator), 1)
        assert simulator.told == []
    assert "nothing was moved: the controller runs another program, or has paused one" in errors


def test_an_arm_that_moves_is_left_alone(tmp_path):
    with controller() as simulator:
        simulator.push((60, -90, 60, -60, -90, 0), speed=0.1)
        errors = ended(started(tmp_path, simulator), 1)
        assert simulator.told == []
    assert "the arm must stand before it is driven" in errors


def test_another_program_that_begins_at_rest_ends_the_motion(tmp_path):
    with controller() as simulator:
        process = begun(tmp_path, simulator, program=at_rest_for_long(SHORT))
        simulator.wait(lambda: simulator.program == 1)
        simulator.wait_for_ticks(150, 1.5)
        simulator.program = 2
        simulator.wait(simulator.told_to_stop)
        simulator.program = 1
        errors = ended(process, 1)
    confirmed(tmp_path, errors, "another program has been started on the controller")


def test_a_second_driver_is_refused(tmp_path):
    (tmp_path / "first").mkdir()
    (tmp_path / "second").mkdir()
    with controller() as simulator:
        process = started(tmp_path / "first", simulator)
        simulator.wait(simulator.moves)
        told = len(simulator.told)
        errors = ended(started(tmp_path / "second", simulator), 1)
        assert f"process {process.pid} drives the arm" in errors
        assert not simulator.told_to_stop()
        assert len(simulator.moves()) >= told
        process.send_signal(signal.SIGINT)
        ended(process, 1)


ROOM = "start_deg = [0, -90, 60, -60, -90, 0]\n[[move]]\njoints_deg = {}\nrest = 1.0\n"


@pytest.mark.parametrize(
    ("joints", "more", "words"),
    [
        ([0, 0, 60, -60, -90, 0], (), "m below the floor, which is taken to be at 0 m"),
        ([0, -90, 172, -60, -90, 0], (), "folds the arm onto itself"),
        ([60, -90, 60, -60, -90, 0], ("--keep-out=-0.3,-0.7,0.8,0,-0.5,1.2",), "into the keep-out box from (-0.3"),
        ([60, -90, 60, -60, -90, 0], ("--keep-out", "1,2"), "expected two corners"),
    ],
)
def test_a_program_that_touches_something_is_refused(tmp_path, joints, more, words):
    (tmp_path / "program.toml").write_text(ROOM.format(joints))
    done = subprocess.run(
        [sys.executable, "-m", "kreisel.cli.main", "run", "program.toml", "--robot", "rtde://127.0.0.1:9", "--imu", "csv://127.0.0.1:9",
         "--model", "ur10e", *more],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 1
    assert words in done.stderr


def test_the_tool_is_slowed_down_and_that_is_said(tmp_path):
    (tmp_path / "program.toml").write_text(ROOM.format([60, -90, 60, -60, -90, 0]) + BACK)
    done = subprocess.run(
        [sys.executable, "-m", "kreisel.cli.main", "run", "program.toml", "--robot", "rtde://127.0.0.1:9", "--imu", "csv://127.0.0.1:9",
         "--model", "ur10e"],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "slowed down, so that the tool stays below 0.25 m/s" in done.stdout
    assert "above the floor" in done.stdout
