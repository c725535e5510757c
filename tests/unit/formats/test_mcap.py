import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from kreisel.errors import RecordingError
from kreisel.formats.bag import load_bag
from kreisel.formats.loading import load
from kreisel.formats.mcap import CHUNK_SIZE, McapWriter
from kreisel.formats.mcap_file import write_mcap
from kreisel.recording.recording import ImuSamples, JointAngles, Recording, ReferencePoses
from kreisel.recording.recording_settings import RecordingSettings

EPOCH = 1_700_000_000_123_456_789
SETTINGS = RecordingSettings.model_validate(
    {
        "imu": {"gyro_noise_density": 1.0 / 3.0e5, "grade": "fog"},
        "site": {"latitude_deg": 49.25, "height_m": 230.0},
        "reference": {"kind": "robot", "position_sd": 2e-4},
        "robot": {"tcp": "flange"},
    }
)


def stamps(n: int, interval_ns: int, first: int = EPOCH) -> np.ndarray:
    return first + interval_ns * np.arange(n, dtype=np.int64)


def imu(n: int = 600, rng: np.random.Generator | None = None) -> ImuSamples:
    rng = rng or np.random.default_rng(1)
    gravity = np.array([0.0, 0.0, 9.81])
    return ImuSamples(
        stamps(n, 10_000_003), rng.normal(size=(n, 3)), gravity + 0.1 * rng.normal(size=(n, 3)), Path("imu")
    )


