"""The recorder itself: how it begins and ends, and what it leaves."""

import asyncio
import itertools
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

import kreisel
from kreisel.acquisition.recorder import record
from kreisel.devices.address import IMUS, parse_address
from kreisel.devices.events import Arrival
from kreisel.errors import DeviceError, ProtocolError, RecordingError, SettingsError
from kreisel.formats.bag import load_bag
from kreisel.formats.recover import recover
from kreisel.protocols import line, rsi

from .live import (
    HOST,
    INTERVAL_NS,
    LIMIT,
    Enough,
    free_port,
    lines,
    pose,
    reading,
    recorder,
    run,
    sending,
    serving,
    steady,
    with_imu,
)


def test_a_port_in_use_is_an_error(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind((HOST, 0))
        with pytest.raises(DeviceError, match="cannot listen there"):
            asyncio.run(run(tmp_path, 1, f"rsi://{HOST}:{taken.getsockname()[1]}"))
    assert list(tmp_path.iterdir()) == []


def test_a_recorder_that_nothing_came_to_removes_what_it_made_alone(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "notes.txt").write_text("mine")

    async def all_of_it():
        stop = asyncio.Event()
        asyncio.get_running_loop().call_later(0.3, stop.set)
        address = parse_address(f"csv://{HOST}:{free_port()}", IMUS)
        for output in (tmp_path / "run", tmp_path / "new" / "deep" / "run.mcap"):
            await record(address, None, output, stop=stop)

    asyncio.run(all_of_it())
    assert [path.name for path in tmp_path.rglob("*")] == ["run", "notes.txt"]


def ended(process, after):
    """Interrupt a recorder once it has said something; return status and the last line it says."""
    said = ""
    while after not in said:
        said = process.stderr.readline()
        assert said
    process.send_signal(signal.SIGINT)
    _, rest = process.communicate(timeout=LIMIT)
    return process.returncode, (said + rest).splitlines()[-1]


def test_a_device_that_is_never_reached_is_a_failure_that_can_be_tried_again(tmp_path):
    port = free_port()
    for _ in range(2):
        status, last = ended(recorder(tmp_path, port), "cannot be reached")
        assert status == 1
        assert last.startswith(f"kreisel: no readings came from csv://{HOST}:{port}: cannot be reached (")
        assert last.endswith("; nothing was recorded")
        assert list(tmp_path.iterdir()) == []


def test_what_came_of_the_imu_is_kept_aside_where_no_pose_came(tmp_path):
    file = tmp_path / "run" / "recording.mcap"

    async def all_of_it():
        port = free_port()
        found = []
        async with serving(lines(steady)) as imu_port:
            for _ in range(2):
                process = recorder(tmp_path, imu_port, "--robot", f"rtde://{HOST}:{port}")
                while not (file.exists() and file.stat().st_size > 20_000):  # some hundred readings
                    await asyncio.sleep(0.05)
                found.append(await asyncio.to_thread(ended, process, "cannot be reached"))
        return port, found

    port, found = asyncio.run(all_of_it())
    for (status, last), name in zip(found, ("run_partial.mcap", "run_partial_2.mcap"), strict=True):
        assert status == 1
        assert f"kreisel: no poses came from rtde://{HOST}:{port}: cannot be reached (" in last
        assert last.endswith(f"the data received are kept in {tmp_path / name}")
        assert load_bag(tmp_path / name).imu.stamps_ns.size > 50
    assert {path.name for path in tmp_path.iterdir()} == {"run_partial.mcap", "run_partial_2.mcap"}


@pytest.mark.parametrize(
    ("address", "complaint"),
    [
        ("ixcom:/host", "names no host"),
        ("http://host", "unknown scheme 'http'; known are: csv, ixcom, mavlink, mcap, ros2, serial"),
        ("ixcom://host:70000", "not an address"),
        ("ixcom://host?speed=3", "unknown option 'speed'; known are: channel, divider"),
    ],
)
def test_addresses_that_make_no_sense(address, complaint):
    with pytest.raises(SettingsError, match=complaint):
        parse_address(address, IMUS)


def test_options_that_make_no_sense(tmp_path):
    with pytest.raises(SettingsError, match="divider is 'two', expected 1 to 65535"):
        asyncio.run(run(tmp_path, 3000, imu="ixcom", options="?divider=two"))
    with pytest.raises(ProtocolError, match="no column"):
        asyncio.run(run(tmp_path, 3000, options="?columns=t [s]"))


def test_nothing_is_written_over(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "recording.mcap").write_bytes(b"precious")
    with pytest.raises(RecordingError, match="exists already"):
        asyncio.run(run(tmp_path, 3000))
    assert (tmp_path / "run" / "recording.mcap").read_bytes() == b"precious"


def test_a_full_disk_keeps_what_was_recorded(tmp_path, monkeypatch):
    """The stream takes 40 kB, then no more."""
    import kreisel.acquisition.recorder as module

    class Full(module.Recorder):
        def flush(self):
            if self._stream.tell() > 40_000:
                raise OSError(28, "No space left on device")
            super().flush()

    monkeypatch.setattr(module, "Recorder", Full)
    with pytest.raises(RecordingError, match="No space left on device.*kept.*kreisel recover"):
        with_imu(tmp_path, lines(steady), seconds=5.0)
    saved = recover(tmp_path / "run" / "recording.mcap")
    assert saved.messages["/imu/data_raw"] > 300


def test_readings_reach_the_disk_within_a_quarter_of_a_second(tmp_path, monkeypatch):
    """By a clock that the readings themselves advance: ten are sent once the ten before were taken."""
    import kreisel.acquisition.recorder as module

    taken, behind, lots = asyncio.Queue(), [0], 40

    class Counting(module.Recorder):
        def take(self, source, event):
            behind[-1] += isinstance(event, Arrival)
            return super().take(source, event)

        def flush(self):
            super().flush()
            behind.append(0)

    async def talk(reader, writer):
        writer.write(f"#{line.COLUMNS}\n".encode())
        for lot in range(lots):
            writer.write(b"".join(line.encode(reading(10 * lot + k)) for k in range(10)))
            for _ in range(10):
                await taken.get()

    class Clock:
        time_ns = time.time_ns

        @staticmethod
        def monotonic():
            return sum(behind) * INTERVAL_NS * 1e-9

        monotonic_ns = time.monotonic_ns

    async def all_of_it():
        enough = Enough(10 * lots * INTERVAL_NS * 1e-9)

        def observe(event):
            enough.take(event)
            taken.put_nowait(event)

        async with serving(talk) as port:
            address = parse_address(f"csv://{HOST}:{port}", IMUS)
            return await record(address, None, tmp_path / "run", stop=enough.stop, observe=observe)

    monkeypatch.setattr(module, "Recorder", Counting)
    monkeypatch.setattr(module, "time", Clock)
    assert asyncio.run(all_of_it()).imu.count == 10 * lots
    assert len(behind) > 5
    assert max(behind) * INTERVAL_NS < 0.25e9


def readings_in(file, folder):
    """Return how many readings are found in a file that is still being written."""
    with TemporaryDirectory(dir=folder) as aside, suppress(OSError, RecordingError):
        return recover(file, Path(aside) / "copy.mcap").messages.get("/imu/data_raw", 0)
    return 0


@pytest.mark.parametrize(
    "how",
    [
        signal.SIGKILL,
        signal.SIGINT,
        *(pytest.param(how, marks=pytest.mark.slow) for how in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)),
    ],
)
def test_a_recorder_that_is_stopped(tmp_path, how):
    """What it was sent is on the disk soon, though nothing more comes, and stays there however it ends."""
    file = tmp_path / "run" / "recording.mcap"

    async def all_of_it():
        sent = itertools.count()

        def items():
            while True:
                k = next(sent)
                yield line.encode(reading(k)) if k < 800 else b"\n"

        async with serving(lines(items)) as port, asyncio.timeout(LIMIT):
            process = recorder(tmp_path, port)
            while await asyncio.to_thread(readings_in, file, tmp_path) < 800:
                await asyncio.sleep(0.05)
            process.send_signal(how)
            _, errors = await asyncio.to_thread(process.communicate)
            return process.returncode, errors

    code, errors = asyncio.run(all_of_it())
    if how is signal.SIGKILL:
        file = recover(file).path
    else:
        assert code == 0, errors
    recording = load_bag(file)
    assert recording.imu.stamps_ns.size == 800
    assert np.all(np.diff(recording.imu.stamps_ns) == INTERVAL_NS)


