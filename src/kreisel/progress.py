"""How long work reports what it does: a step's name, and the share of it that is done."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with a step's name and the share of it that is done, 0 to 1."""

StepProgress = Callable[[float], None]
"""Called with the share that is done of one step, 0 to 1."""


def of_step(progress: Progress | None, name: str) -> StepProgress | None:
    """Return what reports a step under its name; None where nobody listens."""
    return None if progress is None else lambda share: progress(name, share)
