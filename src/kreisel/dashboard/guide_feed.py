"""Messages to the page of a guided calibration: what is written to a file beside the recording. No network here."""

from __future__ import annotations

import json
from pathlib import Path

from kreisel.dashboard.message import Message

ADVICE = "guide.json"
"""The file that the guide writes, beside the recording."""


def problem(text: str) -> Message:
    """Return what the page shows while there is no advice."""
    return {"kind": "problem", "text": text}


def ended(file: Path, text: str, note: str) -> Message:
    """Return what the page shows at the end: the last advice, with a text instead of what to do next."""
    try:
        last: Message = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        last = {}
    if last.get("kind") != "advice":
        return problem(f"{text} {note}".strip())
    return {**last, "step": "end", "text": text, "note": note, "wanted": None}


class GuideFeed:
    """The last advice about a recording that is being made; path: the file of the recording, or its folder."""

    def __init__(self, path: Path) -> None:
        self._file = (path.parent if path.suffix == ".mcap" else path) / ADVICE
        self._last: Message | None = None

    def news(self) -> list[Message]:
        """Return the advice if it is a new one."""
        try:
            found: Message = json.loads(self._file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return []
        if found == self._last:
            return []
        self._last = found
        return [found]

    def look(self) -> Message | None:
        """Return nothing: there are no estimates here."""
        return None

    def so_far(self) -> list[Message]:
        """Return the last advice."""
        return [] if self._last is None else [self._last]