SLOW_PAIRS = [("ekrl", "csv"), ("rtde", "mavlink")]


@pytest.mark.parametrize(
    ("robot", "imu"),
    [("rtde", "csv"), ("ros2", "ros2"), *(pytest.param(*pair, marks=pytest.mark.slow) for pair in SLOW_PAIRS)],
)
def test_the_virtual_cell_is_recorded_and_found_again(tmp_path, robot, imu):
    """Two commands, as a user types them; ten times real time."""
    if "ros2" in (robot, imu):
        pytest.importorskip("cyclonedds")
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    cell = subprocess.Popen(
        [sys.executable, "-m", "kreisel.cli.main", "virtual-cell", "--robot", robot, "--imu", imu, "--interval",
         "0.02", "--seconds", "75", "--speed", "10", "-o", "known"],
        cwd=tmp_path, stdout=subprocess.PIPE, text=True, env=environment,
    )  # fmt: skip
    try:
        urls = __import__("json").loads(cell.stdout.readline())
        done = subprocess.run(
            [sys.executable, "-m", "kreisel.cli.main", "record", "--robot", urls["robot"], "--imu", urls["imu"],
             "--seconds", "6", "--settings", "known/recording.toml", "--urdf", "known/robot.urdf", "-o", "run"],
            cwd=tmp_path, capture_output=True, text=True, timeout=LIMIT, check=True,
        )  # fmt: skip
    finally:
        cell.terminate()
        cell.communicate()
    assert "missing 0 and 0, repeated or late 0 and 0" in done.stdout
    calibration = kreisel.calibrate(kreisel.load(tmp_path / "run"))
    truth = __import__("json").loads((tmp_path / "known" / "truth.json").read_text())
    document = calibration.document
    error = np.array(document["accelerometer"]["offset"]) - truth["accelerometer"]["offset"]
    deviation = np.array(document["standard_deviation"]["accelerometer"]["offset"])
    assert np.all(np.abs(error) < 4.0 * deviation)
    assert (
        abs(document["timing"]["offset"] - truth["time_offset"])
        < 4.0 * document["standard_deviation"]["timing"]["offset"]
    )


