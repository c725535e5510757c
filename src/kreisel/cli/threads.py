"""Works that do not depend on each other, in threads: the compiled library does not hold the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any


def side_by_side(works: Sequence[Callable[[], Any]]) -> list[Any]:
    """Return the results of works; the first error of one is raised when all have ended."""
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(max_workers=len(works)) as pool:
        return [future.result() for future in [pool.submit(work) for work in works]]


def release_memory() -> None:
    """Give back what is looked at of large arrays in files, again and again, until the process ends."""
    import time
    from threading import Thread

    from kreisel import spill

    def run() -> None:
        while True:
            time.sleep(0.02)
            spill.release()

    Thread(target=run, daemon=True).start()
