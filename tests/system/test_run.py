"""Driving a program: what is sent, and what makes the arm stop."""

import asyncio
import json
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import kreisel
from kreisel.acquisition import drive as driving
from kreisel.acquisition.drive import drive
from kreisel.acquisition.motion_watch import Watch
from kreisel.devices.commanded_arm import CommandedArm
from kreisel.devices.events import Arrival, Level, Notice
from kreisel.errors import ProtocolError, SettingsError
from kreisel.protocols import urscript
from kreisel.protocols.samples import ImuSample, RobotSample
from kreisel.robot.kinematics import load_arm
from kreisel.robot.motion import Move
from kreisel.robot.program import Program
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell

PROGRAM = """
start_deg = [0, -90, 60, -60, -90, 0]
[[move]]
joints_deg = [40, -70, 80, -20, -50, 60]
rest = 1.0
[[move]]
joints_deg = [-50, -110, 100, 40, 30, -80]
rest = 1.0
[[move]]
joints_deg = [20, -60, 40, -120, -120, 40]
rest = 1.0
[[move]]
joints_deg = [-30, -120, 120, 100, 60, -60]
rest = 1.0
[[move]]
joints_deg = [60, -80, 70, -100, -20, 120]
rest = 1.0
[[move]]
joints_deg = [-20, -100, 50, 60, -100, -120]
rest = 1.0
"""
START = np.radians([0, -90, 60, -60, -90, 0])
AWAY = np.radians([40, -70, 80, -20, -50, 60])
LIMIT = 300.0
"""Seconds after which a command is taken to hang; reached by failures alone."""

PATIENCE = "3"
"""s; a simulated cell is one process on a machine that does much else, and no device of its own."""

ARM = load_arm("ur10e")


class Arm:
    """An arm that is where it was sent within half a second, or never comes to rest; it notes what it was told.

    It reports its joints all the while; once told to stop it stands, unless it does not obey.
    """

    full_speed = 1.0
    excuse = ""
    straight = True

    def __init__(self, watch, *, arrives=True, obeys=True):
        self.told = []
        self.trouble = None
        self.ways = (("a stop", self.stop),)
        self._watch, self._arrives, self._obeys = watch, arrives, obeys
        self._at, self._turning = START.copy(), False

    async def report(self):
        while True:
            now = time.monotonic_ns()
            if self._turning:
                self._at = self._at + 1e-3
            self._watch.take(Arrival(RobotSample(now, None, None, tuple(self._at.tolist())), now))
            self._watch.take(Arrival(ImuSample(now, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)), now))
            await asyncio.sleep(0.01)

    async def move(self, target, speed):
        self.told.append(("move", target.tolist()))
        if self._arrives:
            self._at = target
        else:
            self._turning = True

    async def stop(self):
        self.told.append(("stop",))
        self._turning = self._turning and not self._obeys

    async def connect(self):
        pass

    async def close(self):
        pass

    def describe(self, target, speed):
        return "a move"

    def peaks(self, way, speed, limits):
        """It is there at once."""
        return np.full(6, np.inf), None


def driven(disturb, *, arrives=True, obeys=True, moves=2, **more):
    """Drive while something is done to watch and stop; return how it ended, and what the arm was told."""

    async def all_of_it():
        watch, stop = Watch(ARM), asyncio.Event()
        arm = Arm(watch, arrives=arrives, obeys=obeys)
        program = Program(START, tuple(Move(AWAY, 0.2) for _ in range(moves)))
        reporting = asyncio.ensure_future(arm.report())
        await asyncio.sleep(0.05)
        asyncio.get_running_loop().call_later(0.3, disturb, watch, stop)
        try:
            return await drive(program, arm, watch, stop, lambda text: None, **more), arm.told
        finally:
            reporting.cancel()

    return asyncio.run(all_of_it())


def nothing(watch, stop):
    pass


def report(watch, joints=(0.0,) * 6, blocked=""):
    now = time.monotonic_ns()
    watch.take(Arrival(RobotSample(now, None, None, joints, blocked), now))


def test_every_move_is_sent_once_and_in_order():
    ended, told = driven(nothing)
    assert str(ended) == "done"
    assert told == [("move", START.tolist()), ("move", AWAY.tolist()), ("move", AWAY.tolist())]


def test_it_ends_between_moves_once_enough_is_known():
    ended, told = driven(nothing, enough=lambda: True)
    assert str(ended) == "enough"
    assert told == []


