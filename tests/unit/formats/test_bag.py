from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kreisel.errors import RecordingError
from kreisel.formats.bag import load_bag
from kreisel.formats.loading import load

FIRST = 1_700_000_000_000_000_007
N = 40
KINDS = ["ros1", "sqlite3", "mcap"]
NONE = np.zeros(9)
MISSING = np.array([-1.0, *np.zeros(8)])


@dataclass(frozen=True)
class Message:
    """A message to be written: topic, type, stamp of its header, and its fields as functions of the types."""

    topic: str
    msgtype: str
    stamp_ns: int
    build: Callable[[Any, Any], Any]
    frame: str = "imu"
    log_delay_ns: int = 1_000_000


def header(types: dict[str, Any], message: Message, ros1: bool) -> Any:
    stamp = types["builtin_interfaces/msg/Time"](*divmod(message.stamp_ns, 10**9))
    return types["std_msgs/msg/Header"](*([0] if ros1 else []), stamp, message.frame)


def write_bag(folder: Path, kind: str, messages: list[Message], log_start: int = FIRST) -> Path:
    ros1 = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    path = folder / ("run.bag" if ros1 else "run")
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Ros1Writer(path) if ros1 else Ros2Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for k, message in enumerate(messages):
            if message.msgtype not in store.types:
                store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", message.msgtype))
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(message.topic, message.msgtype, typestore=store)
            content = message.build(store.types, header(store.types, message, ros1))
            serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
            log_time = message.stamp_ns + message.log_delay_ns if message.stamp_ns else log_start + 10**7 * k
            writer.write(connections[message.topic], log_time, serialize(content, message.msgtype))
    return path


def stamps(n: int = N) -> list[int]:
    return [FIRST + 10_000_000 * k for k in range(n)]


def rate(k: int) -> tuple[float, float, float]:
    return k / 7, -k / 3, 0.1 * k


def acceleration(k: int) -> tuple[float, float, float]:
    return 0.001 * k, 0.002 * k, 9.81 + 0.003 * k


def vector(types: dict[str, Any], x: float, y: float, z: float) -> Any:
    return types["geometry_msgs/msg/Vector3"](x, y, z)


def imu_messages(
    topic: str = "/imu",
    frame: str = "imu",
    n: int = N,
    rates: np.ndarray = NONE,
    accelerations: np.ndarray = NONE,
) -> list[Message]:
    def build(k: int) -> Callable[[Any, Any], Any]:
        return lambda types, head: types["sensor_msgs/msg/Imu"](
            head,
            types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            NONE,
            vector(types, *rate(k)),
            rates,
            vector(types, *acceleration(k)),
            accelerations,
        )

    return [Message(topic, "sensor_msgs/msg/Imu", s, build(k), frame) for k, s in enumerate(stamps(n))]


def point(types: dict[str, Any], k: int) -> Any:
    return types["geometry_msgs/msg/Point"](0.1 * k, 0.2, 0.3)


def turn(types: dict[str, Any]) -> Any:
    return types["geometry_msgs/msg/Quaternion"](0.2, 0.4, 0.8, 0.4)


def pose(types: dict[str, Any], k: int) -> Any:
    return types["geometry_msgs/msg/Pose"](point(types, k), turn(types))


def with_covariance(types: dict[str, Any], k: int) -> Any:
    return types["geometry_msgs/msg/PoseWithCovariance"](pose(types, k), np.zeros(36))


def transform(types: dict[str, Any], head: Any, k: int, child: str) -> Any:
    placed = types["geometry_msgs/msg/Transform"](vector(types, 0.1 * k, 0.2, 0.3), turn(types))
    return types["geometry_msgs/msg/TransformStamped"](head, child, placed)


