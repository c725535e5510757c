"""The 46-state problem through other filters: ``python -m benchmarks.peers`` (needs ``pip install 'kreisel[peers]'``).

All see the same readings and poses of the tests' analytic motion, 200 Hz, an update every 0.4 s, and the same
priors. Times are of the filter alone, after a first run, in strapdown passes over the same samples; errors are
rms errors in the standard deviations kreisel states, so that a filter that does as well shows the same figure, of those
parameters that a filter estimates: what it cannot estimate goes into them.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from typing import Any

import numpy as np
from tests.oracle import plain_filter as plain
from tests.oracle import quaternions as quat
from tests.oracle_case import DEVIATION, EARTH_N, GRAVITY, GROUPS, NAVIGATION, Case, Setup, problem_and_belief
from tests.scenarios.test_filter_agreement import book

from kreisel.estimation.sigma_points import DERIVATIVES
from kreisel.kalman.filter_pass import run_filter

from . import yardstick

SETUP = Setup()
GYRO, ACCEL, EVERY, POSITION, ORIENTATION = SETUP.gyro, SETUP.accel, SETUP.every, SETUP.position, SETUP.orientation

JUDGED = ("gyro_cross_coupling", "gyro_offset", "accel_cross_coupling", "accel_offset", "lever_arms")
Result = tuple[float, dict[str, np.ndarray] | None]


def timed(run: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Return the shortest of a few times, and the last result."""
    best, result = np.inf, None
    for _ in range(repeats):
        began = time.perf_counter()
        result = run()
        best = min(best, time.perf_counter() - began)
    return best, result


def kreisel(case: Case, points: str) -> tuple[Result, dict[str, np.ndarray]]:
    problem, belief = problem_and_belief(case, "central-difference")
    seconds, run = timed(lambda: run_filter(problem, problem.prior.start, gate=np.inf, belief=belief, points=points), 5)
    layout, sd = problem.layout, run.belief.standard_deviation
    values = {g: run.belief.mean[layout.stored(g)] for g in JUDGED}
    return (seconds, values), {g: sd[layout[g]] for g in JUDGED}


def numpy_filter(case: Case) -> Result:
    """Run the tests' filter from the book: NumPy, all sigma points side by side."""
    seconds, result = timed(lambda: book(case, "central"), 1)
    return seconds, {g: np.ravel(result["mean"][GROUPS[g]]) for g in JUDGED}


