"""IMUs recorded over the loopback while everything goes wrong: what was lost, and what was said."""

import asyncio
import itertools
import os
import re
import threading
import time
import tty

import numpy as np
import pytest

from kreisel.devices.simulators import Pace, TcpSimulator
from kreisel.formats.bag import load_bag
from kreisel.protocols import ixcom, line

from .live import (
    HOST,
    INTERVAL_NS,
    LIMIT,
    Enough,
    free_port,
    lines,
    paced,
    reading,
    record_until,
    recorder,
    run,
    said,
    serving,
    steady,
    times_said,
    with_imu,
)


def test_a_connection_that_breaks_is_made_again(tmp_path):
    served = itertools.count()
    numbers = itertools.count()

    def items():
        first = next(served) == 0
        for _ in range(100 if first else 10_000):
            yield line.encode(reading(next(numbers)))

    status, path = with_imu(tmp_path, lines(items), seconds=1.0)
    said(status, "lost (connection: closed by the device)")
    (gap,) = times_said(status, r"are received again after (\S+) s")
    assert gap >= 0.5
    assert np.all(np.diff(load_bag(path).imu.stamps_ns) == INTERVAL_NS)  # this device waits for its clients


def test_a_device_that_falls_silent_is_named_at_the_end(tmp_path):
    served = itertools.count()

    def items():
        for number in range(100 if next(served) == 0 else 0):
            yield line.encode(reading(number))

    async def all_of_it():
        async with serving(lines(items)) as port:
            return await asyncio.to_thread(recorder(tmp_path, port, "--seconds", "4").communicate, timeout=LIMIT)

    out, err = asyncio.run(all_of_it())
    (seconds,) = re.findall(r"nothing came from csv://\S+ in the last (\S+) s", err)
    assert 3.0 < float(seconds) < 4.5
    assert "100 IMU samples" in out


def test_a_device_that_is_not_there_yet_is_waited_for(tmp_path):
    async def all_of_it():
        port = free_port()
        tried = asyncio.Event()

        class Tried(Enough):
            def take(self, event):
                super().take(event)
                tried.set()

        recording = asyncio.ensure_future(run(tmp_path, port, enough=Tried(0.5)))
        await tried.wait()
        simulator = TcpSimulator("csv")
        await simulator.serve(HOST, port)
        began = time.monotonic()
        playing = asyncio.ensure_future(simulator.play((reading(k) for k in range(4000)), Pace(lambda: began)))
        status, _ = await recording
        playing.cancel()
        simulator.close()
        await asyncio.sleep(0.05)  # for the transports to close
        return status

    status = asyncio.run(all_of_it())
    said(status, "cannot be reached")
    said(status, "are received again")
    assert status.imu.count > 150


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

    status, _ = with_imu(tmp_path, talk, 0.0, until="silent for 1 s")
    said(status, "silent for 1 s")


def test_lines_without_a_header_are_told(tmp_path):
    status, _ = with_imu(tmp_path, lines(steady, header=""), 0.0, until="came before a line with the columns")
    said(status, "came before a line with the columns")


@pytest.mark.parametrize("sign", ["#", ""])
def test_a_header_with_an_unknown_unit_is_named_and_not_missed(tmp_path, sign):
    header = f"{sign}t [ms],w_x [rpm],w_y,w_z,a_x [g],a_y,a_z\n"
    status, _ = with_imu(tmp_path, lines(steady, header=header), 0.0, until="known units")
    said(status, "column w_x is in 'rpm'; known units are rad s^-1")
    assert not any("came before" in note for note in status.notes)


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
            data = line.encode(reading(k))
            while data and not over.is_set():
                try:
                    data = data[os.write(controller, data) :]
                except BlockingIOError:
                    over.wait(0.001)

    writing = threading.Thread(target=write, daemon=True)
    writing.start()
    address = f"serial://{os.ttyname(device)}?baud=115200&columns={line.COLUMNS}"

    async def all_of_it():
        await record_until(Enough(0.8), address, None, tmp_path / "run")

    asyncio.run(all_of_it())
    over.set()
    writing.join()
    os.close(device)
    os.close(controller)
    stamps = load_bag(tmp_path / "run").imu.stamps_ns
    assert stamps.size > 250
    assert np.all(np.diff(stamps) == INTERVAL_NS)


def test_a_serial_line_that_is_not_there_is_told(tmp_path):
    async def all_of_it():
        enough = Enough(0.0, until="cannot be reached")
        return await record_until(enough, "serial:///dev/no-such-line", None, tmp_path / "run")

    said(asyncio.run(all_of_it()), "serial:///dev/no-such-line: cannot be reached")