def poses(n: int = 300, *, positions: bool = True, quaternions: bool = True) -> ReferencePoses:
    rng = np.random.default_rng(2)
    p = 1e-3 * np.cumsum(rng.normal(size=(n, 3)), axis=0)
    q = rng.normal(size=(n, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    return ReferencePoses(
        "pose0", stamps(n, 20_000_000), p if positions else None, q if quaternions else None, Path("pose")
    )


def recording(**changes: object) -> Recording:
    joints = JointAngles(stamps(300, 20_000_000), np.random.default_rng(3).normal(size=(300, 6)), Path("joints"))
    fields = {"imu": imu(), "reference": poses(), "joints": joints, "settings": SETTINGS} | changes
    return Recording(Path("made"), **fields)


def assert_same_imu(got: ImuSamples, want: ImuSamples, part: slice = slice(None)) -> None:
    np.testing.assert_array_equal(got.stamps_ns, want.stamps_ns[part])
    np.testing.assert_array_equal(got.rates, want.rates[part])
    np.testing.assert_array_equal(got.accelerations, want.accelerations[part])


def assert_same_poses(got: ReferencePoses, want: ReferencePoses, part: slice = slice(None)) -> None:
    np.testing.assert_array_equal(got.stamps_ns, want.stamps_ns[part])
    for have, expected in ((got.positions, want.positions), (got.quaternions, want.quaternions)):
        if expected is None:
            assert have is None
        else:
            np.testing.assert_array_equal(have, expected[part])


def outcome(path: Path) -> Recording | RecordingError:
    """Return what was read, or why not; any other exception fails the test."""
    try:
        return load_bag(path)
    except RecordingError as error:
        return error


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "run.mcap"
    write_mcap(recording(), path)
    return path


def cut(source: Path, folder: Path, size: int) -> Path:
    path = folder / f"cut_{size}.mcap"
    path.write_bytes(source.read_bytes()[:size])
    return path


def test_everything_comes_back_exactly(written: Path) -> None:
    want, got = recording(), load_bag(written)
    assert_same_imu(got.imu, want.imu)
    assert_same_poses(got.reference, want.reference)
    np.testing.assert_array_equal(got.joints.stamps_ns, want.joints.stamps_ns)
    np.testing.assert_array_equal(got.joints.angles, want.joints.angles)
    assert got.settings == want.settings
    assert got.warnings == ()
    assert got.name == "run.mcap"


def test_load_opens_it(written: Path) -> None:
    got = load(written)
    assert_same_imu(got.imu, recording().imu)
    assert got.reference.name == "/robot/pose"


@pytest.mark.parametrize(
    "values",
    [
        [0.0, -0.0, 5e-324],
        [1.7976931348623157e308, -2.2250738585072014e-308, 0.1],
        [float("nan"), float("inf"), -float("inf")],
    ],
)
def test_any_float_comes_back_bit_by_bit(tmp_path: Path, values: list[float]) -> None:
    rates = np.tile(values, (10, 1))
    samples = ImuSamples(stamps(10, 1), rates, rates[:, ::-1].copy(), Path("imu"))
    write_mcap(recording(imu=samples), tmp_path / "run.mcap")
    assert load_bag(tmp_path / "run.mcap").imu.rates.tobytes() == rates.tobytes()


@pytest.mark.parametrize(
    ("half", "topic"),
    [({"positions": False}, "/robot/orientation"), ({"quaternions": False}, "/robot/position")],
)
def test_half_a_pose_comes_back_as_half(tmp_path: Path, half: dict[str, bool], topic: str) -> None:
    want = poses(**half)
    write_mcap(recording(reference=want), tmp_path / "run.mcap")
    got = load_bag(tmp_path / "run.mcap").reference
    assert_same_poses(got, want)
    assert got.name == topic


def test_a_recording_of_the_imu_alone(tmp_path: Path) -> None:
    alone = recording(reference=None, joints=None, settings=RecordingSettings())
    write_mcap(alone, tmp_path / "run.mcap")
    got = load_bag(tmp_path / "run.mcap")
    assert got.reference is None
    assert got.joints is None
    assert got.settings == RecordingSettings()


def test_the_same_recording_gives_the_same_bytes(written: Path, tmp_path: Path) -> None:
    write_mcap(recording(), tmp_path / "again.mcap")
    assert (tmp_path / "again.mcap").read_bytes() == written.read_bytes()


def test_nothing_is_overwritten_and_nothing_is_left_behind(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"mine")
    with pytest.raises(RecordingError, match=r"run\.mcap: exists already"):
        write_mcap(recording(), path)
    assert path.read_bytes() == b"mine"
    with pytest.raises(RecordingError, match="cannot be written"):
        write_mcap(recording(), path / "below_a_file.mcap")
    assert sorted(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("first", [-1, 2**31 * 10**9])
def test_a_stamp_that_fits_no_header_is_refused(tmp_path: Path, first: int) -> None:
    samples = imu(20)
    outside = ImuSamples(stamps(20, 1000, first), samples.rates, samples.accelerations, Path("imu"))
    with pytest.raises(RecordingError, match=f"{first} ns does not fit a ROS header"):
        write_mcap(recording(imu=outside), tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


def test_rosbags_reads_the_same_messages(written: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    want = recording()
    with Reader(written) as reader:
        assert {c.topic: (c.msgtype, c.msgcount) for c in reader.connections} == {
            "/imu/data_raw": ("sensor_msgs/msg/Imu", 600),
            "/robot/pose": ("geometry_msgs/msg/PoseStamped", 300),
            "/robot/joint_states": ("sensor_msgs/msg/JointState", 300),
        }
        chosen = [c for c in reader.connections if c.topic == "/imu/data_raw"]
        messages = [(t, store.deserialize_cdr(raw, c.msgtype)) for c, t, raw in reader.messages(chosen)]
    assert [t for t, _ in messages] == want.imu.stamps_ns.tolist()
    assert messages[5][1].orientation_covariance[0] == -1.0
    assert messages[5][1].angular_velocity.y == want.imu.rates[5, 1]


def test_the_mcap_tools_read_it(written: Path) -> None:
    with written.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
        assert max(index.uncompressed_size for index in summary.chunk_indexes) < CHUNK_SIZE + 2000
        times = [(m.log_time, m.publish_time) for _, _, m in reader.iter_messages()]
    assert len(times) == 1200
    assert all(log == publish for log, publish in times)


def test_the_chunk_that_was_being_written_is_all_a_cut_costs(written: Path, tmp_path: Path) -> None:
    """Everything in a chunk that is whole comes back; the warning says where the file was cut."""
    want = recording()
    with written.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    assert len(chunks) > 3
    for k, chunk in enumerate(chunks[1:], start=1):
        whole = chunks[k - 1].message_end_time
        n, m = np.sum(want.imu.stamps_ns <= whole), np.sum(want.reference.stamps_ns <= whole)
        for size in (chunk.chunk_start_offset, chunk.chunk_start_offset + 30, chunk.chunk_start_offset + 500):
            got = load_bag(cut(written, tmp_path, size))
            assert_same_imu(got.imu, want.imu, slice(n))
            assert_same_poses(got.reference, want.reference, slice(m))
            assert got.settings == SETTINGS
            assert len(got.warnings) == 1
    assert "without a footer" in str(load_bag(cut(written, tmp_path, chunks[2].chunk_start_offset)).warnings[0])
    beyond = load_bag(cut(written, tmp_path, chunks[2].chunk_start_offset + 30)).warnings[0]
    lasts = (chunks[2].message_end_time - chunks[2].message_start_time) * 1e-9
    assert f"byte {chunks[2].chunk_start_offset} of" in beyond.message
    assert f"with {lasts:.3g} s of messages" in beyond.message


def test_a_file_without_its_index_is_whole_but_for_the_warning(written: Path, tmp_path: Path) -> None:
    got = load_bag(cut(written, tmp_path, written.stat().st_size - 20))
    assert_same_imu(got.imu, recording().imu)
    assert len(got.warnings) == 1


def test_zeros_after_a_loss_of_power(written: Path, tmp_path: Path) -> None:
    with written.open("rb") as file:
        end = make_reader(file).get_summary().chunk_indexes[2].chunk_start_offset
    path = cut(written, tmp_path, end)
    with path.open("ab") as file:
        file.write(bytes(9_000))
    got = load_bag(path)
    assert 0 < got.imu.stamps_ns.size < 600
    assert [warning.message for warning in got.warnings] == [
        f"it is cut or damaged at byte {end} of {end + 9000}; the last 9000 bytes are lost, unless "
        "`kreisel recover` finds more in them"
    ]


def test_a_damaged_chunk_in_the_middle_is_left_out(written: Path, tmp_path: Path) -> None:
    content = bytearray(written.read_bytes())
    with written.open("rb") as file:
        chunk = make_reader(file).get_summary().chunk_indexes[1]
    middle = chunk.chunk_start_offset + chunk.chunk_length // 2
    content[middle : middle + 8] = b"\xff" * 8
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    got, want = load_bag(path), recording()
    lost = (want.imu.stamps_ns >= chunk.message_start_time) & (want.imu.stamps_ns <= chunk.message_end_time)
    np.testing.assert_array_equal(got.imu.stamps_ns, want.imu.stamps_ns[~lost])
    assert f"chunk at byte {chunk.chunk_start_offset} is damaged" in got.warnings[0].message


def test_definitions_lost_with_the_first_chunk_are_found_at_the_end(written: Path, tmp_path: Path) -> None:
    content = bytearray(written.read_bytes())
    with written.open("rb") as file:
        chunk = make_reader(file).get_summary().chunk_indexes[0]
    content[chunk.chunk_start_offset + chunk.chunk_length - 8] ^= 0xFF
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    got, want = load_bag(path), recording()
    np.testing.assert_array_equal(got.imu.stamps_ns, want.imu.stamps_ns[want.imu.stamps_ns > chunk.message_end_time])
    # Without the end they are gone for good.
    with pytest.raises(RecordingError, match=r"no IMU readings.*definition of"):
        load_bag(cut(path, tmp_path, len(content) * 3 // 4))


def test_every_length_of_file_is_read_or_refused(written: Path, tmp_path: Path) -> None:
    size = written.stat().st_size
    before = 0
    for length in sorted({*range(60), *range(60, size, 997), size - 1}):
        got = outcome(cut(written, tmp_path, length))
        n = 0 if isinstance(got, RecordingError) else got.imu.stamps_ns.size
        assert n >= before
        before = n
    assert before == 600


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"\x89MCAP1\r\n" + bytes(100), "is not an MCAP file"),
        (b"#ROSBAG V2.0\n", "is not an MCAP file: starts with 23 52 4f"),
        (b"\x89MCAP0\r\n", "no IMU readings.*no topics.*without a footer"),
        (
            b"\x89MCAP0\r\n" + b"\x06" + struct.pack("<Q", 2**64 - 1),
            "no IMU readings.*cut or damaged at byte 8",
        ),
        (b"\x89MCAP0\r\n" + np.random.default_rng(4).bytes(5000), "no IMU readings"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=message) as caught:
        load_bag(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", list(CompressionType))
def test_files_of_other_writers(tmp_path: Path, chunked: bool, compression: CompressionType) -> None:
    """Without chunks, index or profile, with any compression, and as ROS 1 messages."""
    store, want = get_typestore(Stores.ROS1_NOETIC), imu(50)
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=chunked, compression=compression, index_types=IndexType.NONE)
        writer.start()
        schema = writer.register_schema("sensor_msgs/Imu", "ros1msg", b"")
        channel = writer.register_channel("/mti/imu", "ros1", schema)
        text = writer.register_channel("/text", "json", writer.register_schema("Text", "jsonschema", b"{}"))
        for k in range(50):
            message = ros1_imu(store, want, k)
            log_time = int(want.stamps_ns[k]) + 5
            writer.add_message(channel, log_time, store.serialize_ros1(message, "sensor_msgs/msg/Imu"), 0)
            writer.add_message(text, log_time, b"{}", 0)
        writer.finish()
    got = load_bag(path)
    assert_same_imu(got.imu, want)
    assert got.warnings == ()
    with pytest.raises(RecordingError, match=r"the topic /text holds 50 messages of type Text \(json\)"):
        load_bag(path, imu="/text")


def ros1_imu(store: Any, samples: ImuSamples, k: int) -> Any:
    types, none = store.types, np.zeros(9)
    stamp = types["builtin_interfaces/msg/Time"](*divmod(int(samples.stamps_ns[k]), 10**9))
    vector = types["geometry_msgs/msg/Vector3"]
    return types["sensor_msgs/msg/Imu"](
        types["std_msgs/msg/Header"](k, stamp, "imu"),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        none,
        vector(*samples.rates[k]),
        none,
        vector(*samples.accelerations[k]),
        none,
    )


SMALL = recording(imu=imu(60), reference=poses(30), joints=None)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("small") / "small.mcap"
    write_mcap(SMALL, path)
    return path


@settings(max_examples=300, deadline=None, derandomize=True)
@given(data=st.data())
def test_any_damage_is_a_recording_error_or_a_warning(small: Path, data: st.DataObject) -> None:
    content = bytearray(small.read_bytes())
    where = st.integers(0, len(content) - 1)
    for place, value in data.draw(st.lists(st.tuples(where, st.integers(0, 255)), max_size=6)):
        content[place] = value
    length = data.draw(st.one_of(st.just(len(content)), where))
    path = small.with_name("damaged.mcap")
    path.write_bytes(content[:length])
    got = outcome(path)
    if isinstance(got, RecordingError):
        assert "damaged.mcap" in str(got)
        assert "\n" not in str(got)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(garbage=st.binary(max_size=400))
def test_garbage_is_a_recording_error(small: Path, garbage: bytes) -> None:
    path = small.with_name("garbage.mcap")
    path.write_bytes(b"\x89MCAP0\r\n" + garbage)
    with pytest.raises(RecordingError):
        load_bag(path)


def _restarted(path: Path, *, lost_s: float, with_robot: bool) -> None:
    """Write readings of a device that restarts after 3 s, and comes back after some time."""
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        for k in range(600):
            later = k >= 300
            stamp = 10_000_000 * (k - 300 if later else k + 70_000)
            log = EPOCH + 10_000_000 * k + (round(lost_s * 1e9) if later else 0)
            writer.add_imu(stamp, (0.1 * later, 0.0, 0.0), (0.0, 0.0, 9.8), log, 1 + later)
            if with_robot:
                writer.add_pose(log, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), log, 1)
        writer.finish()


@pytest.mark.parametrize("lost_s", [0.0, 7.0])
def test_readings_before_and_after_a_restart_are_joined_by_their_arrival(tmp_path: Path, lost_s: float) -> None:
    _restarted(tmp_path / "recording.mcap", lost_s=lost_s, with_robot=False)
    recording = load_bag(tmp_path / "recording.mcap")
    step = np.diff(recording.imu.stamps_ns) * 1e-9
    assert step.size == 599
    assert step[299] == pytest.approx(max(0.2, lost_s + 0.01))
    np.testing.assert_allclose(np.delete(step, 299), 0.01)
    np.testing.assert_array_equal(recording.imu.rates[:, 0] > 0.0, np.arange(600) >= 300)
    said = f"clock: the device's clock leapt, at {step[:300].sum():.1f} s: the readings before and after are joined"
    assert [str(warning) for warning in recording.warnings] == [f"{said} by their times of arrival"]


def test_with_poses_on_a_clock_of_their_own_they_are_not(tmp_path: Path) -> None:
    _restarted(tmp_path / "recording.mcap", lost_s=0.0, with_robot=True)
    recording = load_bag(tmp_path / "recording.mcap")
    assert len(recording.imu.stamps_ns) == 300
    assert "took /imu/data_raw of /imu/data_raw, /imu/data_raw_2" in str(recording.warnings[0])


def test_one_part_can_be_asked_for(tmp_path: Path) -> None:
    _restarted(tmp_path / "recording.mcap", lost_s=0.0, with_robot=False)
    recording = load_bag(tmp_path / "recording.mcap", imu="/imu/data_raw_2")
    assert len(recording.imu.stamps_ns) == 300
    assert not recording.warnings
