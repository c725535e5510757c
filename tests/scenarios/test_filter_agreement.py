"""The engine against a filter written from the book, and its choices of sigma points against each other."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.filtering.filter_pass import run_filter
from kreisel.filtering.initial_belief import first_belief
from kreisel.inertial.readings import Readings
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.noise import AssumedNoise, ReferenceNoise
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Prior, Problem
from kreisel.model.schedule import Schedule, Update
from kreisel.model.settings import CalibrationSettings
from kreisel.model.site import Site
from kreisel.preparation.state_layout import build_layout
from kreisel.recording.recording import ReferencePoses
from kreisel.synchronization.clock import Clock

from ..oracle import plain_filter
from ..oracle.motion import AnalyticMotion, inertial_truth, raw_readings
from ..oracle.quaternions import exp, multiply

RATE, SECONDS, EVERY = 200.0, 12.0, 80
GYRO, ACCEL, POSITION, ORIENTATION = 5e-5, 1e-3, 5e-4, 5e-4
GRAVITY = 9.81
EARTH_N = np.array([4.76e-5, 0.0, -5.52e-5])
DEVIATION = {
    "gyro_cross_coupling": np.full(9, 5e-4),
    "gyro_offset": np.full(3, 1e-4),
    "accel_cross_coupling": np.full(9, 5e-4),
    "accel_offset": np.full(3, 5e-3),
    "lever_arms": np.full(9, 2e-3),
    "alignment": np.full(2, 1e-3),
    "north": np.array([1e-9, 1e-3]),  # a small turn of north moves its second component
    "time_offset": np.full(1, 3e-4),
}
NAVIGATION = {"attitude": 1e-3, "velocity": 1e-3, "position": 1e-3}
GROUPS = {
    "gyro_cross_coupling": "K_omega",
    "gyro_offset": "k_w0",
    "accel_cross_coupling": "K_a",
    "accel_offset": "k_a0",
    "lever_arms": "lever_arms",
    "alignment": "q_rn",
    "time_offset": "time_offset",
    "attitude": "q_rb",
    "velocity": "v",
    "position": "p",
}


class Case:
    """Readings and poses of the oracle's motion with errors drawn from the prior."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        motion = AnalyticMotion(rng, duration=SECONDS + 1.0, peak_rate=2.0, peak_acceleration=4.0)
        self.t = np.arange(round(SECONDS * RATE) + 1) / RATE
        q_rn = multiply(np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0]), exp(rng.normal(0, 1e-3, 3)))
        g, earth = _turn(q_rn, [0, 0, GRAVITY]), _turn(q_rn, EARTH_N)
        self.truth = {
            "K_omega": np.eye(3) + rng.normal(0, 5e-4, (3, 3)),
            "k_w": rng.normal(0, 1e-4, (1, 3)),
            "K_a": np.eye(3) + rng.normal(0, 5e-4, (3, 3)),
            "k_a": rng.normal(0, 5e-3, (1, 3)),
            "lever_arms": np.array([0.02, -0.03, 0.05]) + rng.normal(0, 2e-3, (3, 3)),
        }
        offset = rng.normal(0, 3e-4)
        omega, alpha, f = inertial_truth(motion, self.t, g, earth)
        w, a = raw_readings(omega, alpha, f, self.truth)
        self.rates = w + rng.normal(0, GYRO * np.sqrt(RATE), w.shape)
        self.forces = a + rng.normal(0, ACCEL * np.sqrt(RATE), a.shape)
        self.samples = np.arange(2 * EVERY, self.t.size - 4, EVERY)
        self.tau = self.t[self.samples] + rng.uniform(-0.4, 0.4, self.samples.size) / RATE
        at = self.tau + offset
        self.positions = motion.position(at) + rng.normal(0, POSITION, (at.size, 3))
        self.quaternions = multiply(motion.attitude(at), exp(rng.normal(0, ORIENTATION, (at.size, 3))))
        first = self.t[[EVERY]]
        self.start = {
            "q_rb": multiply(motion.attitude(first), exp(rng.normal(0, 1e-3, (1, 3))))[0],
            "v": (motion.velocity(first) + rng.normal(0, 1e-3, (1, 3)))[0],
            "p": (motion.position(first) + rng.normal(0, 1e-3, (1, 3)))[0],
            "q_rn": np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0]),
            "K_omega": np.eye(3),
            "k_w0": np.zeros(3),
            "K_a": np.eye(3),
            "k_a0": np.zeros(3),
            "lever_arms": np.tile([0.02, -0.03, 0.05], (3, 1)),
            "time_offset": np.array(0.0),
        }


def _turn(q, v):
    from ..oracle.quaternions import rotate

    return rotate(q, np.asarray(v, dtype=float))


