"""The dialogue with an autopilot over MAVLink: it is asked for the readings of its IMU, and for its time."""

from __future__ import annotations

from kreisel.devices.address import Address
from kreisel.devices.dialogue import Found, Losses, Remark, Session
from kreisel.errors import ProtocolError, SettingsError, unknown_name
from kreisel.protocols import mavlink

_NO_READINGS_NS = 3_000_000_000
"""ns without readings after which an autopilot that is there is reported. Chosen: it was asked three times."""


class _Clock:
    """The distance of a device's clock from the host's, by answers that state the device's time."""

    _ENOUGH = 5  # answers; chosen: the quickest of a few is seldom a slow one

    def __init__(self) -> None:
        self._answers: list[tuple[int, int]] = []
        self._age_ns: int | None = None

    def compare(self, stated_ns: int, asked_ns: int, now_ns: int) -> list[Found]:
        """Take an answer; return a report once there are enough."""
        if not 0 <= now_ns - asked_ns < 10**9 or len(self._answers) >= self._ENOUGH:
            return []
        self._answers.append((now_ns - asked_ns, stated_ns - (asked_ns + now_ns) // 2))
        if len(self._answers) < self._ENOUGH:
            return []
        trip, ahead = min(self._answers)
        text = f"the device's clock is {ahead * 1e-9:+.4f} s ahead of this computer's, known to {trip * 5e-7:.2f} ms"
        if self._age_ns is None:
            return [Remark(text)]
        return [Remark(f"{text}; readings come {(self._age_ns + ahead) * 1e-6:.1f} ms after their stamps")]

    def read(self, stamp_ns: int, now_ns: int) -> None:
        """Take the stamp of a reading and its time of arrival."""
        age = now_ns - stamp_ns
        self._age_ns = age if self._age_ns is None else min(age, self._age_ns)


class MavlinkSession(Session):
    """An autopilot that is asked for the readings of its IMU, and for its time.

    It is asked again until readings come: a request is lost like any other frame. The distance of its clock from ours,
    and how late its readings come, are reported once.
    """

    period = 1.0
    silence = "no readings are received; is the autopilot on, and is this port the one it sends to?"

    def __init__(self, address: Address) -> None:
        name = address.options.get("message", mavlink.READINGS[0]).upper()
        if name not in mavlink.READINGS:
            raise SettingsError(f"{address}: {unknown_name('message', name, mavlink.READINGS)}")
        self._message = mavlink.Message[name]
        self._rate = address.number("rate", 200.0, 1.0, 8000.0)
        self._system = int(address.number("system", 0, 0, 255))
        self._decoder = mavlink.Decoder()
        self._autopilot: tuple[int, int, int] | None = None
        self._sequence = self._began_ns = 0
        self._losses = Losses("MAVLink")
        self._reading_ns = self._asked_ns = -(10**10)
        self._clock = _Clock()

    def begin(self) -> bytes:
        """Return a sign of life."""
        return mavlink.heartbeat(self._next())

    def ask(self, now_ns: int) -> bytes:
        """Return a sign of life, a question for the time, and a request for readings if none come."""
        return mavlink.heartbeat(self._next()) + mavlink.ask_time(now_ns, self._next()) + self._request(now_ns)

    def receive(self, data: bytes, now_ns: int) -> tuple[list[Found], bytes]:
        """Return readings, refusals, and errors about lost frames; and a request for readings at the first frame."""
        out: list[Found] = []
        answer = b""
        for frame in self._decoder.receive(data):
            if self._system and frame.system != self._system:
                continue
            if frame.message == mavlink.Message.HEARTBEAT:
                answer += self._greet(frame, now_ns)
                out.extend(self._complaint(now_ns))
            stated = mavlink.stated_time(frame)
            if stated is not None:
                out.extend(self._clock.compare(*stated, now_ns))
            refused = mavlink.refusal(frame)
            if refused is not None:
                text = f"the autopilot does not send {self._message.name} as requested ({refused})"
                others = ", ".join(other for other in mavlink.READINGS if other != self._message.name)
                out.append(ProtocolError("MAVLink", f"{text}; others are ?message={others}"))
            if frame.message == self._message:
                out.extend(self._sample(frame, now_ns))
        return out + self._losses.since(self._decoder.skipped, self._decoder.missing), answer

    def _sample(self, frame: mavlink.Frame, now_ns: int) -> list[Found]:
        if self._autopilot is None:
            return []  # whose readings they are, and their units, is known with the first sign of life
        if (frame.system, frame.component) != self._autopilot[:2]:
            return []
        try:
            reading = mavlink.sample(frame, ardupilot=self._autopilot[2] == mavlink.ARDUPILOT)
        except ProtocolError as error:
            return [error]
        self._reading_ns = now_ns
        if reading is not None:
            self._clock.read(reading.stamp_ns, now_ns)
            return [reading]
        return [ProtocolError("MAVLink", "a message says that not all six readings in it are new; it was left out")]

    def _greet(self, frame: mavlink.Frame, now_ns: int) -> bytes:
        """Take the first autopilot that shows itself; return the request for its readings."""
        kind = int(frame.values[2])
        if self._autopilot is None and kind != mavlink.NO_AUTOPILOT:
            self._autopilot = (frame.system, frame.component, kind)
            return self._request(now_ns)
        return b""

    def _complaint(self, now_ns: int) -> list[Found]:
        """Return an error if the autopilot was asked for readings and shows itself, but sends none."""
        self._began_ns = self._began_ns or now_ns
        if now_ns - max(self._reading_ns, self._began_ns) < _NO_READINGS_NS:
            return []
        return [ProtocolError("MAVLink", f"the autopilot is there, but sends no {self._message.name}")]

    def _request(self, now_ns: int) -> bytes:
        if self._autopilot is None or now_ns - max(self._reading_ns, self._asked_ns) < self.period * 0.9e9:
            return b""
        self._asked_ns = now_ns
        return mavlink.request(self._message, self._rate, self._autopilot[:2], self._next())

    def _next(self) -> int:
        self._sequence += 1
        return self._sequence - 1
