"""Messages of ROS 2, against the library that reads and writes them in recordings, and as the standard says."""

import math
import re
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from kreisel.devices.address import IMUS, ROBOTS, check_sender, parse_address
from kreisel.devices.ros2_network import Publisher
from kreisel.devices.ros2_system import ImuListener, RobotListener, _silence, listener_at
from kreisel.errors import ProtocolError, SettingsError
from kreisel.protocols import ros2
from kreisel.protocols.samples import ImuSample, RobotSample

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
NONE = np.zeros(9)
numbers = st.floats(-1e3, 1e3, allow_nan=False)
triples = st.tuples(numbers, numbers, numbers)
stamps = st.integers(0, 2**31 * 10**9 - 1)


def header(stamp_ns, frame=""):
    time = TYPES["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    return TYPES["std_msgs/msg/Header"](time, frame)


def vector(v):
    return TYPES["geometry_msgs/msg/Vector3"](*v)


def turn(q):
    return TYPES["geometry_msgs/msg/Quaternion"](*q[1:], q[0])


def imu(stamp_ns, rate, acceleration, frame="imu", covariance=NONE):
    return TYPES[ros2.IMU](
        header(stamp_ns, frame), turn((1, 0, 0, 0)), NONE, vector(rate), covariance, vector(acceleration), NONE
    )


def transform(stamp_ns, parent, child, position, q):
    inner = TYPES["geometry_msgs/msg/Transform"](vector(position), turn(q))
    return TYPES[ros2.TRANSFORM](header(stamp_ns, parent), child, inner)


def written(message, *, big=False):
    return bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=not big))


@given(stamps, triples, triples, st.text(max_size=9), st.booleans())
def test_readings_of_the_library_are_read(stamp_ns, rate, acceleration, frame, big):
    data = written(imu(stamp_ns, rate, acceleration, frame), big=big)
    assert ros2.decode_imu(data) == ImuSample(stamp_ns, rate, acceleration)


@given(stamps, triples, triples)
def test_the_library_reads_our_readings(stamp_ns, rate, acceleration):
    data = ros2.encode_imu(ImuSample(stamp_ns, rate, acceleration))
    found = STORE.deserialize_cdr(data, ros2.IMU)
    assert ros2.decode_imu(data) == ImuSample(stamp_ns, rate, acceleration)
    assert (found.angular_velocity.x, found.linear_acceleration.z) == (rate[0], acceleration[2])
    assert found.orientation_covariance[0] == -1.0  # no attitude, by the message's definition


@given(stamps, st.dictionaries(st.text(min_size=1, max_size=12), numbers, max_size=8), st.booleans())
def test_joint_angles_of_the_library_are_read(stamp_ns, angles, big):
    message = TYPES[ros2.JOINTS](
        header(stamp_ns), list(angles), np.array(list(angles.values())), np.zeros(2), np.zeros(0)
    )
    names = tuple(name.rstrip("\0") for name in angles)
    assert ros2.decode_joints(written(message, big=big)) == ros2.Joints(stamp_ns, names, tuple(angles.values()))


