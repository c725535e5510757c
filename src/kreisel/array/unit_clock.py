"""The clock of an IMU against that of another one on the same body, by the norms of their rates."""

from __future__ import annotations

import numpy as np

from kreisel.errors import SynchronizationError
from kreisel.recording.recording import ImuSamples
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.correlation import MIN_CORRELATION, correlate_imus

BASES = 3
"""Units that are tried as the one that all others are brought to. Chosen: if no other one moves with any of three, most
are loose, or lie elsewhere."""


def clock_of(imu: ImuSamples, reference: ImuSamples, name: str = "the other one") -> Clock:
    """Return the clock t = start + (1 + skew) tau, with tau the seconds of `imu` and t those of `reference`.

    Parameters
    ----------
    name
        Of the reference unit, for the message.

    Raises
    ------
    SynchronizationError
        If their rates do not correlate: they did not move as one body.
    """
    found = correlate_imus(reference, imu)
    if not found.coefficient >= MIN_CORRELATION:
        if np.isnan(found.coefficient):  # of constant norms
            still = np.ptp(reference.rates, axis=0).max() == 0.0
            reason = f"the rates of {name} never change" if still else "its rates never change"
            raise SynchronizationError(f"does not turn as {name} does: {reason}")
        raise SynchronizationError(
            f"does not turn as {name} does: the best correlation of their rates over all "
            f"shifts is {found.coefficient:.2f}, expected {MIN_CORRELATION} or more",
            correlation=found.coefficient,
        )
    return found.clock
