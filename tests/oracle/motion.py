"""An analytic motion of the body in the robot's frame, and the readings an IMU on it would give.

Everything is a closed expression of time; no derivative is taken by differences. Frames and signs:
r is the robot's base, b the body, q_rb turns a vector from b to r, scalar first.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq

from .quaternions import Array, exp, multiply, normalized, rotate_back

LOWEST_FREQUENCY_HZ, HIGHEST_FREQUENCY_HZ = 0.15, 1.2
SINES_PER_COORDINATE = 4
MAX_RAMP_S = 2.0
PEAK_SEARCH_RATE_HZ = 200.0


@dataclass(frozen=True)
class SumOfSines:
    """Three coordinates, each amplitude * sin(frequency * s + phase) summed; arrays (3, m), rad/s and rad."""

    amplitude: Array
    frequency: Array
    phase: Array

    def derivative(self, s: Array, order: int) -> Array:
        """Return the derivative of the given order with respect to s, (n, 3)."""
        argument = self.frequency * s[:, None, None] + self.phase + order * np.pi / 2.0
        return np.sum(self.amplitude * self.frequency**order * np.sin(argument), axis=-1)

    def scaled(self, factor: float) -> "SumOfSines":
        """Return the same with every amplitude multiplied."""
        return SumOfSines(factor * self.amplitude, self.frequency, self.phase)


@dataclass(frozen=True)
class Warp:
    """A path parameter s(t): s = t, or constant during `rest` at both ends with C5 ramps between."""

    duration: float
    rest: float

    @property
    def ramp(self) -> float:
        """The time from rest to full speed, in seconds."""
        return min(MAX_RAMP_S, (self.duration - 2.0 * self.rest) / 4.0)

    def derivatives(self, t: Array) -> tuple[Array, Array, Array]:
        """Return s, ds/dt and d2s/dt2."""
        if self.rest == 0.0:
            return t, np.ones_like(t), np.zeros_like(t)
        up = (t - self.rest) / self.ramp
        down = (t - self.duration + self.rest + self.ramp) / self.ramp
        s = self.ramp * (_step_integral(up) - _step_integral(down))
        return s, _step(up) - _step(down), (_step_slope(up) - _step_slope(down)) / self.ramp


def _step(u: Array) -> Array:
    """Return the polynomial step from 0 to 1 with four vanishing derivatives at both ends."""
    u = np.clip(u, 0.0, 1.0)
    return u**5 * (126.0 - 420.0 * u + 540.0 * u**2 - 315.0 * u**3 + 70.0 * u**4)


def _step_slope(u: Array) -> Array:
    u = np.clip(u, 0.0, 1.0)
    return 630.0 * u**4 * (1.0 - u) ** 4


def _step_integral(u: Array) -> Array:
    beyond = np.maximum(u - 1.0, 0.0)
    u = np.clip(u, 0.0, 1.0)
    return u**6 * (21.0 - 60.0 * u + 67.5 * u**2 - 35.0 * u**3 + 7.0 * u**4) + beyond


class AnalyticMotion:
    """A random smooth motion with six degrees of freedom.

    Position is a sum of sines; attitude is q_rb = q_home * R_z(angle_0) * R_y(angle_1) * R_x(angle_2), the
    angles sums of sines. Both are scaled until the largest rate and acceleration (as norms, searched at
    200 Hz) are those asked for.

    Parameters
    ----------
    rng
        The randomness; the same generator state gives the same motion.
    peak_rate, peak_acceleration
        Largest norm of omega_rb_b (rad/s) and of the acceleration in r (m/s^2).
    duration
        In seconds, from t = 0.
    rest
        Seconds of exact rest at the beginning and at the end; zero for motion throughout.
    """

    AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])

    def __init__(
        self,
        rng: np.random.Generator,
        peak_rate: float = 3.3,
        peak_acceleration: float = 6.0,
        duration: float = 60.0,
        rest: float = 0.0,
    ) -> None:
        if not 0.0 <= 2.0 * rest < duration:
            raise ValueError(f"Rest does not fit: expected 0 <= 2 * rest < {duration} s, got {rest} s.")
        self.duration, self.rest = duration, rest
        self._warp = Warp(duration, rest)
        self._home_position = rng.uniform(-1.0, 1.0, 3)
        self._home_attitude = normalized(rng.standard_normal(4))
        self._path = _random_sines(rng)
        self._angles = _random_sines(rng)
        t = np.linspace(0.0, duration, int(duration * PEAK_SEARCH_RATE_HZ) + 1)
        self._path = self._path.scaled(peak_acceleration / _largest_norm(self.acceleration(t)))
        self._angles = self._angles.scaled(self._angle_factor(t, peak_rate))

    def position(self, t: Array) -> Array:
        """Return p, (n, 3), in r."""
        return self._home_position + self._in_time(self._path, t)[0]

    def velocity(self, t: Array) -> Array:
        """Return v = dp/dt, (n, 3), in r."""
        return self._in_time(self._path, t)[1]

    def acceleration(self, t: Array) -> Array:
        """Return dv/dt, (n, 3), in r."""
        return self._in_time(self._path, t)[2]

    def attitude(self, t: Array) -> Array:
        """Return q_rb, (n, 4)."""
        angles = self._in_time(self._angles, t)[0]
        q = np.broadcast_to(self._home_attitude, (len(t), 4))
        for axis, angle in zip(self.AXES, angles.T, strict=True):
            q = multiply(q, exp(angle[:, None] * axis))
        return q

    def rate(self, t: Array) -> Array:
        """Return omega_rb_b, (n, 3)."""
        return self._rate_and_derivative(self._angles, t)[0]

    def angular_acceleration(self, t: Array) -> Array:
        """Return d(omega_rb_b)/dt, (n, 3)."""
        return self._rate_and_derivative(self._angles, t)[1]

    def _in_time(self, sines: SumOfSines, t: Array) -> tuple[Array, Array, Array]:
        s, ds, dds = (x[:, None] for x in self._warp.derivatives(np.asarray(t, dtype=float)))
        first = sines.derivative(s[:, 0], 1)
        second = sines.derivative(s[:, 0], 2)
        return sines.derivative(s[:, 0], 0), first * ds, second * ds**2 + first * dds

    def _rate_and_derivative(self, sines: SumOfSines, t: Array) -> tuple[Array, Array]:
        omega = alpha = np.zeros((len(t), 3))
        for axis, *coordinate in zip(self.AXES, *(x.T for x in self._in_time(sines, t)), strict=True):
            angle, first, second = (x[:, None] for x in coordinate)
            q = exp(angle * axis)
            # Each elementary rotation carries the rate of those before it into its own turned frame.
            omega, alpha = rotate_back(q, omega), rotate_back(q, alpha)
            alpha = alpha - np.cross(first * axis, omega) + second * axis
            omega = omega + first * axis
        return omega, alpha

    def _angle_factor(self, t: Array, peak_rate: float) -> float:
        def excess(factor: float) -> float:
            return _largest_norm(self._rate_and_derivative(self._angles.scaled(factor), t)[0]) - peak_rate

        highest = 1.0
        while excess(highest) < 0.0:
            highest *= 2.0
        return float(brentq(excess, 0.0, highest, rtol=1e-13))


def _random_sines(rng: np.random.Generator) -> SumOfSines:
    shape = (3, SINES_PER_COORDINATE)
    frequency = 2.0 * np.pi * rng.uniform(LOWEST_FREQUENCY_HZ, HIGHEST_FREQUENCY_HZ, shape)
    # Division by the frequency gives slow and fast parts a like share of the rate.
    amplitude = rng.uniform(0.5, 1.0, shape) / frequency
    return SumOfSines(amplitude, frequency, rng.uniform(0.0, 2.0 * np.pi, shape))


def _largest_norm(x: Array) -> float:
    return float(np.max(np.linalg.norm(x, axis=-1)))


def inertial_truth(
    motion: AnalyticMotion, t: Array, gravity_r: Array, earth_rate_r: Array
) -> tuple[Array, Array, Array]:
    """Return omega_ib_b, its time derivative alpha_ib_b and the specific force f_b, each (n, 3)."""
    q_rb = motion.attitude(t)
    omega_rb_b = motion.rate(t)
    earth_rate_b = rotate_back(q_rb, np.broadcast_to(earth_rate_r, (len(t), 3)))
    # d(C_rb^T u)/dt = -omega_rb_b x C_rb^T u for u constant in r.
    alpha_ib_b = motion.angular_acceleration(t) - np.cross(omega_rb_b, earth_rate_b)
    coriolis_r = 2.0 * np.cross(earth_rate_r, motion.velocity(t))
    f_b = rotate_back(q_rb, motion.acceleration(t) - gravity_r + coriolis_r)
    return omega_rb_b + earth_rate_b, alpha_ib_b, f_b


def size_effect(omega: Array, alpha: Array, K_a: Array, lever_arms: Array) -> Array:
    """Return e_j = s_j . (alpha x r_j + omega x (omega x r_j)); s_j rows of K_a^-1, r_j of lever_arms."""
    S = np.linalg.inv(K_a)
    parts = [(np.cross(alpha, r) + np.cross(omega, np.cross(omega, r))) @ s for s, r in zip(S, lever_arms, strict=True)]
    return np.stack(parts, axis=-1)


def raw_readings(
    omega: Array, alpha: Array, f: Array, parameters: Mapping[str, Array], form: str = "completed"
) -> tuple[Array, Array]:
    """Return the raw rates and accelerations, each (n, 3), that the sensor model maps to omega and f.

    Parameters
    ----------
    omega, alpha, f
        omega_ib_b (rad/s), its derivative (rad/s^2) and f_b (m/s^2), each (n, 3).
    parameters
        K_omega, K_a (3, 3); k_w, k_a (N, 3): row 0 the offset, row i the coefficient of power i + 1;
        lever_arms (3, 3): row j the position of accelerometer j in b.
    form
        Only "completed", equations (1) and (2) with e inside K_a.
    """
    if form != "completed":
        raise ValueError(f"Unknown form of the size effect: expected 'completed', got {form!r}.")
    # (1): K_omega^-1 omega = w' + k_w0 + sum k_wi w'^i
    w_raw = _invert_polynomial(omega @ np.linalg.inv(parameters["K_omega"]).T, parameters["k_w"])
    # (2): K_a^-1 f + e = a' + k_a0 + sum k_ai a'^i
    e = size_effect(omega, alpha, parameters["K_a"], parameters["lever_arms"])
    a_raw = _invert_polynomial(f @ np.linalg.inv(parameters["K_a"]).T + e, parameters["k_a"])
    return w_raw, a_raw


def _invert_polynomial(value: Array, coefficients: Array) -> Array:
    """Return x with x + c_0 + sum c_i x^(i+1) = value, by Newton's method from x = value - c_0."""
    x = value - coefficients[0]
    powers = range(2, len(coefficients) + 1)
    for _ in range(50):
        residual = x + coefficients[0] - value
        slope = np.ones_like(x)
        for c, power in zip(coefficients[1:], powers, strict=True):
            residual = residual + c * x**power
            slope = slope + power * c * x ** (power - 1)
        step = residual / slope
        x = x - step
        if np.all(np.abs(step) <= 1e-15 * np.maximum(1.0, np.abs(x))):
            return x
    raise ValueError(
        f"Newton's method did not settle: last step {np.max(np.abs(step)):.1e}, expected below 1e-15 of the"
        " reading. Look whether the polynomial is monotonic over these readings."
    )


TimeFunction = Callable[[float], Array]


def inertial_functions(
    motion: AnalyticMotion, gravity_r: Array, earth_rate_r: Array
) -> tuple[TimeFunction, TimeFunction]:
    """Return omega_ib_b(t) and f_b(t) of one instant each, for an integrator."""

    # An integrator asks for both at each instant, and one evaluation gives both.
    @lru_cache(maxsize=1)
    def truth(t: float) -> tuple[Array, Array]:
        omega, _, f = inertial_truth(motion, np.array([t]), gravity_r, earth_rate_r)
        return omega[0], f[0]

    def omega_ib_b(t: float) -> Array:
        return truth(t)[0]

    def f_b(t: float) -> Array:
        return truth(t)[1]

    return omega_ib_b, f_b
