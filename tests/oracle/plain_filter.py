"""A sigma-point Kalman filter for motion and sensor parameters, written from the book and for reading.

R. van der Merwe (2004), "Sigma-Point Kalman Filters for Probabilistic Inference in Dynamic State-Space
Models": central-difference and unscented filters with additive noise, in covariance form. The state lives
on a manifold: attitudes take errors from the right, q = q_mean * exp(error), all else by addition.
A state is a mapping from name to array; a leading axis, where there is one, counts the sigma points.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import quaternions as quat
from .quaternions import Array
from .strapdown import Trajectory, central_differences, five_point_differences, two_sample

State = dict[str, Array]
Pose = tuple[float, Array, Array]
Order = NDArray[np.intp]

SHAPES: dict[str, tuple[int, ...]] = {
    "q_rb": (4,),
    "v": (3,),
    "p": (3,),
    "q_rn": (4,),
    "K_omega": (3, 3),
    "k_w0": (3,),
    "K_a": (3, 3),
    "k_a0": (3,),
    "lever_arms": (3, 3),
    "time_offset": (),
}
ATTITUDES = ("q_rb", "q_rn")
LAYOUT = {
    "q_rb": slice(0, 3),
    "v": slice(3, 6),
    "p": slice(6, 9),
    "q_rn": slice(9, 12),
    "K_omega": slice(12, 21),
    "k_w0": slice(21, 24),
    "K_a": slice(24, 33),
    "k_a0": slice(33, 36),
    "lever_arms": slice(36, 45),
    "time_offset": slice(45, 46),
}
SIZE = 46
NAVIGATION = slice(0, 9)
MARGIN = 3
"""Samples beside a window: the rate of f needs alpha one sample on, and that two samples more."""
ALPHA_RULES = {3: central_differences, 5: five_point_differences}


class Weights(NamedTuple):
    """Spread of the sigma points, weights of the mean, and those of the covariance in one of two forms.

    The covariance is summed over deviations from the mean, or, where `deviations` is None, over first and
    second central differences.
    """

    spread: float
    mean: Array
    first: float = 0.0
    second: float = 0.0
    deviations: Array | None = None


class Imu(NamedTuple):
    """Raw readings: stamps (n,), rates (n, 3), accelerations (n, 3)."""

    stamps: Array
    rates: Array
    accels: Array


class World(NamedTuple):
    """What is taken as known about the place: g (m/s^2) and the Earth's rate in n (rad/s)."""

    gravity_magnitude: float
    earth_rate_n: Array


# ---- the manifold ----


def plus(mean: Mapping[str, Array], error: Array) -> State:
    """Return the state displaced by errors (..., 46)."""
    state: State = {}
    for name, part in LAYOUT.items():
        e = error[..., part]
        if name in ATTITUDES:
            state[name] = quat.multiply(mean[name], quat.exp(e))
        else:
            state[name] = mean[name] + e.reshape((*error.shape[:-1], *SHAPES[name]))
    return state


def minus(state: Mapping[str, Array], mean: Mapping[str, Array]) -> Array:
    """Return the errors (..., 46) that displace the mean to the state."""
    parts = []
    for name in LAYOUT:
        if name in ATTITUDES:
            parts.append(quat.log(quat.multiply(quat.conjugate(mean[name]), state[name])))
        else:
            difference = state[name] - mean[name]
            leading = difference.shape[: difference.ndim - len(SHAPES[name])]
            parts.append(difference.reshape((*leading, -1)))
    return np.concatenate(parts, axis=-1)


def mean_state(points: State, weights: Array) -> State:
    """Return the weighted mean, found by iteration from the central point."""
    mean = {name: x[0] for name, x in points.items()}
    for _ in range(20):
        step = weights @ minus(points, mean)
        mean = plus(mean, step)
        # Attitudes alone need more than one round, and theirs are of the order of a radian.
        if np.max(np.abs(step[np.r_[LAYOUT["q_rb"], LAYOUT["q_rn"]]])) < 1e-15:
            break
    return mean


def mean_attitude(q: Array, weights: Array) -> Array:
    """Return the weighted mean of quaternions (m, 4), found by iteration from the first."""
    mean = q[0]
    for _ in range(20):
        step = weights @ quat.log(quat.multiply(quat.conjugate(mean), q))
        mean = quat.multiply(mean, quat.exp(step))
        if np.max(np.abs(step)) < 1e-15:
            break
    return mean