@pytest.mark.parametrize(
    ("disturb", "reason"),
    [
        (lambda watch, stop: stop.set(), "stop requested"),
        (lambda watch, stop: watch.take(Notice(Level.LOST, "the IMU is lost", 0)), "the IMU is lost"),
        (lambda watch, stop: report(watch, blocked="protective stop"), "the controller reports: protective stop"),
        (
            lambda watch, stop: report(watch, joints=(6.27, 0, 0, 0, 0, 0)),
            "is at 359.2 deg, within a degree of its limits -360 to 360 deg",
        ),
        (
            lambda watch, stop: [
                watch.take(Arrival(ImuSample(k, (0.1 * k, 5.0, 0.2 * k), (0.3 * k, 0.0, 9.8)), time.monotonic_ns()))
                for k in range(30)
            ],
            "the IMU is saturated: w_y stays at 5 while the others change",
        ),
    ],
)
def test_the_motion_is_stopped(disturb, reason):
    for arrives in (True, False):
        ended, told = driven(disturb, arrives=arrives, moves=8)
        assert str(ended).startswith("stopped: ")
        assert reason in ended.reason
        assert ended.stop.confirmed
        assert "stood still" in ended.stop.text
        assert told[-1] == ("stop",)


def test_a_stop_is_not_confirmed_while_the_joints_move():
    ended, told = driven(lambda watch, stop: stop.set(), arrives=False, obeys=False)
    assert str(ended) == "stop NOT confirmed: stop requested"
    assert "the joints still move" in ended.stop.text
    assert told[-2:] == [("stop",), ("stop",)]


def test_warnings_stop_nothing():
    ended, _ = driven(lambda watch, stop: watch.take(Notice(Level.WARNING, "a line was no line", 0)))
    assert str(ended) == "done"


def test_an_arm_that_does_not_arrive_is_stopped(monkeypatch):
    monkeypatch.setattr(driving, "_longest", lambda move, watch: 0.2)
    ended, told = driven(nothing, arrives=False)
    assert "did not come to rest at its target" in ended.reason
    assert told[-1] == ("stop",)


def test_a_driver_that_is_cancelled_stops_the_arm():
    async def all_of_it():
        watch = Watch(ARM)
        arm = Arm(watch, arrives=False)
        task = asyncio.ensure_future(
            drive(Program(START, (Move(AWAY, 1.0),)), arm, watch, asyncio.Event(), lambda text: None)
        )
        reporting = asyncio.ensure_future(arm.report())
        await asyncio.sleep(0.1)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        reporting.cancel()
        return arm.told

    assert asyncio.run(all_of_it())[-1] == ("stop",)


def test_a_sensor_at_rest_is_not_saturated():
    watch = Watch(ARM)
    for k in range(1000):
        watch.take(Arrival(ImuSample(k, (0.0, 0.001, 0.0), (0.0, 0.0, 9.8 + 0.001 * (k % 2))), 0))
    assert watch.alarm is None


def test_lines_are_read_as_they_were_written():
    move = urscript.JointMove((0.1, -1.5, 2.0, -0.25, 1e-9, 3.0), 1.4, 1.05)
    assert urscript.encode(move) == (
        b"movej([0.100000000, -1.500000000, 2.000000000, -0.250000000, 0.000000001, 3.000000000],a=1.4000,v=1.0500)\n"
    )
    assert urscript.decode(urscript.encode(move)) == move
    assert urscript.decode(urscript.encode(urscript.Stop())) == urscript.Stop()
    for line in (b"", b"movej([1,2,3],a=1,v=1)", b"set_digital_out(1, True)", b"\xff" * 9000):
        with pytest.raises(ProtocolError):
            urscript.decode(line)


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    folder = tmp_path_factory.mktemp("program")
    (folder / "program.toml").write_text(PROGRAM)
    (folder / "cell.toml").write_text('seed = 3\n[robot]\nmodel = "ur10e"\n[motion]\nprogram = "program.toml"\n')
    return folder


