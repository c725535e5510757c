"""Frames of autopilots, against the library that is generated from MAVLink's own definitions."""

import random
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kreisel.devices.address import IMUS, parse_address
from kreisel.devices.autopilot_simulator import Autopilot
from kreisel.devices.dialogue import Remark
from kreisel.devices.mavlink_session import MavlinkSession
from kreisel.errors import ProtocolError, SettingsError
from kreisel.protocols import mavlink
from kreisel.protocols.samples import ImuSample

SECOND = 10**9
RATE, FORCE = (0.1, -0.2, 0.3), (1.0, -2.0, 9.5)


@pytest.fixture
def peer():
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    link = common.MAVLink(None, srcSystem=7, srcComponent=1)
    return common, link


def packed(link, message, **options):
    """Return the bytes of a message, and count it as the library does when it sends one."""
    data = message.pack(link, **options)
    link.seq = (link.seq + 1) % 256
    return data


def highres(common, stamp_us=1_500_000, updated=0x3F):
    return common.MAVLink_highres_imu_message(stamp_us, *FORCE, *RATE, *(0.5,) * 7, updated, 0)


def test_the_crc_is_that_of_the_catalogue():
    """CRC-16/MCRF4XX of the nine digits, by the catalogue of parametrised CRC algorithms."""
    assert mavlink.crc(b"123456789") == 0x6F91


@pytest.mark.parametrize("version", [1, 2])
def test_readings_of_the_library_are_read(peer, version):
    common, link = peer
    data = packed(link, highres(common), force_mavlink1=version == 1)
    (frame,) = mavlink.Decoder().receive(data)
    found = mavlink.sample(frame, ardupilot=False)
    assert (frame.system, frame.component) == (7, 1)
    assert found.stamp_ns == 1_500_000_000
    assert found.rate == pytest.approx(RATE, abs=1e-7)
    assert found.acceleration == pytest.approx(FORCE, abs=1e-6)


def test_signed_frames_are_read(peer):
    common, link = peer
    link.signing.secret_key, link.signing.sign_outgoing, link.signing.timestamp = bytes(range(32)), True, 1000
    data = packed(link, highres(common))
    assert data[2] == 1
    frames = mavlink.Decoder().receive(data + data)
    assert [frame.message for frame in frames] == [mavlink.Message.HIGHRES_IMU] * 2


def test_integers_are_read_in_the_units_of_ardupilot(peer):
    common, link = peer
    axes = (100, -200, 1000, 50, -60, 70, 1, 2, 3)
    raw = packed(link, common.MAVLink_raw_imu_message(2_000_000, *axes))
    scaled = packed(link, common.MAVLink_scaled_imu2_message(2_000, *axes))
    frames = mavlink.Decoder().receive(raw + scaled)
    for frame in frames:
        found = mavlink.sample(frame, ardupilot=True)
        assert found.stamp_ns == 2 * SECOND
        assert found.rate == pytest.approx((0.05, -0.06, 0.07))
        assert found.acceleration == pytest.approx((0.980665, -1.96133, 9.80665))
    with pytest.raises(ProtocolError, match="counts of unknown size"):
        mavlink.sample(frames[0], ardupilot=False)


def test_the_library_understands_what_we_send(peer):
    common, link = peer
    sent = (
        mavlink.heartbeat(0)
        + mavlink.request(mavlink.Message.HIGHRES_IMU, 250.0, (7, 1), 1)
        + mavlink.ask_time(5 * SECOND, 2)
        + mavlink.encode_sample(ImuSample(3 * SECOND, RATE, FORCE), 3)
        + mavlink.acknowledge(3, 4)
    )
    beat, command, time, reading, answer = link.parse_buffer(sent)
    assert beat.autopilot == common.MAV_AUTOPILOT_INVALID
    assert beat.type == common.MAV_TYPE_ONBOARD_CONTROLLER
    assert beat.get_srcComponent() == common.MAV_COMP_ID_ONBOARD_COMPUTER
    assert (command.command, command.param1, command.param2) == (common.MAV_CMD_SET_MESSAGE_INTERVAL, 105.0, 4000.0)
    assert (command.target_system, command.target_component) == (7, 1)
    assert (time.tc1, time.ts1) == (0, 5 * SECOND)
    assert (reading.xgyro, reading.ygyro, reading.zgyro) == pytest.approx(RATE, abs=1e-7)
    assert (reading.time_usec, reading.zacc) == (3_000_000, 9.5)
    assert answer.result == common.MAV_RESULT_UNSUPPORTED


def test_unknown_messages_are_passed_over_and_counted(peer):
    common, link = peer
    stream = b""
    for k in range(50):
        stream += packed(link, common.MAVLink_attitude_message(k, *(0.1,) * 6))
        stream += packed(link, highres(common, 1000 * k))[: 100 * (k != 20)]
    decoder = mavlink.Decoder()
    frames = [frame for piece in range(0, len(stream), 13) for frame in decoder.receive(stream[piece : piece + 13])]
    assert len(frames) == 49
    assert decoder.missing == 1
    assert decoder.skipped == 0