# ---- sigma points ----


def choose_weights(name: str, size: int = SIZE) -> Weights:
    """Return the weights called "central" (h = sqrt 3) or "unscented" (alpha 1, beta 2, kappa 0)."""
    if name == "central":
        h2 = 3.0
        mean = np.r_[(h2 - size) / h2, np.full(2 * size, 1.0 / (2.0 * h2))]
        return Weights(np.sqrt(h2), mean, first=1.0 / (4.0 * h2), second=(h2 - 1.0) / (4.0 * h2**2))
    if name == "unscented":
        alpha, beta, kappa = 1.0, 2.0, 0.0
        lambda_ = alpha**2 * (size + kappa) - size
        mean = np.r_[lambda_ / (size + lambda_), np.full(2 * size, 0.5 / (size + lambda_))]
        deviations = mean + np.r_[1.0 - alpha**2 + beta, np.zeros(2 * size)]
        return Weights(np.sqrt(size + lambda_), mean, deviations=deviations)
    raise ValueError(f"Unknown weights: expected 'central' or 'unscented', got {name!r}.")


def square_root(P: Array, order: Order | None = None) -> Array:
    """Return L with L L^T = P, lower triangular once its rows are put in the given order of states."""
    rows = np.arange(len(P)) if order is None else order
    # States known exactly have no column.
    kept = rows[np.diag(P)[rows] > 0.0]
    L = np.zeros_like(P)
    L[np.ix_(kept, kept)] = np.linalg.cholesky(P[np.ix_(kept, kept)])
    return L


def draw(mean: State, P: Array, weights: Weights, order: Order | None) -> State:
    """Return the 2 * 46 + 1 sigma points: the mean, the positive ones, the negative ones."""
    columns = weights.spread * square_root(P, order).T
    return plus(mean, np.concatenate([np.zeros((1, SIZE)), columns, -columns]))


def covariance(x: Array, y: Array, weights: Weights) -> Array:
    """Return the covariance of deviations x (m, a) and y (m, b) of the sigma points from their means."""
    if weights.deviations is not None:
        return (weights.deviations[:, None] * x).T @ y
    (first_x, second_x), (first_y, second_y) = _differences(x), _differences(y)
    return weights.first * first_x.T @ first_y + weights.second * second_x.T @ second_y


def _differences(x: Array) -> tuple[Array, Array]:
    half = len(x) // 2
    positive, negative = x[1 : half + 1], x[half + 1 :]
    return positive - negative, positive + negative - 2.0 * x[0]


# ---- sensor model and propagation ----


class Corrected(NamedTuple):
    """Corrected samples of a window, each (m, n, 3); m counts the sigma points."""

    stamps: Array
    omega: Array
    alpha: Array
    f: Array
    f_rate: Array


def correct(points: State, imu: Imu, start: int, stop: int, alpha_points: int = 3) -> Corrected:
    """Return the corrected samples from start to stop, both included, of every sigma point.

    Notes
    -----
    In e the error of alpha counts in full, not times dt^2 as in the strapdown: central differences of
    three samples leave r dt^2 / 6 of the rate's third derivative in f, of five r dt^4 / 30 of its fifth.
    """
    first, last = max(start - MARGIN, 0), min(stop + MARGIN, len(imu.stamps) - 1)
    stamps = imu.stamps[first : last + 1]
    rates, accels = imu.rates[first : last + 1], imu.accels[first : last + 1]
    # (1)
    omega = (rates + points["k_w0"][:, None]) @ np.swapaxes(points["K_omega"], 1, 2)
    alpha = ALPHA_RULES[alpha_points](stamps, omega)
    # (2)
    e = _size_effect(omega, alpha, points["K_a"], points["lever_arms"])
    f = (accels + points["k_a0"][:, None] - e) @ np.swapaxes(points["K_a"], 1, 2)
    f_rate = central_differences(stamps, f)
    inside = slice(start - first, stop - first + 1)
    return Corrected(stamps[inside], *(x[:, inside] for x in (omega, alpha, f, f_rate)))


def _size_effect(omega: Array, alpha: Array, K_a: Array, lever_arms: Array) -> Array:
    S = np.linalg.inv(K_a)
    B = quat.skew(alpha) + quat.skew(omega) @ quat.skew(omega)
    return np.asarray(np.einsum("mjx,mnxy,mjy->mnj", S, B, lever_arms))


