"""Check of the reference's quaternion convention: its orientations must rotate as the gyros measure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kreisel.errors import RecordingError, SynchronizationError
from kreisel.geometry.interpolation import slerp
from kreisel.geometry.rotation import Array, conjugate, matrix
from kreisel.inertial.readings import Readings
from kreisel.inertial.strapdown import InertialSignal
from kreisel.recording.recording import ReferencePoses
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.rate_fit import LinearFit, check_overlap, explained_share
from kreisel.synchronization.windows import Windows

EXPLAINED = 0.8
"""Share of the reference's rotation that the gyros must explain."""

_MARGIN = 0.2
_MIN_SHARE = 0.6
"""Shares of the accelerations: by which one way to read quaternions must exceed another, and which it must explain.
Chosen: the right one explains all but noise; of a wrong one the matrix of the fit takes up a part."""

_MIN_WINDOWS = 15
"""Windows of a fit. Chosen: their 45 equations are about four times the 12 unknowns, a matrix and gravity."""

_READINGS: dict[str, Callable[[Array], Array]] = {
    "as their conjugates (turns from r to b): change the sign of q_x, q_y, q_z, and if the positions are those of r in "
    "b, too, invert them (p = -C(q)^T p)": conjugate,
    "scalar last (q_x, q_y, q_z, q_w): put q_w first": lambda q: np.roll(q, 1, axis=1),
    "scalar last and conjugated: put q_w first and change the sign of q_x, q_y, q_z": lambda q: conjugate(
        np.roll(q, 1, axis=1)
    ),
}


def checked_fit(readings: Readings, reference: ReferencePoses, clock: Clock) -> LinearFit:
    """Return the linear fit of the readings to a reference whose orientations rotate as the gyros measure.

    The correlation of rate norms cannot show this: a norm is the same in all these conventions.

    Raises
    ------
    RecordingError
        If they do so when read in another convention; the message names it.
    SynchronizationError
        If they do so in no convention, or if too few of them lie within the IMU's recording.
    """
    check_overlap(readings, reference, clock)
    q, tau = reference.quaternions, reference.seconds
    assert q is not None  # noqa: S101 - for the type checker; the callers checked
    found = LinearFit.of(readings, tau, q, clock)
    usual = found.explained
    if usual < EXPLAINED:
        usual = max(usual, explained_share(readings, tau, q, clock))
    if usual >= EXPLAINED:
        return found
    shares = {name: explained_share(readings, tau, read(q), clock) for name, read in _READINGS.items()}
    fitting = [name for name, share in shares.items() if share >= EXPLAINED]
    if fitting:
        names = " or ".join(_most_likely(readings, reference, clock, fitting))
        raise RecordingError(
            f"the quaternions fit the gyros only when read {names} (the gyros then explain "
            f"{100 * shares[fitting[0]]:.0f} % of the rotation, and {100 * max(usual, 0.0):.0f} % as written); "
            "correct the file; where its columns are mapped, the mapping",
            file=reference.source,
        )
    raise SynchronizationError(
        f"{reference.source}: the poses rotate by similar angles as the IMU but about other axes: the gyros explain "
        f"{100 * max(usual, 0.0):.0f} % of the rotation, expected {100 * EXPLAINED:.0f} % or more. "
        "Do the poses belong to this run, was no clock set during it, and are the gyro columns in order?"
        f"{_silent(readings)}",
        correlation=usual,
    )


def _silent(readings: Readings) -> str:
    """Return a sentence about a gyro that hardly changes while the others do; empty where there is none."""
    moved = np.std(readings.rates, axis=0)
    if moved.min() > 0.03 * moved.max():
        return ""
    return f" w_{'xyz'[int(np.argmin(moved))]} hardly changes: does it work?"


def better_reading(readings: Readings, reference: ReferencePoses, clock: Clock) -> str | None:
    """Return how the quaternions must be read to fit the accelerations, or None where no reading fits better."""
    if reference.quaternions is None or reference.positions is None:
        return None
    usual = acceleration_share(readings, reference, reference.quaternions, clock)
    shares = {
        name: acceleration_share(readings, reference, read(reference.quaternions), clock)
        for name, read in _READINGS.items()
    }
    best = max(shares, key=lambda name: shares[name])
    return best if shares[best] > max(usual + _MARGIN, _MIN_SHARE) else None


def _most_likely(readings: Readings, reference: ReferencePoses, clock: Clock, names: list[str]) -> list[str]:
    """Return the conventions that also fit the accelerations; all of them where that cannot be determined.

    A quaternion with its parts in another order is the conjugate of that quaternion between two constant ones: the
    gyros cannot distinguish the two.
    """
    if reference.positions is None or reference.quaternions is None:
        return names
    q = reference.quaternions
    shares = {name: acceleration_share(readings, reference, _READINGS[name](q), clock) for name in names}
    best = max(shares.values())
    return [name for name in names if shares[name] > best - _MARGIN]


def acceleration_share(readings: Readings, reference: ReferencePoses, q: Array, clock: Clock) -> float:
    """Return the share of the positions' accelerations that the accelerometers explain with attitudes q (m, 4).

    Any linear map of the readings and any gravity are allowed; only the attitudes must be right.
    """
    within = clock.imu_time(reference.seconds[[0, -1]])
    parts = [_windows_with(chunk, reference, q, clock) for chunk in readings.excerpt(*within)]
    predicted, reference_accel = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    if len(reference_accel) < _MIN_WINDOWS:
        return 0.0
    A = np.concatenate([predicted, np.broadcast_to(np.eye(3), (len(reference_accel), 3, 3))], axis=2).reshape(-1, 12)
    solution, *_ = np.linalg.lstsq(A, reference_accel.reshape(-1), rcond=None)
    left = reference_accel.reshape(-1) - A @ solution
    return 1.0 - float(left @ left) / max(float(np.sum((reference_accel - reference_accel.mean(axis=0)) ** 2)), 1e-30)


def _windows_with(signal: InertialSignal, reference: ReferencePoses, q: Array, clock: Clock) -> tuple[Array, Array]:
    """Return predicted accelerations, for each coupling (windows, 3, 9), and those of the positions (windows, 3)."""
    p, stamps = reference.positions, signal.stamps
    assert p is not None  # noqa: S101 - for the type checker; the callers checked
    t = clock.imu_time(reference.seconds)
    k = np.clip(np.searchsorted(t, stamps) - 1, 0, t.size - 2)
    share = np.clip((stamps - t[k]) / (t[k + 1] - t[k]), 0.0, 1.0)
    C = matrix(slerp(q[k], q[k + 1], share))
    force = np.einsum("nij,nk->nijk", C, signal.accelerations).reshape(stamps.size, 27)
    windows = Windows.over(signal, clock, reference.seconds)
    return windows.integrate(force).reshape(-1, 3, 9), windows.second_difference(p)
