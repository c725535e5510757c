"""Driving an arm whose controller does what it should not: see `tests/ur_simulator.py`.

What the command must do quickly is measured from the fault to the stop that the simulator is told. How long a command
takes to start and to end says more about the machine: there is only a limit that failures reach.
"""

import math
import re
import resource
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from kreisel.acquisition.motion_watch import ENDED

from ..ur_simulator import LIMIT, UR5E, UrSimulator

START = (0, -90, 60, -60, -90, 0)
SHORT = "start_deg = [0, -90, 60, -60, -90, 0]\n" + "".join(
    f"[[move]]\njoints_deg = {joints}\nrest = 0.5\n"
    for joints in ([10, -80, 70, -60, -80, 10], [0, -90, 60, -60, -90, 0])
)
LONG = "start_deg = [0, -90, 60, -60, -90, 0]\n[[move]]\njoints_deg = [150, -80, 70, -40, -60, 20]\nrest = 1.0\n"
PROMPT = 1.0
"""s; from a fault to the stop."""

BACK = "[[move]]\njoints_deg = [0, -90, 60, -60, -90, 0]\nrest = 1.0\n"


@contextmanager
def controller(**how):
    simulator = UrSimulator(how.pop("joints_deg", START), **how)
    try:
        yield simulator
    finally:
        simulator.close()


