"""Warnings of libraries, kept from the terminal: what a user should know of the data stands in our own warnings."""

from __future__ import annotations

import logging
import os
import warnings
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


def _ignored(*_: Any, **__: Any) -> None:
    """Show nothing."""
