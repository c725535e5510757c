"""What drivers report about a device besides its readings: each kind of fault now and then, not each time."""

from __future__ import annotations

import re
from collections.abc import Callable

from kreisel.devices.dialogue import Found, Remark
from kreisel.devices.events import Arrival, Event, Level, Notice
from kreisel.errors import KreiselError, ProtocolError

SILENCE = 1.0
"""Seconds without a message after which a device counts as lost."""

_KINDS = 20
"""Kinds of faults that are counted apart. Chosen: a protocol has fewer; limited, because messages quote what is
sent."""

_PAUSE_NS = 1_000_000_000
"""ns in which a kind of fault is reported once. Chosen: a person can read as much; the number is reported, too."""


AGAIN = "; trying again"
"""End of the report that a device cannot be reached."""

REPEATED = "such messages so far)"
"""End of the report of a fault that was reported before."""


class Silence:
    """Whether a device is heard; it is reported once that it is not, and once that it is again.

    Parameters
    ----------
    where
        Its address.
    now_ns
        The present time.
    """

    def __init__(self, where: object, now_ns: int) -> None:
        self._where, self._heard_ns, self._silent = where, now_ns, False

    def look(self, now_ns: int, why: Callable[[], str]) -> list[Notice]:
        """Return the notice that nothing is received, if that is so and new; `why` says what to look for."""
        if self._silent or now_ns - self._heard_ns <= SILENCE * 1e9:
            return []
        self._silent = True
        return [Notice(Level.LOST, f"{self._where}: {why()}", now_ns)]

    def hear(self, now_ns: int) -> list[Notice]:
        """Note a reading; return the notice that it is the first after a silence."""
        self._heard_ns = now_ns
        again, self._silent = self._silent, False
        return [Notice(Level.INFO, f"{self._where}: messages are received again", now_ns)] if again else []


class Faults:
    """Faults of one device; each kind is reported at most once a second, with the number so far."""

    def __init__(self) -> None:
        self._seen: dict[str, tuple[int, int]] = {}

    def events(self, found: list[Found], now_ns: int, where: object) -> list[Event]:
        """Return the events of what a session found at a time, for the device at an address."""
        events: list[Event] = []
        for item in found:
            if isinstance(item, ProtocolError):
                events.extend(self.report(item, now_ns))
            elif isinstance(item, Remark):
                events.append(Notice(item.level, f"{where}: {item.text}", now_ns))
            else:
                events.append(Arrival(item, now_ns))
        return events

    def report(self, error: KreiselError, now_ns: int) -> list[Notice]:
        """Return the notice about a fault, none if its kind was reported within the last second."""
        kind = re.sub(r"\d+|'.*", "", str(error))[:40]
        if kind not in self._seen and len(self._seen) >= _KINDS:
            kind = "other"
        count, last_ns = self._seen.get(kind, (0, -_PAUSE_NS))
        quiet = now_ns - last_ns < _PAUSE_NS
        self._seen[kind] = (count + 1, last_ns if quiet else now_ns)
        if quiet:
            return []
        more = "" if count == 0 else f" ({count + 1} {REPEATED}"
        return [Notice(Level.WARNING, f"{error}{more}", now_ns)]