def gravity_and_earth_rate(points: State, world: World) -> tuple[Array, Array]:
    """Return g_r and omega_ie_r of every sigma point, (m, 3)."""
    g_r = quat.rotate(points["q_rn"], np.array([0.0, 0.0, world.gravity_magnitude]))
    return g_r, quat.rotate(points["q_rn"], world.earth_rate_n)


def propagate(points: State, samples: Corrected, world: World) -> tuple[State, Trajectory]:
    """Return the sigma points at the window's end, and their trajectories through it."""
    g_r, earth_rate_r = gravity_and_earth_rate(points, world)
    path = two_sample(
        samples.stamps,
        samples.omega,
        samples.f,
        points["q_rb"],
        points["v"],
        points["p"],
        g_r,
        earth_rate_r,
        samples.alpha,
        samples.f_rate,
    )
    end = {"q_rb": path.q[:, -1], "v": path.v[:, -1], "p": path.p[:, -1]}
    return points | end, path


def process_noise(
    samples: Corrected, path: Trajectory, mean: State, world: World, gyro_density: float, accel_density: float
) -> Array:
    """Return the (46, 46) covariance that white noise of the readings adds over the window.

    Notes
    -----
    Along the path of the central sigma point; noise of the readings reaches b through K_omega and K_a.
    """
    earth_rate_r = quat.rotate(mean["q_rn"], world.earth_rate_n)
    noise_w = gyro_density**2 * mean["K_omega"] @ mean["K_omega"].T
    noise_a = accel_density**2 * mean["K_a"] @ mean["K_a"].T
    C = quat.matrix(path.q[0])
    P = np.zeros((9, 9))
    for k, h in enumerate(np.diff(samples.stamps)):
        omega, f = (0.5 * (x[0, k] + x[0, k + 1]) for x in (samples.omega, samples.f))
        whole, half = (_transition(part, omega, C[k] @ f, C[k], earth_rate_r) for part in (h, h / 2.0))
        N = np.zeros((9, 9))
        N[0:3, 0:3] = h * noise_w
        N[3:6, 3:6] = h * C[k] @ noise_a @ C[k].T
        # Noise of a step enters in its middle, on average.
        P = whole @ P @ whole.T + half @ N @ half.T
    Q = np.zeros((SIZE, SIZE))
    Q[NAVIGATION, NAVIGATION] = P
    return Q


def _transition(h: float, omega_ib_b: Array, f_r: Array, C_rb: Array, earth_rate_r: Array) -> Array:
    """Return the transition over h of the errors theta (from the right), dv, dp.

    Notes
    -----
    d(theta)/dt = -omega_ib_b x theta, the Earth's rate being seen through the same wrong attitude;
    d(dv)/dt = -[f_r x] C_rb theta - 2 omega_ie_r x dv;  d(dp)/dt = dv.
    """
    Phi = np.eye(9)
    Phi[0:3, 0:3] = quat.matrix(quat.exp(-h * omega_ib_b))
    Phi[3:6, 0:3] = -h * quat.skew(f_r) @ C_rb
    Phi[3:6, 3:6] -= 2.0 * h * quat.skew(earth_rate_r)
    Phi[6:9, 0:3] = 0.5 * h * Phi[3:6, 0:3]
    Phi[6:9, 3:6] = h * np.eye(3)
    return Phi


# ---- update ----


def predict_pose(points: State, samples: Corrected, tau: float, world: World) -> tuple[Array, Array]:
    """Return position and attitude of every sigma point at reference time tau; samples end at the epoch."""
    omega, alpha, f = samples.omega[:, -1], samples.alpha[:, -1], samples.f[:, -1]
    g_r, earth_rate_r = gravity_and_earth_rate(points, world)
    dt = (tau + points["time_offset"] - samples.stamps[-1])[:, None]
    acceleration = quat.rotate(points["q_rb"], f) + g_r - 2.0 * np.cross(earth_rate_r, points["v"])
    omega_rb_b = omega - quat.rotate_back(points["q_rb"], earth_rate_r)
    position = points["p"] + points["v"] * dt + 0.5 * acceleration * dt**2
    turn = quat.exp(omega_rb_b * dt + 0.5 * alpha * dt**2)
    return position, quat.multiply(points["q_rb"], turn)


