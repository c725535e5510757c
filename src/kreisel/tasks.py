"""Tasks that do not depend on each other, and who runs them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

Executor = Callable[[Sequence[Callable[[], Any]]], list[Any]]
"""Runs tasks that do not depend on each other, in any order or at the same time, and returns their results in order."""


def sequential(tasks: Sequence[Callable[[], Any]]) -> list[Any]:
    """Return the results of tasks that are run one after another."""
    return [task() for task in tasks]