def started(tmp_path, simulator, program=LONG + BACK, *more, silence="1", **how):
    """Start a run; where a test is not about silence, threads of the twin may be late."""
    (tmp_path / "program.toml").write_text(program)
    return subprocess.Popen(
        [sys.executable, "-m", "kreisel.cli.main", "run", "program.toml", "--robot", simulator.robot,
         "--imu", simulator.imu, "--model", "ur10e", "--tool-speed", "3", "--silence", silence, *more,
         "-o", "run", "--arm"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **how,
    )  # fmt: skip


def at_rest_for_long(program):
    """Return the program with rests that last longer than anything the test waits for."""
    return program.replace("rest = 0.5", f"rest = {2 * LIMIT}")


def ended(process, code):
    """Return what it wrote on standard error."""
    out, errors = process.communicate(timeout=LIMIT)
    assert process.returncode == code, (out, errors)
    assert "Traceback" not in errors
    return errors


def last_line(errors):
    return errors.strip().splitlines()[-1]


def stands(simulator):
    before = list(simulator.q)
    simulator.wait_for_ticks(20, 0.3)
    return simulator.q == before


def confirmed(tmp_path, errors, reason):
    line = last_line(errors)
    assert "the motion was stopped: " in line
    assert reason in line
    assert "the joints have stood still for" in line
    assert "NOT CONFIRMED" not in errors.splitlines()[-1]  # on a busy machine the first look may be too early
    assert (tmp_path / "run" / "recording.mcap").stat().st_size > 1000


def not_confirmed(tmp_path, errors, reason):
    line = last_line(errors)
    assert "THE STOP IS NOT CONFIRMED: press the emergency stop" in line
    assert reason in line
    assert "the motion was stopped" not in errors
    assert (tmp_path / "run" / "recording.mcap").stat().st_size > 1000


@pytest.mark.parametrize(
    "offered",
    [
        (),
        pytest.param(("safety_mode",), marks=pytest.mark.slow),
        pytest.param(("safety_status", "safety_mode", "robot_mode", "runtime_state"), marks=pytest.mark.slow),
    ],
)
def test_a_controller_with_few_fields_and_a_state_in_pieces_is_driven(tmp_path, offered):
    with controller(offered=offered, pieces=True, dashboard=False) as simulator:
        errors = ended(started(tmp_path, simulator, SHORT), 0)
    assert len(simulator.moves()) == 3
    assert "the reported pose is that of the model 'ur10e' with a tool of 0 mm" in errors


def test_a_script_connection_closed_in_a_move_stops_the_arm_over_a_new_one(tmp_path):
    with controller() as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        closed = time.monotonic()
        simulator.close_scripts()
        errors = ended(process, 1)
        assert simulator.told_to_stop()[0] - closed < PROMPT
        assert stands(simulator)
    assert len(simulator.moves()) == 2
    confirmed(tmp_path, errors, "the script connection has ended (closed by the controller)")


def test_a_script_connection_closed_at_rest_gets_no_move(tmp_path):
    with controller() as simulator:
        process = started(tmp_path, simulator, at_rest_for_long(SHORT))
        simulator.wait_for_move(2)
        simulator.wait(lambda: simulator.program == 1)
        simulator.wait_for_ticks(100, 1.0)
        simulator.close_scripts()
        errors = ended(process, 1)
    assert len(simulator.moves()) == 2
    assert "move 2 of 2" not in errors
    confirmed(tmp_path, errors, "the script connection has ended")


def test_the_dashboard_stops_the_arm_where_no_script_is_taken(tmp_path):
    with controller() as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        simulator.close_scripts(listen=False)
        errors = ended(process, 1)
        assert stands(simulator)
    assert simulator.told[-1][1:] == ("dashboard", "stop")
    confirmed(tmp_path, errors, "'stop' to the dashboard server")


@pytest.mark.parametrize("dashboard", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_an_arm_that_moves_on_is_reported_as_not_stopped(tmp_path, dashboard):
    with controller(deaf="all", dashboard=dashboard) as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        simulator.close_scripts(listen=False)
        errors = ended(process, 1)
        assert not stands(simulator)
    not_confirmed(tmp_path, errors, "the joints still move")


@pytest.mark.parametrize(
    "name", ["SIGINT", *(pytest.param(name, marks=pytest.mark.slow) for name in ("SIGTERM", "SIGHUP", "SIGQUIT"))]
)
def test_signals_stop_the_arm(tmp_path, name):
    with controller() as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        process.send_signal(getattr(signal, name))
        errors = ended(process, 1)
        assert stands(simulator)
    assert len(simulator.moves()) == 2
    assert f"{name}: the arm is to stop" in errors
    confirmed(tmp_path, errors, "stop requested")


def test_a_terminal_that_is_gone_does_not_keep_the_arm_from_being_stopped(tmp_path):
    """As where it is closed: nothing can be written any more, and SIGHUP comes."""
    with controller() as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        process.stderr.close()
        process.stdout.close()
        process.send_signal(signal.SIGHUP)
        assert process.wait(LIMIT) != 0
        assert stands(simulator)
    assert simulator.told_to_stop()


def test_an_interrupt_that_the_controller_ignores_is_not_a_stop(tmp_path):
    with controller(deaf="all") as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        process.send_signal(signal.SIGINT)
        errors = ended(process, 1)
        assert not stands(simulator)
    not_confirmed(tmp_path, errors, "stop requested")
    assert "the answer is 'Failed to execute: stop'" in last_line(errors)


def test_a_stop_that_one_connection_ignores_is_sent_over_another(tmp_path):
    with controller(deaf=(0,)) as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        process.send_signal(signal.SIGINT)
        errors = ended(process, 1)
        assert stands(simulator)
    assert [number for _, number, line in simulator.told if line.startswith("stopj")] == [0, 1]
    confirmed(tmp_path, errors, "stopj over a new script connection: sent")


@pytest.mark.slow
def test_an_arm_that_has_not_begun_its_move_yet_is_watched_for_longer(tmp_path):
    with controller(deaf="all", delay=1.5) as simulator:
        process = started(tmp_path, simulator)
        simulator.wait(lambda: len(simulator.moves()) == 2)
        process.send_signal(signal.SIGINT)
        errors = ended(process, 1)
    not_confirmed(tmp_path, errors, "stop requested")


@pytest.mark.slow
@pytest.mark.parametrize("state", [2, 4])  # playing, paused
def test_an_arm_that_stands_within_a_program_is_not_stopped(tmp_path, state):
    with controller(deaf="all") as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        simulator.dwell(LIMIT)
        simulator.program = state
        process.send_signal(signal.SIGINT)
        errors = ended(process, 1)
    not_confirmed(tmp_path, errors, "the controller still holds a program and may continue it")


def test_an_arm_that_somebody_else_moves_at_rest_is_stopped(tmp_path):
    with controller() as simulator:
        process = started(tmp_path, simulator, at_rest_for_long(SHORT))
        simulator.wait_for_move(2)
        simulator.wait(lambda: simulator.program == 1)
        simulator.wait_for_ticks(100, 1.0)
        pushed = time.monotonic()
        simulator.push((100, -80, 70, -40, -60, 20))
        errors = ended(process, 1)
        assert simulator.told_to_stop()[0] - pushed < PROMPT
        assert stands(simulator)
    assert len(simulator.moves()) == 2
    confirmed(tmp_path, errors, "the arm moves during a rest")


def test_an_arm_that_leaves_the_way_of_its_move_is_stopped(tmp_path):
    with controller() as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        simulator.push((-90, -90, 60, -60, -90, 0))
        errors = ended(process, 1)
        assert stands(simulator)
    # whichever of the two sees it first
    reasons = (
        "joint_1 turns at 0.50 rad/s, more than the 0.36 rad/s of the command",
        "the IMU turns faster than the commanded motion can turn it",
    )
    confirmed(tmp_path, errors, next((reason for reason in reasons if reason in errors), reasons[0]))


@pytest.mark.parametrize(
    ("offered", "state", "words"),
    [
        (("safety_status",), 3, "protective stop (safety_status 3)"),
        pytest.param(("safety_mode",), 6, "system emergency stop (safety_mode 6)", marks=pytest.mark.slow),
        ((), None, "emergency stop"),
    ],
)
def test_stops_of_the_controller_end_the_wait_at_once(tmp_path, offered, state, words):
    with controller(offered=offered, pieces=True) as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        at = time.monotonic()
        simulator.halt()
        if state is None:
            simulator.script_state = (1, 0)
        else:
            simulator.safety = state
        errors = ended(process, 1)
        assert simulator.told_to_stop()[0] - at < PROMPT
    assert len(simulator.moves()) == 2
    confirmed(tmp_path, errors, f"the controller reports: {words}")


def test_nothing_is_moved_while_the_controller_is_stopped(tmp_path):
    with controller() as simulator:
        simulator.safety = 7
        errors = ended(started(tmp_path, simulator), 1)
    assert "nothing was moved: the controller reports: robot emergency stop (safety_status 7)" in errors
    assert simulator.told == []


def test_a_move_that_the_controller_ends_is_noticed(tmp_path):
    with controller() as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        at = time.monotonic()
        simulator.halt()
        errors = ended(process, 1)
        assert simulator.told_to_stop()[0] - at < ENDED + PROMPT
    confirmed(tmp_path, errors, "the controller has ended the move away from its target")


def test_a_stop_that_cannot_be_seen_is_not_confirmed(tmp_path):
    with controller() as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        simulator.close_rtde()
        errors = ended(process, 1)
    assert simulator.told_to_stop()
    not_confirmed(tmp_path, errors, "no joint angles are received")


@pytest.mark.slow
def test_a_silent_robot_stream_stops_the_arm(tmp_path):
    with controller() as simulator:
        process = started(tmp_path, simulator, silence="0.2")
        simulator.wait_for_move(2)
        simulator.silent = True
        errors = ended(process, 1)
        assert stands(simulator)
    not_confirmed(tmp_path, errors, "no joint angles for 0.2 s")


@pytest.mark.slow
def test_a_recording_that_cannot_be_written_stops_the_arm_and_its_rest_is_seen(tmp_path):
    def little_space():
        resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))

    with controller() as simulator:
        process = started(tmp_path, simulator, preexec_fn=little_space)
        errors = ended(process, 1)
        assert stands(simulator)
    assert simulator.told_to_stop()
    assert "cannot be written any more (File too large)" in last_line(errors)
    assert "the motion was stopped: the joints have stood still" in last_line(errors)


