"""Passes of the filter over a problem: relinearised at each pass, noise corrected where the data say so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, replace

import numpy as np

from kreisel.calibration.filter_run import GATE, FilterRun, History, first_belief, look_back, run_filter
from kreisel.calibration.observability import unshown_groups
from kreisel.calibration.parameters import GROUPS, CellParameters
from kreisel.calibration.problem import Problem, hold, with_lasting_errors
from kreisel.estimation.consistency import chi_square, correlation_time, lag_one, mean_normalised
from kreisel.estimation.filter import Belief, triangularise, widen
from kreisel.geometry.rotation import Array, Mask, skew
from kreisel.inertial.earth import EARTH_RATE
from kreisel.recording import Finding
from kreisel.units import DEG_PER_HOUR

FIRST_GATE = 100.0
"""How much wider the gate stands in the first pass, when the parameters are still far off."""

MOST_NOISE_PASSES = 8
"""Passes spent at the most on finding noise figures where none are given or the given ones are contradicted."""

CONTRADICTION = 2.0
"""Factor on a given standard deviation from which the data are taken to contradict it."""

COLOURED = 0.3
"""Correlation of neighbouring innovations from which they no longer pass for white."""

NARROWING = 10.0
MOST_PASSES = 4
CURVATURE = 0.2

_AGREEMENT = 1.2

LONGEST = 40.0
"""Update intervals errors of the reference may last; what lasts longer is no error of the path."""

MOST_LUCK = 5.0
"""Log-likelihood a lasting error must bring before it is believed."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Estimate:
    """Final problem (with the noise finally believed), the run over it, and what to say about both.

    The belief's factor is already multiplied by `correlation_factor`. `contradiction` is the largest factor
    by which given noise figures had to be raised; 1 where none were given, or none had to.
    """

    problem: Problem
    run: FilterRun
    passes: int
    correlation_factor: float
    contradiction: float
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class NoiseFactors:
    """Factors by which believed standard deviations miss what the innovations show.

    position, orientation and standstill are the reference's, gyro and accel the IMU's.
    """

    position: float = 1.0
    orientation: float = 1.0
    standstill: float = 1.0
    gyro: float = 1.0
    accel: float = 1.0

    def agree(self) -> bool:
        """Whether all lie within 20 % of one."""
        return all(1.0 / _AGREEMENT < f < _AGREEMENT for f in astuple(self))

    def contradicted(self, *, reference: bool, imu: bool) -> NoiseFactors:
        """Return the factors without those of figures that were given and are not clearly too small."""

        def keep(f: float, *, given: bool) -> float:
            return f if not given or f > CONTRADICTION else 1.0

        return NoiseFactors(
            keep(self.position, given=reference),
            keep(self.orientation, given=reference),
            keep(self.standstill, given=reference),
            keep(self.gyro, given=imu),
            keep(self.accel, given=imu),
        )


