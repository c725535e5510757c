"""Bytes made by other people's libraries and manuals, read and written by ours."""

import math
import struct

import numpy as np
import pytest

from kreisel.errors import ProtocolError
from kreisel.geometry.kuka import from_abc, to_abc
from kreisel.protocols import egm, ixcom, line, rsi, rtde, secondary, varproxy
from kreisel.protocols.samples import ImuSample, RobotSample

DEG = math.pi / 180.0

# made with ABBRobotEGM 1.0.7's message classes, with fields that are not read between those that are
EGM = bytes.fromhex(
    "0a07080710b960180212b1010a360900000000000024400900000000008034c0090000000000403e400900000000000000000900000000"
    "008046400900000000008056c012600a1b090000000000487f401100000000004034c0190000000000608940122409000000000000e03f"
    "11000000000000e03f19000000000000e0bf21000000000000e03f1a1b0900000000008056401100000000000000001900000000008056"
    "c01a0909000000000000f03f220a0880e2cfaa061090a10f1a380a3609000000000000f03f090000000000000040090000000000000840"
    "090000000000001040090000000000001440090000000000001840220208012a020802300142020801510000000000002940"
)
# made with ixcom 1.3.10, the vendor's client
IMURAW = bytes.fromhex("7e0009002c00fc084e46050048e801000000003f00001cc10000a03f0000803d000000bf000000400000ac42")
OPEN_CHANNEL = bytes.fromhex("7efd00001c0000000000000000000000050000000100030000005c45")
ADD_LOG = bytes.fromhex("7efd00001e0000000000000000000000000000000000000004000000254a")
# the telegram of KUKA's RSI manual, its numbers changed
RSI = (
    b'<Rob TYPE="KUKA">\r\n<RIst X="1620.5000" Y="-12.2500" Z="1910.0000" A="90.0000" B="0.0000" C="180.0000"/>\r\n'
    b'<RSol X="1620.5" Y="-12.25" Z="1910.0" A="90.0" B="0.0" C="180.0"/><AIPos A1="0.0" A2="-90.0" A3="90.0" '
    b'A4="45.0" A5="-30.0" A6="10.0"/><Delay D="0"/><Tech C11="0.000000"/><IPOC>123645634563</IPOC></Rob>'
)


def test_an_egm_message_of_the_library_is_read():
    sample = egm.decode(EGM)
    assert sample.stamp_ns == 1_700_000_000_250_000_000
    assert sample.position == pytest.approx((0.5005, -0.02025, 0.812), abs=1e-15)
    assert sample.quaternion == (0.5, 0.5, -0.5, 0.5)
    assert sample.joints == pytest.approx([a * DEG for a in (10.0, -20.5, 30.25, 0.0, 45.0, -90.0)], abs=1e-15)


def test_our_egm_message_is_read_by_the_library():
    messages = pytest.importorskip("ABBRobotEGM._egm_protobuf.egm_pb2")
    found = messages.EgmRobot()
    found.ParseFromString(egm.encode(egm.decode(EGM), 7))
    assert found.header.seqno == 7
    assert list(found.feedBack.joints.joints) == pytest.approx([10.0, -20.5, 30.25, 0.0, 45.0, -90.0], abs=1e-12)
    assert found.feedBack.cartesian.pos.z == pytest.approx(812.0, abs=1e-9)
    assert (found.feedBack.time.sec, found.feedBack.time.usec) == (1_700_000_000, 250_000)


def test_frames_of_the_vendor_are_read_and_written():
    (frame,) = ixcom.Decoder().receive(IMURAW)
    sample = ixcom.sample(frame)
    assert sample.stamp_ns == ((2300 * 7 * 86400) + 345_678) * 10**9 + 125_000_000
    assert sample.acceleration == (0.5, -9.75, 1.25)
    assert sample.rate == (0.0625, -0.5, 2.0)
    assert ixcom.encode_sample(sample, 9) == IMURAW
    assert ixcom.open_channel(3, 0) == OPEN_CHANNEL
    assert ixcom.add_log(ixcom.IMURAW, 4, 0) == ADD_LOG


def test_what_the_vendors_client_sends_is_understood():
    assert [ixcom.wanted_log(frame) for frame in ixcom.Decoder().receive(OPEN_CHANNEL + ADD_LOG)] == [None, (0, 4)]


