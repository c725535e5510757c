"""What becomes of an arm in motion when the computer that moves it fails: it stands within half a second.

The twin is `tests/ur_simulator.py`; its watchdogs are those of the maker's description of URScript.
"""

import json
import math
import signal
import socket
import subprocess
import time
from urllib.parse import urlsplit

import numpy as np
import pytest

from kreisel.protocols import ekrl

from .test_run import KUKA, command, run_kuka
from .test_run_faults import BACK, LONG, controller, ended, started

WITHIN = 0.5
"""s; from the failure to the standstill."""


@pytest.fixture
def twin():
    with controller(patience=0.0) as simulator:
        yield simulator


def travelled(simulator, begun):
    """Degrees that any joint has turned since."""
    return math.degrees(max(abs(a - b) for a, b in zip(simulator.q, begun, strict=True)))


def stands_after(simulator, act):
    """Do something, and return the seconds until the arm stood, and the degrees that it travelled."""
    begun, at = list(simulator.q), time.monotonic()
    act()
    simulator.wait(lambda: simulator.barked)
    stood = list(simulator.q)
    simulator.wait_for_ticks(40, 0.5)
    assert simulator.q == stood
    seconds, degrees = simulator.barked[0] - at, travelled(simulator, begun)
    print(f"stood after {seconds:.2f} s and {degrees:.1f} deg")
    return seconds, degrees


def stands_without(tmp_path, how, program, number):
    """Return what `stands_after` does of an arm whose process is hurt in a move; None if the process stopped it before.

    On a computer that is too busy that is right: states of the arm come too late.
    """
    tmp_path.mkdir()
    with controller(patience=0.0) as simulator:
        process = started(tmp_path, simulator, program)
        try:
            simulator.wait(lambda: len(simulator.moves()) >= number or process.poll() is not None)
            if process.poll() is not None:
                assert simulator.told_to_stop()
                return None
            simulator.wait_for_move(number)
            out = stands_after(simulator, lambda: process.send_signal(how))
            assert not simulator.told_to_stop()
            return out
        finally:
            process.kill()
            print(process.communicate()[1])


@pytest.mark.parametrize("move", [1, 2])  # the slow first one, and a fast one
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_the_arm_stands_when_the_process_is_killed_or_hangs(tmp_path, how, move):
    first = "start_deg = [0, -90, 60, -60, -90, 0]\n[[move]]\njoints_deg = [150, -80, 70, -40, -60, 20]\nrest = 0.5\n"
    program, number = ((LONG if move == 1 else first) + BACK, 2 if move == 1 else 3)
    trials = (stands_without(tmp_path / str(k), how, program, number) for k in range(10))
    found = next((found for found in trials if found is not None), None)
    assert found is not None, "the process stopped the arm itself, ten times; what it said is printed above"
    seconds, degrees = found
    assert seconds < WITHIN
    assert degrees < 30.0


def test_the_arm_stands_when_the_cable_is_cut(tmp_path, twin):
    """Nothing is closed: bytes no longer arrive, in either direction."""
    process = started(tmp_path, twin)
    try:
        twin.wait_for_move(2)
        seconds, _ = stands_after(twin, lambda: setattr(twin, "cut", True))
        process.send_signal(signal.SIGINT)
        errors = ended(process, 1)
    finally:
        process.kill()
    assert seconds < WITHIN
    assert "THE STOP IS NOT CONFIRMED" in errors


def test_without_a_watchdog_that_is_said_before_the_first_move(tmp_path):
    with controller(registers=()) as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(1)
        process.send_signal(signal.SIGINT)
        errors = ended(process, 1)
    said = errors.index("NOTHING STOPS THE ARM IF THIS COMPUTER FAILS")
    assert said < errors.index("move 0 of")


def test_a_register_that_another_program_writes_is_left_to_it(tmp_path):
    with controller(in_use=(24,)) as simulator:
        errors = ended(started(tmp_path, simulator), 1)
        assert simulator.moves() == []
        assert "another program writes input_int_register_24" in errors
        assert "?watchdog=25" in errors
        (tmp_path / "run" / "recording.mcap").unlink()
        simulator.robot += "&watchdog=31"
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        process.send_signal(signal.SIGINT)
        assert "input_int_register_31 is not written for 0.1 s" in ended(process, 1)


def test_the_last_way_to_stop_is_silence(tmp_path):
    with controller(deaf=range(9), dashboard=False) as simulator:
        process = started(tmp_path, simulator)
        simulator.wait_for_move(2)
        process.send_signal(signal.SIGINT)
        errors = ended(process, 1)
        assert simulator.barked
    assert "the motion was stopped" in errors
    assert "no more heartbeats for the watchdog: sent" in errors


def states(port, seconds):
    """The joint angles that a controller tells, (n, 6)."""
    splitter, out, ends = ekrl.Splitter("Robot"), [], time.monotonic() + seconds
    with socket.create_connection(("127.0.0.1", port), timeout=10.0) as connection:
        while time.monotonic() < ends:
            out += [ekrl.decode_state(one).sample.joints for one in splitter.receive(connection.recv(4096))]
    return np.array(out)


def test_a_computer_that_is_late_is_told_why_the_arm_stopped(tmp_path, twin):
    process = started(tmp_path, twin)
    twin.wait_for_move(2)
    process.send_signal(signal.SIGSTOP)
    twin.wait(lambda: twin.barked)
    process.send_signal(signal.SIGCONT)
    errors = ended(process, 1)
    assert "the controller has ended the move away from its target: its watchdog did so" in errors
    assert "this computer is too busy" in errors


def test_a_kuka_arm_brakes_when_the_process_hangs(tmp_path):
    """Against the simulated controller, whose poses are read beside the hanging process."""
    (tmp_path / "program.toml").write_text(KUKA)
    (tmp_path / "cell.toml").write_text('seed = 3\n[robot]\nmodel = "kr125"\n[motion]\nprogram = "program.toml"\n')
    cell = subprocess.Popen(
        command("virtual-cell", "cell.toml", "--robot", "ekrl", "--imu", "csv", "--obey"),
        cwd=tmp_path, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    process = None
    try:
        where = json.loads(cell.stdout.readline())
        process = subprocess.Popen(run_kuka(where, tmp_path), stderr=subprocess.PIPE, text=True)
        while "move 1 of" not in process.stderr.readline():
            pass
        port = int(urlsplit(where["robot"]).port)
        while abs(states(port, 0.2)[-1, 0]) < 0.05:
            pass
        process.send_signal(signal.SIGSTOP)
        seen = states(port, seconds=1.0)
        for _ in range(15):  # on a busy machine the simulated controller waits for longer, and fewer states are seen
            if len(seen) > 2 and np.ptp(seen, axis=0).max() < 1e-9:
                break
            seen = states(port, seconds=1.0)
    finally:
        for one in (process, cell):
            if one is not None:
                one.kill()
                one.communicate()
    assert np.ptp(seen, axis=0).max() < 1e-9
    assert 0.01 < abs(seen[-1, 0]) < np.radians(29.0)  # on its way from 0 to 30 deg