def odometry(types: dict[str, Any], head: Any, k: int, child: str) -> Any:
    still = types["geometry_msgs/msg/Twist"](vector(types, 0.0, 0.0, 0.0), vector(types, 0.0, 0.0, 0.0))
    twist = types["geometry_msgs/msg/TwistWithCovariance"](still, np.zeros(36))
    return types["nav_msgs/msg/Odometry"](head, child, with_covariance(types, k), twist)


REFERENCES: dict[str, Callable[[Any, Any, int], Any]] = {
    "geometry_msgs/msg/PoseStamped": lambda t, head, k: t["geometry_msgs/msg/PoseStamped"](head, pose(t, k)),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda t, head, k: t["geometry_msgs/msg/PoseWithCovarianceStamped"](
        head, with_covariance(t, k)
    ),
    "geometry_msgs/msg/TransformStamped": lambda t, head, k: transform(t, head, k, "body"),
    "nav_msgs/msg/Odometry": lambda t, head, k: odometry(t, head, k, "body"),
    "geometry_msgs/msg/PointStamped": lambda t, head, k: t["geometry_msgs/msg/PointStamped"](head, point(t, k)),
    "geometry_msgs/msg/QuaternionStamped": lambda t, head, _: t["geometry_msgs/msg/QuaternionStamped"](head, turn(t)),
}


def reference_messages(msgtype: str = "geometry_msgs/msg/PoseStamped", topic: str = "/pose") -> list[Message]:
    def build(k: int) -> Callable[[Any, Any], Any]:
        return lambda types, head: REFERENCES[msgtype](types, head, k)

    return [Message(topic, msgtype, s, build(k), "world") for k, s in enumerate(stamps())]


def joint_messages(
    topic: str = "/joint_states", names: tuple[str, ...] = ("a1", "a2"), n: int = N, positions: int = 2
) -> list[Message]:
    def build(k: int) -> Callable[[Any, Any], Any]:
        angles = np.array([0.5 * k, -0.25 * k])[:positions]
        return lambda types, head: types["sensor_msgs/msg/JointState"](
            head, list(names), angles, np.zeros(0), np.zeros(0)
        )

    return [Message(topic, "sensor_msgs/msg/JointState", s, build(k), "robot") for k, s in enumerate(stamps(n))]


def text_messages(topic: str = "/text") -> list[Message]:
    return [Message(topic, "std_msgs/msg/String", s, lambda t, _: t["std_msgs/msg/String"]("x")) for s in stamps(3)]


def assert_imu(imu: Any, n: int = N) -> None:
    np.testing.assert_array_equal(imu.stamps_ns, stamps(n))
    np.testing.assert_array_equal(imu.rates, [rate(k) for k in range(n)])
    np.testing.assert_array_equal(imu.accelerations, [acceleration(k) for k in range(n)])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("msgtype", list(REFERENCES))
def test_every_kind_of_bag_and_of_reference(tmp_path: Path, kind: str, msgtype: str) -> None:
    path = write_bag(tmp_path, kind, imu_messages() + reference_messages(msgtype) + joint_messages() + text_messages())
    got = load_bag(path)
    assert_imu(got.imu)
    assert got.warnings == ()
    assert got.reference.name == "/pose"
    np.testing.assert_array_equal(got.reference.stamps_ns, stamps())
    if msgtype.endswith("QuaternionStamped"):
        assert got.reference.positions is None
    else:
        k = np.arange(N)
        want = np.column_stack([0.1 * k, np.full(N, 0.2), np.full(N, 0.3)])
        np.testing.assert_array_equal(got.reference.positions, want)
    if msgtype.endswith("PointStamped"):
        assert got.reference.quaternions is None
    else:
        np.testing.assert_array_equal(got.reference.quaternions, np.tile([0.4, 0.2, 0.4, 0.8], (N, 1)))
    want = np.column_stack([0.5 * np.arange(N), -0.25 * np.arange(N)])
    np.testing.assert_array_equal(got.joints.angles, want)


