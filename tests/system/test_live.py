"""Recording over the loopback while everything goes wrong: what was lost, and what was said."""

import asyncio
import itertools
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import tty
from contextlib import asynccontextmanager, suppress

import numpy as np
import pytest

import kreisel
from kreisel.acquisition.record import record
from kreisel.devices.address import IMUS, ROBOTS, parse_address
from kreisel.devices.simulators import Pace, TcpSimulator
from kreisel.errors import DeviceError, ProtocolError, RecordingError, SettingsError
from kreisel.formats.bag import load_bag
from kreisel.formats.recover import recover
from kreisel.protocols import egm, ixcom, line, rsi, rtde
from kreisel.protocols.samples import ImuSample, RobotSample

HOST = "127.0.0.1"
INTERVAL_NS = 2_500_000
CYCLE_NS = 4_000_000


def reading(k, start_ns=10**9):
    return ImuSample(start_ns + k * INTERVAL_NS, (0.1, 0.2, 1e-3 * k), (0.0, 0.0, 9.8))


def pose(k, start_ns=5 * 10**9):
    q = (float(np.cos(5e-4 * k)), 0.0, 0.0, float(np.sin(5e-4 * k)))
    return RobotSample(start_ns + k * CYCLE_NS, (1e-3 * k, 0.0, 1.0), q, (1e-3 * k,) * 6)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


async def paced(items, interval):
    """Yield items in real time."""
    began = time.monotonic()
    for k, item in enumerate(items):
        await asyncio.sleep(max(0.0, began + k * interval - time.monotonic()))
        yield item


@asynccontextmanager
async def sending(port, datagrams, interval=CYCLE_NS * 1e-9):
    """Send datagrams to a port while the block runs."""
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        asyncio.DatagramProtocol, remote_addr=(HOST, port)
    )

    async def send():
        async for datagram in paced(datagrams, interval):
            if datagram is not None:
                transport.sendto(datagram)

    task = asyncio.ensure_future(send())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        transport.close()


