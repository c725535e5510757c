"""Tasks that do not depend on each other, in threads: the compiled library does not hold the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

from kreisel.memory import releasing_memory

__all__ = ["in_threads", "releasing_memory"]


def in_threads(tasks: Sequence[Callable[[], Any]]) -> list[Any]:
    """Return the results of tasks; the first error of one is raised when all have ended."""
    from concurrent.futures import ThreadPoolExecutor

    workers = min(len(tasks), max(2, os.cpu_count() or 1))
    with ThreadPoolExecutor(max_workers=workers) as pool:
        return [future.result() for future in [pool.submit(task) for task in tasks]]