def estimate(problem: Problem, *, reference_given: bool, imu_given: bool, progress: Progress | None = None) -> Estimate:
    """Return the estimate after all passes.

    Parameters
    ----------
    reference_given, imu_given
        Whether the noise figures are the user's word; they are then changed only if contradicted.
    """
    given = problem
    problem, run, done, changed = _passes(problem, 0, reference_given, imu_given, progress)
    problem, run, done = _lasting_errors(problem, run, done, progress)
    factor = correlation_factor(run.history)
    unshown = unshown_groups(problem, factor * run.belief.standard_deviation)
    findings: list[Finding] = []
    if unshown:
        problem, run, done, again = _passes(hold(problem, unshown), done, reference_given, imu_given, progress)
        changed |= again
        factor = correlation_factor(run.history)
        findings.append(
            Finding(
                "motion", f"does not show {', '.join(unshown)}: held at nominal values (--fix does the same at once)"
            )
        )
    if changed:
        findings.append(_noise_finding(problem, given=reference_given and imu_given))
    if problem.correlation_time > 0.0:
        findings.append(
            Finding("whiteness", f"the reference's errors on the path last for about {problem.correlation_time:.2g} s")
        )
    if factor > 1.0:
        findings.append(
            Finding(
                "whiteness",
                f"innovations are correlated in time; standard deviations were multiplied by {factor:.2f} for it",
            )
        )
    contradiction = _contradiction(given, problem, reference=reference_given, imu=imu_given)
    run = towards_prior(problem, run)
    belief = Belief(run.belief.mean, factor * run.belief.factor)
    if max(problem.frame_sd) > 0.0:
        belief = _with_frame_doubt(problem, run, belief)
        length, angle = (1e3 * sd for sd in problem.frame_sd)
        findings.append(
            Finding(
                "robot",
                f"its errors are stated but not estimated (no joint angles with robot.urdf): {length:.2g} mm and "
                f"{angle:.2g} mrad were added for where base and tool may lie",
            )
        )
    if problem.site.earth_rate_n is None and "gyro_offset" in problem.layout:
        belief = widen(problem.layout, belief, "gyro_offset", EARTH_RATE / 3**0.5)
        findings.append(
            Finding(
                "site",
                f"no latitude is given, so the Earth's rotation is left out; {EARTH_RATE / DEG_PER_HOUR / 3**0.5:.1f} "
                "deg/h were added to the gyro offset's standard deviation for it (site.latitude_deg in recording.toml)",
            )
        )
    return Estimate(problem, replace(run, belief=belief), done, factor, contradiction, tuple(findings))


def _with_frame_doubt(problem: Problem, run: FilterRun, belief: Belief) -> Belief:
    """Return the belief with the doubt where the base's and the tool's frame lie.

    A tool turned by a small angle turns both cross-coupling matrices and the lever arms with it, one that
    is shifted shifts the lever arms; a base turned turns gravity.
    """
    layout, sensors = problem.layout, run.parameters.sensors
    length, angle = problem.frame_sd
    columns = np.zeros((layout.degrees, 8))
    for i, axis in enumerate(np.eye(3)):
        turned = angle * skew(axis)
        for group, value in (
            ("gyro_cross_coupling", turned @ sensors.K_omega),
            ("accel_cross_coupling", turned @ sensors.K_a),
            ("lever_arms", sensors.lever_arms @ turned.T),
        ):
            if group in layout:
                columns[layout[group], i] = value.ravel()
        if "lever_arms" in layout:
            columns[layout["lever_arms"], 3 + i] = np.tile(length * axis, 3)
    if "alignment" in layout:
        columns[layout["alignment"], 6:] = angle * np.eye(2)
    return replace(belief, factor=triangularise(np.hstack([belief.factor, columns])))


def _contradiction(given: Problem, final: Problem, *, reference: bool, imu: bool) -> float:
    """Return the largest factor between noise figures finally believed and those the user gave."""
    ratios = [1.0]
    if reference:
        ratios += [final.noise.position / given.noise.position, final.noise.orientation / given.noise.orientation]
    if imu:
        ratios += [a / b for a, b in zip(imu_density(final), imu_density(given), strict=True)]
    return max(ratios)


def _passes(
    problem: Problem, done: int, reference_given: bool, imu_given: bool, progress: Progress | None
) -> tuple[Problem, FilterRun, int, bool]:
    """Run passes until they are as many as asked for and the noise figures fit; return their number too."""
    first = done
    run = run_filter(problem, problem.start, gate=FIRST_GATE, progress=_named(progress, f"pass {done + 1}"))
    done, changed = done + 1, False
    while True:
        factors = noise_factors(run.history, lasting=problem.correlation_time > 0.0).contradicted(
            reference=reference_given, imu=imu_given
        )
        factors = _within_bounds(problem, factors)
        if done == first + 1 and problem.reference.quaternions is None:
            factors = NoiseFactors()  # the attitude was a guess: such innovations say nothing of the noise
        settled = factors.agree() or done - first >= MOST_NOISE_PASSES
        if settled and not _another_pass(problem, run, done - first):
            return problem, run, done, changed
        problem = look_back(problem, run)
        if not factors.agree():
            problem, changed = _with_factors(problem, factors), True
        done += 1
        belief = narrowed_belief(problem, run)
        run = run_filter(problem, run.parameters, belief=belief, progress=_named(progress, f"pass {done}"))