def test_the_library_reads_our_joint_angles_poses_and_frames():
    joints = ros2.as_published(3 * 10**9, (0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    found = STORE.deserialize_cdr(ros2.encode_joints(joints), ros2.JOINTS)
    assert found.name[0] == "elbow_joint"
    assert list(found.position) == [0.3, 0.2, 0.1, 0.4, 0.5, 0.6]
    q = (0.5, -0.5, 0.5, 0.5)
    pose = STORE.deserialize_cdr(ros2.encode_pose(RobotSample(5, (1.0, 2.0, 3.0), q)), ros2.POSE)
    assert (pose.pose.orientation.w, pose.pose.orientation.x, pose.pose.position.y) == (0.5, -0.5, 2.0)
    one = ros2.Transform(7, "base", "tool", (1.0, 2.0, 3.0), q)
    frames = STORE.deserialize_cdr(ros2.encode_frames([one, one]), ros2.FRAMES)
    assert [f.child_frame_id for f in frames.transforms] == ["tool", "tool"]
    assert STORE.deserialize_cdr(ros2.encode_transform(one), ros2.TRANSFORM).transform.rotation.x == -0.5


@given(stamps, triples, st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1), st.booleans())
def test_poses_and_frames_of_the_library_are_read(stamp_ns, position, q, big):
    q = tuple(x / math.hypot(*q) for x in q)
    point = TYPES["geometry_msgs/msg/Point"](*position)
    pose = TYPES[ros2.POSE](header(stamp_ns), TYPES["geometry_msgs/msg/Pose"](point, turn(q)))
    found = ros2.decode_pose(written(pose, big=big))
    one = transform(stamp_ns, "/base", "tool", position, q)
    (frame,) = ros2.decode_frames(written(TYPES[ros2.FRAMES]([one]), big=big))
    assert frame == ros2.decode_transform(written(one, big=big))
    assert (frame.parent, frame.child) == ("base", "tool")
    for item in (found, frame):
        assert (item.stamp_ns, item.position) == (stamp_ns, position)
        assert item.quaternion == pytest.approx(q, abs=1e-15)


def test_cdr_2_aligns_to_four_bytes():
    """By the standard: the double after a frame of one letter begins at 12 of 8 + 4 + 2 bytes, rounded up to 4."""
    body = struct.pack("<iII2s", 1, 2, 2, b"a\0") + b"\0\0"
    assert len(body) == 16
    fields = struct.pack("<37d", *(0.0,) * 13, 1.0, 2.0, 3.0, *(0.0,) * 9, 4.0, 5.0, 6.0, *(0.0,) * 9)
    assert ros2.decode_imu(b"\0\7\0\0" + body + fields).rate == (1.0, 2.0, 3.0)
    shifted = struct.pack("<iII5s", 1, 2, 5, b"abcd\0") + b"\0\0\0"
    assert len(shifted) == 20
    assert ros2.decode_imu(b"\0\7\0\0" + shifted + fields).rate == (1.0, 2.0, 3.0)
    assert ros2.decode_imu(b"\0\1\0\0" + shifted + b"\0" * 4 + fields).rate == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (b"", "unknown representation"),
        (b"\0\3\0\0" + b"\0" * 400, "unknown representation"),
        (written(imu(5, (0, 0, 0), (0, 0, 0)))[:-8], "ends too early"),
        (written(imu(5, (math.nan, 0, 0), (0, 0, 0))), "not finite"),
        (written(imu(5, (0, 0, 0), (0, 0, 0), covariance=np.array([-1.0, *NONE[1:]]))), "have no rates"),
        (struct.pack("<4siII", b"\0\1\0\0", 1, 2, 10**9), "a text of 1000000000 bytes"),
        (struct.pack("<4siI", b"\0\1\0\0", -1, 2), "impossible"),
    ],
)
def test_messages_that_are_none(data, complaint):
    with pytest.raises(ProtocolError, match=complaint):
        ros2.decode_imu(data)


def test_an_attitude_that_is_none_is_refused():
    with pytest.raises(ProtocolError, match="norm 2"):
        ros2.decode_transform(written(transform(1, "a", "b", (0, 0, 0), (2.0, 0, 0, 0))))


def test_a_sequence_without_end_is_refused():
    with pytest.raises(ProtocolError, match="expected 1000 at most"):
        ros2.decode_frames(b"\0\1\0\0\xff\xff\xff\xff")


