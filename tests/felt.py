"""Simulated cells for tests, and what an IMU feels on poses alone: independent of what simulates them."""

from math import factorial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell

H = 0.0025
"""s between two IMU samples, and between two poses where they are differentiated."""

START_NS = 10**12
MARGIN = 0.06

FAULTLESS = {
    "geometry_length_sd": 0.0,
    "geometry_angle_sd": 0.0,
    "repeatability_position_sd": 0.0,
    "repeatability_orientation_sd": 0.0,
    "path_position_sd": 0.0,
    "path_orientation_sd": 0.0,
}


def run(seconds=30.0, seed=1, errors=None, trial=None, **tables):
    """Truth and recording of a cell without errors or noise, on one clock, but for what is said."""
    content = {
        "seed": seed,
        "seconds": seconds,
        "errors": {**FAULTLESS, **(errors or {})},
        "imu": {"noise": False, "rate": 1.0 / H, **tables.pop("imu", {})},
        "reference": {"interval": H, "clock_offset": 0.0, **tables.pop("reference", {})},
        **tables,
    }
    return simulate(Cell.model_validate(content), Path("cell"), trial=trial)


def inside_chi_square(values, sd):
    """Whether the values' root mean square is one that a normal variable of this deviation shows, but for 1e-6."""
    low, high = chi2.ppf([5e-7, 1.0 - 5e-7], np.size(values))
    return low < np.sum(np.square(values)) / sd**2 < high


# What an IMU on these poses should feel


def central(x, order, accuracy):
    """Central differences of rows H apart, without the first and last four rows."""
    half = accuracy // 2
    steps = np.arange(-half, half + 1)
    right = np.zeros(accuracy + 1)
    right[order] = factorial(order)
    weights = np.linalg.solve(np.vander(steps, increasing=True).T.astype(float), right) / H**order
    return sum(w * x[4 + k : len(x) - 4 + k] for k, w in zip(steps, weights, strict=True))


def product(a, b):
    """Hamilton's, scalar first."""
    scalar = a[:, 0] * b[:, 0] - np.sum(a[:, 1:] * b[:, 1:], axis=1)
    return np.column_stack([scalar, a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])])


def felt(p, q, gravity, earth, accuracy):
    """Inertial rate, its derivative and specific force in b, from poses alone."""
    flips = np.cumsum(np.concatenate([[0], np.sum(q[1:] * q[:-1], axis=1) < 0.0]))
    q = np.where(flips % 2, -1.0, 1.0)[:, None] * q
    middle = q[4:-4]
    back = middle * [1.0, -1.0, -1.0, -1.0]
    C_rb = Rotation.from_quat(middle, scalar_first=True).as_matrix()
    # q' = q omega / 2, so omega = 2 q* q', and alpha = 2 q* q'' but for a scalar
    omega_rb = 2.0 * product(back, central(q, 1, accuracy))[:, 1:]
    alpha_rb = 2.0 * product(back, central(q, 2, accuracy))[:, 1:]
    earth_b = np.einsum("nji,j->ni", C_rb, earth)
    acceleration = central(p, 2, accuracy) - gravity + 2.0 * np.cross(earth, central(p, 1, accuracy))
    # the Earth's rate stands still in r, and turns backwards in b
    return omega_rb + earth_b, alpha_rb - np.cross(omega_rb, earth_b), np.einsum("nji,nj->ni", C_rb, acceleration)


def corrected(rates, accelerations, omega, alpha, sensors):
    """Equations (1) and (2), measured to true: omega = K (w' + k), f = K_a (a' + k_a - e), one axis at a time."""
    w, a = rates.copy(), accelerations.copy()
    for power, (k_w, k_a) in enumerate(zip(sensors.k_w, sensors.k_a, strict=True), start=1):
        w += k_w * (rates**power if power > 1 else 1.0)
        a += k_a * (accelerations**power if power > 1 else 1.0)
    axes = np.linalg.inv(sensors.K_a)
    for j, r in enumerate(sensors.lever_arms):
        a[:, j] -= (np.cross(alpha, r) + np.cross(omega, np.cross(omega, r))) @ axes[j]
    return np.array([sensors.K_omega @ row for row in w]), np.array([sensors.K_a @ row for row in a])


