"""Telegrams for a KUKA controller: bytes, streams, a serial line, and the program that reads and writes them."""

import asyncio
import math
import os
import re
import xml.etree.ElementTree as ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kreisel.acquisition.movers import EkrlMover
from kreisel.devices.address import MOVERS, parse_address
from kreisel.devices.krl import write_krl
from kreisel.devices.simulators import ekrl_simulator
from kreisel.errors import DeviceError, ProtocolError, SettingsError
from kreisel.protocols import ekrl
from kreisel.protocols.samples import RobotSample

angles = st.tuples(*[st.floats(-6.0, 6.0)] * 6)
numbers = st.integers(0, 2**31 - 1)
moves = st.builds(ekrl.Move, numbers, angles, st.floats(0.001, 1.0))
commands = moves | st.builds(ekrl.Stop, numbers) | st.builds(ekrl.Beat)
HALF = RobotSample(123_000_000, (1.5, -0.25, 2.0), (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)), (0.1,) * 6)
STATE = ekrl.State(7, ekrl.Doing.MOVING, HALF)


def test_telegrams_are_these_bytes():
    assert ekrl.encode(ekrl.Move(3, tuple(map(math.radians, (10, -90, 90, 0, 30, -0.5))), 0.25)) == (
        b"<Kreisel><Move><Id>3</Id><V>25.000</V><A1>10.00000</A1><A2>-90.00000</A2><A3>90.00000</A3><A4>0.00000</A4>"
        b"<A5>30.00000</A5><A6>-0.50000</A6></Move></Kreisel>"
    )
    assert ekrl.encode(ekrl.Stop(4)) == b"<Kreisel><Stop><Id>4</Id></Stop></Kreisel>"
    state = ekrl.decode_state(
        b"<Robot><Id>3</Id><Do>1</Do><T>123</T><A1>10</A1><A2>-90.0</A2><A3>90</A3><A4>0</A4><A5>30</A5><A6>0</A6>"
        b"<X>1500.0</X><Y>0</Y><Z>900</Z><A>90</A><B>0</B><C>0</C></Robot>"
    )
    assert (state.number, state.doing, state.sample.stamp_ns) == (3, ekrl.Doing.MOVING, 123_000_000)
    assert state.sample.position == (1.5, 0.0, 0.9)
    assert state.sample.quaternion == pytest.approx((math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))
    assert state.sample.joints == pytest.approx(tuple(map(math.radians, (10, -90, 90, 0, 30, 0))))


@given(commands)
def test_commands_come_back(command):
    found = ekrl.decode(ekrl.encode(command))
    assert type(found) is type(command)
    assert isinstance(command, ekrl.Beat) or found.number == command.number
    if isinstance(command, ekrl.Move):
        assert found.target == pytest.approx(command.target, abs=1e-7)
        assert found.share == pytest.approx(command.share, abs=1e-5)


def test_states_come_back():
    found = ekrl.decode_state(ekrl.encode_state(STATE))
    assert found.doing is ekrl.Doing.MOVING
    assert found.sample.position == pytest.approx(HALF.position, abs=1e-8)
    assert found.sample.quaternion == pytest.approx(HALF.quaternion, abs=1e-7)


@given(st.lists(commands, max_size=5), st.lists(st.integers(1, 200), max_size=40), st.booleans())
def test_any_split_of_the_stream_gives_the_same(sent, sizes, lines):
    between = b"\r\n" if lines else b""
    data, found, splitter = between.join(map(ekrl.encode, sent)), [], ekrl.Splitter("Kreisel")
    for size in [*sizes, len(data)]:
        found += splitter.receive(data[:size])
        data = data[size:]
    assert found == [ekrl.encode(command) for command in sent]
    assert splitter.skipped == 0


@given(st.binary(max_size=300), commands, st.binary(max_size=60))
def test_what_stands_between_telegrams_is_skipped(before, command, cut):
    whole = ekrl.encode(command)
    splitter = ekrl.Splitter("Kreisel")
    found = splitter.receive(before + whole[: len(cut)] + whole + whole)
    assert found[-1] == whole