UR = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (sorted(UR), UR),
        ([f"left_{name}" for name in reversed(UR)], [f"left_{name}" for name in UR]),
        (["joint_a10", *(f"joint_a{k}" for k in range(9, 0, -1))], [f"joint_a{k}" for k in range(1, 11)]),
        (["panda_joint2", "panda_joint1"], ["panda_joint1", "panda_joint2"]),
        (["panda_joint1", "panda_joint2", "panda_finger_joint1"], None),
        (["joint_1", "joint_3"], None),
        (["shoulder", "elbow"], None),
        (["arm1_joint1", "arm2_joint1"], None),
        ([], None),
    ],
)
def test_the_order_of_joints_is_taken_only_where_names_show_it(names, expected):
    found = ros2.from_base(names)
    assert found == (None if expected is None else tuple(expected))


def test_a_chain_of_frames_is_that_of_scipy():
    rng = np.random.default_rng(3)
    turns = [Rotation.random(rng=rng) for _ in range(3)]
    places = rng.normal(size=(3, 3))
    names = ["base", "a", "b", "tool"]
    frames = [
        ros2.Transform(9, names[k], names[k + 1], tuple(places[k]), tuple(turns[k].as_quat(scalar_first=True)))
        for k in range(3)
    ]
    found = ros2.Chain("base", "/tool").take(frames[::-1])
    expected = turns[0] * turns[1] * turns[2]
    place = places[0] + turns[0].apply(places[1] + turns[1].apply(places[2]))
    assert found.position == pytest.approx(place, abs=1e-14)
    error = expected.inv() * Rotation.from_quat(found.quaternion, scalar_first=True)
    assert error.magnitude() < 1e-14
    assert found.stamp_ns == 9


def at(stamp_ns, parent, child):
    return ros2.Transform(stamp_ns, parent, child, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))


def test_frames_of_different_times_make_no_pose():
    chain = ros2.Chain("base", "tool")
    chain.take([at(0, "arm", "tool")], static=True)
    assert chain.take([at(10, "base", "arm")]).position == (2.0, 0.0, 0.0)
    assert chain.take([at(11, "map", "base")]) is None  # moves the base, not the tool in it
    longer = ros2.Chain("map", "tool")
    longer.take([at(0, "arm", "tool")], static=True)
    with pytest.raises(ProtocolError, match=r"differ by 5 ms"):
        longer.take([at(10, "base", "arm"), at(5_000_010, "map", "base")])


@pytest.mark.parametrize("frames", [[], [("b", "c")], [("tool", "a"), ("a", "tool")]])
def test_a_chain_without_an_end_is_named(frames):
    with pytest.raises(ProtocolError, match="no frames lead from 'tool' up to 'base'"):
        ros2.Chain("base", "tool").take([at(1, *frame) for frame in frames])


def robot(options):
    return RobotListener(parse_address(f"ros2://127.0.0.1{options}", ROBOTS))