def _lasting_errors(
    problem: Problem, run: FilterRun, done: int, progress: Progress | None
) -> tuple[Problem, FilterRun, int]:
    """Return problem and run with the reference's errors as a process in time, if innovations are coloured.

    How long they last is found by likelihood, doubling it from the update interval as long as that pays.
    """
    if problem.settings.passes is not None or not _coloured(run.history):
        return problem, run, done
    best, best_run = problem, run
    reference = run_filter(problem, run.parameters, belief=narrowed_belief(problem, run))
    likelihood = float(reference.history.log_likelihood.sum()) + MOST_LUCK
    time = 0.5 * problem.update_interval
    while time < LONGEST * problem.update_interval:
        trial = with_lasting_errors(problem, time)
        done += 1
        belief = narrowed_belief(trial, run)
        trial_run = run_filter(trial, run.parameters, belief=belief, progress=_named(progress, f"pass {done}"))
        found = float(trial_run.history.log_likelihood.sum())
        if found > likelihood:
            best, best_run, likelihood = trial, trial_run, found
        elif best is not problem:
            break
        time *= 2.0
    return best, best_run, done


def _coloured(history: History) -> bool:
    """Return whether innovations on the path are correlated from one update to the next."""
    path = history.used & ~history.at_rest
    return path.sum() >= 20 and float(np.nanmax(_lag_one_by_kind(history, path), initial=0.0)) > COLOURED


def _lag_one_by_kind(history: History, path: Mask) -> Array:
    """Return the mean correlation of neighbouring innovations of position and of orientation."""
    lags = lag_one(history.whitened[:, :6], path)
    return np.array([np.mean(lags[:3]), np.mean(lags[3:])])


def narrowed_belief(problem: Problem, run: FilterRun) -> Belief:
    """Return the belief a further pass begins with: the prior, and the pass before believed `NARROWING` times less.

    Sigma points then stay where the model is nearly linear, also along what the motion hardly tells apart; the
    same data are counted twice by one part in `NARROWING` squared.
    """
    belief = first_belief(problem, run.parameters)
    n = len(problem.parameter_names)
    if n == 0:
        return belief
    prior = belief.factor[:n, :n] @ belief.factor[:n, :n].T
    found = NARROWING**2 * run.belief.covariance[:n, :n]
    # P = (A^-1 + B^-1)^-1 = A (A + B)^-1 B, scaled by the prior's deviations
    scale = np.sqrt(np.diag(prior))
    A, B = (M / np.outer(scale, scale) for M in (prior, found))
    P = A @ np.linalg.solve(A + B, B)
    factor = belief.factor.copy()
    factor[:n, :n] = scale[:, None] * np.linalg.cholesky(0.5 * (P + P.T) + 1e-15 * np.diag(np.diag(P)))
    return Belief(belief.mean, factor)


def _another_pass(problem: Problem, run: FilterRun, done: int) -> bool:
    """Return whether another pass is asked for, or pays.

    It pays where the estimates moved so far from where the pass began that what the sigma points leave of
    the model's curvature, about the square of the way, is not small against the standard deviation; and
    where the first pass, whose gate stands wide, let in what the usual gate would not: grossly, or often.
    """
    if problem.settings.passes is not None:
        return done < problem.settings.passes
    if done >= MOST_PASSES:
        return False
    beyond = run.history.used * run.history.nis / chi_square(GATE, run.history.degrees)
    let_in = bool((beyond > 4.0).any()) or float(np.mean(beyond > 1.0)) > 0.002
    if done == 1 and (let_in or problem.settings.polynomial_order > 1 or problem.reference.quaternions is None):
        return True
    layout = problem.layout
    angles = {"gyro_cross_coupling": 9, "accel_cross_coupling": 9, "alignment": 2}
    parts = [slice(layout[g].start, layout[g].start + n) for g, n in angles.items() if g in layout]
    if not parts:
        return False
    moved = layout.minus(run.belief.mean[:, None], first_mean(problem, run))[:, 0]
    way = max(float(np.max(np.abs(moved[part]))) for part in parts)
    deviation = min(float(np.median(run.belief.standard_deviation[part])) for part in parts)
    return way**2 > CURVATURE * deviation


