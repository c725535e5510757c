"""Recordings in the place of devices: what is recorded anew is what was recorded."""

import asyncio
import subprocess
import sys
import time

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from kreisel.acquisition.recorder import Recorder, record
from kreisel.devices.address import IMUS, ROBOTS, parse_address
from kreisel.devices.events import Arrival
from kreisel.devices.simulators import Pace, TcpSimulator
from kreisel.errors import RecordingError, SettingsError
from kreisel.formats.bag import load_bag
from kreisel.formats.mcap_file import write_mcap
from kreisel.protocols.samples import ImuSample, RobotSample
from kreisel.recording.recording_settings import RecordingSettings

FAST = "speed=1000000"
STORE = get_typestore(Stores.ROS2_HUMBLE)
MS = 10**6


def reading(ns):
    k = ns / 1e9
    return ImuSample(ns, (np.sin(k), np.cos(k), 0.1 * k), (0.2 * k, -0.3, 9.8 + k / 3))


def pose(ns):
    k = ns / 1e9
    return RobotSample(ns, (k / 3, 0.1, 1.0), (np.cos(k), 0.0, 0.0, np.sin(k)), (k / 7,) * 6)


def recorded(file, samples, *, finish=True):
    """Record (host_ns, sample) as a live recorder does."""
    with file.open("wb") as stream:
        recorder = Recorder(stream, RecordingSettings(), None, 1_700_000_000 * 10**9, 0)
        for host_ns, sample in samples:
            recorder.take("device", Arrival(sample, host_ns))
        recorder.flush()
        if finish:
            recorder.finish()
    return file


def live(seconds=6.0, gap=(2.0, 4.5), imu_ns=10**9, robot_ns=1_700_000_000 * 10**9, late=0.4):
    """Yield what two devices send: clocks of their own, a gap of seconds, times of arrival that jitter."""
    rng, out = np.random.default_rng(1), []
    for start, first, step, make in ((imu_ns, 0.0, 0.0025, reading), (robot_ns, late, 0.004, pose)):
        out += [
            (int(1e9 * t + rng.uniform(0, 2 * MS)), make(start + round(1e9 * (t - first))))
            for t in np.arange(first, seconds, step)
            if not gap[0] < t < gap[1]
        ]
    return sorted(out, key=lambda pair: pair[0])


def replayed(file, output, *, imu="", robot="", with_robot=True, **more):
    of_imu = parse_address(f"mcap://{file}?{imu or FAST}", IMUS)
    of_robot = parse_address(f"mcap://{file}?{robot or FAST}", ROBOTS) if with_robot else None

    async def all_of_it():
        async with asyncio.timeout(60.0):
            return await record(of_imu, of_robot, output, **more)

    return asyncio.run(all_of_it())


def same(a, b):
    """Both recordings are of the same readings, to the last bit."""
    assert np.array_equal(a.imu.stamps_ns, b.imu.stamps_ns)
    assert np.array_equal(a.imu.rates, b.imu.rates)
    assert np.array_equal(a.imu.accelerations, b.imu.accelerations)
    for old, new in ((a.reference, b.reference), (a.joints, b.joints)):
        assert (old is None) == (new is None)
        for name in ("stamps_ns", "positions", "quaternions", "angles"):
            x, y = getattr(old, name, None), getattr(new, name, None)
            assert (x is None) == (y is None)
            assert x is None or np.array_equal(x, y), name


def log_times(file):
    found = {}
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append(message.log_time)
    return {topic: np.array(times) for topic, times in found.items()}


def test_a_recording_replayed_is_the_recording(tmp_path):
    """At any speed: a gap of seconds is none of the clock's jumps, and what arrived when is kept too."""
    file = recorded(tmp_path / "old.mcap", live())
    status = replayed(file, tmp_path / "new")
    same(load_bag(file), load_bag(tmp_path / "new"))
    assert status.imu.epoch == status.robot.epoch == 1
    assert status.imu.late == status.robot.late == 0
    assert any("gap of 2.5" in note and note.startswith("imu mcap:///") for note in status.notes)
    before, after = log_times(file), log_times(tmp_path / "new" / "recording.mcap")
    shift = after["/imu/data_raw"] - before["/imu/data_raw"]
    assert np.all(shift == shift[0])
    assert np.abs(after["/robot/pose"] - before["/robot/pose"] - shift[0]).max() < 100 * MS  # begun one after the other
    assert np.array_equal(after["/robot/pose"], after["/robot/joint_states"])