def test_a_lone_storage_file(tmp_path: Path) -> None:
    folder = write_bag(tmp_path, "sqlite3", imu_messages() + reference_messages())
    assert_imu(load_bag(folder / "run.db3").imu)
    (tmp_path / "2").mkdir()
    folder = write_bag(tmp_path / "2", "mcap", imu_messages() + reference_messages())
    assert_imu(load_bag(folder / "run.mcap").imu)


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_a_compressed_bag(tmp_path: Path, mode: CompressionMode, plugin: StoragePlugin) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Ros2Writer(tmp_path / "run", version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        for message in imu_messages():
            content = message.build(store.types, header(store.types, message, ros1=False))
            writer.write(connection, message.stamp_ns, store.serialize_cdr(content, message.msgtype))
    assert_imu(load_bag(tmp_path / "run").imu)


def test_load_takes_bags_and_topics(tmp_path: Path) -> None:
    messages = imu_messages("/a/imu", n=600) + imu_messages("/b/imu", n=600)
    path = write_bag(tmp_path, "mcap", messages)
    assert_imu(load(path, imu="/b/imu").imu, 600)
    (path / "metadata.yaml").unlink()
    got = load(path, imu="/b/imu")
    assert_imu(got.imu, 600)
    assert "no metadata.yaml" in got.warnings[0].message


def test_messages_are_taken_in_the_order_of_their_log_times(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", imu_messages()[::-1])
    assert_imu(load_bag(path).imu)
    assert_imu(load_bag(path / "run.mcap").imu)


# Topics


@pytest.mark.parametrize("kind", KINDS)
def test_of_several_topics_none_is_taken_silently(tmp_path: Path, kind: str) -> None:
    two = imu_messages("/left/imu") + imu_messages("/right/imu", n=7)
    path = write_bag(tmp_path, kind, two + reference_messages(topic="/a") + reference_messages(topic="/b"))
    listed = r"/left/imu \(sensor_msgs/msg/Imu, 40 messages\), /right/imu \(sensor_msgs/msg/Imu, 7 messages\)"
    with pytest.raises(RecordingError, match=rf"2 topics hold IMU readings, expected one: {listed}.*--imu TOPIC"):
        load_bag(path)
    with pytest.raises(RecordingError, match=r"2 topics hold reference poses.*/a .*/b .*--reference TOPIC"):
        load_bag(path, imu="/left/imu")
    got = load_bag(path, imu="right/imu", reference="/b")
    assert_imu(got.imu, 7)
    assert got.reference.name == "/b"


def test_the_topics_of_kreisel_go_first(tmp_path: Path) -> None:
    messages = (
        imu_messages("/other/imu", n=5)
        + imu_messages("/imu/data_raw")
        + reference_messages(topic="/other/pose")
        + reference_messages(topic="/robot/pose")
        + joint_messages("/other/joints")
        + joint_messages("/robot/joint_states")
    )
    got = load_bag(write_bag(tmp_path, "mcap", messages))
    assert_imu(got.imu)
    assert got.reference.name == "/robot/pose"
    assert got.joints is not None
    assert [str(warning) for warning in got.warnings] == [
        "topics: took /imu/data_raw of /other/imu, /imu/data_raw; --imu chooses another",
        "topics: took /robot/pose of /other/pose, /robot/pose; --reference chooses another",
    ]


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"imu": "/nowhere"}, r"unknown topic with IMU readings '/nowhere'; known are: /imu; .*--imu TOPIC"),
        (
            {"imu": "/text"},
            r"the topic /text holds 3 messages of type std_msgs/msg/String \(cdr\); expected IMU",
        ),
        (
            {"reference": "/imu"},
            r"the topic /imu holds 40 messages of type sensor_msgs/msg/Imu \(cdr\); expected ref",
        ),
        ({"imu": "/imu@elsewhere"}, r"unknown frame id on /imu 'elsewhere'; known are: imu"),
        ({"reference": "/pose0"}, r"known are: none: no topic holds reference poses"),
    ],
)
def test_a_topic_that_is_not_there(tmp_path: Path, asked: dict[str, str], message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        load_bag(write_bag(tmp_path, "mcap", imu_messages() + text_messages()), **asked)


@pytest.mark.parametrize("kind", KINDS)
def test_two_imus_on_one_topic_are_told_apart(tmp_path: Path, kind: str) -> None:
    left, right = imu_messages(frame="left"), imu_messages(frame="right", n=9)
    path = write_bag(tmp_path, kind, [*left, *right])
    with pytest.raises(RecordingError) as caught:
        load_bag(path)
    assert str(caught.value) == (
        f"{path}: 2 bodies share the topic /imu, with the frame ids 'left', 'right'; expected one. "
        "Choose with --imu '/imu@left' or --imu '/imu@right'"
    )
    assert_imu(load_bag(path, imu="/imu@left").imu)
    assert_imu(load_bag(path, imu="imu@right").imu, 9)


def test_names_that_would_break_the_line(tmp_path: Path) -> None:
    strange = imu_messages(frame="a\nb") + imu_messages(frame="\x1b[31m") + joint_messages(names=("a", "\n"))
    with pytest.raises(RecordingError, match="2 bodies share") as caught:
        load_bag(write_bag(tmp_path, "mcap", strange))
    assert str(caught.value).isprintable()


def test_two_tracked_bodies_on_one_topic_are_told_apart(tmp_path: Path) -> None:
    msgtype = "geometry_msgs/msg/TransformStamped"
    messages = [
        replace(message, build=lambda types, head, child=child, k=k: transform(types, head, k, child))
        for child in ("wand", "plate")
        for k, message in enumerate(reference_messages(msgtype, "/tracker"))
    ]
    path = write_bag(tmp_path, "mcap", imu_messages() + messages)
    with pytest.raises(RecordingError, match=r"'plate', 'wand'.*--reference '/tracker@plate'"):
        load_bag(path)
    assert load_bag(path, reference="/tracker@wand").reference.stamps_ns.size == N


def test_without_an_imu_the_topics_are_listed(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "sqlite3", text_messages())
    with pytest.raises(RecordingError, match=r"no IMU readings.*/text \(std_msgs/msg/String, 3 messages\)"):
        load_bag(path)


def test_without_a_reference_there_is_none(tmp_path: Path) -> None:
    got = load_bag(write_bag(tmp_path, "ros1", imu_messages()))
    assert got.reference is None
    assert got.joints is None
    assert not got.warnings


# Messages


def test_headers_stamped_zero(tmp_path: Path) -> None:
    unstamped = [replace(message, stamp_ns=0) for message in imu_messages()]
    got = load_bag(write_bag(tmp_path, "mcap", unstamped))
    np.testing.assert_array_equal(got.imu.stamps_ns, stamps())
    assert "every header on /imu is stamped zero" in str(got.warnings[0])


def test_a_clock_that_begins_at_zero_loses_nothing(tmp_path: Path) -> None:
    messages = [replace(m, stamp_ns=m.stamp_ns - FIRST) for m in imu_messages()]
    got = load_bag(write_bag(tmp_path, "mcap", messages, log_start=0))
    np.testing.assert_array_equal(got.imu.stamps_ns, np.array(stamps()) - FIRST)
    assert not got.warnings


def test_first_headers_stamped_zero(tmp_path: Path) -> None:
    messages = [imu_messages(), reference_messages(), joint_messages()]
    some = [replace(m, stamp_ns=0) if k < 3 else m for part in messages for k, m in enumerate(part)]
    got = load_bag(write_bag(tmp_path, "mcap", some))
    assert got.reference is not None
    assert got.joints is not None
    for stream in (got.imu, got.reference, got.joints):
        np.testing.assert_array_equal(stream.stamps_ns, stamps()[3:])
    np.testing.assert_array_equal(got.imu.rates, [rate(k) for k in range(3, N)])
    np.testing.assert_array_equal(got.joints.angles, [[0.5 * k, -0.25 * k] for k in range(3, N)])
    assert [str(w) for w in got.warnings] == [
        f"stamps: left out 3 messages on {topic} whose headers are stamped zero"
        for topic in ("/imu", "/pose", "/joint_states")
    ]


@pytest.mark.parametrize("lacking", ["rates", "accelerations"])
def test_an_imu_without_one_half(tmp_path: Path, lacking: str) -> None:
    path = write_bag(tmp_path, "mcap", imu_messages(**{lacking: MISSING}))
    quantity = "angular_velocity" if lacking == "rates" else "linear_acceleration"
    with pytest.raises(RecordingError, match=rf"40 of 40 messages on /imu have no {quantity}.*--imu TOPIC"):
        load_bag(path)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (joint_messages(names=("b1", "b2"), n=3), r"2 positions of the joints \[b1, b2\], expected 2 of \[a1, a2\]"),
        (joint_messages(names=("a2",), n=3, positions=1), r"1 positions of the joints \[a2\], expected 2"),
        (joint_messages(n=3, positions=0), r"0 positions of the joints \[a1, a2\]"),
    ],
)
def test_joints_that_change(tmp_path: Path, other: list[Message], message: str) -> None:
    later = [replace(m, log_delay_ns=10**10) for m in other]
    path = write_bag(tmp_path, "mcap", imu_messages() + joint_messages() + later)
    with pytest.raises(RecordingError, match=rf"message 41 on /joint_states has {message}"):
        load_bag(path)


