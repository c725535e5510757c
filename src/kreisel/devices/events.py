"""What comes from a device: readings with the host's own time of arrival, and what happened to the connection."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from kreisel.protocols.samples import ImuSample, RobotSample


@dataclass(frozen=True, slots=True)
class Arrival:
    """A reading, and the host's monotonic time in ns when its bytes came in."""

    sample: ImuSample | RobotSample
    host_ns: int


class Level(StrEnum):
    """How bad it is."""

    INFO = "info"
    WARNING = "warning"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class Notice:
    """Something to be told: a device lost, or back, bytes that were no message."""

    level: Level
    text: str
    host_ns: int


Event = Arrival | Notice