@given(st.randoms(), st.lists(st.integers(0, 3000), max_size=8))
def test_frames_survive_any_cut_and_garbage_between_them(rng, cuts):
    readings = [ImuSample(k * 1_000_000, (0.1 * k, 0.0, 1.0), (1.0, 2.0, float(k))) for k in range(12)]
    stream = b""
    for k, reading in enumerate(readings):
        stream += bytes(rng.randrange(0xFD) for _ in range(rng.randrange(12))) + mavlink.encode_sample(reading, k)
    edges = sorted({0, len(stream), *(c % (len(stream) + 1) for c in cuts)})
    decoder = mavlink.Decoder()
    frames = [f for a, b in pairwise(edges) for f in decoder.receive(stream[a:b])]
    found = [mavlink.sample(frame, ardupilot=False) for frame in frames]
    assert [one.stamp_ns for one in found] == [one.stamp_ns for one in readings]
    assert decoder.missing == 0


def test_a_damaged_frame_costs_itself_alone():
    frames = [mavlink.encode_sample(ImuSample(k * 2_500_000, RATE, FORCE), k) for k in range(20)]
    for at in range(len(frames[10])):
        spoilt = bytearray(frames[10])
        spoilt[at] ^= 0x55
        decoder = mavlink.Decoder()
        stream = b"".join(frames[:10]) + bytes(spoilt) + b"".join(frames[11:]) + b"".join(frames) * 8
        stamps = [mavlink.sample(frame, ardupilot=False).stamp_ns for frame in decoder.receive(stream)]
        assert len(stamps) >= 19 + 160 - 6  # a wrong length swallows 255 bytes at most
        assert set(stamps) <= {k * 2_500_000 for k in range(20)}


def session(options=""):
    return MavlinkSession(parse_address(f"mavlink://127.0.0.1{options}", IMUS))


def talk(ours, theirs, seconds=8.0, readings=True, delay_ns=2_000_000, ahead_ns=5 * SECOND):
    """Return what a session finds in a dialogue with an autopilot, on a link with a delay."""
    found, now = [], SECOND
    to_them = ours.begin()
    beats = k = 0
    while now < seconds * SECOND:
        now += 10_000_000
        to_us = theirs.receive(to_them, now + ahead_ns)
        to_them = b""
        if now // SECOND > beats:
            beats = now // SECOND
            to_us += theirs.beat()
            to_them += ours.ask(now - delay_ns)
        if readings:
            k += 1
            to_us += theirs.encode(ImuSample(now + ahead_ns - 1_000_000, RATE, FORCE))
        items, answer = ours.receive(to_us, now + delay_ns)
        to_them += answer
        found += items
    return found


def test_an_autopilot_is_asked_and_its_clock_is_reported():
    found = talk(session(), Autopilot())
    readings = [item for item in found if isinstance(item, ImuSample)]
    assert len(readings) > 650
    assert readings[0].rate == pytest.approx(RATE, abs=1e-7)
    (text,) = [item.text for item in found if isinstance(item, Remark)]
    assert "+5.0" in text
    assert "known to" in text
    assert not [item for item in found if isinstance(item, ProtocolError)]


def test_an_autopilot_that_sends_no_readings_is_named():
    found = talk(session(), Autopilot(), readings=False)
    texts = {str(item) for item in found if isinstance(item, ProtocolError)}
    assert texts == {"MAVLink: the autopilot is there, but sends no HIGHRES_IMU"}


def test_a_refusal_names_what_else_there_is():
    found = talk(session("?message=RAW_IMU"), Autopilot())
    texts = {str(item) for item in found if isinstance(item, ProtocolError)}
    assert any("does not send RAW_IMU as requested (unsupported)" in text and "SCALED_IMU2" in text for text in texts)


def test_another_system_on_the_link_is_not_listened_to(peer):
    common, link = peer
    ours = session("?system=9")
    beat = packed(link, common.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3))
    assert ours.receive(beat + packed(link, highres(common)), SECOND) == ([], b"")
    link.srcSystem = 9
    beat = packed(link, common.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3))
    found, answer = ours.receive(beat + packed(link, highres(common)), SECOND)
    assert [type(item) for item in found] == [ImuSample]
    assert answer


def test_readings_that_are_not_all_new_are_left_out(peer):
    common, link = peer
    ours = session()
    beat = packed(link, common.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3))
    found, _ = ours.receive(beat + packed(link, highres(common, updated=0x38)), SECOND)
    assert "not all six readings" in str(found[0])
    found, _ = ours.receive(packed(link, highres(common, updated=0)), SECOND)  # a sender that does not fill it in
    assert isinstance(found[0], ImuSample)


def test_a_camera_is_no_autopilot(peer):
    common, link = peer
    ours = session()
    beat = packed(link, common.MAVLink_heartbeat_message(30, common.MAV_AUTOPILOT_INVALID, 0, 0, 3, 3))
    assert ours.receive(beat, SECOND) == ([], b"")


@pytest.mark.parametrize("options", ["?message=GPS", "?rate=0", "?system=300"])
def test_wrong_options_are_refused(options):
    with pytest.raises(SettingsError):
        session(options)


def test_nothing_we_send_moves_anything(peer):
    """Of all commands there is one, which sets the interval of a message."""
    _, link = peer
    ours, sent, rng = session(), b"", random.Random(1)
    theirs = Autopilot()
    for k in range(1000):
        to_us = theirs.beat() + rng.randbytes(20)
        _, answer = ours.receive(to_us, k * SECOND // 4)
        sent += answer + ours.ask(k * SECOND // 4)
    commands = {(m.get_type(), getattr(m, "command", None)) for m in link.parse_buffer(sent)}
    assert commands == {("HEARTBEAT", None), ("TIMESYNC", None), ("COMMAND_LONG", 511)}
    assert np.all([m.param1 == 105.0 for m in link.parse_buffer(sent) or [] if m.get_type() == "COMMAND_LONG"])