@given(st.binary(max_size=400))
def test_garbage_raises_our_errors_alone(data):
    for splitter, decode in ((ekrl.Splitter("Robot"), ekrl.decode_state), (ekrl.Splitter("Kreisel"), ekrl.decode)):
        root = splitter._begin.decode()[1:-1].encode()
        for telegram in splitter.receive(b"<" + root + b">" + data + b"</" + root + b">"):
            try:
                decode(telegram)
            except ProtocolError:
                continue


@pytest.mark.parametrize(
    ("telegram", "said"),
    [
        (b"<Kreisel></Kreisel>", "holds nothing, expected Move, Stop or Beat"),
        (ekrl.encode(ekrl.Stop(1)).replace(b">1<", b">-1<"), "expected a whole number"),
        (ekrl.encode(ekrl.Move(1, (0.0,) * 6, 1.0)).replace(b"100.000", b"101"), "a move at 101 per cent"),
        (ekrl.encode(ekrl.Move(1, (0.0,) * 6, 1.0)).replace(b"<A2>0.00000", b"<A2>nan"), "not finite"),
        (ekrl.encode(ekrl.Move(1, (0.0,) * 6, 1.0)).replace(b"<A2>0.00000</A2>", b""), "<A2> is ''"),
        (b"<!DOCTYPE x><Kreisel></Kreisel>", "declaration"),
    ],
)
def test_impossible_commands_are_told(telegram, said):
    with pytest.raises(ProtocolError, match=re.escape(said)):
        ekrl.decode(telegram)


def test_a_stream_without_end_takes_no_memory():
    splitter = ekrl.Splitter("Robot")
    for _ in range(100):
        splitter.receive(b"<Robot>" + b"x" * 4000)
    assert len(splitter._buffer) <= 2 * ekrl.MAX_BYTES
    assert splitter.receive(ekrl.encode_state(STATE)) == [ekrl.encode_state(STATE)]


class Arm:
    """An arm that takes a while for every move, and refuses what turns too far."""

    def __init__(self):
        self.told, self.moving = [], False

    def move(self, target):
        if max(map(abs, target)) > 3.0:
            return "too far"
        self.told.append(tuple(target))
        return None

    def stop(self):
        self.told.append("stop")


def test_moves_go_over_a_serial_line():
    """The paper's: a pseudo-terminal in place of the cable, the program's part played by the simulator."""
    pytest.importorskip("serial")
    host, device = os.openpty()
    arm = Arm()

    async def all_of_it():
        os.set_blocking(host, False)
        loop, reader = asyncio.get_running_loop(), asyncio.StreamReader()
        reading, _ = await loop.connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(reader), os.fdopen(host, "rb", 0)
        )
        transport, protocol = await loop.connect_write_pipe(
            asyncio.streams.FlowControlMixin, os.fdopen(os.dup(host), "wb", 0)
        )
        simulator = asyncio.ensure_future(
            ekrl_simulator(arm, reader, asyncio.StreamWriter(transport, protocol, reader, loop))
        )
        mover = EkrlMover(parse_address(f"serial://{os.ttyname(device)}?baud=9600", MOVERS), 0.5)
        await mover.connect()
        await mover.move(_array(0.1), 1.0)
        with pytest.raises(DeviceError, match="the controller refuses <Kreisel><Move>"):
            await mover.move(_array(3.1), 1.0)
        await mover.stop()
        await mover.close()
        simulator.cancel()
        reading.close()
        transport.close()
        await asyncio.gather(simulator, return_exceptions=True)
        await asyncio.sleep(0.05)

    asyncio.run(all_of_it())
    os.close(device)
    assert arm.told[0] == pytest.approx((0.1,) * 6, abs=1e-7)
    assert arm.told[1:] == ["stop"]


def _array(value):
    import numpy as np

    return np.full(6, value)


