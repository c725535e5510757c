"""The oracles are checked against each other, SciPy and closed expressions; nothing of kreisel is used."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from ..oracle import plain_filter
from ..oracle import quaternions as quat
from ..oracle.motion import AnalyticMotion, inertial_functions, inertial_truth, raw_readings
from ..oracle.quaternions import Array
from ..oracle.strapdown import Trajectory, five_point_differences, integrate, two_sample

GRAVITY_R = np.array([0.05, -0.1, 9.81])
EARTH_RATE = 7.292115e-5
EARTH_RATE_R = EARTH_RATE * np.array([0.6, 0.2, -0.77])
LATITUDE = np.radians(49.0)
EARTH_RATE_N = EARTH_RATE * np.array([np.cos(LATITUDE), 0.0, -np.sin(LATITUDE)])
START = np.zeros(1)


def start_of(motion: AnalyticMotion) -> tuple[Array, Array, Array]:
    return motion.attitude(START)[0], motion.velocity(START)[0], motion.position(START)[0]


def worst_errors(motion: AnalyticMotion, t: Array, path: Trajectory) -> Array:
    """Return the largest error of attitude (rad), velocity (m/s) and position (m)."""
    turn = quat.log(quat.multiply(quat.conjugate(motion.attitude(t)), path.q))
    errors = turn, path.v - motion.velocity(t), path.p - motion.position(t)
    return np.array([np.max(np.linalg.norm(e, axis=-1)) for e in errors])


# ---- quaternions ----


def test_quaternions_agree_with_scipy() -> None:
    rng = np.random.default_rng(1)
    q, u = quat.normalized(rng.standard_normal((2, 100, 4))), rng.standard_normal((100, 3))
    first, second = (Rotation.from_quat(x, scalar_first=True) for x in q)
    np.testing.assert_allclose(quat.matrix(q[0]), first.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(quat.rotate(q[0], u), first.apply(u), atol=1e-14)
    np.testing.assert_allclose(quat.rotate_back(q[0], u), first.inv().apply(u), atol=1e-14)
    np.testing.assert_allclose(quat.matrix(quat.multiply(*q)), (first * second).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(quat.log(q[0]), first.as_rotvec(), atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-160, 1e-12, 1e-6, 1.0, 3.14])
def test_log_inverts_exp(angle: float) -> None:
    phi = angle * np.array([0.48, -0.6, 0.64])
    np.testing.assert_allclose(quat.log(quat.exp(phi)), phi, rtol=1e-13)
    np.testing.assert_allclose(quat.log(-quat.exp(phi)), phi, rtol=1e-13)


# ---- motion ----


def derivative(function: Callable[[Array], Array], t: Array) -> Array:
    """Return the derivative by central differences of eighth order.

    Notes
    -----
    With frequencies up to some 15 rad/s the truncation is h^8 15^9 / 630, 4e-13, beside rounding of 1e-13.
    """
    h = 3e-3
    weights = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
    return sum(w * (function(t + k * h) - function(t - k * h)) / h for k, w in enumerate(weights, start=1))


@pytest.mark.parametrize("rest", [0.0, 3.0])
def test_motion_derivatives(rest: float) -> None:
    motion = AnalyticMotion(np.random.default_rng(5), rest=rest)
    t = np.random.default_rng(6).uniform(0.0, motion.duration, 500)
    np.testing.assert_allclose(derivative(motion.position, t), motion.velocity(t), atol=1e-10)
    np.testing.assert_allclose(derivative(motion.velocity, t), motion.acceleration(t), atol=1e-10)
    turned = 2.0 * quat.multiply(quat.conjugate(motion.attitude(t)), derivative(motion.attitude, t))
    np.testing.assert_allclose(turned[:, 0], 0.0, atol=1e-10)
    np.testing.assert_allclose(turned[:, 1:], motion.rate(t), atol=1e-10)
    np.testing.assert_allclose(derivative(motion.rate, t), motion.angular_acceleration(t), atol=1e-10)


def test_motion_reaches_its_peaks_and_rests() -> None:
    motion = AnalyticMotion(np.random.default_rng(7), peak_rate=2.0, peak_acceleration=4.0, rest=3.0)
    t = np.linspace(0.0, motion.duration, 60_001)
    # The peaks were searched every 5 ms: between, a parabola may rise by (15 rad/s * 2.5 ms)^2 / 2.
    assert np.max(np.linalg.norm(motion.rate(t), axis=1)) == pytest.approx(2.0, rel=7e-4)
    assert np.max(np.linalg.norm(motion.acceleration(t), axis=1)) == pytest.approx(4.0, rel=7e-4)
    still = (t <= 3.0) | (t >= motion.duration - 3.0)
    for of_motion in (motion.velocity, motion.acceleration, motion.rate, motion.angular_acceleration):
        assert np.all(of_motion(t[still]) == 0.0)


def test_inertial_truth_at_rest() -> None:
    motion = AnalyticMotion(np.random.default_rng(8), rest=3.0)
    omega, alpha, f = inertial_truth(motion, START, GRAVITY_R, EARTH_RATE_R)
    C_rb = Rotation.from_quat(motion.attitude(START), scalar_first=True)
    np.testing.assert_allclose(f, C_rb.inv().apply(-GRAVITY_R), rtol=1e-13)
    np.testing.assert_allclose(omega, C_rb.inv().apply(EARTH_RATE_R), rtol=1e-13)
    np.testing.assert_array_equal(alpha, 0.0)


def test_inertial_angular_acceleration() -> None:
    motion = AnalyticMotion(np.random.default_rng(9))
    t = np.linspace(1.0, 59.0, 500)

    def omega(at: Array) -> Array:
        return inertial_truth(motion, at, GRAVITY_R, EARTH_RATE_R)[0]

    alpha = inertial_truth(motion, t, GRAVITY_R, EARTH_RATE_R)[1]
    np.testing.assert_allclose(derivative(omega, t), alpha, atol=1e-10)


def test_raw_readings_invert_the_sensor_model() -> None:
    rng = np.random.default_rng(10)
    omega, alpha, f = rng.uniform(-3.0, 3.0, (3, 200, 3))
    parameters = {
        "K_omega": np.eye(3) + 0.2 * rng.standard_normal((3, 3)),
        "K_a": np.eye(3) + 0.2 * rng.standard_normal((3, 3)),
        "k_w": 1e-3 * rng.standard_normal((3, 3)),
        "k_a": 1e-3 * rng.standard_normal((2, 3)),
        "lever_arms": 0.1 * rng.standard_normal((3, 3)),
    }
    w_raw, a_raw = raw_readings(omega, alpha, f, parameters)
    k_w, k_a = parameters["k_w"], parameters["k_a"]
    omega_again = (w_raw + k_w[0] + k_w[1] * w_raw**2 + k_w[2] * w_raw**3) @ parameters["K_omega"].T
    np.testing.assert_allclose(omega_again, omega, atol=1e-14)
    for n in range(20):
        # The specific force where accelerometer j sits, by its definition, seen along its axis.
        W = quat.skew(omega[n])
        there = [f[n] + (quat.skew(alpha[n]) + W @ W) @ r for r in parameters["lever_arms"]]
        sensed = np.sum(np.linalg.inv(parameters["K_a"]) * there, axis=1)
        np.testing.assert_allclose(a_raw[n] + k_a[0] + k_a[1] * a_raw[n] ** 2, sensed, atol=1e-13)


def test_raw_readings_refuse_other_forms() -> None:
    with pytest.raises(ValueError, match="fox2005"):
        raw_readings(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)), {}, form="fox2005")


# ---- strapdown ----


@pytest.fixture(scope="module")
def integrated() -> tuple[AnalyticMotion, Array, Trajectory]:
    motion = AnalyticMotion(np.random.default_rng(3), duration=10.0)
    times = np.linspace(0.0, 10.0, 41)
    functions = inertial_functions(motion, GRAVITY_R, EARTH_RATE_R)
    path = integrate(*functions, *start_of(motion), times, GRAVITY_R, EARTH_RATE_R)
    return motion, times, path


@pytest.mark.slow
def test_integration_closes_on_the_motion(integrated: tuple[AnalyticMotion, Array, Trajectory]) -> None:
    assert np.all(worst_errors(*integrated) < [1e-11, 1e-10, 1e-9])


def sampled(motion: AnalyticMotion, rate_hz: float) -> tuple[Array, Trajectory]:
    t = np.arange(round(motion.duration * rate_hz) + 1) / rate_hz
    omega, _, f = inertial_truth(motion, t, GRAVITY_R, EARTH_RATE_R)
    return t, two_sample(t, omega, f, *start_of(motion), GRAVITY_R, EARTH_RATE_R)


@pytest.mark.slow
def test_two_sample_at_400_hz_against_integration(
    integrated: tuple[AnalyticMotion, Array, Trajectory],
) -> None:
    motion, times, exact = integrated
    t, path = sampled(motion, 400.0)
    np.testing.assert_allclose(t[::100], times, atol=1e-12)
    turn = quat.log(quat.multiply(quat.conjugate(exact.q), path.q[::100]))
    # Differences instead of alpha leave dt^4 / 72 of the rate's third derivative, 3.3 rad/s at some 8 rad/s:
    # 1e-9 rad; what coning leaves out is some four times that. Gravity through this attitude over 10 s gives
    # 4e-7 m/s and 2e-6 m.
    assert np.max(np.abs(turn)) < 1e-8
    assert np.max(np.abs(path.v[::100] - exact.v)) < 1e-6
    assert np.max(np.abs(path.p[::100] - exact.p)) < 5e-6


@pytest.mark.parametrize("seed", [0, 1])
def test_two_sample_is_of_fourth_order(seed: int) -> None:
    motion = AnalyticMotion(np.random.default_rng(seed), duration=10.0)
    coarse, fine = (worst_errors(motion, *sampled(motion, rate)) for rate in (200.0, 400.0))
    np.testing.assert_allclose(coarse / fine, 16.0, rtol=0.05)


def test_two_sample_batch_is_each_alone() -> None:
    rng = np.random.default_rng(11)
    t = np.cumsum(rng.uniform(0.002, 0.003, 50))
    omega, f = rng.standard_normal((2, 4, 50, 3))
    q0, (v0, p0) = quat.normalized(rng.standard_normal((4, 4))), rng.standard_normal((2, 4, 3))
    gravity, earth_rate = GRAVITY_R + rng.standard_normal((4, 3)), EARTH_RATE * rng.standard_normal((4, 3))
    arguments = omega, f, q0, v0, p0, gravity, earth_rate
    together = two_sample(t, *arguments)
    for i in range(4):
        alone = two_sample(t, *(x[i] for x in arguments))
        for whole, part in zip(together, alone, strict=True):
            np.testing.assert_allclose(whole[i], part, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("even", [True, False])
def test_five_point_differences_are_exact_for_quartics(even: bool) -> None:
    rng = np.random.default_rng(13)
    t = np.arange(12.0) if even else np.cumsum(rng.uniform(0.5, 1.5, 12))
    quartics = [np.polynomial.Polynomial(c, domain=[0, 12]) for c in rng.standard_normal((3, 5))]
    values, slopes = (np.stack([q(t) for q in x], axis=-1) for x in (quartics, [q.deriv() for q in quartics]))
    np.testing.assert_allclose(five_point_differences(t, values)[2:-2], slopes[2:-2], atol=1e-12)


# ---- plain filter ----


def prior_sd() -> Array:
    sd = {
        "q_rb": 3e-4,
        "v": 2e-3,
        "p": 3e-4,
        "q_rn": 1e-3,
        "K_omega": 5e-4,
        "k_w0": 1e-4,
        "K_a": 5e-4,
        "k_a0": 5e-3,
        "lever_arms": 2e-3,
        "time_offset": 3e-4,
    }
    return np.concatenate([np.full(part.stop - part.start, sd[n]) for n, part in plain_filter.LAYOUT.items()])


class Example:
    """A recording of 20 s with little noise, and the truth at its beginning and its last update."""

    gyro_density, accel_density, position_sd, orientation_sd = 1e-6, 1e-5, 1e-4, 1e-4

    def __init__(self, seed: int, rate_hz: float = 200.0) -> None:
        self.rate_hz = rate_hz
        rng = np.random.default_rng(seed)
        self.motion = AnalyticMotion(rng, duration=20.0)
        self.parameters = self._draw_parameters(rng)
        stamps, rates, accels = self._draw_readings(rng)
        self.truth = self.truth_at(stamps[:1])
        sd = prior_sd()
        initial = plain_filter.plus(self.truth, sd * rng.standard_normal(plain_filter.SIZE))
        poses = self._draw_poses(rng)
        guess = np.array([tau for tau, _, _ in poses]) + initial["time_offset"]
        self.sample_index = np.round(guess * self.rate_hz).astype(int)
        self.end = self.truth_at(stamps[self.sample_index[-1:]])
        self.arguments: dict[str, Any] = {
            "stamps": stamps,
            "rates": rates,
            "accels": accels,
            "poses": poses,
            "sample_index": self.sample_index,
            "initial": initial,
            "P0": np.diag(sd**2),
            "gyro_noise_density": self.gyro_density,
            "accel_noise_density": self.accel_density,
            "position_sd": self.position_sd,
            "orientation_sd": self.orientation_sd,
            "gravity_magnitude": 9.81,
            "earth_rate_n": EARTH_RATE_N,
        }

    def truth_at(self, t: Array) -> plain_filter.State:
        known = {name: self.parameters[name] for name in ("q_rn", "K_omega", "K_a", "lever_arms")}
        offsets = {"k_w0": self.parameters["k_w"][0], "k_a0": self.parameters["k_a"][0]}
        pose = {"q_rb": self.motion.attitude(t)[0], "v": self.motion.velocity(t)[0]}
        time = {"p": self.motion.position(t)[0], "time_offset": self.parameters["time_offset"]}
        return known | offsets | pose | time

    @staticmethod
    def _draw_parameters(rng: np.random.Generator) -> dict[str, Array]:
        mount = quat.matrix(quat.exp(0.1 * rng.standard_normal(3)))
        upside_down = np.array([0.0, 1.0, 0.0, 0.0])
        return {
            "q_rn": quat.multiply(upside_down, quat.exp(0.02 * rng.standard_normal(3))),
            "K_omega": mount @ (np.eye(3) + 1e-3 * rng.standard_normal((3, 3))),
            "K_a": mount @ (np.eye(3) + 1e-3 * rng.standard_normal((3, 3))),
            "k_w": 1e-3 * rng.standard_normal((1, 3)),
            "k_a": 2e-2 * rng.standard_normal((1, 3)),
            "lever_arms": 5e-2 * rng.standard_normal((3, 3)),
            "time_offset": np.array(7.3e-3),
        }

    def _draw_readings(self, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        stamps = np.arange(int(self.motion.duration * self.rate_hz) + 1) / self.rate_hz
        gravity_r = quat.rotate(self.parameters["q_rn"], np.array([0.0, 0.0, 9.81]))
        earth_rate_r = quat.rotate(self.parameters["q_rn"], EARTH_RATE_N)
        rates, accels = raw_readings(*inertial_truth(self.motion, stamps, gravity_r, earth_rate_r), self.parameters)
        sd = np.sqrt(self.rate_hz) * np.array([self.gyro_density, self.accel_density])
        noise = sd[:, None, None] * rng.standard_normal((2, *rates.shape))
        return stamps, rates + noise[0], accels + noise[1]

    def _draw_poses(self, rng: np.random.Generator) -> list[plain_filter.Pose]:
        tau = 0.48 * np.arange(1, 41)
        t = tau + self.parameters["time_offset"]
        noise = rng.standard_normal((2, len(t), 3))
        positions = self.motion.position(t) + self.position_sd * noise[0]
        attitudes = quat.multiply(self.motion.attitude(t), quat.exp(self.orientation_sd * noise[1]))
        return list(zip(tau.tolist(), positions, attitudes, strict=True))


# At 200 Hz three-point differences of the rate leave more in f than the noise of this example.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("weights", "rate_hz", "alpha_points"),
    [("central", 400.0, 3), ("unscented", 200.0, 5)],
)
def test_filter_recovers_the_parameters(weights: str, rate_hz: float, alpha_points: int) -> None:
    example = Example(2, rate_hz)
    answer = plain_filter.run(**example.arguments, weights=weights, alpha_points=alpha_points)
    error = plain_filter.minus(example.end, answer["mean"])
    sd = np.sqrt(np.diag(answer["P"]))
    assert np.max(np.abs(error / sd)) < 4.0
    # Two-sided, one in a thousand each.
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], plain_filter.SIZE)
    assert low < error @ np.linalg.solve(answer["P"], error) < high
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 6 * len(answer["nis"]))
    assert low < np.sum(answer["nis"]) < high
    # The motion shows all but the heading of the base, which the Earth's rate would need hours for.
    seen = np.ones(plain_filter.SIZE, dtype=bool)
    seen[plain_filter.LAYOUT["q_rn"]] = False
    assert np.all(sd[seen] < 0.5 * prior_sd()[seen])


def test_filter_without_propagation_is_the_linear_update() -> None:
    example = Example(4)
    # At the true time of the first sample a pose is a direct reading of position and attitude.
    example.arguments |= {"poses": [(-7.3e-3, *start_of(example.motion)[2::-2])], "sample_index": [0]}
    P0 = np.diag(prior_sd() ** 2)
    P0[45, 45] = 0.0
    example.arguments["initial"] |= {"time_offset": np.array(7.3e-3)}
    answer = plain_filter.run(**example.arguments | {"P0": P0})
    for name in ("p", "q_rb"):
        part = plain_filter.LAYOUT[name]
        expected = (3e-4**-2 + 1e-4**-2) ** -1
        # Errors of 3e-4 rad leave the linear rule by their square.
        np.testing.assert_allclose(np.diag(answer["P"])[part], expected, rtol=1e-6)
    untouched = np.r_[3:6, 9:45]
    np.testing.assert_allclose(np.diag(answer["P"])[untouched], np.diag(P0)[untouched], rtol=1e-6)
    assert np.all(answer["P"][45] == 0.0)


def window(example: Example, stop: int) -> tuple[plain_filter.Corrected, Trajectory, plain_filter.World]:
    """Return samples and path of one sigma point, the true one, through the first samples."""
    imu = plain_filter.Imu(*(example.arguments[name] for name in ("stamps", "rates", "accels")))
    world = plain_filter.World(9.81, EARTH_RATE_N)
    truth = {name: np.asarray(x)[None] for name, x in example.truth.items()}
    samples = plain_filter.correct(truth, imu, 0, stop)
    return samples, plain_filter.propagate(truth, samples, world)[1], world


def specific_force_error(rate_hz: float, alpha_points: int) -> float:
    """Return the largest error of the corrected specific force from noise-free readings with lever arms."""
    motion = AnalyticMotion(np.random.default_rng(14), duration=5.0)
    t = np.arange(round(5.0 * rate_hz) + 1) / rate_hz
    omega, alpha, f = inertial_truth(motion, t, GRAVITY_R, EARTH_RATE_R)
    example = Example(5)
    imu = plain_filter.Imu(t, *raw_readings(omega, alpha, f, example.parameters))
    truth = {name: np.asarray(x)[None] for name, x in example.truth.items()}
    inside = slice(5, len(t) - 5)
    samples = plain_filter.correct(truth, imu, inside.start, inside.stop - 1, alpha_points)
    np.testing.assert_allclose(samples.omega[0], omega[inside], atol=1e-14)
    return float(np.max(np.abs(samples.f[0] - f[inside])))


@pytest.mark.parametrize(("alpha_points", "order"), [(3, 2), (5, 4)])
def test_corrected_force_is_exact_but_for_alpha(alpha_points: int, order: int) -> None:
    coarse, fine = (specific_force_error(rate_hz, alpha_points) for rate_hz in (100.0, 200.0))
    assert coarse / fine == pytest.approx(2.0**order, rel=0.1)


def test_process_noise_is_the_spread_of_noisy_integrations() -> None:
    rng, count, stop = np.random.default_rng(12), 4000, 96
    example = Example(5)
    samples, path, world = window(example, stop)
    example.truth |= {"K_omega": np.eye(3), "K_a": np.eye(3)}
    gyro_density, accel_density = 1e-5, 2e-5
    Q = plain_filter.process_noise(samples, path, example.truth, world, gyro_density, accel_density)[:9, :9]
    noise = np.sqrt(example.rate_hz) * rng.standard_normal((2, count, stop + 1, 3))
    batch = [np.broadcast_to(x[:, 0], (count, x.shape[-1])) for x in path]
    truth = {name: np.asarray(x)[None] for name, x in example.truth.items()}
    place = [np.broadcast_to(x, (count, 3)) for x in plain_filter.gravity_and_earth_rate(truth, world)]
    omega, f = samples.omega + gyro_density * noise[0], samples.f + accel_density * noise[1]
    noisy = two_sample(samples.stamps, omega, f, *batch, *place)
    turn = quat.log(quat.multiply(quat.conjugate(path.q[:, -1]), noisy.q[:, -1]))
    errors = np.concatenate([turn, noisy.v[:, -1] - path.v[:, -1], noisy.p[:, -1] - path.p[:, -1]], axis=-1)
    whitened = np.linalg.solve(np.linalg.cholesky(Q), errors.T)
    # Five sigma of a sample covariance, and 1 % for the end samples that count by half.
    tolerance = 5.0 * np.sqrt(2.0 / count) + 0.01
    np.testing.assert_allclose(whitened @ whitened.T / count, np.eye(9), atol=tolerance)
