"""The dialogue over one connection, from its beginning: bytes in, readings and answers out. No sockets here."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from kreisel.devices.address import Address
from kreisel.devices.dialogue import Found, Losses, Remark, Session
from kreisel.devices.events import Level
from kreisel.devices.mavlink_session import MavlinkSession
from kreisel.errors import ProtocolError, SettingsError, unknown_name
from kreisel.protocols import egm, ekrl, ixcom, line, rsi, rtde, varproxy


class RtdeSession(Session):
    """A Universal Robots controller."""

    def __init__(self, address: Address) -> None:
        self._client = rtde.Client(address.number("rate", 500.0, 1.0, 1000.0))

    def begin(self) -> bytes:
        """Return the request for a protocol version."""
        return self._client.begin()

    def receive(self, data: bytes, now_ns: int) -> tuple[list[Found], bytes]:  # noqa: ARG002 - the device stamps
        """Return poses and the controller's messages."""
        samples, answer, texts = self._client.receive(data)
        messages = [ProtocolError("RTDE", f"the controller says: {text}") for text in texts]
        return [*messages, *samples], answer


class IxcomSession(Session):
    """An iMAR system that is asked for its raw readings."""

    def __init__(self, address: Address) -> None:
        self._channel = int(address.number("channel", 0, 0, 31))
        self._divider = int(address.number("divider", 1, 1, 65535))
        self._decoder = ixcom.Decoder()
        self._losses = Losses("iXCOM")

    def begin(self) -> bytes:
        """Return the commands that open a channel and request readings."""
        return ixcom.open_channel(self._channel) + ixcom.add_log(ixcom.IMURAW, self._divider)

    def receive(self, data: bytes, now_ns: int) -> tuple[list[Found], bytes]:  # noqa: ARG002 - the device stamps
        """Return readings, refusals, and errors about lost bytes and frames."""
        out: list[Found] = []
        for frame in self._decoder.receive(data):
            try:
                if frame.message == ixcom.IMURAW:
                    out.append(ixcom.sample(frame))
                elif frame.message == ixcom.RESPONSE:
                    ixcom.check_response(frame)
            except ProtocolError as error:
                out.append(error)
        return out + self._losses.since(self._decoder.skipped, self._decoder.missing), b""


class LineSession(Session):
    """An IMU that sends lines of text."""

    def __init__(self, address: Address) -> None:
        named = address.options.get("columns")
        self._decoder = line.Decoder(None if named is None else line.Columns.parse(named))

    def receive(self, data: bytes, now_ns: int) -> tuple[list[Found], bytes]:  # noqa: ARG002 - the device stamps
        """Return readings, and an error for each invalid line."""
        return list(self._decoder.receive(data)), b""


class VarproxySession(Session):
    """A KUKA controller that is asked for its pose.

    It sends no time: the stamp of a pose is the host's time half way between request and answer.
    """

    def __init__(self, address: Address) -> None:
        self.period = 1.0 / address.number("rate", 50.0, 0.1, 250.0)
        self._splitter = varproxy.splitter()
        self._asked: dict[int, int] = {}
        self._number = 0

    def ask(self, now_ns: int) -> bytes:
        """Return the request for the tool's pose."""
        self._number = (self._number + 1) % 2**16
        self._asked[self._number] = now_ns
        return varproxy.encode_request(varproxy.Request(self._number, "$POS_ACT"))

    def receive(self, data: bytes, now_ns: int) -> tuple[list[Found], bytes]:
        """Return poses, and an error for each invalid answer."""
        out: list[Found] = []
        for number, content in self._splitter.receive(data):
            asked = self._asked.pop(number, None)
            try:
                answer = varproxy.decode_answer(number, content)
                if asked is not None and answer.well:
                    out.append(varproxy.pose(answer.value, (asked + now_ns) // 2))
            except ProtocolError as error:
                out.append(error)
        return out, b""


class EkrlSession(Session):
    """The states that kreisel's program on a KUKA controller sends."""

    def __init__(self, address: Address) -> None:  # noqa: ARG002 - all sessions have this signature
        self._splitter = ekrl.Splitter("Robot")
        self._skipped = 0

    def receive(self, data: bytes, now_ns: int) -> tuple[list[Found], bytes]:  # noqa: ARG002 - the device stamps
        """Return poses, and an error for each invalid telegram."""
        out: list[Found] = []
        for telegram in self._splitter.receive(data):
            try:
                out.append(ekrl.decode_state(telegram).sample)
            except ProtocolError as error:
                out.append(error)
        if self._splitter.skipped > self._skipped:
            out.append(
                ProtocolError("EthernetKRL", f"{self._splitter.skipped - self._skipped} bytes belong to no telegram")
            )
            self._skipped = self._splitter.skipped
        return out, b""


class RsiSession(Session):
    """A KUKA controller that sends telegrams to a port, and may need an answer to each."""

    def __init__(self, address: Address) -> None:
        self._answers = address.options.get("answer", "no").lower() in ("yes", "true", "1")
        self._late = 0

    def receive(self, data: bytes, now_ns: int) -> tuple[list[Found], bytes]:  # noqa: ARG002 - the device stamps
        """Return the pose of a telegram and its answer, and an error about answers that came late."""
        out: list[Found] = []
        try:
            out.append(rsi.decode(data))
        except ProtocolError as error:  # it is answered all the same if that is possible: else the robot is stopped
            out.append(error)
        if not self._answers:
            return out, b""
        answer = b""
        with suppress(ProtocolError):
            answer = rsi.encode_answer(data)
        late = rsi.late_answers(data)
        if late > self._late:
            text = f"{late - self._late} answers reached the controller late, {late} in all; it stops the robot after "
            out.append(Remark(f"{text}a few: is this machine busy?", Level.WARNING))
        self._late = late
        return out, answer


class EgmSession(Session):
    """An ABB controller that sends its poses to a port."""

    def __init__(self, address: Address) -> None:
        """Take nothing from the address; all sessions have this signature."""

    def receive(self, data: bytes, now_ns: int) -> tuple[list[Found], bytes]:  # noqa: ARG002 - the device stamps
        """Return the pose of a telegram."""
        return [egm.decode(data)], b""


SESSIONS: dict[str, Callable[[Address], Session]] = {
    "rtde": RtdeSession,
    "ixcom": IxcomSession,
    "csv": LineSession,
    "serial": LineSession,
    "varproxy": VarproxySession,
    "ekrl": EkrlSession,
    "rsi": RsiSession,
    "egm": EgmSession,
    "mavlink": MavlinkSession,
}
"""Session classes by protocol; each is constructed from an address."""


def session_at(address: Address) -> Session:
    """Return the beginning of the dialogue with the device at an address.

    Raises
    ------
    SettingsError, ProtocolError
        If an option of the address is invalid.
    """
    protocol = address.options.get("protocol", address.scheme)
    if address.scheme == "serial" and protocol not in ("serial", "csv", "mavlink"):
        raise SettingsError(f"{address}: {unknown_name('protocol', protocol, ('csv', 'mavlink'))}")
    return SESSIONS[protocol](address)