def update(
    mean: State,
    P: Array,
    points: State,
    predicted: tuple[Array, Array],
    pose: Pose,
    R: Array,
    weights: Weights,
) -> tuple[State, Array, Array, Array]:
    """Return mean and covariance after a pose, the innovation and its covariance.

    Notes
    -----
    The innovation is a difference of positions in r and the rotation vector log(q_predicted^-1 q_pose).
    P stays in the tangent space of the mean before the step: no reset of the right perturbation.
    """
    positions, attitudes = predicted
    position, attitude = weights.mean @ positions, mean_attitude(attitudes, weights.mean)
    y = np.concatenate([positions - position, quat.log(quat.multiply(quat.conjugate(attitude), attitudes))], axis=-1)
    turn = quat.log(quat.multiply(quat.conjugate(attitude), np.asarray(pose[2], dtype=float)))
    innovation = np.concatenate([pose[1] - position, turn])
    S = covariance(y, y, weights) + R
    gain = np.linalg.solve(S, covariance(minus(points, mean), y, weights).T).T
    P = P - gain @ S @ gain.T
    return plus(mean, gain @ innovation), 0.5 * (P + P.T), innovation, S


def run(
    stamps: Array,
    rates: Array,
    accels: Array,
    poses: Sequence[Pose],
    sample_index: Sequence[int],
    initial: Mapping[str, Array],
    P0: Array,
    gyro_noise_density: float,
    accel_noise_density: float,
    position_sd: float,
    orientation_sd: float,
    gravity_magnitude: float,
    earth_rate_n: Array,
    start_index: int = 0,
    weights: str = "central",
    drawing_order: Order | None = None,
    alpha_points: int = 3,
) -> dict[str, Any]:
    """Return mean, covariance, NIS of every pose and the history, after all poses.

    Parameters
    ----------
    stamps, rates, accels
        (n,), (n, 3), (n, 3): IMU clock (s) and raw readings (rad/s, m/s^2).
    poses
        (tau on the reference clock in s, position in r (3,), q_rb (4,)), in order of time.
    sample_index
        For every pose the IMU sample at which the state stands when the pose is used; not decreasing.
    initial, P0
        Mean by the names of `SHAPES` and covariance (46, 46) in the order of `LAYOUT`, at start_index.
    gyro_noise_density, accel_noise_density
        White noise of the raw readings: standard deviation of a sample times sqrt(dt).
    position_sd, orientation_sd
        Of a pose, per axis: m in r; rad, error rotation from the right.
    gravity_magnitude, earth_rate_n
        g (m/s^2) and the Earth's rate in n (rad/s), (3,).
    weights
        "central" or "unscented".
    drawing_order
        Permutation of the 46 errors in which the Cholesky factor is lower triangular; as in `LAYOUT` if
        not given. Another order gives another square root, as good: results differ beyond second order.
    alpha_points
        Samples in the differences that give alpha: 3 or 5.

    Returns
    -------
    dict
        mean (names of `SHAPES`), P (46, 46), nis (list), history (a list of dicts with index, mean, P,
        innovation (6,) and S (6, 6) after every pose).
    """
    imu, world = Imu(stamps, rates, accels), World(gravity_magnitude, np.asarray(earth_rate_n, dtype=float))
    chosen = choose_weights(weights)
    R = np.diag(np.repeat([position_sd**2, orientation_sd**2], 3))
    mean = {name: np.asarray(initial[name], dtype=float) for name in SHAPES}
    P, start = np.asarray(P0, dtype=float), start_index
    nis: list[float] = []
    history: list[dict[str, Any]] = []
    for pose, stop in zip(poses, sample_index, strict=True):
        points = draw(mean, P, chosen, drawing_order)
        samples = correct(points, imu, start, stop, alpha_points)
        points, path = propagate(points, samples, world)
        Q = process_noise(samples, path, mean, world, gyro_noise_density, accel_noise_density)
        mean = mean_state(points, chosen.mean)
        deviations = minus(points, mean)
        P = covariance(deviations, deviations, chosen) + Q
        points = draw(mean, P, chosen, drawing_order)
        samples = correct(points, imu, stop, stop, alpha_points)
        predicted = predict_pose(points, samples, pose[0], world)
        mean, P, innovation, S = update(mean, P, points, predicted, pose, R, chosen)
        nis.append(float(innovation @ np.linalg.solve(S, innovation)))
        history.append({"index": stop, "mean": mean, "P": P, "innovation": innovation, "S": S})
        start = stop
    return {"mean": mean, "P": P, "nis": nis, "history": history}
