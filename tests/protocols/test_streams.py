"""However bytes are cut, spoilt or invented: the same records, and no errors but ours."""

import math
import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kreisel.errors import ProtocolError
from kreisel.protocols import egm, ekrl, ixcom, line, mavlink, ros2, rsi, rtde, secondary, varproxy
from kreisel.protocols.samples import ImuSample, RobotSample

numbers = st.floats(-1e3, 1e3, allow_nan=False)
stamps = st.integers(0, 2**31 * 10**9 - 10**9)
triples = st.tuples(numbers, numbers, numbers)
turns = st.tuples(*[st.floats(-1.0, 1.0)] * 4).map(lambda q: (q[0] or 1.0, *q[1:])).filter(lambda q: _size(q) > 1e-3)
poses = st.builds(
    RobotSample, stamps, triples, turns.map(lambda q: tuple(x / _size(q) for x in q)), st.tuples(*[numbers] * 6)
)
readings = st.builds(ImuSample, stamps, triples, triples)


def _size(q):
    return sum(x * x for x in q) ** 0.5


def same_turn(a, b, tolerance):
    return abs(abs(sum(x * y for x, y in zip(a, b, strict=True))) - 1.0) < tolerance


def cut(data, cuts):
    """Return the pieces of data between cuts."""
    edges = sorted({0, len(data), *(c % (len(data) + 1) for c in cuts)})
    return [data[a:b] for a, b in pairwise(edges)]


@given(poses)
def test_egm_gives_back_what_was_sent(pose):
    found = egm.decode(egm.encode(pose, 1))
    assert found.stamp_ns == pose.stamp_ns // 1000 * 1000
    assert all(abs(a - b) < 1e-12 * (1 + abs(b)) for a, b in zip(found.position, pose.position, strict=True))
    assert same_turn(found.quaternion, pose.quaternion, 1e-12)
    assert all(abs(a - b) < 1e-12 * (1 + abs(b)) for a, b in zip(found.joints, pose.joints, strict=True))


@given(poses)
def test_rsi_gives_back_what_was_sent_to_four_digits(pose):
    found = rsi.decode(rsi.encode(pose))
    assert abs(found.stamp_ns - pose.stamp_ns) <= 500_000
    assert all(abs(a - b) < 5.1e-8 for a, b in zip(found.position, pose.position, strict=True))
    assert same_turn(found.quaternion, pose.quaternion, 1e-11)


@given(poses)
def test_the_proxys_variables_give_back_what_was_asked(pose):
    frame, axes = (varproxy.pose(varproxy.variable(name, pose), pose.stamp_ns) for name in ("$POS_ACT", "$AXIS_ACT"))
    assert all(abs(a - b) < 1e-8 for a, b in zip(frame.position, pose.position, strict=True))
    assert same_turn(frame.quaternion, pose.quaternion, 1e-11)
    assert all(abs(a - b) < 1e-7 for a, b in zip(axes.joints, pose.joints, strict=True))
    assert varproxy.variable("$OV_PRO", pose) is None


@given(poses)
def test_rtde_gives_back_what_was_sent(pose):
    client, server = rtde.Client(500.0), rtde.Server()
    to_server = client.begin()
    for _ in range(3):
        _, to_server, _ = client.receive(server.receive(to_server))
    (found,), _, _ = client.receive(server.encode(pose))
    assert abs(found.stamp_ns - pose.stamp_ns) < 1000  # a double of seconds
    assert found.position == pose.position
    assert same_turn(found.quaternion, pose.quaternion, 1e-12)
    assert found.joints == pose.joints