def test_the_commanded_arm_waits_moves_and_refuses(program):
    recording = simulate(
        Cell.model_validate({
            "robot": {"model": "ur10e"}, "motion": {"program": str(program / "program.toml")},
            "reference": {"interval": 0.002},
        }),
        program,
    )[1]  # fmt: skip
    cell = CommandedArm(recording)
    stamps = ([], [])
    angles = []

    def wait(seconds):
        for _ in range(round(seconds / 0.004)):
            for kept, new in zip(stamps, cell.advance(0.004), strict=True):
                kept.extend(sample.stamp_ns for sample in new)
                angles.extend(sample.joints for sample in new if isinstance(sample, RobotSample))

    wait(20.0)
    assert np.ptp(angles, axis=0).max() < 1e-9
    assert cell.move(AWAY + 0.1) == "a move to another target than the program's 1"
    assert cell.move(AWAY) is None
    assert cell.move(AWAY) == "a move while another is under way"
    wait(20.0)
    assert angles[-1] == pytest.approx(AWAY, abs=1e-6)
    for kept, interval in zip(stamps, (recording.imu.interval, 0.002), strict=True):
        assert np.diff(kept) == pytest.approx(interval * 1e9, abs=1)
    assert cell.move(np.radians([-50, -110, 100, 40, 30, -80])) is None
    wait(1.0)
    cell.stop()
    count = len(angles)
    wait(5.0)
    assert len(angles) == count + 2500  # it stands, and goes on to tell so
    assert np.ptp(angles[count:], axis=0).max() == 0.0
    for kept, interval in zip(stamps, (recording.imu.interval, 0.002), strict=True):
        assert np.diff(kept) == pytest.approx(interval * 1e9, abs=1)


def command(*arguments):
    return [sys.executable, "-m", "kreisel.cli.main", *map(str, arguments)]


