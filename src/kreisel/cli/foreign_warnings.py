"""Warnings of libraries, kept from the terminal: what a user should know of the data stands in our own warnings."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


def keep_from_terminal() -> None:
    """Keep what libraries warn of, by `warnings` or by `logging`, from standard error.

    Processes that are started later inherit it through the environment. KREISEL_DEBUG shows all of it.
    """
    if os.environ.get("KREISEL_DEBUG"):
        return
    # a filter would not do: libraries set filters of their own
    warnings.showwarning = _ignored
    logging.lastResort = None
    logging.getLogger().addHandler(logging.NullHandler())
    os.environ.setdefault("PYTHONWARNINGS", "ignore")


@contextmanager
def kept_from_standard_error() -> Iterator[None]:
    """Keep what libraries in C write to standard error, as fontconfig does, from the terminal while the body runs."""
    try:
        kept = os.dup(2) if not os.environ.get("KREISEL_DEBUG") else None
    except OSError:  # it is closed
        kept = None
    if kept is None:
        yield
        return
    with open(os.devnull, "wb") as nothing:  # noqa: PTH123 - a device, no path
        os.dup2(nothing.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _ignored(*_: Any, **__: Any) -> None:
    """Show nothing."""
