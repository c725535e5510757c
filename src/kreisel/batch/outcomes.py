"""What can become of a unit, and the exit status for it: what a program that tests units goes by."""

from __future__ import annotations

from collections.abc import Iterable

OUTCOMES = ("conforms", "accepted", "no decision", "does not conform", "rejected", "failed")
"""The best first; "accepted" where there are no limits, "failed" where there is no result."""

GOOD = ("conforms", "accepted")
"""Outcomes with which a unit may be delivered."""

FAILED, REJECTED, UNDECIDED = 1, 3, 4
"""Exit statuses. 1 is usual for any failure, and 2 is that of a wrong command line (click); 3 and 4 are the next."""

STATUS = {"failed": FAILED, "rejected": REJECTED, "does not conform": REJECTED, "no decision": UNDECIDED}
"""Exit status by outcome; 0 for all else."""

_MOST_SERIOUS_FIRST = (FAILED, REJECTED, UNDECIDED, 0)


def most_serious(statuses: Iterable[int]) -> int:
    """Return the exit status of several together: the first of 1, 3, 4, 0 that occurs."""
    found = set(statuses)
    return next(status for status in _MOST_SERIOUS_FIRST if status in found or status == 0)