@pytest.fixture
def cell(program):
    """Start the commanded arm by its command; give its addresses."""
    process = subprocess.Popen(
        command("virtual-cell", "cell.toml", "--robot", "rtde", "--obey", "--tool-speed", "3"),
        cwd=program,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield json.loads(process.stdout.readline())
    finally:
        process.terminate()
        process.communicate()


def test_without_arming_nothing_is_needed_and_nothing_sent(program):
    done = subprocess.run(
        command(
            "run", "program.toml", "--robot", "rtde://127.0.0.1:9", "--imu", "csv://127.0.0.1:9", "--model", "ur10e",
            "--picture", "path.html", "--keep-out", "5,5,0,6,6,1"
        ),
        cwd=program, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.startswith("nothing is moved")
    assert re.search(r"tool speed\W+[\d.]+ m/s\W+0.25 m/s\W+\d+ %", done.stdout)
    page = (program / "path.html").read_text(encoding="utf-8")
    for text in ("Path of a program", "keep out", "floor, 0 m", "joint_6 angle"):
        assert text in page
    assert done.stdout.count("movej(") == 7


def run_of(program, cell, output, *more, name="program.toml"):
    return command(
        "run", program / name, "--robot", cell["robot"], "--imu", cell["imu"], "--model", "ur10e",
        "--tool-speed", "3", "--silence", PATIENCE, "-o", output, "--arm", *more,
    )  # fmt: skip


@pytest.mark.slow
def test_a_program_is_driven_recorded_and_found_again(program, cell, tmp_path):
    done = subprocess.run(run_of(program, cell, tmp_path / "run"), capture_output=True, text=True, timeout=LIMIT)
    assert done.returncode == 0, done.stderr
    assert "; done; next" in done.stdout
    calibration = kreisel.calibrate(kreisel.load(tmp_path / "run"))
    assert calibration.document["verdict"]["accepted"]
    assert len(calibration.document["accelerometer"]["offset"]) == 3


@pytest.mark.slow
def test_it_ends_early_when_enough_is_known(program, cell, tmp_path):
    """The arm rests for long before the last move, so that a slow machine has the time to calibrate too."""
    parts = PROGRAM.rsplit("rest = 1.0", 2)
    (program / "patient.toml").write_text("rest = 90.0".join(parts[:2]) + "rest = 1.0" + parts[2])
    done = subprocess.run(
        run_of(program, cell, tmp_path / "run", "--until", "timing.offset=1000ms", name="patient.toml"),
        capture_output=True, text=True, timeout=LIMIT, check=True,
    )  # fmt: skip
    assert "; enough; next" in done.stdout, done.stderr


def test_an_interrupt_stops_the_arm_and_keeps_the_recording(program, cell, tmp_path):
    process = subprocess.Popen(run_of(program, cell, tmp_path / "run"), stderr=subprocess.PIPE, text=True)
    while "move 1" not in process.stderr.readline():
        pass
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=LIMIT)
    assert process.returncode == 1
    assert "the motion was stopped: stop requested; what was recorded is kept" in errors
    assert "Traceback" not in errors
    assert (tmp_path / "run" / "recording.mcap").stat().st_size > 10_000


def test_the_page_shows_the_program_while_it_runs(program, cell, tmp_path):
    client = pytest.importorskip("websockets.sync.client")
    process = subprocess.Popen(
        run_of(program, cell, tmp_path / "run", "--dashboard", "--port", "0"),
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        url = process.stdout.readline().strip()
        with client.connect(f"{url.replace('http', 'ws', 1)}/live") as page:
            seen = {}
            while not (seen.get("status", {}).get("imu", {}).get("count") and seen.get("pose", {}).get("arm")):
                message = json.loads(page.recv(timeout=LIMIT))
                seen[message["kind"]] = message
            begun = seen["pose"]["pose"][:3]
            while np.linalg.norm(np.subtract(seen["pose"]["pose"][:3], begun)) < 0.1:  # it moves
                message = json.loads(page.recv(timeout=LIMIT))
                seen[message["kind"]] = message
    finally:
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=LIMIT)
    assert "the motion was stopped: stop requested; what was recorded is kept" in errors
    assert "Traceback" not in errors
    with pytest.raises(OSError, match="refused"):  # the page goes with the program
        client.connect(f"{url.replace('http', 'ws', 1)}/live")


KUKA = """
start_deg = [0, -90, 90, 0, 30, 0]
[[move]]
joints_deg = [30, -70, 80, 20, 50, 40]
rest = 1.0
[[move]]
joints_deg = [-30, -100, 100, -60, 40, -80]
rest = 1.0
[[move]]
joints_deg = [20, -60, 70, 80, -50, 100]
rest = 1.0
"""


@pytest.fixture(params=[pytest.param("rsi", marks=pytest.mark.slow), "ekrl"])
def kuka(request, tmp_path):
    """Start a commanded KUKA arm, which tells its poses by RSI or by kreisel's program; give its addresses."""
    (tmp_path / "program.toml").write_text(KUKA)
    (tmp_path / "cell.toml").write_text('seed = 3\n[robot]\nmodel = "kr125"\n[motion]\nprogram = "program.toml"\n')
    process = subprocess.Popen(
        command("virtual-cell", "cell.toml", "--robot", request.param, "--imu", "csv", "--obey", "--tool-speed", "3"),
        cwd=tmp_path, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        yield json.loads(process.stdout.readline())
    finally:
        process.terminate()
        process.communicate()


def run_kuka(kuka, tmp_path, program="program.toml"):
    return command(
        "run", tmp_path / program, "--robot", kuka["robot"], "--imu", kuka["imu"], "--mover", kuka["mover"],
        "--model", "kr125", "--tool-speed", "3", "--silence", PATIENCE, "-o", tmp_path / "run", "--arm",
    )  # fmt: skip


@pytest.mark.slow
def test_a_kuka_arm_is_driven_and_recorded(kuka, tmp_path):
    done = subprocess.run(run_kuka(kuka, tmp_path), capture_output=True, text=True, timeout=LIMIT)
    assert done.returncode == 0, done.stderr
    assert "; done; next" in done.stdout
    recording = kreisel.load(tmp_path / "run")
    last = np.radians([20, -60, 70, 80, -50, 100])
    assert recording.joints.angles[-1] == pytest.approx(last, abs=1e-3)
    assert kreisel.calibrate(recording).document["verdict"]["accepted"]


def test_a_kuka_arm_is_stopped_where_a_move_is_refused(kuka, tmp_path):
    (tmp_path / "other.toml").write_text(KUKA.replace("[30, -70, 80, 20, 50, 40]", "[60, -70, 80, 20, 50, 40]"))
    done = subprocess.run(run_kuka(kuka, tmp_path, "other.toml"), capture_output=True, text=True, timeout=LIMIT)
    assert done.returncode == 1
    assert "the controller refuses <Kreisel><Move>" in done.stderr
    assert "what was recorded is kept" in done.stderr
    assert "Traceback" not in done.stderr


def test_where_moves_go_must_be_known(program):
    done = subprocess.run(
        command(
            "run", "program.toml", "--robot", "rsi://127.0.0.1:0", "--imu", "csv://127.0.0.1:9", "--model", "kr125"
        ),
        cwd=program, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 1
    assert "give with --mover where moves are sent: urscript://" in done.stderr


def test_programs_that_cannot_obey(program):
    recording = simulate(Cell.model_validate({"seconds": 20.0, "reference": {"joints": False}}), program)[1]
    with pytest.raises(SettingsError, match="joint angles"):
        CommandedArm(recording)