def test_a_recording_that_exists_is_named_and_nothing_is_moved(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "recording.mcap").write_bytes(b"precious")
    with controller() as simulator:
        errors = ended(started(tmp_path, simulator), 1)
    assert simulator.told == []
    assert "exists already" in last_line(errors)


@pytest.mark.slow
def test_an_arm_far_from_the_start_is_not_moved_unless_that_is_allowed(tmp_path):
    with controller(joints_deg=(0, -90, 60, -48, -90, 0)) as simulator:
        errors = ended(started(tmp_path, simulator, SHORT), 1)
        assert simulator.moves() == []
        assert re.search(r"joint_4 is 12\.0 deg from the program's start .*0\.0, -12\.0, 0\.0.*--approach 12", errors)
        (tmp_path / "run" / "recording.mcap").unlink()
        ended(started(tmp_path, simulator, SHORT, "--approach", "12.5"), 0)
        assert len(simulator.moves()) == 3
    assert all(float(re.search(r"v=([\d.]+)", line)[1]) <= 0.25 for line in simulator.moves()[:2])


def test_another_robot_is_stopped_in_the_first_move(tmp_path):
    with controller(robot=UR5E) as simulator:
        errors = ended(started(tmp_path, simulator), 1)
        assert simulator.moves() == []
        assert "the reported pose is that of the model 'ur10e' only with a tool of 332 mm" in errors
        (tmp_path / "run" / "recording.mcap").unlink()
        rich = LONG.replace("[150, -80, 70, -40, -60, 20]", "[40, -70, 80, -20, -50, 60]") + BACK
        errors = ended(started(tmp_path, simulator, rich, "--longest-tool", "0.5"), 1)
        assert len(simulator.moves()) == 2
        assert abs(math.degrees(simulator.q[0])) < 20.0
    confirmed(tmp_path, errors, "do not follow the model 'ur10e'")


@pytest.mark.parametrize("arm", [True, False])
def test_moves_faster_than_the_model_allows_are_refused(tmp_path, arm):
    with controller() as simulator:
        process = started(tmp_path, simulator, LONG + BACK, "--speed", "3.0")
        if not arm:
            process.kill()
            process.communicate()
            process = subprocess.Popen(
                process.args[:-3], cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.PIPE,
                text=True,
            )  # fmt: skip
        errors = ended(process, 1)
    assert "move 2: joint_1 moves at 3.00 rad/s, and its limit in the model 'ur10e' is 2.09 rad/s" in errors
    assert "give --speed 2.09 or less" in errors
    assert simulator.told == []