def test_angles_and_pose_of_the_same_time_are_one_sample():
    listener = robot("?pose=/tf&joints=/joint_states&base=base&tool=tool")
    assert listener.topics == ("/joint_states", "/tf", "/tf_static")
    joints = ros2.as_published(50, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    (said,) = listener.take("/joint_states", ros2.JOINTS, ros2.encode_joints(joints))
    assert said.text == f"joints from the base on: {', '.join(UR)}"
    (sample,) = listener.take("/tf", ros2.FRAMES, ros2.encode_frames([at(50, "base", "tool")]))
    assert sample.joints == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert sample.position == (1.0, 0.0, 0.0)
    assert not listener.take("/tf", ros2.FRAMES, ros2.encode_frames([at(60, "base", "tool")]))
    later = ros2.as_published(60, (6.0, 5.0, 4.0, 3.0, 2.0, 1.0))
    (sample,) = listener.take("/joint_states", ros2.JOINTS, ros2.encode_joints(later))
    assert (sample.stamp_ns, sample.joints[0], sample.position) == (60, 6.0, (1.0, 0.0, 0.0))


def test_a_pose_without_angles_waits_until_they_cannot_come():
    listener = robot("?pose=/tf&joints=/joint_states&base=base&tool=tool")
    assert not listener.take("/tf", ros2.FRAMES, ros2.encode_frames([at(50, "base", "tool")]))
    later = ros2.encode_joints(ros2.as_published(55, (0.0,) * 6))
    (_, alone) = listener.take("/joint_states", ros2.JOINTS, later)
    assert (alone.stamp_ns, alone.joints) == (50, ())
    found = [
        s for k in range(60, 80) for s in listener.take("/tf", ros2.FRAMES, ros2.encode_frames([at(k, "base", "tool")]))
    ]
    assert [sample.stamp_ns for sample in found] == list(range(60, 72))


def test_joints_of_others_on_the_same_topic_are_passed_over():
    listener = robot("?names=b,a")
    (_, sample) = listener.take(
        "/joint_states", ros2.JOINTS, ros2.encode_joints(ros2.Joints(1, ("a", "b", "c"), (1, 2, 3)))
    )
    assert sample.joints == (2.0, 1.0)
    assert not listener.take("/joint_states", ros2.JOINTS, ros2.encode_joints(ros2.Joints(2, ("finger",), (0.1,))))
    with pytest.raises(ProtocolError, match="no angle of b among a"):
        listener.take("/joint_states", ros2.JOINTS, ros2.encode_joints(ros2.Joints(3, ("a",), (0.1,))))


def test_an_order_that_is_not_shown_is_asked_for():
    with pytest.raises(ProtocolError, match=r"\?names=shoulder,elbow"):
        robot("").take(
            "/joint_states", ros2.JOINTS, ros2.encode_joints(ros2.Joints(1, ("shoulder", "elbow"), (1.0, 2.0)))
        )


def test_frames_without_names_are_asked_for_and_listed():
    with pytest.raises(ProtocolError, match="these come: tool0"):
        robot("?pose=/tf").take("/tf", ros2.FRAMES, ros2.encode_frames([at(1, "base_link", "tool0")]))


def test_a_topic_of_another_type_is_named():
    listener = ImuListener(parse_address("ros2://127.0.0.1?topic=/scan", IMUS))
    with pytest.raises(ProtocolError, match="/scan has messages of type sensor_msgs/msg/LaserScan, expected"):
        listener.take("/scan", "sensor_msgs/msg/LaserScan", b"")


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ("?base=base_link", "base and tool together"),
        ("?joints=states", "the name of a topic"),
        ("?peers=host", "addresses in numbers"),
    ],
)
def test_wrong_options_are_refused(options, complaint):
    with pytest.raises(SettingsError, match=complaint):
        listener_at(parse_address(f"ros2://127.0.0.1{options}", ROBOTS))


def test_no_arm_is_driven_by_what_ros_says():
    with pytest.raises(SettingsError, match="anybody in the domain"):
        check_sender(parse_address("ros2://127.0.0.1", ROBOTS))


@pytest.mark.parametrize(
    ("published", "failure", "words"),
    [
        ([], "", "nobody was found in this domain"),
        (
            [("/imu", ros2.IMU)],
            "",
            r"nobody publishes /imu/data_raw; topics that would do: /imu \(sensor_msgs/msg/Imu\)",
        ),
        ([("/scan", "sensor_msgs/msg/LaserScan")], "", "topics that are published: /scan"),
        ([("/imu/data_raw", ros2.IMU)], "", "nothing is received on /imu/data_raw, which somebody publishes"),
        (
            [("/imu/data_raw", "my_msgs/msg/Imu")],
            "",
            "has messages of type my_msgs/msg/Imu, expected sensor_msgs/msg/Imu",
        ),
        ([("/imu/data_raw", ros2.IMU)], "DDSException: x", "can no longer be read"),
    ],
)
def test_silence_is_explained_by_what_is_published(published, failure, words):
    publishers = {str(k): Publisher(*one, reliable=True, kept=False) for k, one in enumerate(published)}
    network = SimpleNamespace(publishers=publishers, failure=failure)
    assert re.search(words, _silence(network, ImuListener(parse_address("ros2://127.0.0.1", IMUS))))
