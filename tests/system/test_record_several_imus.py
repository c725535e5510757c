"""Several IMUs recorded in one file: each on its topic and its clock, and read as units of a tray."""

import asyncio
import itertools
import signal

import numpy as np
import pytest

from kreisel.acquisition.recorder import record
from kreisel.acquisition.tail import Tail
from kreisel.devices.address import IMUS, parse_address
from kreisel.devices.events import Arrival
from kreisel.errors import SettingsError
from kreisel.formats.imus import imu_reader, imus_in
from kreisel.formats.recover import recover
from kreisel.protocols import line
from kreisel.recording.recording_settings import DeviceTable, RecordingSettings

from .live import HOST, INTERVAL_NS, LIMIT, Enough, free_port, lines, reading, recorder, said, serving, steady

SETTINGS = RecordingSettings(devices={"device1": DeviceTable(serial_number="0042")})


def later():
    """Return readings on a clock that is 500 s ahead, of which some are missing."""
    return (line.encode(reading(k, 501 * 10**9)) for k in itertools.count() if not 60 <= k < 200)


def leaping():
    """Return readings of a device that begins its clock anew."""
    return (line.encode(reading(k, 10**9 if k < 80 else 90 * 10**9)) for k in itertools.count())


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a recording of three devices, its status, their addresses, and what was observed."""
    folder, seen = tmp_path_factory.mktemp("recorded"), []

    async def all_of_it():
        enough = Enough(1.0, until="on a new topic")

        def observe(event):
            seen.append(event)
            enough.take(event)

        def show(status):
            if any("on a new topic" in note for note in status.notes) and status.further[0].missing:
                enough.stop.set()

        async with serving(lines(steady)) as a, serving(lines(later)) as b, serving(lines(leaping)) as c:
            first, *further = [parse_address(f"csv://{HOST}:{port}", IMUS) for port in (a, b, c)]
            status = await record(
                first, None, folder / "run.mcap", further=further, settings=SETTINGS, stop=enough.stop,
                observe=observe, show=show,
            )  # fmt: skip
            return status, [first, *further]

    status, addresses = asyncio.run(all_of_it())
    return folder / "run.mcap", status, addresses, seen


def test_each_device_has_a_topic_and_its_own_stamps(made):
    file, status, _, _ = made
    assert imus_in(file) == ("imu0", "imu1", "imu2")
    read = imu_reader(file)
    for k, (name, begin) in enumerate((("imu0", 10**9), ("imu1", 501 * 10**9), ("imu2", 10**9))):
        imu, _ = read(name)
        assert imu.stamps_ns[0] - begin < 200 * INTERVAL_NS
        assert imu.source.relative_to(file).as_posix() == f"imu{k or ''}/data_raw"
        n = imu.stamps_ns.size
        assert n == (80 - (imu.stamps_ns[0] - begin) // INTERVAL_NS if k == 2 else status.imus[k].count)
        np.testing.assert_allclose(imu.rates[:, 2], 1e-3 * ((imu.stamps_ns - begin) // INTERVAL_NS))


def test_losses_and_leaps_are_said_of_each_device(made):
    file, status, addresses, _ = made
    said(status, f"{addresses[1]}: gap of 0.35")
    assert [stream.missing for stream in status.imus] == [0, 140, 0]
    said(status, f"{addresses[2]}: the device's clock leapt")
    assert [stream.epoch for stream in status.imus] == [1, 1, 2]
    _, warnings = imu_reader(file)("imu0")
    assert not warnings


def test_live_values_are_of_the_first_device(made):
    _, status, _, seen = made
    stamps = [event.sample.stamp_ns for event in seen if isinstance(event, Arrival)]
    assert len(stamps) == status.imu.count
    assert max(stamps) < 90 * 10**9
    assert status.excitation.turned[1] == pytest.approx(0.2 * (len(stamps) - 1) * INTERVAL_NS * 1e-9)


def test_a_growing_recording_is_that_of_the_first_device(made):
    tail = Tail(made[0])
    topics = tail.read()
    assert "/imu/data_raw" in topics
    assert not any("imu1" in topic or "imu2" in topic for topic in topics)


def test_a_recovered_copy_has_all_units(made, tmp_path):
    whole = made[0].read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    found = recover(cut)
    assert {"/imu/data_raw", "/imu1/data_raw", "/imu2/data_raw"} <= found.messages.keys()
    assert imus_in(found.path) == ("imu0", "imu1", "imu2")


def test_one_address_twice_is_refused(tmp_path):
    address = parse_address(f"csv://{HOST}:{free_port()}", IMUS)
    with pytest.raises(SettingsError, match=r"--imu csv://.* is given twice"):
        asyncio.run(record(address, None, tmp_path / "run", further=[address]))
    assert not list(tmp_path.iterdir())


def test_the_command_says_what_came_of_each_device(tmp_path):
    file = tmp_path / "run" / "recording.mcap"

    async def all_of_it(*, silent):
        async with serving(lines(steady)) as a, serving(lines(later)) as b:
            port = free_port()
            more = ["--imu", f"csv://{HOST}:{port}"] if silent else []
            process = recorder(tmp_path, a, "--imu", f"csv://{HOST}:{b}", *more)
            while not (file.exists() and file.stat().st_size > 40_000):
                await asyncio.sleep(0.05)
            process.send_signal(signal.SIGINT)
            return process, port, await asyncio.to_thread(process.communicate, timeout=LIMIT)

    process, port, (_, told) = asyncio.run(all_of_it(silent=True))
    assert process.returncode == 1
    assert f"no readings came from csv://{HOST}:{port}" in told
    assert imus_in(tmp_path / "run_partial.mcap") == ("imu0", "imu1")
    process, _, (told, _) = asyncio.run(all_of_it(silent=False))
    assert process.returncode == 0
    assert "samples of imu0 at" in told
    assert "samples of imu1 at" in told
    assert imus_in(file.parent) == ("imu0", "imu1")