def test_a_telegram_of_the_manual_is_read():
    sample = rsi.decode(RSI)
    assert sample.stamp_ns == 123_645_634_563 * 10**6
    assert sample.position == pytest.approx((1.6205, -0.01225, 1.91), abs=1e-12)
    # Rz(90) Rx(180): x to y, y to x, z to -z
    assert sample.quaternion == pytest.approx((0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0), abs=1e-15)
    assert sample.joints == pytest.approx([a * DEG for a in (0, -90, 90, 45, -30, 10)], abs=1e-15)
    assert rsi.decode_answer(rsi.encode_answer(RSI)) == 123_645_634_563


def test_angles_are_those_of_scipys_intrinsic_zyx():
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation
    for a, b, c in ((10.0, 20.0, 30.0), (-170.0, 80.0, 5.0), (45.0, -89.0, 179.0), (0.0, 90.0, 0.0)):
        q = rotation.from_euler("ZYX", (a, b, c), degrees=True).as_quat(scalar_first=True)
        ours = from_abc(*np.radians((a, b, c)))
        assert abs(sum(x * y for x, y in zip(q, ours, strict=True))) == pytest.approx(1.0, abs=1e-15)
        again = from_abc(*to_abc(ours))
        assert abs(sum(x * y for x, y in zip(again, ours, strict=True))) == pytest.approx(1.0, abs=1e-12)


def test_a_client_comes_to_run_against_bytes_of_the_manual():
    client = rtde.Client(125.0)
    assert client.begin() == bytes.fromhex("0005560002")
    samples, answer, _ = client.receive(bytes.fromhex("00045601"))
    assert answer[:3] == struct.pack(">HB", len(answer), ord("O"))
    asked = b"timestamp,actual_q,actual_TCP_pose,safety_status,safety_mode,robot_mode,runtime_state"
    assert answer[3:] == struct.pack(">d", 125.0) + asked
    types = b"DOUBLE,VECTOR6D,VECTOR6D,NOT_FOUND,NOT_FOUND,NOT_FOUND,NOT_FOUND"
    _, answer, _ = client.receive(struct.pack(">HBB", 4 + len(types), ord("O"), 0) + types)
    assert answer[3:] == struct.pack(">d", 125.0) + b"timestamp,actual_q,actual_TCP_pose"
    types = b"DOUBLE,VECTOR6D,VECTOR6D"
    _, answer, _ = client.receive(struct.pack(">HBB", 4 + len(types), ord("O"), 5) + types)
    assert answer == bytes.fromhex("000353")
    client.receive(bytes.fromhex("00045301"))
    values = (12.25, 0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7, -0.8, 0.9, 0.0, math.pi / 2, 0.0)
    data = struct.pack(">HBB13d", 3 + 1 + 104, ord("U"), 5, *values)
    samples, _, _ = client.receive(data)
    assert samples[0].stamp_ns == 12_250_000_000
    assert samples[0].position == (0.7, -0.8, 0.9)
    assert samples[0].quaternion == pytest.approx((math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0), abs=1e-15)
    assert samples[0].joints == (0.1, -0.2, 0.3, -0.4, 0.5, -0.6)


