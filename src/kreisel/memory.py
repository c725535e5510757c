"""Memory of a process that works with large arrays in files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


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
