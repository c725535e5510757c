"""Readings and poses of the oracle's motion, as a problem of ours and as the oracle's filters take them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from kreisel.fitting.stored_state import first_belief
from kreisel.inertial.readings import Readings
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.assumed_noise import AssumedNoise, ReferenceNoise
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Prior, Problem, Sensor
from kreisel.model.schedule import Schedule, Update
from kreisel.model.site import Site
from kreisel.preparation.state_layout import build_layout
from kreisel.recording.recording import ReferencePoses
from kreisel.synchronization.clock import Clock

from .oracle import plain_filter
from .oracle.motion import AnalyticMotion, inertial_truth, raw_readings
from .oracle.quaternions import conjugate, exp, log, multiply, rotate

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


@dataclass(frozen=True)
class Setup:
    """Rates and lengths of a case (Hz, s, samples between poses), its noise, and its motion (rad/s, m/s^2)."""

    rate: float = 200.0
    seconds: float = 12.0
    every: int = 80
    gyro: float = 5e-5
    accel: float = 1e-3
    position: float = 5e-4
    orientation: float = 5e-4
    peak_rate: float = 2.0
    peak_acceleration: float = 4.0
    deviation: Mapping[str, np.ndarray] = field(default_factory=lambda: DEVIATION)


class Case:
    """Readings and poses of the oracle's motion with errors drawn from the prior."""

    def __init__(self, seed, setup=Setup()):
        self.setup = s = setup
        rng = np.random.default_rng(seed)
        motion = AnalyticMotion(
            rng, duration=s.seconds + 1.0, peak_rate=s.peak_rate, peak_acceleration=s.peak_acceleration
        )
        self.t = np.arange(round(s.seconds * s.rate) + 1) / s.rate
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
        self.rates = w + rng.normal(0, s.gyro * np.sqrt(s.rate), w.shape)
        self.forces = a + rng.normal(0, s.accel * np.sqrt(s.rate), a.shape)
        self.samples = np.arange(2 * s.every, self.t.size - 4, s.every)
        self.tau = self.t[self.samples] + rng.uniform(-0.4, 0.4, self.samples.size) / s.rate
        at = self.tau + offset
        self.positions = motion.position(at) + rng.normal(0, s.position, (at.size, 3))
        self.quaternions = multiply(motion.attitude(at), exp(rng.normal(0, s.orientation, (at.size, 3))))
        first = self.t[[s.every]]
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
    return rotate(q, np.asarray(v, dtype=float))


def problem_and_belief(case, weights):
    """Return the case as our problem, and the belief its prior is."""
    settings = CalibrationSettings(sigma_points=weights, fixed=("gravity",))
    layout = build_layout(settings, latitude=True, skew=False, standstill_error=False)
    density = np.repeat(np.array([case.setup.gyro**2, case.setup.accel**2, 0.0, 0.0])[:, None], 3, axis=1)
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
    firsts = np.concatenate([[case.setup.every], case.samples[:-1]])
    updates = tuple(
        Update(int(a), int(b), i, float(tau), None, False, False)
        for i, (a, b, tau) in enumerate(zip(firsts, case.samples, case.tau, strict=True))
    )
    noise = AssumedNoise(
        reference=ReferenceNoise(case.setup.position, case.setup.orientation, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0),
        min_reference=(0.0, 0.0),
        imu_bounds=((0.0, 1.0), (0.0, 1.0)),
        offset_walk={},
    )
    covariance = {name: np.diag(sd**2) for name, sd in case.setup.deviation.items()}
    stamps_ns = np.round(1e9 * case.tau).astype(np.int64)
    problem = Problem(
        sensors=(Sensor("imu0", readings),),
        reference=ReferencePoses("oracle", stamps_ns, case.positions, case.quaternions, Path("oracle")),
        schedule=Schedule(
            updates, case.setup.every / case.setup.rate, Clock(0.0), (), np.tile(s["q_rb"], (case.samples.size, 1))
        ),
        settings=settings,
        site=Site(GRAVITY, 0.0, EARTH_N),
        layout=layout,
        prior=Prior(start, covariance, start, covariance, case.setup.deviation, (), start),
        noise=noise,
    )
    belief = first_belief(problem, start)
    mean, factor = belief.mean.copy(), belief.factor.copy()
    for name, deviation in NAVIGATION.items():
        mean[layout.stored(name)] = s[GROUPS[name]]
        factor[layout[name], layout[name]] = deviation * np.eye(3)
    return problem, type(belief)(mean, factor)


def book_covariance(case):
    """Return the prior's covariance (46, 46) as the book orders it; the alignment is as wide as that of two axes."""
    P = np.zeros((plain_filter.SIZE, plain_filter.SIZE))
    deviation = case.setup.deviation
    priors = {**deviation, **{k: np.full(3, v) for k, v in NAVIGATION.items()}, "alignment": np.full(3, 1e-3)}
    del priors["north"]
    for name, sd in priors.items():
        part = plain_filter.LAYOUT[GROUPS[name]]
        P[part, part] = np.diag(sd**2)
    return P


def compare(layout, run, result, names=tuple(GROUPS)):
    """Return the largest difference of means and of deviations, in the book's standard deviations."""
    deviation = np.sqrt(np.diag(result["P"]))
    ours_sd = run.belief.standard_deviation
    means, spreads = [], []
    for name in names:
        theirs = GROUPS[name]
        part = plain_filter.LAYOUT[theirs]
        sd = deviation[part]
        x = run.belief.mean[layout.stored(name)]
        value = np.asarray(result["mean"][theirs], dtype=float)
        own = ours_sd[layout[name]]
        if name in ("attitude", "alignment"):
            difference = log(multiply(conjugate(value), x))
            if name == "alignment":
                difference[2] += run.belief.mean[layout.stored("north")][1]
                own = np.append(own, ours_sd[layout["north"]][1])
        else:
            difference = x - value.ravel()
        means.append(np.abs(difference / sd).max())
        spreads.append(np.abs(own / sd - 1.0).max())
    return max(means), max(spreads)
