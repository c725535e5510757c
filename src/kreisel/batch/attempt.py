"""What a station did with a unit once."""

from __future__ import annotations

from dataclasses import dataclass

RECORDING, CALIBRATING, ENDED = "recording", "calibrating", "ended"
"""States of an attempt, in their order."""

INTERRUPTED = "interrupted"
"""Outcome of an attempt that ended without a decision on the unit; the others are those of `kreisel batch`."""


@dataclass(frozen=True)
class Attempt:
    """One attempt to calibrate a unit; a row of the file of results.

    Attributes
    ----------
    id
        Its number; 0 until it is written.
    kind
        "unit", or "golden" for the unit that checks the station.
    station, operator
        As stated; may be empty.
    begun, ended
        UTC, ISO 8601; `ended` is None while it runs.
    state
        One of the three above.
    outcome, reason
        Empty until it has ended.
    recording
        Its file, below the station's folder.
    key
        Of its run; empty where there is none.
    printed
        How many times its certificate was printed.
    """

    id: int
    unit: str
    kind: str
    station: str
    operator: str
    begun: str
    ended: str | None = None
    state: str = RECORDING
    outcome: str = ""
    reason: str = ""
    recording: str = ""
    key: str = ""
    printed: int = 0
