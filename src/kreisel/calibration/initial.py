"""First values for the accelerometers and gravity, by linear least squares before any filter runs.

The second difference of the reference's positions over half a second equals the readings' double
integral with a triangular weight. With the attitude known from gyros and reference together, that is
linear in K_a, K_a k_a0, a common lever arm and gravity.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from kreisel._kernels import quadrature, unit_forces
from kreisel.geometry.rotation import (
    Array,
    Indices,
    Mask,
    apply,
    conjugate,
    exp,
    from_matrix,
    log,
    multiply,
    nearest_rotation,
    running_mean,
)
from kreisel.inertial.strapdown import InertialSignal, integrate_attitude, linear_rate
from kreisel.synchronization import Clock, RateFit

HALF_WINDOW = 0.25
"""Half the length of a second difference, s."""

_BLIND_HALF_WINDOW = 3.0
_BLIND_STRETCH = 25.0
_REST_WEIGHT = 20.0
_NEAR_GAP = 1.0
_LEAST_WINDOWS = 20


@dataclass(frozen=True)
class ForceFit:
    """First values found for the accelerometers.

    Attributes
    ----------
    K_a, k_a0, lever_arm, gravity
        (3, 3), (3,), (3,), (3,); SI, gravity in r.
    motion_slope
        How the reference's accelerations scale with those the IMU felt, gravity taken off: about 1.
    residual_sd
        What is left in a second difference, as an acceleration, m/s^2.
    K_a_sd, k_a0_sd, lever_arm_sd, tilt_sd
        Standard deviations of the fit; that of gravity's direction in rad.
    seen
        What it was fitted to.
    """

    K_a: Array
    k_a0: Array
    lever_arm: Array
    gravity: Array
    motion_slope: float
    residual_sd: float
    K_a_sd: Array
    k_a0_sd: Array
    lever_arm_sd: Array
    tilt_sd: float
    seen: Accelerations


def reference_attitude(signal: InertialSignal, fit: RateFit, tau: Array, q: Array) -> Array:
    """Return q_rb at every IMU sample, (n, 4): integrated rates held to the reference over seconds."""
    b = fit.K_omega @ fit.k_w0
    free = integrate_attitude(signal, linear_rate(fit.K_omega, b, signal.order))
    t = fit.clock.imu_time(tau)
    k = np.clip(np.searchsorted(signal.stamps, t) - 1, 0, signal.stamps.size - 2)
    at_pose = multiply(free[k], exp((signal.rates[k] @ fit.K_omega.T + b) * (t - signal.stamps[k])[:, None]))
    # left error: q = exp(error) * exp(first error) * free, slowly varying
    error = multiply(q, conjugate(at_pose))
    turned = log(multiply(error, conjugate(error[0])))
    width = max(3, round(1.0 / float(np.median(np.diff(tau)))))
    smooth = running_mean(_unwrapped(turned), width)
    at_sample = np.column_stack([np.interp(signal.stamps, t, smooth[:, i]) for i in range(3)])
    return multiply(multiply(exp(at_sample), error[0]), free)


def _unwrapped(theta: Array) -> Array:
    """Keep rotation vectors from jumping by a full turn as their angle passes pi."""
    out = theta.copy()
    for k in np.flatnonzero(np.linalg.norm(theta, axis=1) > 2.5):
        if k > 0 and np.linalg.norm(out[k] - out[k - 1]) > np.pi:
            angle = float(np.linalg.norm(out[k]))
            out[k] *= (angle - 2.0 * np.pi) / angle
    return out


def attitude_from_positions(
    signal: InertialSignal, fit: RateFit, tau: Array, p: Array, force: ForceFit | None = None
) -> Array:
    """Return q_rb at every IMU sample, (n, 4), where the reference shows positions alone.

    Parameters
    ----------
    tau, p : (m,), (m, 3)
        Reference seconds and positions.
    force
        What is known of the accelerometers from an attitude found before; the lever arm matters most.

    Notes
    -----
    Integrated rates give the attitude up to one turn. That turn brings the accelerations felt, seen from
    the first attitude, onto those the positions show; gravity is the same in both and drops out with the
    means. Scale errors of the gyros spoil the integral as it goes on, so every stretch of `_BLIND_STRETCH`
    seconds has a turn of its own.
    """
    b = fit.K_omega @ fit.k_w0
    free = integrate_attitude(signal, linear_rate(fit.K_omega, b, signal.order))
    windows = Windows.over(signal, fit.clock, tau)
    shown = windows.second_difference(p)
    f = signal.accelerations
    if force is not None:
        omega, alpha = signal.rates @ fit.K_omega.T + b, signal.slopes @ fit.K_omega.T
        arm = np.cross(alpha, force.lever_arm) + np.cross(omega, np.cross(omega, force.lever_arm))
        f = (f + force.k_a0) @ force.K_a.T - arm
    felt = windows.integrate(apply(free, f))
    stretch = (windows.t[1] // _BLIND_STRETCH).astype(int)
    turns: dict[int, Array] = {}
    for number in np.unique(stretch):
        inside = stretch == number
        if inside.sum() > _LEAST_WINDOWS:
            x, y = shown[inside], felt[inside]
            turns[int(number)] = from_matrix(nearest_rotation((x - x.mean(axis=0)).T @ (y - y.mean(axis=0))))
    turn = next(iter(turns.values()), np.array([1.0, 0.0, 0.0, 0.0]))
    out = np.empty_like(free)
    of_sample = (signal.stamps // _BLIND_STRETCH).astype(int)
    for number in range(of_sample[0], of_sample[-1] + 1):
        turn = turns.get(number, turn)
        part = of_sample == number
        out[part] = multiply(turn, free[part])
    return out


@dataclass(frozen=True)
class Accelerations:
    """Accelerations of one body, from readings and from the reference, over the same windows.

    Attributes
    ----------
    felt : (windows, 3, 15)
        What a unit of each parameter makes felt: see `_kernels.unit_forces`.
    shown : (windows, 3)
        By the positions; zero where there are none.
    still : (rests, 3, 15)
        Means over rests, of the same columns.
    """

    felt: Array
    shown: Array
    still: Array

    @classmethod
    def over(
        cls,
        signal: InertialSignal,
        fit: RateFit,
        tau: Array,
        q: Array,
        p: Array | None,
        rests: Sequence[tuple[float, float]],
    ) -> Accelerations:
        """Return them for a stretch of readings.

        Parameters
        ----------
        tau, p : (m,), (m, 3) or None
            Reference seconds and positions.
        q : (n, 4)
            Attitude q_rb at every sample.
        rests
            First and last IMU second of every rest.
        """
        windows = Windows.over(signal, fit.clock, tau, HALF_WINDOW if p is not None else _BLIND_HALF_WINDOW)
        omega = np.ascontiguousarray(signal.rates @ fit.K_omega.T + fit.K_omega @ fit.k_w0)
        alpha = np.ascontiguousarray(signal.slopes @ fit.K_omega.T)
        sampled = (q, np.ascontiguousarray(signal.accelerations), omega, alpha)
        means = windows.means(
            3 * unit_forces.PARAMETERS, lambda *at: unit_forces.double_integrals(signal.stamps, *sampled, *at)
        )
        shown = np.zeros((len(means), 3)) if p is None else windows.second_difference(p)
        inside = [rest for rest in rests if rest[0] >= signal.stamps[0] and rest[1] <= signal.stamps[-1]]
        still = [_mean_felt(signal.stamps, sampled, *rest) for rest in inside] if p is None else []
        shape = (-1, 3, unit_forces.PARAMETERS)
        return cls(means.reshape(shape), shown, np.array(still).reshape(shape))

    @classmethod
    def joined(cls, parts: Sequence[Accelerations]) -> Accelerations:
        """Return those of several stretches as one."""
        felt, shown, still = zip(*((part.felt, part.shown, part.still) for part in parts), strict=True)
        return cls(np.concatenate(felt), np.concatenate(shown), np.concatenate(still))


def fit_forces(seen: Accelerations, fit: RateFit, gravity: float, *, blind: bool) -> ForceFit:
    """Return first values of accelerometers and gravity.

    Parameters
    ----------
    gravity
        Its magnitude, m/s^2.
    blind
        Whether the reference shows no positions: only rests, and that nothing runs away in seconds, are known.
    """
    A = np.concatenate([seen.felt, np.broadcast_to(np.eye(3), (len(seen.felt), 3, 3))], axis=2)
    target = seen.shown
    R = nearest_rotation(fit.K_omega)
    felt = A[:, :, :9] @ R.ravel()
    g = target.mean(axis=0) - felt.mean(axis=0)
    g *= gravity / np.linalg.norm(g)
    slope = 1.0
    if blind:
        at_rest = np.concatenate([seen.still, np.broadcast_to(np.eye(3), (len(seen.still), 3, 3))], axis=2)
        A = np.concatenate([A, _REST_WEIGHT * at_rest])
        target = np.zeros(A.shape[:2])
    else:
        moved, expected = target - target.mean(axis=0), felt - felt.mean(axis=0)
        slope = float(np.sum(moved * expected) / max(np.sum(expected**2), 1e-12))
    solution, deviation, residual = _solve(A, target, R, g, gravity)
    K = solution[:9].reshape(3, 3)
    return ForceFit(
        K_a=K,
        k_a0=np.asarray(np.linalg.solve(K, solution[9:12]), dtype=float),
        lever_arm=solution[12:15],
        gravity=solution[15:18],
        motion_slope=slope,
        residual_sd=residual,
        K_a_sd=deviation[:9].reshape(3, 3),
        k_a0_sd=deviation[9:12],
        lever_arm_sd=deviation[12:15],
        tilt_sd=float(np.max(deviation[15:18])) / gravity,
        seen=seen,
    )


def _mean_felt(stamps: Array, sampled: tuple[Array, ...], start: float, stop: float) -> Array:
    """Return the mean of what is felt over a stretch, (45,)."""
    q, readings, omega, alpha = sampled
    part = range(*np.searchsorted(stamps, (start, stop)))
    out, total = np.empty(3 * unit_forces.PARAMETERS), np.zeros(3 * unit_forces.PARAMETERS)
    for k in part:
        unit_forces.at_sample(q[k], readings[k], omega[k], alpha[k], out)
        total += out
    return total / max(len(part), 1)


def _solve(A: Array, target: Array, R: Array, g: Array, gravity: float) -> tuple[Array, Array, float]:
    """Solve with weak priors (axes near the gyros', offsets and lever arms near nothing), robustly."""
    prior = np.concatenate([R.ravel(), np.zeros(6), g])
    x = prior.copy()
    normal = np.eye(18)
    weight = np.ones(target.shape[0])
    variance = 0.1
    for _ in range(8):
        along = x[15:18] / np.linalg.norm(x[15:18])
        prior[15:18] = gravity * along
        precision = np.diag(np.concatenate([np.full(9, 0.2**-2), np.full(3, 1.0), np.full(3, 0.3**-2), np.zeros(3)]))
        precision[15:18, 15:18] += np.outer(along, along) / 1e-4**2 + np.eye(3) / (0.5 * gravity) ** 2
        W = weight[:, None, None] * A
        # windows overlap by half or more and share their noise
        normal = np.einsum("nij,nik->jk", W, A) / (2.0 * variance) + precision
        right = np.einsum("nij,ni->j", W, target) / (2.0 * variance) + precision @ prior
        x = np.linalg.solve(normal, right)
        left = np.linalg.norm(target - A @ x, axis=1)
        variance = max((float(np.median(left)) / 1.538) ** 2, 1e-10)
        weight = 1.0 / (1.0 + left**2 / (16.0 * variance))
    return x, np.sqrt(np.diag(np.linalg.inv(normal))), float(np.sqrt(variance))


@dataclass(frozen=True)
class Windows:
    """Second differences at evenly spread poses, divided by their half length (IMU seconds) squared."""

    stamps: Array
    t: tuple[Array, Array, Array]
    tau: tuple[Array, Array, Array]
    reference: Array
    half: float

    @classmethod
    def over(cls, signal: InertialSignal, clock: Clock, tau: Array, shortest: float = HALF_WINDOW) -> Windows:
        """Choose windows that lie inside both recordings."""
        half = max(shortest, 3.0 * float(np.median(np.diff(tau))))
        low = max(tau[0] + half, float(clock.reference_time(signal.stamps[1])) + half)
        high = min(tau[-1] - half, float(clock.reference_time(signal.stamps[-2])) - half)
        middle = np.arange(low, high, 0.4 * half)
        middle = middle[_without_gaps(signal, clock, tau, middle, half)]
        at = (middle - half, middle, middle + half)
        t = tuple(clock.imu_time(s) for s in at)
        return cls(signal.stamps, t, at, tau, half * (1.0 + clock.skew))  # type: ignore[arg-type]

    def second_difference(self, p: Array) -> Array:
        """Second difference of positions, smoothed over the poses near each end, (windows, 3)."""
        width = max(1, round(0.1 / float(np.median(np.diff(self.reference)))))
        smooth = running_mean(p, width) if width > 2 else p
        a, b, c = (np.column_stack([np.interp(s, self.reference, smooth[:, i]) for i in range(3)]) for s in self.tau)
        return np.asarray((a - 2.0 * b + c) / self.half**2)

    def integrate(self, values: Array) -> Array:
        """Triangularly weighted mean of sampled vectors (n, 3), (windows, 3)."""
        values = np.ascontiguousarray(values)
        return self.means(3, lambda *at: quadrature.double_integral(self.stamps, values, *at))

    def means(self, columns: int, integrate: Callable[[Indices, Array, Array], None]) -> Array:
        """Return triangularly weighted means, (windows, columns), of what is integrated twice.

        Parameters
        ----------
        integrate
            Write the double integral (m, columns) to moments: see `_kernels.quadrature.double_integral`.
        """
        moments = np.concatenate(self.t)
        order = np.argsort(moments, kind="stable")
        moments = moments[order]
        before = np.clip(np.searchsorted(self.stamps, moments, side="right") - 1, 0, self.stamps.size - 2)
        share = (moments - self.stamps[before]) / (self.stamps[before + 1] - self.stamps[before])
        ordered, integral = np.empty((moments.size, columns)), np.empty((moments.size, columns))
        integrate(before, share, ordered)
        integral[order] = ordered
        a, b, c = np.split(integral, 3)
        return np.asarray((a - 2.0 * b + c) / self.half**2)


def _without_gaps(signal: InertialSignal, clock: Clock, tau: Array, middle: Array, half: float) -> Mask:
    """Return which windows have samples all through, at some distance from gaps, and poses near their ends.

    The attitude is smoothed over a second, so that near a gap it is not known well.
    """
    starts, stops = (signal.stamps[np.array(ends)] for ends in zip(*signal.segments, strict=True))
    starts[1:] += _NEAR_GAP
    stops[:-1] -= _NEAR_GAP
    first, last = clock.imu_time(middle - half), clock.imu_time(middle + half)
    segment = np.clip(np.searchsorted(starts, first, side="right") - 1, 0, starts.size - 1)
    known = (first >= starts[segment]) & (last <= stops[segment])
    steps = np.diff(tau)
    for at in (middle - half, middle, middle + half):
        k = np.clip(np.searchsorted(tau, at) - 1, 0, steps.size - 1)
        known &= steps[k] < 6.0 * float(np.median(steps))
    return np.asarray(known)


def alignment_from_gravity(gravity: Array, north: Array | None = None) -> Array:
    """Return q_rn (4,) with n's down along gravity.

    Parameters
    ----------
    gravity : (3,)
        In r.
    north : (3,)
        A direction in r whose level part is north; r's y axis by default, which is that of a robot whose
        x axis faces east.
    """
    down = gravity / np.linalg.norm(gravity)
    if north is None:
        north = np.array([0.0, 1.0, 0.0]) if abs(down[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    level = north - (north @ down) * down
    level /= np.linalg.norm(level)
    C = np.column_stack([level, np.cross(down, level), down])
    return from_matrix(C)