def correlation_factor(history: History) -> float:
    """Return the factor on standard deviations that correlated innovations call for; 1 where they are white.

    Errors of the reference that last over several updates are counted as often as they are seen. Their
    number is effectively divided by the correlation time of the innovations, the larger of those of
    position and orientation. Innovations smaller than believed already leave room for that.
    """
    path = history.used & ~history.at_rest
    size = min(mean_normalised(history.nis[path], history.degrees[path]), 1.0) if path.any() else 1.0
    times = []
    for rows in (slice(0, 3), slice(3, 6)):
        series = history.whitened[path, rows]
        if series.shape[0] < 20 or not np.isfinite(series).all():
            continue
        if float(np.mean(lag_one(series, np.ones(series.shape[0], dtype=bool)))) > COLOURED:
            times.append(float(np.mean([correlation_time(series[:, i]) for i in range(3)])))
    return float(np.sqrt(max(1.0, size * max(times, default=1.0))))


def noise_factors(history: History, *, lasting: bool = False) -> NoiseFactors:
    """Return how far believed and shown noise differ.

    Where the reference's errors last, innovations and what is left of them no longer tell their size: the
    mean NIS then stands for both position and orientation.

    Notes
    -----
    Reference: innovation times what is left of it after the update has the measurement noise as its
    expectation (Desroziers, Berre, Chapnik and Poli 2005). IMU: the updates' corrections of attitude and
    velocity against the variance the filter expected of them. The largest two per cent are left out.
    """
    settled = np.arange(history.nis.size) >= history.nis.size // 10
    path = settled & ~history.at_rest & history.used

    def reference(rows: slice) -> float:
        product = np.sum(history.innovation[path, rows] * history.residual[path, rows], axis=1)
        return _trimmed_ratio(product, np.sum(history.noise_variance[path, rows], axis=1))

    def imu(rows: slice) -> float:
        size = np.sum(history.correction[path, rows] ** 2, axis=1)
        return _trimmed_ratio(size, np.sum(history.correction_variance[path, rows], axis=1))

    at_rest = settled & history.at_rest
    standstill = 1.0
    if at_rest.sum() >= 6:
        ratio = float(np.median(history.nis[at_rest] / history.degrees[at_rest]))
        standstill = float(np.sqrt(np.clip(ratio, 1.0, 1e3)))
    size = float(np.sqrt(mean_normalised(history.nis[path], history.degrees[path]))) if lasting and path.any() else None
    return NoiseFactors(
        position=reference(slice(0, 3)) if size is None else size,
        orientation=reference(slice(3, 6)) if size is None else size,
        standstill=standstill,
        gyro=imu(slice(3, 6)),
        accel=imu(slice(0, 3)),
    )


def _within_bounds(problem: Problem, factors: NoiseFactors) -> NoiseFactors:
    """Keep the densities within what the problem allows, and the reference's noise above a tenth of the guess."""
    limited = []
    for density, factor, (low, high) in zip(
        imu_density(problem), (factors.gyro, factors.accel), problem.imu_bounds, strict=True
    ):
        limited.append(float(np.clip(density * factor, low, high)) / density)
    return replace(
        factors,
        gyro=limited[0],
        accel=limited[1],
        position=max(factors.position, problem.least_noise[0] / problem.noise.position),
        orientation=max(factors.orientation, problem.least_noise[1] / problem.noise.orientation),
    )


