"""Tasks that do not depend on each other, in threads: the compiled library does not hold the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any


def in_threads(tasks: Sequence[Callable[[], Any]]) -> list[Any]:
    """Return the results of tasks; the first error of one is raised when all have ended."""
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(max_workers=len(tasks)) as pool:
        return [future.result() for future in [pool.submit(task) for task in tasks]]


@contextmanager
def releasing_memory() -> Iterator[None]:
    """Give back what is looked at of large arrays in files, again and again, while the body runs."""
    from threading import Event, Thread

    from kreisel import spill

    ended = Event()

    def run() -> None:
        while not ended.wait(0.02):
            spill.release()

    thread = Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