def test_joints_in_another_order_are_sorted_by_their_names(tmp_path: Path) -> None:
    half = [replace(m, stamp_ns=m.stamp_ns + 5_000_000) for m in joint_messages(names=("a2", "a1"))]
    both = [m for pair in zip(joint_messages(), half, strict=True) for m in pair]
    joints = load_bag(write_bag(tmp_path, "mcap", imu_messages() + both)).joints
    assert joints is not None
    np.testing.assert_array_equal(joints.angles[0::2], [[0.5 * k, -0.25 * k] for k in range(N)])
    np.testing.assert_array_equal(joints.angles[1::2], [[-0.25 * k, 0.5 * k] for k in range(N)])


@pytest.mark.parametrize("first", [True, False])
def test_a_gripper_on_the_topic_of_the_joints(tmp_path: Path, first: bool) -> None:
    delay = -1_000_000 if first else 1_000_000
    grip = [
        replace(m, stamp_ns=m.stamp_ns + delay, log_delay_ns=0) for m in joint_messages(names=("grip",), positions=1)
    ]
    got = load_bag(write_bag(tmp_path, "mcap", imu_messages() + joint_messages() + grip))
    assert got.joints is not None
    np.testing.assert_array_equal(got.joints.stamps_ns, stamps())
    np.testing.assert_array_equal(got.joints.angles, [[0.5 * k, -0.25 * k] for k in range(N)])
    assert [str(w) for w in got.warnings] == [
        "joints: left out 40 messages on /joint_states with other joints than [a1, a2]"
    ]