def test_it_takes_as_long_as_it_took_and_ends_by_itself(tmp_path):
    file = recorded(tmp_path / "old.mcap", live(seconds=3.0, gap=(9.0, 9.0)))
    for speed, seconds in ((1, 3.0), (4, 0.75)):
        for attempt in range(5):  # a busy machine makes one late
            began = time.monotonic()
            new = tmp_path / f"new{speed}_{attempt}"
            replayed(file, new, imu=f"speed={speed}", robot=f"speed={speed}")
            took = time.monotonic() - began
            assert took > seconds - 0.1
            same(load_bag(file), load_bag(new))
            if took < seconds + 1.0:
                break
        assert took < seconds + 1.0


@pytest.mark.parametrize("offset", [-1_600_000_000, 3, 400_000_000])
def test_files_logged_by_the_devices_own_clocks_do_not_wait_for_years(tmp_path, offset):
    """As `kreisel convert` writes them: there the log times are the stamps."""
    began = 1_650_000_000
    sent = live(late=0.0, gap=(9, 9), imu_ns=began * 10**9, robot_ns=(began + offset) * 10**9)
    recording = load_bag(recorded(tmp_path / "old.mcap", sent))
    write_mcap(recording, tmp_path / "own.mcap")
    replayed(tmp_path / "own.mcap", tmp_path / "new", imu="speed=50", robot="speed=50")
    same(recording, load_bag(tmp_path / "new"))


def test_a_clock_that_leapt_is_on_a_topic_of_its_own_that_can_be_played(tmp_path):
    first = [(round(1e9 * t), pose(round(1e12 + 1e9 * t))) for t in np.arange(0.0, 1.0, 0.004)]
    again = [(10**9 + host_ns, pose(sample.stamp_ns - 10**11)) for host_ns, sample in first]
    imu = [(round(1e9 * t), reading(round(1e9 * t))) for t in np.arange(0.0, 2.0, 0.0025)]
    file = recorded(tmp_path / "old.mcap", sorted([*first, *again, *imu], key=lambda pair: pair[0]))
    replayed(file, tmp_path / "new", robot=f"topic=/robot/pose_2&{FAST}")
    found = load_bag(tmp_path / "new")
    assert found.reference.stamps_ns.tolist() == [sample.stamp_ns for _, sample in again]
    assert found.joints.angles.tolist() == [list(sample.joints) for _, sample in again]
    same(load_bag(file, reference="/robot/pose_2"), found)


def header(types, stamp_ns, frame):
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    return types["std_msgs/msg/Header"](stamp, frame)


def imu_message(types, stamp_ns, frame="imu", rate=0.1, mark=0.0):
    vector, none = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    return types["sensor_msgs/msg/Imu"](
        header(types, stamp_ns, frame), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), none,
        vector(rate, 0.0, stamp_ns * 1e-9 % 1.0), np.full(9, mark), vector(0.0, 0.0, 9.8), none,
    )  # fmt: skip


def transform(types, stamp_ns, body):
    turn = types["geometry_msgs/msg/Transform"](
        types["geometry_msgs/msg/Vector3"](stamp_ns * 1e-9 % 1.0, 0.0, 1.0),
        types["geometry_msgs/msg/Quaternion"](0.2, 0.4, 0.8, 0.4),
    )
    return types["geometry_msgs/msg/TransformStamped"](header(types, stamp_ns, "world"), body, turn)


def joints(types, stamp_ns):
    none = np.zeros(0)
    angles = np.full(6, stamp_ns * 1e-9 % 1.0)
    return types["sensor_msgs/msg/JointState"](header(types, stamp_ns, ""), list("abcdef"), angles, none, none)