def problem_and_belief(case, weights):
    """Return the case as our problem, and the belief its prior is."""
    settings = CalibrationSettings(sigma_points=weights, fixed=("gravity",))
    layout = build_layout(settings, latitude=True, skew=False, standstill_error=False)
    density = np.repeat(np.array([GYRO**2, ACCEL**2, 0.0, 0.0])[:, None], 3, axis=1)
    readings = Readings(case.t, case.rates, case.forces, ((0, case.t.size - 1),), noise=density)
    s = case.start
    zero = np.zeros((1, 3))
    start = CellParameters(
        SensorParameters(s["K_omega"], zero, s["K_a"], zero, s["lever_arms"]),
        s["q_rn"],
        np.array([1.0, 0.0]),
        GRAVITY,
        0.0,
        0.0,
    )
    firsts = np.concatenate([[EVERY], case.samples[:-1]])
    updates = tuple(
        Update(int(a), int(b), i, float(tau), None, False, False)
        for i, (a, b, tau) in enumerate(zip(firsts, case.samples, case.tau, strict=True))
    )
    noise = AssumedNoise(
        reference=ReferenceNoise(POSITION, ORIENTATION, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0),
        min_reference=(0.0, 0.0),
        imu_bounds=((0.0, 1.0), (0.0, 1.0)),
        offset_walk={},
    )
    covariance = {name: np.diag(sd**2) for name, sd in DEVIATION.items()}
    stamps_ns = np.round(1e9 * case.tau).astype(np.int64)
    problem = Problem(
        readings=readings,
        reference=ReferencePoses("oracle", stamps_ns, case.positions, case.quaternions, Path("oracle")),
        schedule=Schedule(updates, EVERY / RATE, Clock(0.0), (), np.tile(s["q_rb"], (case.samples.size, 1))),
        settings=settings,
        site=Site(GRAVITY, 0.0, EARTH_N),
        layout=layout,
        prior=Prior(start, covariance, start, covariance, DEVIATION, (), start),
        noise=noise,
    )
    belief = first_belief(problem, start)
    mean, factor = belief.mean.copy(), belief.factor.copy()
    for name, deviation in NAVIGATION.items():
        mean[layout.stored(name)] = s[GROUPS[name]]
        factor[layout[name], layout[name]] = deviation * np.eye(3)
    return problem, type(belief)(mean, factor)


def ours(case, weights):
    problem, belief = problem_and_belief(case, weights)
    return problem.layout, run_filter(problem, problem.prior.start, gate=np.inf, belief=belief)


def book(case, weights, order=None):
    P = np.zeros((46, 46))
    layout = plain_filter.LAYOUT
    priors = {**DEVIATION, **{k: np.full(3, v) for k, v in NAVIGATION.items()}, "alignment": np.full(3, 1e-3)}
    del priors["north"]
    for name, deviation in priors.items():
        part = layout[GROUPS[name]]
        P[part, part] = np.diag(deviation**2)
    poses = [(float(tau), p, q) for tau, p, q in zip(case.tau, case.positions, case.quaternions, strict=True)]
    return plain_filter.run(
        case.t,
        case.rates,
        case.forces,
        poses,
        [int(k) for k in case.samples],
        case.start,
        P,
        GYRO,
        ACCEL,
        POSITION,
        ORIENTATION,
        GRAVITY,
        EARTH_N,
        start_index=EVERY,
        weights=weights,
        drawing_order=order,
        alpha_points=5,
    )


def compare(case, layout, run, result):
    """Return the largest difference of means and of deviations, in the book's standard deviations."""
    deviation = np.sqrt(np.diag(result["P"]))
    ours_sd = run.belief.standard_deviation
    means, spreads = [], []
    for name, theirs in GROUPS.items():
        part = plain_filter.LAYOUT[theirs]
        sd = deviation[part]
        x = run.belief.mean[layout.stored(name)]
        value = np.asarray(result["mean"][theirs], dtype=float)
        own = ours_sd[layout[name]]
        if name in ("attitude", "alignment"):
            from ..oracle.quaternions import conjugate, log

            difference = log(multiply(conjugate(value), x))
            if name == "alignment":
                difference[2] += run.belief.mean[layout.stored("north")][1]
                own = np.append(own, ours_sd[layout["north"]][1])
        else:
            difference = x - value.ravel()
        means.append(np.abs(difference / sd).max())
        spreads.append(np.abs(own / sd - 1.0).max())
    return max(means), max(spreads)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("weights", ["central-difference", "unscented"])
def test_engine_and_book_agree(seed, weights):
    """Same readings, same prior: the book redraws its points before the update and keeps covariances.

    What may differ is of second order in the prior's deviations; ten times what was measured is allowed.
    """
    case = Case(seed)
    layout, run = ours(case, weights)
    mean, spread = compare(case, layout, run, book(case, "central" if weights == "central-difference" else weights))
    print(f"seed {seed} {weights}: means differ by {mean:.2g} sd, deviations by {spread:.2g}")
    assert mean < 0.02
    assert spread < 1e-3


def test_choices_of_sigma_points_agree():
    case = Case(2)
    runs = {name: ours(case, name) for name in ("central-difference", "unscented", "linear")}
    layout, reference = runs["central-difference"]
    sd = reference.belief.standard_deviation
    for name in ("unscented", "linear"):
        other = runs[name][1]
        difference = layout.minus(other.belief.mean[:, None], reference.belief.mean)[:, 0] / sd
        assert np.abs(difference).max() < 0.1, name
        assert np.abs(other.belief.standard_deviation / sd - 1.0).max() < 0.02, name


def test_errors_are_as_large_as_the_filter_says():
    """NEES of the 37 parameters over eight runs: mean inside the 99.9 % interval of chi-square."""
    from scipy.stats import chi2

    total, degrees = 0.0, 0
    for seed in range(8):
        case = Case(100 + seed)
        layout, run = ours(case, "central-difference")
        t = case.truth
        error = []
        for group, value in (
            ("gyro_cross_coupling", t["K_omega"]),
            ("gyro_offset", t["k_w"][0]),
            ("accel_cross_coupling", t["K_a"]),
            ("accel_offset", t["k_a"][0]),
            ("lever_arms", t["lever_arms"]),
        ):
            error.append(run.belief.mean[layout.stored(group)] - np.ravel(value))
        error = np.concatenate(error)
        n = error.size
        total += float(error @ np.linalg.solve(run.belief.covariance[:n, :n], error))
        degrees += n
    low, high = chi2.ppf([5e-4, 1 - 5e-4], degrees)
    print(f"NEES {total / degrees:.3f} per degree, bounds {low / degrees:.3f} to {high / degrees:.3f}")
    assert low < total < high