def test_joints_of_several_robots_are_left_out(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", imu_messages() + joint_messages("/a/joints") + joint_messages("/b/joints"))
    got = load_bag(path)
    assert got.joints is None
    assert "left out, because /a/joints, /b/joints hold them" in str(got.warnings[0])


# Settings


@pytest.mark.parametrize("kind", KINDS)
def test_settings_beside_a_bag(tmp_path: Path, kind: str) -> None:
    path = write_bag(tmp_path, kind, imu_messages())
    beside = path / "recording.toml" if path.is_dir() else tmp_path / "run.toml"
    beside.write_text("[site]\nheight_m = 230.0\n")
    assert load_bag(path).settings.site.height_m == 230.0
    beside.write_text("[site]\nheight = 230.0\n")
    with pytest.raises(RecordingError, match=r"unknown key 'site\.height'"):
        load_bag(path)


# Damage


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("run.bag", b"", "empty"),
        ("run.bag", b"#ROSBAG V1.2\n", "version 102 is not supported"),
        ("run.bag", b"garbage" * 100, "cannot be read"),
        ("run.db3", b"", "cannot be read|no IMU readings"),
        ("run.db3", b"garbage" * 1000, "not a database"),
        ("run.db3", b"SQLite format 3\0" + b"garbage" * 1000, "cannot be read"),
    ],
)
def test_what_is_no_bag_is_refused(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=message) as caught:
        load_bag(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "[", "rosbag2_bagfile_information: 3", "a: b: c:\n\n  - x"])