def foreign(folder, messages):
    """Write a ROS 2 bag as others do: metadata.yaml and an MCAP file; messages are (ns, topic, message)."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for log_ns, topic, build in sorted(messages, key=lambda message: message[0]):
            message = build(store.types)
            msgtype = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=store)
            writer.write(connections[topic], log_ns, store.serialize_cdr(message, msgtype))
    return folder


START = 1_700_000_000 * 10**9


@pytest.fixture
def others(tmp_path):
    """Two IMUs, two bodies on one topic, and joints on stamps of their own."""
    messages = []
    for k in range(400):
        t = START + k * 5 * MS
        for topic in ("/left/imu", "/right/imu"):
            rate = 0.1 if topic == "/left/imu" else 0.2
            messages.append((t + MS, topic, lambda types, t=t, rate=rate: imu_message(types, t, rate=rate)))
        messages += [
            (t + 3 * MS, "/mocap", lambda types, t=t, body=body: transform(types, t, body))
            for body in ("hand", "table")
        ]
        if k % 4 == 0:
            messages.append((t, "/joints", lambda types, t=t: joints(types, t + 2 * MS)))
    return foreign(tmp_path / "bag", messages)


def test_recordings_of_others_are_played(others, tmp_path):
    options = {"imu": f"topic=/left/imu&{FAST}", "robot": f"topic=/mocap@hand&{FAST}"}
    status = replayed(others, tmp_path / "new", **options)
    same(load_bag(others, reference="/mocap@hand", imu="/left/imu"), load_bag(tmp_path / "new"))
    assert (status.imu.late, status.robot.late) == (0, 0)
    replayed(others, tmp_path / "joints", imu=options["imu"], robot=f"topic=/joints&{FAST}")
    found = load_bag(tmp_path / "joints")
    assert found.reference is None
    assert found.joints.stamps_ns.size == 100


@pytest.mark.parametrize(
    ("imu", "robot", "complaint"),
    [
        ("topic=/imu/data", "", "unknown topic with IMU readings '/imu/data'; known are: /left/imu, /right/imu"),
        ("topic=/mocap", "", "the topic /mocap holds 800 messages of type geometry_msgs/msg/TransformStamped"),
        ("", "", r"2 topics hold IMU readings.*/left/imu .*/right/imu.*choose with \?topic=TOPIC"),
        ("topic=/left/imu", "topic=/x", "unknown topic with poses or joint angles '/x'; known are: /joints, /mocap"),
        ("topic=/left/imu", "topic=/mocap", "hand', 'table'; expected one. Choose with \\?topic='/mocap@hand'"),
        ("topic=/left/imu", "topic=/mocap@foot", "unknown frame id on /mocap 'foot'; known are: hand, table"),
    ],
)
def test_topics_that_are_not_meant_or_not_there(others, tmp_path, imu, robot, complaint):
    with pytest.raises(RecordingError, match=complaint):
        replayed(others, tmp_path / "new", imu=imu or "speed=9", robot=robot or "speed=9")
    assert not (tmp_path / "new").exists()


def test_files_that_cannot_be_played(tmp_path):
    whole = recorded(tmp_path / "whole.mcap", live(seconds=1.0, gap=(9, 9)))
    (tmp_path / "cut.mcap").write_bytes(whole.read_bytes()[:-9])
    (tmp_path / "text.mcap").write_text("t,x,y,z\n1,2,3,4\n")
    (tmp_path / "nothing.mcap").write_bytes(b"")
    growing = recorded(tmp_path / "growing.mcap", live(seconds=1.0, gap=(9, 9)), finish=False)
    without_imu = foreign(tmp_path / "bag", [(START, "/joints", lambda types: joints(types, START))])
    unsaid = [(START + k, "/imu", lambda types, k=k: imu_message(types, START + k, mark=-1.0)) for k in range(9)]
    for path, complaint in (
        (tmp_path / "no.mcap", "no.mcap: no such file"),
        (tmp_path / "text.mcap", "text.mcap: is not an MCAP file: starts with 74 2c"),
        (tmp_path / "nothing.mcap", "nothing.mcap: is empty; expected an MCAP file"),
        (tmp_path / "cut.mcap", "still being written, or was cut.*kreisel recover .*cut.mcap"),
        (growing, "still being written"),
        (tmp_path, "the folder holds 5 .mcap files .*cut.mcap.*name it"),
        (without_imu, r"no IMU readings.*got /joints \(sensor_msgs/msg/JointState, 1 messages\)"),
        (foreign(tmp_path / "unsaid", unsaid), r"9 of 9 messages on /imu have no angular_velocity.*\?topic=TOPIC"),
    ):
        with pytest.raises(RecordingError, match=complaint):
            replayed(path, tmp_path / "new")
    imu_alone = recorded(tmp_path / "imu.mcap", [(k, reading(k * MS)) for k in range(100)])
    with pytest.raises(RecordingError, match=r"no poses and no joint angles of a robot; got /imu/data_raw"):
        replayed(imu_alone, tmp_path / "new")


@pytest.mark.parametrize(
    ("address", "complaint"),
    [
        ("mcap://run/recording.mcap", "names a host, 'run', expected a path from the root, with three slashes: mcap:///run"),
        ("mcap://", "names no path"),
        ("mcap:///a.mcap?channel=1", "unknown option 'channel'; known are: speed, topic"),
    ],
)  # fmt: skip
def test_addresses_that_make_no_sense(address, complaint):
    with pytest.raises(SettingsError, match=complaint):
        parse_address(address, IMUS)


def test_names_with_blanks_and_signs(tmp_path):
    file = recorded(tmp_path / "a b#1?.mcap", live(seconds=0.5, gap=(9, 9)))
    replayed(str(file).replace(" ", "%20").replace("?", "%3F"), tmp_path / "new")
    same(load_bag(file), load_bag(tmp_path / "new"))
    with pytest.raises(SettingsError, match="speed is 'fast', expected 0.001 to 1e\\+06"):
        replayed("/a.mcap", tmp_path / "new2", imu="speed=fast")


def test_a_damaged_part_is_told_and_the_rest_played(tmp_path):
    file = recorded(tmp_path / "old.mcap", live(seconds=10.0, gap=(99, 99)))
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    status = replayed(file, tmp_path / "new")
    assert any("is damaged" in note for note in status.notes)
    same(load_bag(file), load_bag(tmp_path / "new"))


def test_readings_that_are_impossible_are_left_out_and_told(tmp_path):
    rates = [0.1, np.nan, 0.3, np.inf, 0.5]
    messages = [
        (START + k, "/imu", lambda types, k=k, rate=rate: imu_message(types, START + k, rate=rate))
        for k, rate in enumerate(rates)
    ]
    status = replayed(foreign(tmp_path / "bag", messages), tmp_path / "new", with_robot=False)
    assert any("2 messages left out: values not finite" in note for note in status.notes)
    assert load_bag(tmp_path / "new").imu.rates[:, 0].tolist() == [0.1, 0.3, 0.5]


def test_a_recording_beside_a_device_ends_with_the_recording(tmp_path):
    """A live IMU, and the robot of a recording."""
    file = recorded(tmp_path / "old.mcap", live(seconds=1.0, gap=(9, 9), late=0.0))

    async def all_of_it(output):
        simulator = TcpSimulator("csv")
        port = await simulator.serve("127.0.0.1", 0)
        began = time.monotonic()
        playing = asyncio.ensure_future(
            simulator.play((reading(k * 2 * MS) for k in range(10**6)), Pace(lambda: began))
        )
        imu, robot = parse_address(f"csv://127.0.0.1:{port}", IMUS), parse_address(f"mcap://{file}", ROBOTS)
        async with asyncio.timeout(60.0):
            status = await record(imu, robot, output)
        playing.cancel()
        simulator.close()
        await asyncio.sleep(0.05)
        return status

    for attempt in range(5):  # a busy machine makes one late
        status = asyncio.run(all_of_it(tmp_path / f"new{attempt}"))
        assert status.robot.count == 250
        if 350 < status.imu.count < 650:
            break
    assert 350 < status.imu.count < 650


def test_the_command_replays_and_the_program_refuses_to(tmp_path):
    file = recorded(tmp_path / "old.mcap", live(seconds=1.0, gap=(9, 9)))

    def kreisel(*arguments):
        command = [sys.executable, "-m", "kreisel.cli.main", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)

    address = f"mcap://{file}?speed=10"
    done = kreisel("record", "--imu", address, "--robot", address, "-o", "new")
    assert done.returncode == 0, done.stderr
    assert (
        "400 IMU samples at 400.0 Hz, 150 poses at 250.0 Hz; missing 0 and 0, repeated or late 0 and 0" in done.stdout
    )
    assert "has ended" in done.stderr
    same(load_bag(file), load_bag(tmp_path / "new"))
    done = kreisel("record", "--imu", "mcap:///no.mcap", "-o", "newer")
    assert done.returncode == 1
    assert done.stderr.startswith("kreisel: /no.mcap: no such file")
    done = kreisel("run", "p.toml", "--robot", "rtde://127.0.0.1", "--imu", address, "--model", "ur10e")
    assert done.returncode == 1
    assert "a recording does not measure this motion" in done.stderr