def filterpy(case: Case, updates: int) -> Result:
    """Run filterpy's unscented filter over some updates; the time is scaled up to all."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    imu, world = plain.Imu(case.t, case.rates, case.forces), plain.World(GRAVITY, EARTH_N)
    nominal = {name: np.asarray(case.start[name], dtype=float) for name in plain.SHAPES}
    P = np.zeros((plain.SIZE, plain.SIZE))
    priors = {**DEVIATION, **{k: np.full(3, v) for k, v in NAVIGATION.items()}, "alignment": np.full(3, 1e-3)}
    for name in GROUPS:
        part = plain.LAYOUT[GROUPS[name]]
        P[part, part] = np.diag(priors[name] ** 2)
    points = MerweScaledSigmaPoints(plain.SIZE, 1.0, 2.0, 0.0)
    ukf = UnscentedKalmanFilter(plain.SIZE, 6, 1.0, hx=None, fx=None, points=points)
    ukf.x, ukf.P = np.zeros(plain.SIZE), P
    ukf.R = np.diag(np.repeat([POSITION**2, ORIENTATION**2], 3))
    began, start = time.perf_counter(), EVERY
    for tau, position, quaternion, stop in zip(
        case.tau[:updates], case.positions, case.quaternions, case.samples, strict=False
    ):
        centre = plain.plus(nominal, np.zeros((1, plain.SIZE)))
        samples = plain.correct(centre, imu, start, int(stop), 5)
        after, path = plain.propagate(centre, samples, world)
        after = {name: value[0] for name, value in after.items()}

        def move(
            x: Any, _dt: float, nominal: Any = nominal, start: int = start, stop: int = int(stop), after: Any = after
        ) -> Any:
            moved = plain.plus(nominal, x[None])
            moved, _ = plain.propagate(moved, plain.correct(moved, imu, start, stop, 5), world)
            return plain.minus(moved, after)[0]

        ukf.Q = plain.process_noise(samples, path, nominal, world, GYRO, ACCEL)
        at_end = plain.plus(after, np.zeros((1, plain.SIZE)))
        p0, q0 = plain.predict_pose(at_end, plain.correct(at_end, imu, int(stop), int(stop), 5), float(tau), world)

        def look(
            x: Any, after: Any = after, stop: int = int(stop), tau: float = float(tau), p0: Any = p0, q0: Any = q0
        ) -> Any:
            there = plain.plus(after, x[None])
            p, q = plain.predict_pose(there, plain.correct(there, imu, stop, stop, 5), tau, world)
            return np.concatenate([(p - p0)[0], quat.log(quat.multiply(quat.conjugate(q0), q))[0]])

        ukf.predict(fx=move)
        measured = np.concatenate([position - p0[0], quat.log(quat.multiply(quat.conjugate(q0[0]), quaternion))])
        ukf.update(measured, hx=look)
        nominal = plain.plus(after, ukf.x)
        ukf.x, start = np.zeros(plain.SIZE), int(stop)
    seconds = (time.perf_counter() - began) * len(case.samples) / updates
    values = {g: np.ravel(nominal[GROUPS[g]]) for g in JUDGED} if updates == len(case.samples) else None
    return seconds, values


def pyins(case: Case) -> Result:
    """Run pyins' feedback filter: biases, scales and misalignments from positions; no lever arms, no clock."""
    import pandas as pd
    from pyins import filters, inertial_sensor, measurements, strapdown, transform

    lla = np.array([49.0, 7.0, 0.0])  # where EARTH_N is that of the case
    to_n = quat.conjugate(case.start["q_rn"])
    begin = case.t[EVERY]
    imu = pd.DataFrame(
        np.hstack([case.rates, case.forces]), index=case.t,
        columns=["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"],
    ).loc[begin:]  # fmt: skip
    increments = strapdown.compute_increments_from_imu(imu, "rate")
    start = case.start
    attitude = quat.matrix(quat.multiply(to_n, start["q_rb"]))
    pva = pd.Series(
        [*transform.perturb_lla(lla, quat.rotate(to_n, start["p"])), *quat.rotate(to_n, start["v"]),
         *transform.mat_to_rph(attitude)],
        index=["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"], name=begin,
    )  # fmt: skip
    positions = pd.DataFrame(
        [transform.perturb_lla(lla, quat.rotate(to_n, p)) for p in case.positions], index=case.tau,
        columns=["lat", "lon", "alt"],
    )  # fmt: skip
    scale = np.full((3, 3), 5e-4)

    def run() -> Any:
        return filters.run_feedback_filter(
            pva, 1e-3, 1e-3, np.degrees(1e-3), np.degrees(1e-3), increments,
            inertial_sensor.EstimationModel(1e-4, GYRO, None, scale),
            inertial_sensor.EstimationModel(5e-3, ACCEL, None, scale),
            [measurements.Position(positions, POSITION, start["lever_arms"][0])],
        )  # fmt: skip

    run()
    seconds, result = timed(run, 1)
    values = {}
    for sensor, cross_coupling, offset in (("gyro", *JUDGED[:2]), ("accel", *JUDGED[2:4])):
        last = result[sensor].iloc[-1]
        # raw = T true + bias, so that K is the inverse of T
        T = np.eye(3) + np.array([[last[f"sm_{a}{b}"] for b in "xyz"] for a in "xyz"])
        values[cross_coupling] = np.linalg.inv(T).ravel()
        values[offset] = -np.array([last[f"bias_{a}"] for a in "xyz"])
    return seconds, values


def gtsam(case: Case) -> Result:
    """Preintegrate one parameter set, sample by sample through the Python binding."""
    import gtsam

    params = gtsam.PreintegrationParams.MakeSharedD(GRAVITY)
    dt = 1.0 / 200.0

    def run() -> Any:
        motion = gtsam.PreintegratedImuMeasurements(params, gtsam.imuBias.ConstantBias())
        for f, w in zip(case.forces, case.rates, strict=True):
            motion.integrateMeasurement(f, w, dt)
        return motion

    return timed(run, 3)[0], None


