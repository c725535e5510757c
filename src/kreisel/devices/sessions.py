"""The dialogue over one connection, from its beginning: bytes in, readings and answers out. No sockets here."""

from __future__ import annotations

from kreisel.devices.address import Address
from kreisel.errors import ProtocolError
from kreisel.protocols import ekrl, ixcom, line, rtde, varproxy
from kreisel.protocols.samples import ImuSample, RobotSample

Found = ImuSample | RobotSample | ProtocolError


class Session:
    """The state of one connection to a device; every connection gets a new one.

    Attributes
    ----------
    period
        Seconds between two requests, if a device sends only what is requested; otherwise None.
    """

    period: float | None = None

    def begin(self) -> bytes:
        """Return what to send first."""
        return b""

    def ask(self, now_ns: int) -> bytes:
        """Return the next request; `now_ns` is on the host's clock."""
        raise NotImplementedError(f"{type(self).__name__} at {now_ns} sends no requests")

    def receive(self, data: bytes, now_ns: int) -> tuple[list[Found], bytes]:
        """Return the readings and errors in bytes received at `now_ns`, and what to send.

        Raises
        ------
        ProtocolError
            If the connection is no longer usable.
        """
        raise NotImplementedError(f"{type(self).__name__} reads nothing of {len(data)} bytes at {now_ns}")


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
        self._skipped = self._missing = 0

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
        skipped, missing = self._decoder.skipped, self._decoder.missing
        if skipped > self._skipped:
            out.append(ProtocolError("iXCOM", f"{skipped - self._skipped} bytes belong to no frame"))
        if missing > self._missing:
            out.append(ProtocolError("iXCOM", f"{missing - self._missing} frames were lost"))
        self._skipped, self._missing = skipped, missing
        return out, b""


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


SESSIONS: dict[str, type[Session]] = {
    "rtde": RtdeSession,
    "ixcom": IxcomSession,
    "csv": LineSession,
    "serial": LineSession,
    "varproxy": VarproxySession,
    "ekrl": EkrlSession,
}
"""Session classes by the scheme of the address; each is constructed from an address."""
