"""Progress of long work: the name of a step and the share of it that is done."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with a step's name and the share of it that is done, 0 to 1."""

StepProgress = Callable[[float], None]
"""Called with the share of one step that is done, 0 to 1."""


def of_step(progress: Progress | None, name: str) -> StepProgress | None:
    """Return a function that reports the progress of a step under its name; None if `progress` is None."""
    return None if progress is None else lambda share: progress(name, share)


def of_parts(progress: Progress | None, name: str, count: int) -> list[Progress | None]:
    """Return functions for the parts of one step, which are done side by side: the mean of their shares is reported."""
    if progress is None:
        return [None] * count
    shares = [0.0] * count

    def part(i: int) -> Progress:
        def report(step: str, share: float) -> None:
            del step
            shares[i] = max(shares[i], share)
            progress(name, sum(shares) / count)

        return report

    return [part(i) for i in range(count)]