def test_a_damaged_metadata_yaml(tmp_path: Path, text: str) -> None:
    path = write_bag(tmp_path, "sqlite3", imu_messages())
    (path / "metadata.yaml").write_text(text)
    with pytest.raises(RecordingError, match="cannot be read") as caught:
        load_bag(path)
    assert "\n" not in str(caught.value)


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such file"):
        load_bag(tmp_path / "run.bag")
    with pytest.raises(RecordingError, match="cannot be read"):
        load_bag(tmp_path)


def test_a_cut_file_in_a_folder_is_read_through_the_stream(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", imu_messages())
    content = (path / "run.mcap").read_bytes()
    (path / "run.mcap").write_bytes(content[:-20])
    got = load_bag(path)
    assert_imu(got.imu)
    assert "cut or damaged" in got.warnings[0].message


@pytest.mark.parametrize("text", ["", "[", "rosbag2_bagfile_information: 3", "a: b: c:\n\n  - x"])
def test_files_beside_a_damaged_metadata_yaml_are_read(tmp_path: Path, text: str) -> None:
    path = write_bag(tmp_path, "mcap", imu_messages())
    (path / "metadata.yaml").write_text(text)
    got = load_bag(path)
    assert_imu(got.imu)
    assert "read its .mcap files one by one" in got.warnings[0].message


@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
@pytest.mark.parametrize("part", [0.3, 0.6, 0.99])
def test_a_cut_bag_is_refused(tmp_path: Path, kind: str, part: float) -> None:
    path = write_bag(tmp_path, kind, imu_messages(n=400))
    file = path / "run.db3" if path.is_dir() else path
    file.write_bytes(file.read_bytes()[: int(part * file.stat().st_size)])
    with pytest.raises(RecordingError, match=r"reindex") as caught:
        load_bag(path)
    assert str(path) in str(caught.value)


def refusal(path: Path) -> str | None:
    """Return what the error says, None where there is none; any other exception fails the test."""
    try:
        load_bag(path)
    except RecordingError as error:
        return str(error)
    return None


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    messages = imu_messages(n=20) + reference_messages()
    folders = {kind: tmp_path_factory.mktemp(kind) for kind in KINDS}
    paths = {kind: write_bag(folder, kind, messages) for kind, folder in folders.items()}
    return {kind: next(path.glob("run.*")) if path.is_dir() else path for kind, path in paths.items()}


@settings(max_examples=200, deadline=None, derandomize=True)
@given(data=st.data(), kind=st.sampled_from(KINDS))
def test_damage_raises_recording_errors_only(bags: dict[str, Path], data: st.DataObject, kind: str) -> None:
    content = bytearray(bags[kind].read_bytes())
    where = st.integers(0, len(content) - 1)
    for place, value in data.draw(st.lists(st.tuples(where, st.integers(0, 255)), max_size=6)):
        content[place] = value
    length = data.draw(st.one_of(st.just(len(content)), where))
    path = bags[kind].parent / f"damaged{bags[kind].suffix}"
    path.write_bytes(content[:length])
    message = refusal(path)
    assert message is None or (path.name in message and "\n" not in message)
