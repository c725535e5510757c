"""Events of a device: readings with the host's time of arrival, and notices about the connection."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from kreisel.protocols.samples import ImuSample, RobotSample


@dataclass(frozen=True, slots=True)
class Arrival:
    """A reading, and the host's monotonic time in ns when its bytes were received."""

    sample: ImuSample | RobotSample
    host_ns: int


class Level(StrEnum):
    """Severity of a notice; LOCKED_OUT: another sender than the one that is recorded may be the device."""

    INFO = "info"
    WARNING = "warning"
    LOST = "lost"
    LOCKED_OUT = "locked out"


@dataclass(frozen=True, slots=True)
class Notice:
    """A message about a device: connection lost or restored, bytes that are not a message."""

    level: Level
    text: str
    host_ns: int


Event = Arrival | Notice