@given(st.lists(readings, min_size=1, max_size=8), st.lists(st.integers(0, 4000)), st.randoms())
def test_frames_survive_any_cut_and_garbage_between_them(sent, cuts, rng):
    stream = b""
    for k, reading in enumerate(sent):
        stream += rng.randbytes(rng.randrange(12)).replace(b"\x7e", b"\x7f") + ixcom.encode_sample(reading, k)
    decoder = ixcom.Decoder()
    frames = [frame for piece in cut(stream, cuts) for frame in decoder.receive(piece)]
    assert [frame.stamp_ns for frame in frames] == [reading.stamp_ns // 1000 * 1000 for reading in sent]
    assert decoder.missing == 0


@given(st.lists(readings, min_size=1, max_size=8), st.lists(st.integers(0, 4000)))
def test_lines_survive_any_cut(sent, cuts):
    stream = f"#{line.COLUMNS}\n".encode() + b"".join(line.encode(reading) for reading in sent)
    decoder = line.Decoder()
    assert [found for piece in cut(stream, cuts) for found in decoder.receive(piece)] == sent


@given(
    st.lists(st.tuples(st.text("abc$_1", min_size=1), st.none() | st.text("xyz 09")), min_size=1),
    st.lists(st.integers(0, 4000)),
)
def test_requests_survive_any_cut(wanted, cuts):
    requests = [varproxy.Request(k, name, value) for k, (name, value) in enumerate(wanted)]
    splitter = varproxy.splitter()
    stream = b"".join(varproxy.encode_request(request) for request in requests)
    found = [varproxy.decode_request(*m) for piece in cut(stream, cuts) for m in splitter.receive(piece)]
    assert found == requests


def test_a_damaged_frame_costs_itself_alone():
    readings = [ImuSample(k * 2_500_000, (0.1, 0.2, 0.3), (1.0, 2.0, 3.0)) for k in range(20)]
    frames = [ixcom.encode_sample(reading, k) for k, reading in enumerate(readings)]
    for at in range(len(frames[10])):
        spoilt = bytearray(frames[10])
        spoilt[at] ^= 0x55
        decoder = ixcom.Decoder()
        found = decoder.receive(b"".join(frames[:10]) + bytes(spoilt) + b"".join(frames[11:]))
        found += decoder.receive(b"".join(frames) * 3)  # what a wrong length has swallowed comes out again
        assert {frame.stamp_ns for frame in found[:19]} >= {r.stamp_ns for r in readings[:10]}
        assert len(found) >= 19 + 60 - 1


@given(st.binary(max_size=300))
def test_garbage_raises_nothing_but_our_own_errors(data):
    attack_all(data)


@given(
    st.sampled_from(["egm", "rsi", "ixcom", "rtde", "varproxy", "line", "mavlink", "imu", "joints", "frames"]),
    st.integers(0, 2**32), poses, readings,
)  # fmt: skip
def test_nearly_right_bytes_raise_nothing_but_our_own_errors(kind, seed, pose, reading):
    rng = random.Random(seed)
    original = {
        "egm": lambda: egm.encode(pose, 3),
        "rsi": lambda: rsi.encode(pose),
        "ixcom": lambda: ixcom.encode_sample(reading, 3) + ixcom.respond(4, "no", 4) + ixcom.add_log(0, 1),
        "rtde": lambda: (
            rtde.package(86, b"\x01")
            + rtde.package(79, b"\x01DOUBLE,VECTOR6D,VECTOR6D,INT32,INT32,INT32,UINT32")
            + rtde.package(83, b"\x01")
        ),
        "varproxy": lambda: varproxy.encode_answer(varproxy.Answer(3, "{A1 1.0}", True)),
        "line": lambda: f"#{line.COLUMNS}\n".encode() + line.encode(reading),
        "mavlink": lambda: mavlink.encode_sample(reading, 3) + mavlink.heartbeat(4, autopilot=3),
        "imu": lambda: ros2.encode_imu(reading),
        "joints": lambda: ros2.encode_joints(ros2.as_published(pose.stamp_ns, pose.joints)),
        "frames": lambda: ros2.encode_frames(
            [ros2.Transform(pose.stamp_ns, "a", name, pose.position, pose.quaternion) for name in "bc"]
        ),
    }[kind]()
    data = bytearray(original)
    for _ in range(rng.randrange(1, 6)):
        at = rng.randrange(len(data))
        data[at : at + rng.randrange(3)] = rng.randbytes(rng.randrange(3))
    attack_all(bytes(data))


def _read(frame):
    if mavlink.Message(frame.message).name in mavlink.READINGS:
        mavlink.sample(frame, ardupilot=True)


ACTS_ON_FRAMES = (mavlink.requested, mavlink.refusal, mavlink.stated_time, mavlink.asks_time, _read)


def attack_all(data):
    """Give bytes to every decoder; an error that is not ours fails the test."""
    decoder = ixcom.Decoder()
    attacks = [
        lambda: egm.decode(data), lambda: rsi.decode(data), lambda: rsi.encode_answer(data),
        lambda: rsi.decode_answer(data), lambda: rtde.Client(500.0).receive(data), lambda: rtde.Server().receive(data),
        lambda: [varproxy.decode_answer(*message) for message in varproxy.splitter().receive(data)],
        lambda: [varproxy.decode_request(*message) for message in varproxy.splitter().receive(data)],
        lambda: varproxy.pose(data.decode("latin-1"), 0), lambda: line.Columns.parse(data.decode("latin-1")),
        lambda: line.Decoder(line.Columns.parse(line.COLUMNS)).receive(data + b"\n" + data + b"\n"),
        lambda: line.Decoder().receive(data + b"\n" + data + b"\n"),
        lambda: [(ixcom.sample(f), ixcom.wanted_log(f), ixcom.check_response(f)) for f in decoder.receive(data)],
        lambda: secondary.Client().receive(data), lambda: ekrl.decode(data), lambda: ekrl.decode_state(data),
        lambda: [ekrl.decode_state(telegram) for telegram in ekrl.Splitter("Robot").receive(data)],
    ]  # fmt: skip
    client = rtde.Client(500.0)
    client.state = rtde.State.RUNNING
    attacks.append(lambda: client.receive(data))
    attacks += [
        lambda: ros2.decode_imu(data), lambda: ros2.from_base(ros2.decode_joints(data).names),
        lambda: ros2.decode_pose(data), lambda: ros2.decode_transform(data),
        lambda: ros2.Chain("a", "c").take(ros2.decode_frames(data)),
        lambda: [act(frame) for frame in mavlink.Decoder().receive(data) for act in ACTS_ON_FRAMES],
    ]  # fmt: skip
    for attack in attacks:
        try:
            attack()
        except ProtocolError as error:
            assert str(error).isprintable()


@pytest.mark.parametrize("prefix", ["", "$"])
def test_lines_with_checksums_are_read_if_they_are_right(prefix):
    """The exclusive or of the characters, worked out by hand for the first: 1 xor 2 is 03."""
    assert line.without_checksum("12*03") == "12"
    values = "1000,0.1,0.2,0.3,0,0,9.8"
    checksum = 0
    for character in values:
        checksum ^= ord(character)
    decoder = line.Decoder(line.Columns.parse(line.COLUMNS))
    (good,) = decoder.receive(f"{prefix}{values}*{checksum:02X}\r\n".encode())
    assert good == line.decode(values, decoder.columns)
    for wrong in (f"{checksum ^ 1:02X}", "", "0", "XYZ", "é"):
        (told,) = decoder.receive(f"{prefix}{values}*{wrong}\n".encode())
        assert "the checksum" in str(told)


def test_a_line_of_names_needs_no_sign_and_says_what_it_lacks():
    values = "12.5,1,2,3,0,0,9.8\n"
    decoder = line.Decoder()
    assert decoder.receive(b"t [ms],w_x [rad/s],w_y,w_z,a_x [m/s^2],a_y,a_z\n") == []
    (reading,) = decoder.receive(values.encode())
    assert reading.stamp_ns == 12_500_000
    decoder = line.Decoder()
    assert decoder.receive(b"millis,ax,ay,az,gx,gy,gz\n") == []  # the first line may be incomplete
    (error,) = decoder.receive(values.encode())
    assert "no column t, w_x" in str(error)
    assert "'millis,ax,ay,az,gx,gy,gz'" in str(error)
    decoder = line.Decoder(line.Columns.parse("tag," + line.COLUMNS))
    (reading,) = decoder.receive(b"imu,12,1,2,3,0,0,9.8\n" * 2)[-1:]  # text in a column that is skipped
    assert reading.stamp_ns == 12


def test_another_header_holds_from_there_on():
    """A device that was switched to degrees says so; a comment about one reading says nothing."""
    values = "1000000,1.0,0.0,0.0,0.0,0.0,9.8\n"
    text = (
        f"#{line.COLUMNS}\n{values}# w_x, corrected\n{values}#{line.COLUMNS.replace('rad s^-1', 'deg s^-1')}\n{values}"
    )
    rates = [sample.rate[0] for sample in line.Decoder().receive(text.encode())]
    assert rates == pytest.approx([1.0, 1.0, math.radians(1.0)])
    stated = line.Decoder(line.Columns.parse(line.COLUMNS))  # the user's columns hold
    assert [sample.rate[0] for sample in stated.receive(text.encode())] == pytest.approx([1.0] * 3)
