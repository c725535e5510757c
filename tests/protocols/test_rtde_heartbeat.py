"""The heartbeat's dialogue, with bytes written out by the maker's description of RTDE."""

import struct

import numpy as np
import pytest

from kreisel.errors import ProtocolError
from kreisel.protocols import rtde, urscript
from kreisel.protocols.rtde_heartbeat import Heartbeat

REGISTER = "input_int_register_24"


def answered(types, recipe=1):
    return rtde.package(ord("I"), bytes([recipe]) + types)


def test_the_register_is_asked_for_and_written():
    client = Heartbeat(REGISTER)
    assert client.begin() == b"\x00\x05V\x00\x02"
    assert client.receive(b"\x00\x04V\x01") == b"\x00\x18I" + REGISTER.encode()
    assert client.receive(answered(b"INT32", 7)) == b"\x00\x14O" + struct.pack(">d", 1.0) + b"timestamp"
    assert client.receive(b"\x00\x0aO\x01DOUBLE") == b"\x00\x03S"
    assert not client.running
    assert client.receive(b"\x00\x04S\x01") == b""
    assert client.running
    beats = [client.beat() for _ in range(3)]
    assert beats[0] == b"\x00\x08U" + struct.pack(">Bi", 7, 1)
    assert len(set(beats)) == 3


def test_the_servers_side_hears_it():
    client, server = Heartbeat(REGISTER), rtde.Server()
    said = client.begin()
    while said:
        said = client.receive(server.receive(said))
    assert client.running
    for _ in range(5):
        server.receive(client.beat())
    assert (server.inputs, server.written) == ([REGISTER], 5)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"\x00\x04V\x00", "protocol version 2"),
        (answered(b"NOT_FOUND"), "has no input"),
        (answered(b""), "no type"),
        (answered(b"INT32", 0), "has no input"),
        (b"\x00\x04S\x00", "refuses to start"),
        (b"\x00\x03S", "refuses to start"),
        (rtde.package(ord("I")), "no type"),
    ],
)
def test_a_controller_without_it_says_so(data, why):
    client = Heartbeat(REGISTER)
    assert client.receive(data) == b""
    assert why in client.unsupported
    assert not client.running


def test_a_register_of_another_client_is_an_error():
    with pytest.raises(ProtocolError, match="another program writes input_int_register_24"):
        Heartbeat(REGISTER).receive(answered(b"IN_USE", 0))


def test_any_bytes_are_an_answer_or_an_error():
    generator = np.random.default_rng(5)
    for _ in range(3000):
        client = Heartbeat(REGISTER)
        kind = generator.choice(list(b"VIOSUMv"))
        data = rtde.package(int(kind), generator.bytes(int(generator.integers(0, 30)))) + generator.bytes(6)
        try:
            client.receive(data)
        except ProtocolError:
            continue


def test_a_program_begins_with_its_watchdog():
    dog = urscript.Watchdog(REGISTER, 10.0)
    move = urscript.JointMove((0.0,) * 6, 2.0, 1.0)
    lines = urscript.encode(move, dog).split(b"\n")
    assert lines[0] == b"def kreisel():"
    assert lines[1] == b'rtde_set_watchdog("input_int_register_24",10,"stop")'
    assert urscript.decode_watchdog(lines[1]) == dog
    assert urscript.decode(lines[2]) == move
    assert lines[3:] == [b"end", b""]
    assert urscript.decode_watchdog(lines[2]) is None