@asynccontextmanager
async def serving(talk):
    """Serve what is said to every client, and yield the port."""

    clients = {}

    async def quietly(reader, writer):
        with suppress(OSError):
            await talk(reader, writer)
        writer.close()

    def connected(reader, writer):
        clients[writer] = asyncio.ensure_future(quietly(reader, writer))

    server = await asyncio.start_server(connected, HOST, 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for writer, task in clients.items():
            task.cancel()
            writer.close()
        await asyncio.gather(*clients.values(), *(writer.wait_closed() for writer in clients), return_exceptions=True)


def lines(items, *, header=f"#{line.COLUMNS}"):
    """Return what an IMU of lines says to a client: a header, then items of bytes as they come, None for silence."""

    async def talk(reader, writer):
        writer.write(f"{header}\n".encode())
        async for item in paced(items(), INTERVAL_NS * 1e-9):
            writer.write(item or b"")
            await writer.drain()

    return talk


def steady():
    return (line.encode(reading(k)) for k in itertools.count())


async def run(tmp_path, imu_port, robot=None, seconds=1.0, imu="csv", options="", most=10.0):
    """Record, and return what the recorder says and what can be read of the file."""
    address = parse_address(f"{imu}://{HOST}:{imu_port}{options}", IMUS)
    of_robot = None if robot is None else parse_address(robot, ROBOTS)
    stop = asyncio.Event()
    asyncio.get_running_loop().call_later(most, stop.set)
    status = await record(address, of_robot, tmp_path / "run", seconds=seconds, stop=stop)
    return status, tmp_path / "run"


def with_robot(tmp_path, datagrams, scheme="rsi", seconds=1.0, options=""):
    """Record a steady IMU and what a controller sends."""

    async def all_of_it():
        port = free_port()
        async with serving(lines(steady)) as imu_port, sending(port, datagrams):
            return await run(tmp_path, imu_port, f"{scheme}://{HOST}:{port}{options}", seconds)

    return asyncio.run(all_of_it())


def with_imu(tmp_path, talk, seconds=1.0, imu="csv", options="", most=10.0):
    """Record an IMU alone."""

    async def all_of_it():
        async with serving(talk) as port:
            return await run(tmp_path, port, None, seconds, imu, options, most)

    return asyncio.run(all_of_it())


def said(status, text):
    assert any(text in note for note in status.notes), status.notes


def test_all_is_recorded_with_both_clocks(tmp_path):
    status, path = with_robot(tmp_path, (rsi.encode(pose(k)) for k in itertools.count()))
    recording = load_bag(path)
    k = np.arange(recording.imu.stamps_ns.size)
    assert status.imu.missing == status.robot.missing == 0
    assert np.array_equal(recording.imu.stamps_ns, 10**9 + INTERVAL_NS * (recording.imu.rates[:, 2] * 1e3).round())
    assert recording.imu.rates[0, 2] + 1e-3 * k == pytest.approx(recording.imu.rates[:, 2], abs=1e-12)
    assert k.size * INTERVAL_NS == pytest.approx(np.ptp(recording.reference.stamps_ns), rel=0.15)
    assert np.diff(recording.reference.stamps_ns) == pytest.approx(CYCLE_NS)
    assert recording.joints.angles[-1] == pytest.approx(recording.reference.positions[-1, [0] * 6], abs=2e-6)


def test_lost_datagrams_are_counted(tmp_path):
    rng = np.random.default_rng(1)
    sent = (rsi.encode(pose(k)) if rng.random() > 0.05 else None for k in itertools.count())
    status, path = with_robot(tmp_path, sent, seconds=2.0)
    recording = load_bag(path)
    steps = np.diff(recording.reference.stamps_ns) // CYCLE_NS
    assert 0.01 < np.mean(steps > 1) < 0.12
    assert status.robot.missing == pytest.approx(np.sum(steps - 1), abs=3)  # the first few tell the interval
    assert status.imu.missing == 0


def test_what_comes_twice_or_late_is_left_out(tmp_path):
    order = itertools.chain.from_iterable((k, k, k + 2, k + 1) for k in range(0, 10_000, 3))
    status, path = with_robot(tmp_path, (rsi.encode(pose(k)) for k in order))
    recording = load_bag(path)
    assert status.robot.late > 50
    assert np.all(np.diff(recording.reference.stamps_ns) > 0)


@pytest.mark.parametrize(
    ("rubbish", "complaint"),
    [
        (b"\x00\xff" * 30, "not UTF-8"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><Rob/>', "declaration"),
        (b"<Rob>" + b" " * 20_000 + b"</Rob>", "20011 bytes"),
        (b"<Rob><IPOC>12</IPOC></Rob>", "neither RIst nor AIPos"),
    ],
)
def test_rubbish_between_telegrams_costs_nothing(tmp_path, rubbish, complaint):
    sent = (part for k in itertools.count() for part in (rsi.encode(pose(k)), rubbish))
    status, path = with_robot(tmp_path, sent)
    said(status, complaint)
    assert len([note for note in status.notes if complaint in note]) <= 3  # told once a second
    assert np.diff(load_bag(path).reference.stamps_ns) == pytest.approx(CYCLE_NS)


def test_a_silent_controller_is_told_and_the_gap_marked(tmp_path):
    sent = (None if 100 <= k < 450 else rsi.encode(pose(k)) for k in itertools.count())
    status, path = with_robot(tmp_path, sent, seconds=2.5)
    said(status, "nothing is received")
    said(status, "messages are received again")
    said(status, "gap of 1.4")
    recording = load_bag(path)
    assert any("gap of 1.4" in warning.message for warning in recording.warnings)
    assert recording.reference.stamps_ns.size > 200


def test_a_controller_started_anew_has_a_topic_of_its_own(tmp_path):
    sent = (rsi.encode(pose(k) if k < 120 else pose(k - 120, 10**9)) for k in itertools.count())
    status, path = with_robot(tmp_path, sent)
    said(status, "leapt by -4.4")
    assert status.robot.epoch == 2
    recording = load_bag(path)
    assert recording.reference.name == "/robot/pose"
    assert recording.reference.stamps_ns[-1] == pose(119).stamp_ns
    again = load_bag(path, reference="/robot/pose_2")
    assert again.reference.stamps_ns[0] == 10**9


def test_a_clock_that_leaps_forward_is_told(tmp_path):
    sent = (rsi.encode(pose(k) if k < 120 else pose(k, 500 * 10**9)) for k in itertools.count())
    status, _ = with_robot(tmp_path, sent)
    said(status, "leapt by +49")


def test_single_telegrams_of_another_clock_are_dropped(tmp_path):
    sent = (rsi.encode(pose(k, 500 * 10**9) if k % 50 in (48, 49) else pose(k)) for k in itertools.count())
    status, path = with_robot(tmp_path, sent)
    said(status, "readings dropped: stamps on another clock")
    assert status.robot.epoch == 1
    assert status.robot.odd >= 8
    assert load_bag(path).reference.stamps_ns[-1] < 10 * 10**9


@pytest.mark.parametrize("scheme", ["rsi", "egm"])
def test_telegrams_of_another_sender_are_dropped_and_reported(tmp_path, scheme):
    """Perfect ones, from another port of the same host, on the same clock, from another place."""
    encode = {"rsi": lambda sample, _: rsi.encode(sample), "egm": egm.encode}[scheme]

    def elsewhere(k):
        return encode(RobotSample(pose(k).stamp_ns + 1_000_000, (9.0, 9.0, 9.0), (1.0, 0.0, 0.0, 0.0), (0.5,) * 6), k)

    async def all_of_it():
        port = free_port()
        others = (None if k < 25 else elsewhere(k) for k in itertools.count())
        right = (encode(pose(k), k) for k in itertools.count())
        async with serving(lines(steady)) as imu_port, sending(port, right), sending(port, others):
            return await run(tmp_path, imu_port, f"{scheme}://{HOST}:{port}")

    status, path = asyncio.run(all_of_it())
    reports = [note for note in status.notes if "dropped" in note]
    assert "1 so far: this port accepts only 127.0.0.1:" in reports[0]
    assert len(reports) <= 3
    assert load_bag(path).reference.positions[:, 0].max() < 5.0
    assert np.all(np.diff(load_bag(path).reference.stamps_ns) == CYCLE_NS)


def test_only_the_kept_sender_is_answered(tmp_path):
    async def all_of_it():
        port, answers = free_port(), []

        class Other(asyncio.DatagramProtocol):
            def datagram_received(self, data, addr):
                answers.append(data)

        telegrams = (rsi.encode(pose(k)) for k in itertools.count())
        async with serving(lines(steady)) as imu_port, sending(port, telegrams):
            recording = asyncio.ensure_future(run(tmp_path, imu_port, f"rsi://{HOST}:{port}?answer=yes", 0.5))
            await asyncio.sleep(0.2)
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(Other, remote_addr=(HOST, port))
            for k in range(20):
                transport.sendto(rsi.encode(pose(k)))
            await recording
            transport.close()
        return answers

    assert asyncio.run(all_of_it()) == []


def test_a_controller_restarted_on_another_port_is_taken_after_silence(tmp_path):
    async def all_of_it():
        port = free_port()
        async with serving(lines(steady)) as imu_port:
            recording = asyncio.ensure_future(run(tmp_path, imu_port, f"rsi://{HOST}:{port}", 4.0))
            async with sending(port, (rsi.encode(pose(k)) for k in itertools.count())):
                await asyncio.sleep(0.5)
            async with sending(port, (rsi.encode(pose(k, 10**9)) for k in itertools.count())):
                return await recording

    status, path = asyncio.run(all_of_it())
    said(status, "was silent for 2.0 s; now 127.0.0.1:")
    assert status.robot.epoch == 2
    assert load_bag(path, reference="/robot/pose_2").reference.stamps_ns[0] > 10**9


def test_datagrams_that_are_no_telegrams_do_not_hide_a_silent_controller(tmp_path):
    sent = (rsi.encode(pose(k)) if k < 100 else b"<Rob>" for k in itertools.count())
    status, _ = with_robot(tmp_path, sent, seconds=2.0)
    said(status, "nothing is received")


def test_egm_is_recorded_too(tmp_path):
    status, path = with_robot(tmp_path, (egm.encode(pose(k), k) for k in itertools.count()), "egm")
    assert status.robot.missing == 0
    assert load_bag(path).reference.positions[-1, 2] == 1.0


@pytest.mark.parametrize("answer", ["yes", "no"])
def test_answers_that_reach_the_controller_late_are_told(tmp_path, answer):
    """It counts them; who does not answer has none to lose."""
    late = (0 if k < 60 else 2 if k < 120 else 3 for k in itertools.count())
    datagrams = (rsi.encode(pose(k), missed) for k, missed in zip(itertools.count(), late))
    status, _ = with_robot(tmp_path, datagrams, options=f"?answer={answer}")
    told = [note for note in status.notes if "answers reached the controller late" in note]
    assert len(told) == (2 if answer == "yes" else 0)
    if told:
        assert "2 answers reached the controller late, 2 in all" in told[0]
        assert "1 answers reached the controller late, 3 in all" in told[1]
    assert status.robot.missing == 0


def test_rsi_is_answered_where_that_is_wanted(tmp_path):
    async def all_of_it():
        port, answers = free_port(), []

        class Controller(asyncio.DatagramProtocol):
            def datagram_received(self, data, addr):
                answers.append(rsi.decode_answer(data))

        async with serving(lines(steady)) as imu_port:
            loop = asyncio.get_running_loop()
            transport, _ = await loop.create_datagram_endpoint(Controller, remote_addr=(HOST, port))

            async def send():
                async for k in paced(range(10_000), CYCLE_NS * 1e-9):
                    transport.sendto(rsi.encode(pose(k)))

            task = asyncio.ensure_future(send())
            await run(tmp_path, imu_port, f"rsi://{HOST}:{port}?answer=yes", 0.5)
            task.cancel()
            transport.close()
        return answers

    answers = asyncio.run(all_of_it())
    assert np.all(np.diff(answers) == CYCLE_NS // 10**6)


def test_a_connection_that_breaks_is_made_again(tmp_path):
    served = itertools.count()
    numbers = itertools.count()

    def items():
        first = next(served) == 0
        for _ in range(100 if first else 10_000):
            yield line.encode(reading(next(numbers)))

    status, path = with_imu(tmp_path, lines(items), seconds=1.5)
    said(status, "lost (connection: closed by the device)")
    said(status, "are received again after 0.5")
    assert np.all(np.diff(load_bag(path).imu.stamps_ns) == INTERVAL_NS)  # this device waits for its clients


def test_a_device_that_is_not_there_yet_is_waited_for(tmp_path):
    async def all_of_it():
        port = free_port()
        address = parse_address(f"csv://{HOST}:{port}", IMUS)
        recording = asyncio.ensure_future(record(address, None, tmp_path / "run", seconds=0.5))
        await asyncio.sleep(0.3)
        simulator = TcpSimulator("csv")
        await simulator.serve(HOST, port)
        began = time.monotonic()
        playing = asyncio.ensure_future(simulator.play((reading(k) for k in range(4000)), Pace(lambda: began)))
        status = await recording
        playing.cancel()
        simulator.close()
        await asyncio.sleep(0.05)  # for the transports to close
        return status

    status = asyncio.run(all_of_it())
    said(status, "cannot be reached")
    said(status, "are received again")
    assert status.imu.count > 150


def test_a_proxy_is_asked_for_poses(tmp_path):
    """The simulated one, whose poses move on by a millimetre every 4 ms."""

    async def all_of_it():
        proxy, imu, began = TcpSimulator("varproxy"), TcpSimulator("csv"), time.monotonic()
        ports = [await simulator.serve(HOST, 0) for simulator in (proxy, imu)]
        pace = Pace(lambda: began)
        playing = [
            asyncio.ensure_future(proxy.play((pose(k) for k in range(1000)), pace)),
            asyncio.ensure_future(imu.play((reading(k) for k in range(4000)), pace)),
        ]
        addresses = (
            parse_address(f"csv://{HOST}:{ports[1]}", IMUS),
            parse_address(f"varproxy://{HOST}:{ports[0]}?rate=100", ROBOTS),
        )
        status = await record(*addresses, tmp_path / "run", seconds=0.5)
        for task, simulator in zip(playing, (proxy, imu), strict=True):
            task.cancel()
            simulator.close()
        await asyncio.sleep(0.05)  # for the transports to close
        return status

    status = asyncio.run(all_of_it())
    assert status.robot.count >= 25
    reference = load_bag(tmp_path / "run").reference
    moved = np.linalg.norm(reference.positions - reference.positions[0], axis=1)
    assert np.all(np.diff(moved) >= 0.0)
    assert moved[-1] > 0.05


def test_garbage_among_frames_is_skipped_and_told(tmp_path):
    async def talk(reader, writer):
        await reader.read(4096)
        async for k in paced(range(10_000), INTERVAL_NS * 1e-9):
            writer.write(b"\x7e\x00\x01garbage" if k == 100 else ixcom.encode_sample(reading(k), k))

    status, path = with_imu(tmp_path, talk, imu="ixcom")
    said(status, "bytes belong to no frame")
    said(status, "1 frames were lost")
    assert status.imu.missing == 1
    steps = np.diff(load_bag(path).imu.stamps_ns)
    assert steps.max() <= 2 * INTERVAL_NS


def test_a_refusal_is_told_in_the_devices_words(tmp_path):
    async def talk(reader, writer):
        await reader.read(4096)
        writer.write(ixcom.respond(8, "channel in use", 0))
        async for k in paced(range(10_000), INTERVAL_NS * 1e-9):
            writer.write(ixcom.encode_sample(reading(k), k))

    status, _ = with_imu(tmp_path, talk, imu="ixcom", seconds=0.3)
    said(status, "the device refuses: channel in use (response 8)")


def test_a_silent_connection_is_given_up_and_made_again(tmp_path):
    async def talk(reader, writer):
        await reader.read(-1)

    status, _ = with_imu(tmp_path, talk, most=2.0)
    said(status, "silent for 1 s")


def test_lines_without_a_header_are_told(tmp_path):
    status, _ = with_imu(tmp_path, lines(steady, header=""), most=1.0)
    said(status, "no header received")


def test_columns_can_be_named_by_the_user(tmp_path):
    columns = "t%20[ns],w_x%20[deg/s],w_y,w_z,a_x%20[g],a_y,a_z"
    status, path = with_imu(tmp_path, lines(steady, header=""), seconds=0.4, options=f"?columns={columns}")
    assert status.imu.count > 100
    assert load_bag(path).imu.accelerations[0, 2] == pytest.approx(9.8 * 9.80665)


def test_lines_that_are_none_are_told_and_skipped(tmp_path):
    items = lambda: (b"nonsense,1,2\n" if k % 50 == 9 else line.encode(reading(k)) for k in itertools.count())  # noqa: E731
    status, path = with_imu(tmp_path, lines(items))
    said(status, "3 columns, expected 7")
    assert np.diff(load_bag(path).imu.stamps_ns).max() == 2 * INTERVAL_NS


@pytest.mark.parametrize(
    ("answer", "complaint"),
    [
        (rtde.package(ord("V"), b"\x00"), "refuses protocol version 2"),
        (b"\xff\xff\x00", "message of 65535 bytes"),
        (rtde.package(ord("S"), b"\x01"), "while waiting for version"),
    ],
)
def test_a_controller_that_refuses_is_told(tmp_path, answer, complaint):
    async def talk(reader, writer):
        await reader.read(4096)
        writer.write(answer)
        await asyncio.sleep(5.0)

    async def all_of_it():
        async with serving(talk) as robot_port, serving(lines(steady)) as imu_port:
            return await run(tmp_path, imu_port, f"rtde://{HOST}:{robot_port}", None, most=0.8)

    status, path = asyncio.run(all_of_it())
    said(status, complaint)
    assert load_bag(path).imu.stamps_ns.size > 200  # the IMU is recorded all the while


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
    _, rest = process.communicate(timeout=30.0)
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
    async def all_of_it():
        port = free_port()
        found = []
        async with serving(lines(steady)) as imu_port:
            for _ in range(2):
                process = recorder(tmp_path, imu_port, "--robot", f"rtde://{HOST}:{port}")
                await asyncio.sleep(1.5)
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
        ("http://host", "unknown scheme 'http'; known are: csv, ixcom, mcap, serial"),
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
    import kreisel.acquisition.record as module

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


def recorder(tmp_path, port, *more):
    command = [sys.executable, "-m", "kreisel.cli.main", "record", "--imu", f"csv://{HOST}:{port}", "-o", "run"]
    return subprocess.Popen([*command, *more], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT])
def test_a_recorder_that_is_stopped(tmp_path, how):
    """A killed one loses a quarter of a second at most; one that is told to end loses nothing."""

    async def all_of_it():
        sent = itertools.count()
        last = [0]

        def items():
            for k in sent:
                last[0] = k
                yield line.encode(reading(k))

        async with serving(lines(items)) as port:
            process = recorder(tmp_path, port)
            while last[0] < 800:
                await asyncio.sleep(0.05)
            process.send_signal(how)
            at = last[0]
            await asyncio.sleep(0.5)
            _, errors = await asyncio.to_thread(process.communicate)
            return at, process.returncode, errors

    at, code, errors = asyncio.run(all_of_it())
    file = tmp_path / "run" / "recording.mcap"
    if how is signal.SIGKILL:
        file = recover(file).path
    else:
        assert code == 0, errors
    recording = load_bag(file)
    assert at - (recording.imu.stamps_ns[-1] - 10**9) / INTERVAL_NS < 0.25 / (INTERVAL_NS * 1e-9)
    assert np.all(np.diff(recording.imu.stamps_ns) == INTERVAL_NS)


@pytest.mark.parametrize("robot", ["rtde", "ekrl"])
def test_the_virtual_cell_is_recorded_and_found_again(tmp_path, robot):
    """Two commands, as a user types them; ten times real time."""
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    cell = subprocess.Popen(
        [sys.executable, "-m", "kreisel.cli.main", "virtual-cell", "--robot", robot, "--imu", "csv", "--interval",
         "0.02", "--seconds", "75", "--speed", "10", "-o", "known"],
        cwd=tmp_path, stdout=subprocess.PIPE, text=True, env=environment,
    )  # fmt: skip
    try:
        urls = __import__("json").loads(cell.stdout.readline())
        done = subprocess.run(
            [sys.executable, "-m", "kreisel.cli.main", "record", "--robot", urls["robot"], "--imu", urls["imu"],
             "--seconds", "6", "--settings", "known/recording.toml", "--urdf", "known/robot.urdf", "-o", "run"],
            cwd=tmp_path, capture_output=True, text=True, timeout=60, check=True,
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


def test_a_serial_line_is_read(tmp_path):
    """Over a pseudo-terminal."""
    controller, device = os.openpty()
    tty.setraw(device)
    os.set_blocking(controller, False)  # once nobody reads
    over = threading.Event()

    def write():
        began = time.monotonic()
        for k in itertools.count():
            if over.wait(max(0.0, began + k * INTERVAL_NS * 1e-9 - time.monotonic())):
                return
            with suppress(BlockingIOError):
                os.write(controller, line.encode(reading(k)))

    writing = threading.Thread(target=write, daemon=True)
    writing.start()
    address = parse_address(f"serial://{os.ttyname(device)}?baud=115200&columns={line.COLUMNS}", IMUS)
    asyncio.run(record(address, None, tmp_path / "run", seconds=0.8))
    over.set()
    writing.join()
    os.close(device)
    os.close(controller)
    stamps = load_bag(tmp_path / "run").imu.stamps_ns
    assert stamps.size > 250
    assert np.all(np.diff(stamps) == INTERVAL_NS)


def test_a_serial_line_that_is_not_there_is_told(tmp_path):
    async def all_of_it():
        stop = asyncio.Event()
        asyncio.get_running_loop().call_later(0.5, stop.set)
        return await record(parse_address("serial:///dev/no-such-line", IMUS), None, tmp_path / "run", stop=stop)

    said(asyncio.run(all_of_it()), "serial:///dev/no-such-line: cannot be reached")