def gtsam_graph(case: Case) -> Result:
    """Smooth with combined preintegration and poses as priors: constant biases and nothing else of the sensors."""
    import gtsam
    from gtsam.symbol_shorthand import B, V, X

    to_n = quat.conjugate(case.start["q_rn"])
    params = gtsam.PreintegrationCombinedParams.MakeSharedD(GRAVITY)
    params.setGyroscopeCovariance(GYRO**2 * np.eye(3))
    params.setAccelerometerCovariance(ACCEL**2 * np.eye(3))
    params.setIntegrationCovariance(1e-12 * np.eye(3))
    params.setBiasOmegaCovariance(1e-16 * np.eye(3))
    params.setBiasAccCovariance(1e-14 * np.eye(3))
    params.setOmegaCoriolis(EARTH_N)
    params.setBodyPSensor(gtsam.Pose3(gtsam.Rot3(), case.start["lever_arms"][0]))
    pose_noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([ORIENTATION, POSITION], 3))
    bias_noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([5e-3, 1e-4], 3))

    def pose(q: np.ndarray, p: np.ndarray) -> Any:
        attitude = quat.multiply(to_n, q)
        return gtsam.Pose3(gtsam.Rot3(quat.matrix(attitude)), quat.rotate(to_n, p))

    def run() -> Any:
        graph, first = gtsam.NonlinearFactorGraph(), gtsam.Values()
        zero = gtsam.imuBias.ConstantBias()
        graph.add(gtsam.PriorFactorConstantBias(B(0), zero, bias_noise))
        times = np.concatenate([[case.t[EVERY]], case.tau])
        poses = [pose(case.start["q_rb"], case.start["p"])]
        poses += [pose(q, p) for q, p in zip(case.quaternions, case.positions, strict=True)]
        for i, one in enumerate(poses):
            if i:
                graph.add(gtsam.PriorFactorPose3(X(i), one, pose_noise))
            first.insert(X(i), one)
            velocity = np.gradient([p.translation() for p in poses[max(i - 1, 0) : i + 2]], axis=0) / (
                times[2] - times[1]
            )
            first.insert(V(i), velocity[min(i, 1)])
            first.insert(B(i), zero)
        for i, (begin, end) in enumerate(pairwise(times)):
            motion = gtsam.PreintegratedCombinedMeasurements(params, zero)
            samples = np.flatnonzero((case.t > begin) & (case.t < end))
            edges = np.concatenate([[begin], case.t[samples], [end]])
            for lower, upper in pairwise(edges):
                at = 0.5 * (lower + upper)
                force, rate = (
                    [np.interp(at, case.t, x[:, k]) for k in range(3)] for x in (case.forces, case.rates)
                )  # the mean over the step, for readings that change evenly
                if upper > lower:
                    motion.integrateMeasurement(np.array(force), np.array(rate), upper - lower)
            graph.add(gtsam.CombinedImuFactor(X(i), V(i), X(i + 1), V(i + 1), B(i), B(i + 1), motion))
        return gtsam.LevenbergMarquardtOptimizer(graph, first).optimize()

    seconds, result = timed(run, 1)
    bias = result.atConstantBias(B(len(case.samples)))
    return seconds, {"gyro_offset": -bias.gyroscope(), "accel_offset": -bias.accelerometer()}


PACKAGES = ("filterpy", "python-ins", "gtsam")
"""Distributions of peers."""


def _installed() -> list[str]:
    """Return the distributions of this table that are installed."""
    found = []
    for package in ("kreisel", "numpy", *PACKAGES):
        try:
            version(package)
        except PackageNotFoundError:
            continue
        found.append(package)
    return found


def main(runs: int = 4) -> None:
    """Print the table."""
    rows: dict[str, list[Result]] = {}
    scores: dict[str, list[float]] = {}
    unit = 0.0
    for seed in range(runs):
        case: Any = Case(seed)
        unit = yardstick.seconds(case.rates, case.forces, 1.0 / 200.0, 50)
        ours, deviation = kreisel(case, "central-difference")
        truth = {g: np.ravel(case.truth["k_w" if g == "gyro_offset" else "k_a" if g == "accel_offset" else GROUPS[g]])
                 for g in JUDGED}  # fmt: skip
        found = {
            "kreisel": ours,
            "kreisel, ekf": kreisel(case, DERIVATIVES)[0],
            "NumPy, from the book": numpy_filter(case),
        }
        peers: dict[str, Callable[[Any], Result]] = {
            "filterpy UKF": lambda c: filterpy(c, len(c.samples)),
            "pyins EKF (fewer states)": pyins,
            "gtsam graph (biases only)": gtsam_graph,
            "gtsam preintegration (1 set)": gtsam,
        }
        for name, peer in peers.items():
            if seed > 0 and name.startswith("gtsam pre"):
                continue
            try:
                found[name] = peer(case)
            except ImportError as error:
                print(f"{name}: not installed ({error})", file=sys.stderr)
        for name, (seconds, values) in found.items():
            rows.setdefault(name, []).append((seconds, values))
            if values is not None:
                score = np.concatenate([(values[g] - truth[g]) / deviation[g] for g in values])
                scores.setdefault(name, []).append(float(np.mean(score**2)))
        print(f"run {seed + 1} of {runs} done", file=sys.stderr)
    first = min(seconds for seconds, _ in rows["kreisel"])
    print("versions: " + ", ".join(f"{package} {version(package)}" for package in _installed()))
    print(f"{'filter':30s} {'ms':>10s} {'strapdown passes':>17s} {'times kreisel':>14s} {'error over sd':>14s}")
    for name, results in rows.items():
        seconds = min(s for s, _ in results)
        score_text = f"{np.sqrt(np.mean(scores[name])):14.3f}" if name in scores else f"{'':>14s}"
        print(f"{name:30s} {seconds * 1e3:10.2f} {seconds / unit:17.1f} {seconds / first:14.1f} {score_text}")


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:2]))