@pytest.mark.parametrize(("options", "status"), [("", 1), ("?from=127.0.0.1", 0), ("?from=127.0.0.2", 0)])
def test_a_robot_that_is_locked_out_is_told_at_the_end(tmp_path, options, status):
    """A stranger speaks first, from another address of this machine; the robot's own is 127.0.0.2."""

    async def all_of_it():
        port = free_port()
        async with (
            serving(lines(lambda: (line.encode(reading(k)) for k in itertools.count()))) as imu,
            sending(port, (rsi.encode(pose(k)) for k in itertools.count())),
            sending(port, (rsi.encode(pose(k)) for k in itertools.count()), host="127.0.0.2"),
        ):
            process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "kreisel.cli.main", "record", "--robot", f"rsi://{HOST}:{port}{options}",
                "--imu", f"csv://{HOST}:{imu}", "--seconds", "1", "-o", str(tmp_path / "run"),
                stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )  # fmt: skip
            _, errors = await asyncio.wait_for(process.communicate(), LIMIT)
            return process.returncode, errors.decode()

    code, errors = asyncio.run(all_of_it())
    told = "which of them is the device? State its host as ?from=HOST" in errors
    assert (code, told) == (status, status == 1)
    assert (tmp_path / "run" / "recording.mcap").stat().st_size > 1000


def test_an_arm_is_not_driven_by_whoever_speaks_first(tmp_path):
    (tmp_path / "program.toml").write_text("start_deg = [0, -90, 90, 0, 30, 0]\n")
    done = subprocess.run(
        [sys.executable, "-m", "kreisel.cli.main", "run", "program.toml", "--robot", "rsi://0.0.0.0:49152",
         "--mover", "ekrl://192.168.1.10", "--imu", "csv://127.0.0.1:9", "--model", "kr125"],
        cwd=tmp_path, capture_output=True, text=True, timeout=LIMIT,
    )  # fmt: skip
    assert done.returncode == 1
    assert "give the controller's address, rsi://0.0.0.0:49152?from=" in done.stderr
