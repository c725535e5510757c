"""Why units are not used, in words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kreisel.errors import KreiselError, RecordingError
from kreisel.recording.recording import ImuSamples

_FIRST = 3
"""Reasons in one line."""

COPY = "holds the readings of {other}: check how the files were written"
"""What is said of a unit whose file, or topic, is one of another unit."""


def reason_of(error: KreiselError) -> str:
    """Return the message of an error in one line."""
    return str(error).replace("\n", " ")


def in_words(left_out: Mapping[str, str]) -> str:
    """Return names and reasons of the first units that are left out, and how many more there are."""
    first = [f"{name}: {reason}" for name, reason in left_out.items()][:_FIRST]
    more = len(left_out) - len(first)
    return "; ".join([*first, f"and {more} more"] if more else first)


def check_copy(imu: ImuSamples, others: Mapping[str, ImuSamples]) -> None:
    """Check that the readings of a unit are not those of another one.

    Raises
    ------
    RecordingError
        If they are: files, or topics, of one sensor are no two units.
    """
    for name, other in others.items():
        if imu.rates.shape == other.rates.shape and np.array_equal(imu.rates, other.rates):
            raise RecordingError(COPY.format(other=name), file=imu.source)
