"""What accuracy a recording is to reach: a file beside it, from who records to the page. No network here."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path


def write_goals(path: Path, goals: Mapping[str, float]) -> bool:
    """Write standard deviations that are to be reached (SI), by group of parameters; return whether it was possible.

    path: the file of the recording, or its folder.
    """
    try:
        _beside(path).write_text(json.dumps(dict(goals)), encoding="utf-8")
    except OSError:
        return False
    return True


def goals_of(path: Path) -> dict[str, float]:
    """Return the standard deviations that a recording is to reach (SI), by group of parameters; empty without any."""
    try:
        found = json.loads(_beside(path).read_text(encoding="utf-8"))
        return {str(group): float(goal) for group, goal in found.items()}
    except (OSError, ValueError, AttributeError, TypeError):
        return {}


def _beside(path: Path) -> Path:
    return path.with_suffix(".goals.json") if path.suffix == ".mcap" else path / "goals.json"
