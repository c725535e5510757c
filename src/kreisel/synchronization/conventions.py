"""Conventions of the reference's orientations, recognised by whether they turn as the gyros say."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kreisel.errors import RecordingError, SynchronizationError
from kreisel.geometry.rotation import Array, conjugate
from kreisel.inertial.strapdown import InertialSignal
from kreisel.recording import ReferencePoses
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.rate_fit import explained_share

EXPLAINED = 0.8
"""Share of the reference's rotation the gyros must explain."""

_READINGS: dict[str, Callable[[Array], Array]] = {
    "as their conjugates (turn from r to b): change the sign of q_x, q_y, q_z": conjugate,
    "scalar last (q_x, q_y, q_z, q_w): put q_w first": lambda q: np.roll(q, 1, axis=1),
    "scalar last and conjugated: put q_w first and change the sign of q_x, q_y, q_z": lambda q: conjugate(
        np.roll(q, 1, axis=1)
    ),
}


def check_conventions(signal: InertialSignal, reference: ReferencePoses, clock: Clock) -> None:
    """Raise an error if the reference's orientations do not turn as the gyros say.

    The correlation of rate norms says nothing of that: a norm is the same in all these conventions.

    Raises
    ------
    RecordingError
        If they do when read in another convention, which is named.
    SynchronizationError
        If they do not at all.
    """
    if reference.quaternions is None:
        return
    q, tau = reference.quaternions, reference.seconds
    usual = explained_share(signal, tau, q, clock)
    if usual >= EXPLAINED:
        return
    shares = {name: explained_share(signal, tau, read(q), clock) for name, read in _READINGS.items()}
    best = max(shares, key=lambda name: shares[name])
    if shares[best] >= EXPLAINED:
        raise RecordingError(
            f"the quaternions fit the gyros only when read {best} (they then explain {100 * shares[best]:.0f} % "
            f"of the rotation, as they stand {100 * max(usual, 0.0):.0f} %); correct the file",
            file=reference.source,
        )
    raise SynchronizationError(
        f"{reference.source}: the poses turn by similar amounts as the IMU but about other axes: the gyros explain "
        f"{100 * max(usual, 0.0):.0f} % of the rotation, expected {100 * EXPLAINED:.0f} % or more. "
        "Do the poses belong to this run, and are the gyro columns in order?",
        correlation=usual,
    )
