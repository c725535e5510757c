"""Why units are not used, in words."""

from __future__ import annotations

from collections.abc import Mapping

from kreisel.errors import KreiselError

_FIRST = 3
"""Reasons in one line."""


def reason_of(error: KreiselError) -> str:
    """Return the message of an error in one line."""
    return str(error).replace("\n", " ")


def in_words(left_out: Mapping[str, str]) -> str:
    """Return names and reasons of the first units that are left out, and how many more there are."""
    first = [f"{name}: {reason}" for name, reason in left_out.items()][:_FIRST]
    more = len(left_out) - len(first)
    return "; ".join([*first, f"and {more} more"] if more else first)