@pytest.mark.parametrize("closes", [True, False])
def test_a_controller_that_does_not_answer_is_told(monkeypatch, closes):
    monkeypatch.setattr("kreisel.acquisition.movers._PATIENCE", 30.0 if closes else 0.3)

    async def all_of_it():
        async def deaf(reader, writer):
            await reader.read(10)
            if not closes:
                await reader.read()
            writer.close()

        server = await asyncio.start_server(deaf, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        mover = EkrlMover(parse_address(f"ekrl://127.0.0.1:{port}", MOVERS), 0.5)
        await mover.connect()
        with pytest.raises(DeviceError, match="has closed the connection" if closes else "does not answer command 1"):
            await mover.move(_array(0.1), 1.0)
        await mover.close()
        server.close()
        await asyncio.sleep(0.05)

    asyncio.run(all_of_it())


@pytest.mark.parametrize(
    ("answers", "closes", "trouble"),
    [
        ([ekrl.Doing.MOVING, ekrl.Doing.ARRIVED], False, None),
        ([ekrl.Doing.MOVING, ekrl.Doing.STOPPED], False, "reports that move 1 was stopped"),
        ([ekrl.Doing.MOVING], True, "the controller has closed the connection"),
    ],
)
def test_what_happens_after_a_move_is_taken_up_is_read_all_the_time(answers, closes, trouble):
    async def all_of_it():
        told = asyncio.Event()

        async def talk(reader, writer):
            await reader.read(4096)
            for doing in answers:
                writer.write(ekrl.encode_state(ekrl.State(1, doing, HALF)))
                await asyncio.sleep(0.05)
            told.set()
            if not closes:
                await reader.read()
            writer.close()

        server = await asyncio.start_server(talk, "127.0.0.1", 0)
        mover = EkrlMover(parse_address(f"ekrl://127.0.0.1:{server.sockets[0].getsockname()[1]}", MOVERS), 0.5)
        await mover.connect()
        await mover.move(_array(0.1), 1.0)
        assert mover.trouble is None
        async with asyncio.timeout(30.0):
            await told.wait()
            while trouble is not None and mover.trouble is None:
                await asyncio.sleep(0.01)
        await asyncio.sleep(0.1)
        seen = mover.trouble
        await mover.close()
        server.close()
        await asyncio.sleep(0.05)
        return seen

    seen = asyncio.run(all_of_it())
    assert seen is None if trouble is None else trouble in seen


def test_the_second_way_to_stop_is_to_close_the_connection():
    """The program brakes when nobody is connected."""
    arm = Arm()

    async def all_of_it():
        stopped = asyncio.Event()

        async def deaf(reader, writer):
            while await reader.read(4096):
                pass
            arm.stop()
            stopped.set()
            writer.close()

        server = await asyncio.start_server(deaf, "127.0.0.1", 0)
        mover = EkrlMover(parse_address(f"ekrl://127.0.0.1:{server.sockets[0].getsockname()[1]}", MOVERS), 0.5)
        await mover.connect()
        (_, first), (name, second) = mover.ways
        with pytest.raises(DeviceError, match="does not answer command 1"):
            await first()
        assert arm.told == []
        await second()
        async with asyncio.timeout(30.0):
            await stopped.wait()
        server.close()
        await asyncio.sleep(0.05)
        return name

    assert asyncio.run(all_of_it()) == "the connection closed"
    assert arm.told == ["stop"]


def test_nobody_there_is_told():
    mover = EkrlMover(parse_address("ekrl://127.0.0.1:9", MOVERS), 0.5)
    with pytest.raises(DeviceError, match="does kreisel's program run there"):
        asyncio.run(mover.connect())


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("krl")
    write_krl(folder, "172.31.1.147", 54604)
    return folder


def tags(file, part):
    return [e.attrib for e in ElementTree.parse(file).getroot().find(part).iter("ELEMENT")]


def test_the_connections_carry_what_is_sent(files):
    """Every element of a telegram is configured, and nothing else; the flags are those the program waits for."""
    for name, port in (("KreiselMove", 54604), ("KreiselState", 54605)):
        internal = ElementTree.parse(files / f"{name}.xml").getroot().find("CONFIGURATION/INTERNAL")
        assert (internal.findtext("IP"), internal.findtext("PORT")) == ("172.31.1.147", str(port))
    received = tags(files / "KreiselMove.xml", "RECEIVE")
    named = {e["Tag"] for e in received if "Type" in e}
    sent = set()
    for command in (ekrl.Move(1, (0.0,) * 6, 1.0), ekrl.Stop(1)):
        root = ElementTree.fromstring(ekrl.encode(command))
        sent |= {f"Kreisel/{root[0].tag}/{leaf.tag}" for leaf in root[0]}
    assert named == sent
    assert {e["Tag"]: e["Set_Flag"] for e in received if "Set_Flag" in e} == {
        "Kreisel/Move": "903",
        "Kreisel/Stop": "902",
        "Kreisel/Beat": "905",
    }
    for name in ("KreiselMove", "KreiselState"):
        paths = [e["Tag"].split("/")[1] for e in tags(files / f"{name}.xml", "SEND")]
        telegram = "<Robot>" + "".join(f"<{p}>1</{p}>" for p in paths) + "</Robot>"
        state = ekrl.decode_state(telegram.encode())
        assert (state.sample.position is not None) == (name == "KreiselState")


def test_the_program_names_only_what_is_configured_and_declared(files):
    text, data = (files / "kreisel.src").read_text(), (files / "kreisel.dat").read_text()
    for connection, tag in re.findall(r'EKI_(?:Get|Set)\w+\("(\w+)", "([\w/]+)"', text):
        part = "SEND" if tag.startswith("Robot") else "RECEIVE"
        assert tag in [e["Tag"] for e in tags(files / f"{connection}.xml", part)]
    declared = set(re.findall(r"DECL \w+ (\w+)", data))
    defined = set(re.findall(r"^DEF (\w+)\(", text, re.MULTILINE))
    used = set(re.findall(r"\bkr_\w+", text))
    assert used - defined == {name for name in declared if name.startswith("kr_")}


def test_the_program_keeps_external_axes_examines_what_it_reads_and_watches_for_heartbeats(files):
    text, data = (files / "kreisel.src").read_text(), (files / "kreisel.dat").read_text()
    take = text.split("DEF kr_take( )")[1].split("END", 1)[0]
    assert take.index("kr_target = $AXIS_ACT") < take.index("EKI_GetReal")
    code = [line.strip() for line in take.splitlines() if line.strip() and not line.strip().startswith(";")]
    assert all(code[k + 1] == "kr_check( )" for k, line in enumerate(code) if line.startswith("kr_ret ="))
    assert re.search(r"kr_patience = (\d+)", data)[1] == str(round(1e3 * ekrl.BEAT_PATIENCE))
    assert ekrl.BEAT_INTERVAL < 0.5 * ekrl.BEAT_PATIENCE
    switched = {part: set(re.findall(rf"INTERRUPT {part} (\d+)", text)) for part in ("ON", "OFF")}
    declared = set(re.findall(r"INTERRUPT DECL (\d+)", text))
    assert switched["ON"] == declared
    assert switched["OFF"] == declared - {"24"}  # poses are sent until the program ends


@pytest.mark.parametrize("name", ["kreisel.src", "kreisel_serial.src"])
def test_blocks_of_the_programs_are_closed(files, name):
    raw = (files / name).read_bytes()
    assert raw.count(b"\n") == raw.count(b"\r\n")
    code = [line.split(";")[0].strip() for line in raw.decode("ascii").splitlines()]
    for opens, closes in (("DEF ", "END"), ("IF ", "ENDIF"), ("LOOP", "ENDLOOP"), ("FOR ", "ENDFOR")):
        assert sum(line.startswith(opens) for line in code) == sum(line == closes for line in code), opens


def test_the_serial_program_reads_and_writes_our_telegrams(files):
    text = (files / "kreisel_serial.src").read_text()
    formats = re.findall(r'"(<[^"]+>)"', text)
    move, stop, state = formats
    number = r"[-\d.]+"
    for pattern, telegram in (
        (move, ekrl.encode(ekrl.Move(1, (0.5,) * 6, 0.5))),
        (stop, ekrl.encode(ekrl.Stop(12))),
    ):
        assert re.fullmatch(re.sub(r"%[.\d]*[df]", lambda _: number, pattern), telegram.decode())
    written = re.sub(r"%d", "1", re.sub(r"%\.5f", "10.00000", state))
    assert ekrl.decode_state(written.encode()).sample.joints == pytest.approx((math.radians(10.0),) * 6)


def test_nothing_is_overwritten(files):
    with pytest.raises(SettingsError, match=r"holds kreisel\.src, .* already"):
        write_krl(files, "0.0.0.0", 54600)