@pytest.mark.parametrize(
    ("offered", "values", "blocked", "running"),
    [
        ("INT32,INT32,INT32,UINT32", (1, 1, 7, 2), "", True),
        ("INT32,INT32,INT32,UINT32", (2, 2, 7, 1), "", False),
        ("INT32,INT32,INT32,UINT32", (3, 3, 7, 4), "protective stop (safety_status 3)", False),
        ("INT32,INT32,INT32,UINT32", (7, 7, 3, 1), "robot emergency stop (safety_status 7)", False),
        ("INT32,INT32,INT32,UINT32", (77, 1, 7, 1), "a safety state (safety_status 77)", False),
        ("NOT_FOUND,INT32,INT32,NOT_FOUND", (5, 7), "safeguard stop (safety_mode 5)", None),
        ("NOT_FOUND,NOT_FOUND,INT32,NOT_FOUND", (3,), "power off (robot_mode 3)", None),
        ("INT32,NOT_FOUND,NOT_FOUND,NOT_FOUND", (0,), "", None),
    ],
)
def test_the_controllers_states_are_read_as_far_as_it_has_them(offered, values, blocked, running):
    client = rtde.Client(500.0)
    client.begin()
    _, answer, _ = client.receive(bytes.fromhex("00045601"))
    types = b"DOUBLE,VECTOR6D,VECTOR6D," + offered.encode()
    _, answer, _ = client.receive(struct.pack(">HBB", 4 + len(types), ord("O"), 1) + types)
    if "NOT_FOUND" in offered:
        assert answer[11:].count(b",") == 2 + len(values)
        types = types.replace(b",NOT_FOUND", b"")
        _, answer, _ = client.receive(struct.pack(">HBB", 4 + len(types), ord("O"), 2) + types)
    assert answer == bytes.fromhex("000353")
    recipe = 2 if "NOT_FOUND" in offered else 1
    client.receive(bytes.fromhex("00045301"))
    data = struct.pack(f">B13d{len(values)}i", recipe, *[0.5] * 13, *values)
    (sample,), _, _ = client.receive(struct.pack(">HB", 3 + len(data), ord("U")) + data)
    assert (sample.blocked, sample.running) == (blocked, running)


def test_the_state_on_the_script_port_is_read_in_any_pieces():
    """Bytes of the manual: a version message, then a state whose first part is of another kind."""
    message = struct.pack(">IB", 5 + 12, 20) + bytes(12)
    other = struct.pack(">IB", 5 + 30, 1) + bytes(30)
    for emergency, protective, expected in ((0, 0, ""), (1, 0, "emergency stop"), (0, 1, "protective stop")):
        flags = struct.pack(">Q7B2B3d", 10**9, 1, 1, 1, emergency, protective, 1, 0, 7, 0, 1.0, 1.0, 1.0)
        part = struct.pack(">IB", 5 + len(flags), 0) + flags
        data = message + struct.pack(">IB", 5 + len(other) + len(part), 16) + other + part
        for size in (1, 7, len(data)):
            client = secondary.Client()
            found = [client.receive(data[at : at + size]) for at in range(0, len(data), size)]
            assert found == [*[""] * (len(found) - 1), expected]


def test_bytes_on_the_script_port_that_are_no_packages_are_skipped():
    client = secondary.Client()
    for data in (b"\x00\x00\x00\x01\x10", b"hello", secondary.encode_state(1, emergency=True)):
        assert client.receive(data) == ""


def test_a_rotation_without_bounds_is_refused():
    client = rtde.Client(500.0)
    client.state = rtde.State.RUNNING
    data = struct.pack(">HBB13d", 3 + 1 + 104, ord("U"), 0, *[0.0] * 10, 1e200, 0.0, 0.0)
    with pytest.raises(ProtocolError, match="longer than 4 pi"):
        client.receive(data)


def test_a_field_the_controller_does_not_have_is_told():
    client = rtde.Client(500.0)
    client.receive(bytes.fromhex("00045601"))
    types = b"DOUBLE,NOT_FOUND,VECTOR6D"
    with pytest.raises(ProtocolError, match="actual_q.*NOT_FOUND"):
        client.receive(struct.pack(">HBB", 4 + len(types), ord("O"), 5) + types)


def test_variables_as_the_proxy_packs_them():
    asked = varproxy.encode_request(varproxy.Request(17, "$POS_ACT"))
    assert asked == struct.pack("!HHBH8s", 17, 11, 0, 8, b"$POS_ACT")
    written = varproxy.encode_request(varproxy.Request(18, "$OV_PRO", "50"))
    assert written == struct.pack("!HHBH7sH2s", 18, 14, 1, 7, b"$OV_PRO", 2, b"50")
    value = "{E6POS: X 1620.0, Y 0.0, Z 1910.0, A 0.0, B 90.0, C 0.0, S 2, T 2}"
    answer = struct.pack(f"!HHBH{len(value)}s3s", 17, len(value) + 6, 0, len(value), value.encode(), b"\x00\x01\x01")
    ((number, content),) = varproxy.splitter().receive(answer)
    found = varproxy.decode_answer(number, content)
    assert found.well
    pose = varproxy.pose(found.value, 5)
    assert pose.position == pytest.approx((1.62, 0.0, 1.91))
    assert pose.quaternion == pytest.approx((math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))
    axes = varproxy.pose("{E6AXIS: A1 0.0, A2 -90.0, A3 90.0, A4 0.0, A5 0.0, A6 0.0, E1 0.0}", 5)
    assert axes.joints == pytest.approx([0.0, -math.pi / 2, math.pi / 2, 0.0, 0.0, 0.0])