def local_site(latitude_deg=49.2571, height=200.0, heading_deg=30.0):
    """Gravity and Earth rate where x points along the heading and z up, from textbook formulae.

    Somigliana's gravity of WGS 84 with the usual free-air reduction, which is good to 1e-7 m/s^2 at 200 m.
    """
    latitude, heading = np.radians([latitude_deg, heading_deg])
    s2 = np.sin(latitude) ** 2
    surface = 9.7803253359 * (1.0 + 0.00193185265241 * s2) / np.sqrt(1.0 - 0.00669437999014 * s2)
    g = surface - (3.0877e-6 - 0.0044e-6 * s2) * height + 0.072e-12 * height**2
    north = np.array([np.cos(heading), np.sin(heading), 0.0])  # y points to the left of the heading
    up = np.array([0.0, 0.0, 1.0])
    return -g * up, 7.292115e-5 * (np.cos(latitude) * north + np.sin(latitude) * up)


SMOOTH_RATE, SMOOTH_FORCE = 5e-9, 5e-6
"""rad/s and m/s^2. Joint angles carry rounding of 1e-12 rad, by the smoothing, six of them at up to 2.6 m; sixth
order multiplies that by 1.8 / H and 6 / H^2. Earth's rate is 7e-5 rad/s, its Coriolis term 2e-4 m/s^2."""

CORNER_RATE, CORNER_FORCE = 1e-5, 1e-2
"""Where the jerk turns: joints of at most 23 to 58 rad/s^3 together move the tool by 150 m/s^3, within 12 ms. The
fourth derivative then jumps by 12 500 m/s^4 (less than 2e4 rad/s^4): H^2 / 12 and H^3 / 24 of it, twice."""


def agreement(truth, recording, p, q, gravity, earth):
    """Compare readings with what the poses p, q (at the reference's stamps) make an IMU feel.

    Where fourth and sixth order agree, differentiation is good, and readings must fit to its rounding; elsewhere
    to what a jump of the fourth derivative does.
    """
    first = np.searchsorted(recording.imu.stamps_ns, recording.reference.stamps_ns[0])
    rows = slice(first, first + len(p))
    np.testing.assert_array_equal(recording.imu.stamps_ns[rows], recording.reference.stamps_ns)
    coarse, fine = (felt(p, q, gravity, earth, accuracy) for accuracy in (4, 6))
    omega, alpha, force = fine
    inner = (recording.imu.rates[rows][4:-4], recording.imu.accelerations[rows][4:-4])
    found_omega, found_force = corrected(*inner, omega, alpha, truth.sensors)
    # in shares of what is allowed; an accelerometer is 0.4 m off at the most
    by_rate = np.abs(coarse[0] - omega).max(axis=1) / SMOOTH_RATE
    by_force = (np.abs(coarse[2] - force).max(axis=1) + 0.4 * np.abs(coarse[1] - alpha).max(axis=1)) / SMOOTH_FORCE
    unsure = np.maximum(by_rate, by_force)
    # a jump shows in both orders only when both stencils hold it: look three rows to each side
    smooth = np.max([np.roll(unsure, k) for k in range(-3, 4)], axis=0) < 0.5
    rate_error = np.abs(found_omega - omega).max(axis=1)
    force_error = np.abs(found_force - force).max(axis=1)
    assert rate_error[smooth].max() < SMOOTH_RATE
    assert force_error[smooth].max() < SMOOTH_FORCE
    assert rate_error.max() < CORNER_RATE
    assert force_error.max() < CORNER_FORCE
    moving = np.linalg.norm(omega, axis=1) > 0.1
    assert moving.mean() > 0.4  # there is something to feel
    assert smooth[moving].mean() > 0.5  # and most of it is looked at closely
    assert np.all(np.abs(omega).max(axis=0) > 0.3)
    assert np.ptp(np.linalg.norm(force, axis=1)) > 1.0


LEVEL = {"tilt_sd": 0.0}


def rests_of(angles):
    """Masks of the stretches over which the joints stand, at least fifteen rows of them."""
    still = np.concatenate([[False], np.all(np.diff(angles, axis=0) == 0.0, axis=1), [False]]).astype(int)
    begins, ends = np.flatnonzero(np.diff(still) > 0), np.flatnonzero(np.diff(still) < 0)
    masks = []
    for begin, end in zip(begins, ends, strict=True):
        if end - begin >= 15:
            mask = np.zeros(len(angles), dtype=bool)
            mask[begin : end + 1] = True
            masks.append(mask)
    return masks
