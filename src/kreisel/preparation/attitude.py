"""The body's attitude at every sample, from gyros and reference together, before any filter runs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from kreisel.geometry.interpolation import interpolate_columns, running_mean
from kreisel.geometry.rotation import (
    Array,
    Indices,
    apply,
    conjugate,
    exp,
    from_matrix,
    lengths,
    log,
    multiply,
    nearest_rotation,
)
from kreisel.inertial.strapdown import InertialSignal, integrate_attitude, linear_rate
from kreisel.preparation.preparation import AccelerometerFit, Preparation
from kreisel.recording.recording import ReferencePoses
from kreisel.synchronization.fits import RateFit
from kreisel.synchronization.windows import Windows

_MIN_POSES = 10
"""Poses of a segment, or in a chunk, that show its attitude. Chosen: the correction is a mean over a second, of three
poses at least."""

_MIN_WINDOWS = 20
"""Windows that determine a rotation; an interval with fewer has the one before. Chosen: an interval of
`_SECONDS_OF_A_TURN` has 250, every 0.1 s, and a rotation has three unknowns."""

_SECONDS_OF_A_TURN = 25.0
"""s in which the rates are integrated without a correction. Chosen: a scale error of 1 % drifts by a hundredth of the
rotation in that time; shorter intervals may lie in a single standstill, where nothing is accelerated."""


def reference_attitude(signal: InertialSignal, fit: RateFit, tau: Array, q: Array) -> Array:
    """Return q_rb at every IMU sample, (n, 4): integrated rates, corrected by the reference over seconds.

    Every segment has a correction of its own: over a gap the rates are not known.
    """
    free = integrate_attitude(signal, linear_rate(fit.K_omega, fit.rate_at_zero))
    t = fit.clock.imu_time(tau)
    width = max(3, round(1.0 / float(np.median(np.diff(tau)))))
    for first, last in signal.segments:
        own = (t >= signal.stamps[first]) & (t <= signal.stamps[last])
        if np.count_nonzero(own) < _MIN_POSES:
            continue
        k = np.clip(np.searchsorted(signal.stamps, t[own]) - 1, first, last - 1)
        step = (signal.rates[k] @ fit.K_omega.T + fit.rate_at_zero) * (t[own] - signal.stamps[k])[:, None]
        # left error: q = exp(error) * exp(first error) * free, slowly varying
        error = multiply(q[own], conjugate(multiply(free[k], exp(step))))
        turned = log(multiply(error, conjugate(error[0])))
        part = slice(first, last + 1)
        slowly = multiply(exp(running_mean(_unwrapped(turned), width)), error[0])
        at_sample = interpolate_columns(signal.stamps[part], t[own], slowly)
        at_sample /= np.sqrt(np.einsum("ni,ni->n", at_sample, at_sample))[:, None]
        free[part] = multiply(at_sample, free[part])
    return free


def _unwrapped(theta: Array) -> Array:
    """Return rotation vectors without jumps of a full turn where their angle passes pi, up to 3.7 rad."""
    out = theta.copy()
    for k in np.flatnonzero(lengths(theta) > 2.5):
        if k > 0 and np.linalg.norm(out[k] - out[k - 1]) > np.pi:
            angle = float(np.linalg.norm(out[k]))
            out[k] *= (angle - 2.0 * np.pi) / angle
    return out


def attitude_from_positions(
    signal: InertialSignal, fit: RateFit, tau: Array, p: Array, accelerometers: AccelerometerFit | None = None
) -> Array:
    """Return q_rb at every IMU sample, (n, 4), where the reference has positions only.

    Parameters
    ----------
    tau, p : (m,), (m, 3)
        Reference seconds and positions.
    accelerometers
        Their fit with an attitude found before; the lever arm matters most.

    Notes
    -----
    Integrated rates give the attitude up to one constant rotation. This rotation turns the predicted accelerations,
    in the frame of the first attitude, into the reference's; gravity is the same in both and is removed with the
    means. The integral drifts with scale errors of the gyros, so every interval of `_SECONDS_OF_A_TURN` has a rotation
    of its own.
    """
    free = integrate_attitude(signal, linear_rate(fit.K_omega, fit.rate_at_zero))
    windows = Windows.over(signal, fit.clock, tau)
    reference = windows.second_difference(p)
    f = signal.accelerations
    if accelerometers is not None:
        omega, alpha = signal.rates @ fit.K_omega.T + fit.rate_at_zero, signal.slopes @ fit.K_omega.T
        arm = accelerometers.lever_arm
        size_effect = np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
        f = (f + accelerometers.k_a0) @ accelerometers.K_a.T - size_effect
    predicted = windows.integrate(apply(free, f))
    part = (windows.t[1] // _SECONDS_OF_A_TURN).astype(int)
    turns: dict[int, Array] = {}
    for number in np.unique(part):
        inside = part == number
        if inside.sum() > _MIN_WINDOWS:
            x, y = reference[inside], predicted[inside]
            turns[int(number)] = from_matrix(nearest_rotation((x - x.mean(axis=0)).T @ (y - y.mean(axis=0))))
    turn = next(iter(turns.values()), np.array([1.0, 0.0, 0.0, 0.0]))
    out = np.empty_like(free)
    of_sample = (signal.stamps // _SECONDS_OF_A_TURN).astype(int)
    for number in range(of_sample[0], of_sample[-1] + 1):
        turn = turns.get(number, turn)
        now = of_sample == number
        out[now] = multiply(turn, free[now])
    return out


def with_attitude(
    chunks: Iterable[InertialSignal],
    fit: RateFit,
    reference: ReferencePoses,
    accelerometers: AccelerometerFit | None,
) -> Iterator[tuple[InertialSignal, Array, Array | None, Array]]:
    """Yield chunks of readings with reference seconds and positions in them, and attitudes at their samples."""
    tau = reference.seconds
    for signal in chunks:
        part = slice(*np.searchsorted(fit.clock.imu_time(tau), signal.stamps[[0, -1]]))
        if part.stop - part.start < _MIN_POSES or not signal.segments:
            continue
        p = None if reference.positions is None else reference.positions[part]
        if reference.quaternions is not None:
            q = reference_attitude(signal, fit, tau[part], reference.quaternions[part])
        else:
            assert p is not None  # noqa: S101 - for the type checker; a reference has one of the two
            q = attitude_from_positions(signal, fit, tau[part], p, accelerometers)
        yield signal, tau[part], p, q


def start_attitudes(preparation: Preparation, samples: Indices) -> Array:
    """Return the attitudes with which navigation starts at samples, (k, 4), where the reference has none."""
    out = np.tile([1.0, 0.0, 0.0, 0.0], (samples.size, 1))
    reference = preparation.reference
    if reference.quaternions is not None:
        return out
    chunks = preparation.readings.chunks()
    for signal, _, _, q in with_attitude(chunks, preparation.rate_fit, reference, preparation.accelerometer_fit):
        inside = (samples >= signal.begin) & (samples < signal.begin + signal.stamps.size)
        out[inside] = q[samples[inside] - signal.begin]
    return out


def alignment_from_gravity(gravity: Array, north: Array | None = None) -> Array:
    """Return q_rn (4,) with n's down along gravity.

    Parameters
    ----------
    gravity : (3,)
        In r.
    north : (3,)
        A direction in r whose level part is north; r's y axis by default, which is north for a robot whose
        x axis points east.
    """
    down = gravity / np.linalg.norm(gravity)
    if north is None:
        north = np.array([0.0, 1.0, 0.0]) if abs(down[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    level = north - (north @ down) * down
    level /= np.linalg.norm(level)
    C = np.column_stack([level, np.cross(down, level), down])
    return from_matrix(C)