def _trimmed_ratio(shown: Array, believed: Array) -> float:
    """Return the root of the mean ratio, without its largest and smallest two per cent."""
    if shown.size < 15 or not np.isfinite(shown).all():
        return 1.0
    ratio = np.sort(shown / believed)
    cut = max(1, ratio.size // 50)
    return float(np.sqrt(np.clip(np.mean(ratio[cut:-cut]), 1e-2, 1e4)))


def _with_factors(problem: Problem, factors: NoiseFactors) -> Problem:
    noise, signal = problem.noise, problem.signal
    return replace(
        problem,
        noise=replace(
            noise,
            position=noise.position * factors.position,
            orientation=noise.orientation * factors.orientation,
            standstill_position=noise.standstill_position * factors.standstill,
            standstill_orientation=noise.standstill_orientation * factors.standstill,
            jitter_position=noise.jitter_position * factors.standstill,
            jitter_orientation=noise.jitter_orientation * factors.standstill,
            velocity=noise.velocity * factors.standstill,
        ),
        signal=replace(
            signal,
            rate_variance=signal.rate_variance * factors.gyro**2,
            force_variance=signal.force_variance * factors.accel**2,
        ),
    )


def imu_density(problem: Problem) -> tuple[float, float]:
    """Return the noise densities believed in, gyro and accelerometer, rms over the axes, SI."""
    dt = np.diff(problem.signal.stamps)[:, None]
    variance = [np.median(v / dt, axis=0).mean() for v in (problem.signal.rate_variance, problem.signal.force_variance)]
    return float(np.sqrt(variance[0])), float(np.sqrt(variance[1]))


def _noise_finding(problem: Problem, *, given: bool) -> Finding:
    noise = problem.noise
    gyro, accel = imu_density(problem)
    figures = (
        f"reference {noise.position * 1e3:.3g} mm and {noise.orientation * 1e3:.3g} mrad on the path, "
        f"{noise.standstill_position * 1e3:.3g} mm and {noise.standstill_orientation * 1e3:.3g} mrad at rest; "
        f"gyro {gyro:.3g} rad/s/sqrt(Hz), accelerometer {accel:.3g} m/s^2/sqrt(Hz)"
    )
    if given:
        return Finding("noise", f"given noise figures contradict the data; used instead: {figures}")
    return Finding("noise", f"found from the data: {figures}")


def towards_prior(problem: Problem, run: FilterRun) -> FilterRun:
    """Return the run with the prior put back where it belongs.

    A pass that starts from estimates carries its prior centred there. To first order the mean is mended by
    the posterior covariance times the prior's information times the distance of the two centres.
    """
    layout = problem.layout
    change = np.zeros(layout.degrees)
    start = first_mean(problem, run)
    for group in problem.groups:
        d, s = layout[group], layout.stored(group)
        if group == "alignment":
            continue  # its prior is weak, and its centre a rotation
        change[d] = np.linalg.solve(problem.prior_covariance[group], problem.prior.stored(group) - start[s])
    moved = run.belief.covariance @ change
    mean = layout.plus(run.belief.mean, moved[:, None])[:, 0].copy()
    values = {g: run.parameters.stored(g) for g in GROUPS}
    values.update({g: mean[layout.stored(g)] for g in problem.groups})
    return replace(run, belief=Belief(mean, run.belief.factor), parameters=CellParameters.from_stored(values))


def first_mean(problem: Problem, run: FilterRun) -> Array:
    """Return the stored state a run started from."""
    mean = np.zeros(problem.layout.size)
    mean[problem.layout.stored("attitude")] = (1.0, 0.0, 0.0, 0.0)
    for group in problem.groups:
        mean[problem.layout.stored(group)] = run.start.stored(group)
    return mean


def _named(progress: Progress | None, name: str) -> Callable[[float], None] | None:
    if progress is None:
        return None
    return lambda share: progress(name, share)