def test_lines_in_other_units():
    columns = line.Columns.parse("#t [ms],temperature [C],w_x [deg/s],w_y,w_z,a_x [g],a_y,a_z")
    sample = line.decode("1500.25, 36.6, 180, -90, 0, 0, 0, 1", columns)
    assert sample == ImuSample(
        1_500_250_000, pytest.approx((math.pi, -math.pi / 2, 0.0)), pytest.approx((0.0, 0.0, 9.80665))
    )


@pytest.mark.parametrize(
    ("header", "complaint"),
    [
        ("t [ns],w_x [rad/s],w_y,w_z,a_x [m/s^2],a_y", "no column a_z"),
        ("t [days],w_x [rad/s],w_y,w_z,a_x [m/s^2],a_y,a_z", "'days'; known units are ns"),
        ("t [ns],w_x,w_y,w_z,a_x [m/s^2],a_y,a_z", "column w_x is in 'ns'"),
        ("t [ns],?!,w_y", "column 2, '\\?!'"),
    ],
)
def test_headers_that_say_too_little(header, complaint):
    with pytest.raises(ProtocolError, match=complaint):
        line.Columns.parse(header)


@pytest.mark.parametrize(
    ("telegram", "complaint"),
    [
        (b'<!DOCTYPE x [<!ENTITY a "b">]><Rob><IPOC>1</IPOC></Rob>', "declaration"),
        (b"<Rob><!-- --><IPOC>1</IPOC></Rob>", "declaration or comment"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><Rob><IPOC>1</IPOC></Rob>'.encode("utf-16"), "not UTF-8"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><Rob><IPOC>1</IPOC></Rob>'.encode("utf-16-le"), "as in UTF-16"),
        (b'<?xml version="1.0" encoding="UTF-7"?><Rob><IPOC>1</IPOC></Rob>', "stated to be in UTF-7"),
        (b"<Rob><IPOC>\xb0</IPOC></Rob>", "not UTF-8"),
        (b"<Rob><RIst X='1'/><IPOC>1</IPOC></Rob>", "has no Y, Z, A, B, C"),
        (b"<Rob><RIst X='1' Y='nan' Z='1' A='1' B='1' C='1'/><IPOC>1</IPOC></Rob>", "not finite"),
        (b"<Rob><RIst X='1' Y='2' Z='1' A='1' B='1' C='1'/></Rob>", "IPOC is ''"),
        (b"<Rob><RIst X='1' Y='2' Z='1' A='1' B='1' C='1'/><IPOC>-5</IPOC></Rob>", "IPOC is '-5'"),
        (b"<Rob><RIst X='1' Y='2' Z='1' A='1' B='1' C='1'/><IPOC>9999999999999999</IPOC></Rob>", "impossible"),
        (b"<Rob><RIst X='one' Y='2' Z='1' A='1' B='1' C='1'/><IPOC>1</IPOC></Rob>", "not a number"),
        (b"<Rob><IPOC>1</IPOC></Rob>", "neither RIst nor AIPos"),
        (b"<Sen><IPOC>1</IPOC></Sen>", "expected <Rob>"),
        (b"<Rob>", "not well-formed"),
        (b" " * 9000, "9000 bytes"),
    ],
)
def test_telegrams_that_are_none(telegram, complaint):
    with pytest.raises(ProtocolError, match=complaint):
        rsi.decode(telegram)


def test_the_twin_of_a_controller_understands_its_client():
    client, server = rtde.Client(500.0), rtde.Server()
    to_server = client.begin()
    for _ in range(3):
        _, to_server, _ = client.receive(server.receive(to_server))
    assert server.streaming
    sample = RobotSample(1_234_000_000, (0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 0.0), (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    (found,), _, _ = client.receive(server.encode(sample))
    assert found == sample
