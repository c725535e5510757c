"""Progress of long work: the name of a step and the share of it that is done."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

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


@contextmanager
def shown(progress: Progress | bool | None) -> Iterator[Progress | None]:
    """Yield the function that reports progress: the given one, None, or for True one that shows it.

    In a notebook one line of the cell's output is kept up to date; in a terminal one line of standard error, which is
    removed at the end. Elsewhere the name of each step is written to standard error, once.
    """
    if callable(progress):
        yield progress
    elif not progress:
        yield None
    elif (cell := _output_of_cell()) is not None:
        yield cell
        cell.finish()
    elif sys.stderr.isatty():
        yield from _in_terminal()
    else:
        yield _StepNames(sys.stderr)


_PAUSE, _CELLS = 0.1, 20
"""s between two changes of a line in a notebook; characters of its bar."""


class CellLine:
    """One line in the output of a notebook's cell.

    Parameters
    ----------
    show
        Shows a text for the first time; returns a function that puts another in its place.
    clock
        Seconds.
    """

    def __init__(
        self, show: Callable[[str], Callable[[str], None]], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._clock, self._began = clock, clock()
        self._put, self._changed = show(""), -math.inf

    def __call__(self, step: str, share: float) -> None:
        """Show the step and its share, unless the line has just been changed."""
        now = self._clock()
        if now - self._changed >= _PAUSE:
            self._changed = now
            share = min(max(share, 0.0), 1.0)
            done = round(_CELLS * share)
            self._put(f"{step:<16} {'█' * done}{'░' * (_CELLS - done)} {100.0 * share:3.0f} %  {self._spent(now)}")

    def finish(self) -> None:
        """Show how long it took."""
        self._put(f"done in {self._spent(self._clock())}")

    def _spent(self, now: float) -> str:
        return f"{now - self._began:.1f} s"


def _output_of_cell() -> CellLine | None:
    """Return a line in the output of the cell that is being executed; None where this is no notebook."""
    if "IPython" not in sys.modules:
        return None
    from IPython import get_ipython

    shell = get_ipython()
    return CellLine(_shown_in_cell) if getattr(shell, "kernel", None) is not None else None


def _shown_in_cell(text: str) -> Callable[[str], None]:
    from IPython.display import display

    handle: Any = display({"text/plain": text}, raw=True, display_id=True)  # type: ignore[no-untyped-call]
    return lambda other: handle.update({"text/plain": other}, raw=True)


def _in_terminal() -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda step, share: bar.update(task, description=f"{step:<16}", completed=share)


class _StepNames:
    """Writes the name of each step when it is first reported."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._said = stream, set[str]()

    def __call__(self, step: str, share: float) -> None:
        del share
        if step not in self._said:
            self._said.add(step)
            self._stream.write(f"{step}\n")
            self._stream.flush()
