"""Estimation from standstills in many attitudes: first values, Gauss-Newton, noise, effects, and what does not fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, right_angle_turns
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.considered_terms import MIN_GAIN, USUAL_ODDS, Considered
from kreisel.model.parameters import CellParameters
from kreisel.progress import StepProgress
from kreisel.static.rest_equations import ACCEL_WALK, ATTITUDE, GYRO_WALK, Linear, attitudes_by, linearised, moved
from kreisel.static.rest_noise import NO_NOISE, RestNoise, Weighing, as_row, find_noise, solution, weighing
from kreisel.static.rest_problem import RestProblem, begun
from kreisel.static.turns import turns_between

MIN_ATTITUDES = 6
"""Fewest standstills. Chosen: scale factors and offsets of three axes need six; fewer show nothing of their own."""

_ITERATIONS, _SEARCHES, _SETTLED = 20, 4, 0.01
"""Steps of Gauss-Newton at most; noise is estimated in so many first steps, and then once in so many; change of every
parameter, in deviations, with which the steps end."""

KINDS = ("force", "rate", "turn")
"""Names of what is measured at standstills and between them, in the order of the equations."""

_MISFIT, _ODDS, _NOTHING = 3.5, 3.0, 1e4
"""Deviations of a row beyond which a standstill or a turn is suspected, gain of evidence with which it is left out, and
variance with which a row says nothing, over its own."""

CANDIDATES = ("gyro_polynomial", "gyro_asymmetry", "gyro_temperature", "accel_polynomial",
              "accel_asymmetry", "accel_temperature")  # fmt: skip
"""Effects that are looked for; those of temperature where it was recorded."""


@dataclass(frozen=True)
class StaticEstimate:
    """An estimate from standstills.

    Attributes
    ----------
    parameters, covariance
        And its covariance (P, P), in the order of `problem.names`.
    attitudes : (M, 3, 3)
        From b to the local level.
    noise
        Noise figures found.
    linear, weighing
        Equations about the estimate, and how they are weighed.
    considered
        Effects that were looked for.
    inflated
        Variances by which rows (k,) that do not fit are inflated, by kind.
    undecided : (P, k)
        What effects that are not estimated may do to the parameters, in deviations of one.
    """

    problem: RestProblem
    parameters: CellParameters
    covariance: Array
    attitudes: Array
    noise: RestNoise
    linear: Linear
    weighing: Weighing
    log_evidence: float
    considered: tuple[Considered, ...] = ()
    inflated: Mapping[str, Array] = field(default_factory=dict)
    undecided: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def deviation(self) -> Array:
        """Standard deviations, (P,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def left_out(self) -> tuple[tuple[str, int], ...]:
        """What does not fit: kinds and numbers of standstills."""
        rows = dict(zip(KINDS, self.linear.all, strict=False))
        return tuple((k, int(n)) for k, v in self.inflated.items() for n in rows[k].node[v > 0.0])

    @property
    def walks(self) -> tuple[Array, Array]:
        """How far the offsets of gyros and accelerometers are from those in the middle, (M, 3) each."""
        return self._nodes[:, GYRO_WALK], self._nodes[:, ACCEL_WALK]

    @property
    def residuals(self) -> tuple[Array, ...]:
        """What is left of force, rate and turn, (k, 3) each, in deviations of a row."""
        x, out = self._nodes, []
        for one, variance in zip(self.linear.all[:3], self.variances, strict=False):
            left = one.residual + np.einsum("kia,ka->ki", one.of_node, x[one.node])
            if one.of_next is not None:
                left += np.einsum("kia,ka->ki", one.of_next, x[one.node + 1])
            out.append(left / np.sqrt(variance))
        return tuple(out)

    @property
    def variances(self) -> list[Array]:
        """Variances of the rows of each kind, (k, 3)."""
        return [variance[0] for variance in self.weighing.variances(as_row(self.noise))]

    @cached_property
    def _nodes(self) -> Array:
        """What is left of every standstill's unknowns about the estimate, (M, NODE)."""
        zero = np.zeros(self.problem.layout.degrees)
        return solution(self.problem, self.linear, self.weighing, as_row(self.noise), zero).nodes()[0]


def estimate_static(problem: RestProblem, progress: StepProgress | None = None) -> StaticEstimate:
    """Return the estimate: usual parameters, then what does not fit is left out, then effects the data show.

    Raises
    ------
    RecordingError
        If there are too few attitudes, or nothing fits.
    """
    if problem.rests.count < MIN_ATTITUDES:
        raise RecordingError(
            f"{problem.rests.count} standstills, expected {MIN_ATTITUDES} or more in different attitudes, a dozen if "
            "possible", file=problem.imu.source,
        )  # fmt: skip
    tell = progress or (lambda _: None)
    start = first_values(problem)
    tell(0.1)
    found = _robust(fitted(problem, start, NO_NOISE, {}))
    tell(0.4)
    found = _with_effects(found, tell)
    tell(1.0)
    return found


def first_values(problem: RestProblem) -> CellParameters:
    """Return parameters by which all forces are about as long as gravity, and the gyros turned as the forces say."""
    K, k = _by_length(problem.rests.forces, problem.site.gravity)
    sensors = SensorParameters(np.eye(3), np.zeros((1, 3)), K, k[None], np.zeros((3, 3)))
    sensors = replace(sensors, k_w=-np.median(problem.rests.rates, axis=0)[None])
    up = (problem.rests.forces + k) @ K.T
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    best, least = sensors, np.inf
    for sign in (1.0, -1.0):
        own = replace(sensors, K_omega=sign * np.eye(3))
        turns = turns_between(problem.imu, problem.raw, problem.rests, own)
        for Q in right_angle_turns():
            seen = np.einsum("ij,mkj,kl,ml->mi", Q, turns.rotations, Q.T, up[:-1])
            misfit = float(np.median(np.linalg.norm(seen - up[1:], axis=1)))
            if misfit < least:
                best, least = replace(sensors, K_omega=sign * Q), misfit
    return begun(best, problem.site)


def _by_length(forces: Array, gravity: float) -> tuple[Array, Array]:
    """Return an upper triangular K (3, 3) and k (3,) with |K (a + k)| = g, from no errors on, by Gauss-Newton."""
    places = np.triu_indices(3)
    x = np.concatenate([np.eye(3)[places], np.zeros(3)])
    damping = np.diag([1e-3] * 6 + [1e-5] * 3)  # of what few attitudes do not show
    for _ in range(_ITERATIONS):
        K = np.zeros((3, 3))
        K[places] = x[:6]
        y = forces + x[6:]
        f = y @ K.T
        length = np.linalg.norm(f, axis=1)
        u = f / length[:, None]
        J = np.column_stack([*(u[:, i] * y[:, j] for i, j in zip(*places, strict=True)), u @ K])
        step = np.linalg.solve(J.T @ J + damping, J.T @ (gravity - length))
        x = x + step
    return K, x[6:]


def fitted(
    problem: RestProblem, start: CellParameters, noise: RestNoise, inflated: Mapping[str, Array],
    attitudes: Array | None = None, *, steps: int = _ITERATIONS,
) -> StaticEstimate:  # fmt: skip
    """Return the least-squares estimate, with noise figures by the evidence.

    Parameters
    ----------
    noise
        First values of the noise figures.
    inflated
        Variances of rows that do not fit; see `weighing`.
    attitudes
        First ones; by forces and gyros if not given.
    steps
        Of Gauss-Newton, at most.
    """
    p = problem.room(start)
    C = attitudes
    if C is None:
        C = attitudes_by(problem, p, turns_between(problem.imu, problem.raw, problem.rests, p.sensors))
    prior = problem.room(begun(start.sensors, problem.site))
    figures, settled = noise, np.zeros(1, dtype=bool)
    for i in range(steps + 1):
        linear = linearised(problem, p, C)
        how = weighing(problem, linear, inflated)
        about = problem.values(prior) - problem.values(p)
        if i < _SEARCHES or i % _SEARCHES == 0:
            figures = find_noise(problem, linear, how, about, figures)
        found = solution(problem, linear, how, as_row(figures), about)
        if i == steps or settled.all():
            break
        change, nodes = found.parameters[0], found.nodes()[0]
        p, C = problem.changed(p, change), moved(C, nodes[:, ATTITUDE])
        settled = np.abs(change) < _SETTLED / np.sqrt(np.diag(found.information[0]))
    if not np.isfinite(found.log_evidence).all():
        raise RecordingError(
            "the readings do not fit standstills and turns: are rates and accelerations of one device, in rad/s and "
            "m/s^2?", file=problem.imu.source,
        )  # fmt: skip
    return StaticEstimate(
        problem,
        p,
        found.covariance[0],
        C,
        figures,
        linear,
        how,
        float(found.log_evidence[0]),
        inflated=inflated,
        undecided=np.zeros((problem.layout.degrees, 0)),
    )


def _robust(found: StaticEstimate) -> StaticEstimate:
    """Return the estimate without standstills and turns that do not fit, one after the other.

    A row that is left out has a variance so large that it says nothing; the evidence pays for it.
    """
    for _ in range(found.problem.rests.count // 4):
        far = [np.abs(r).max(axis=1) if r.size else np.zeros(1) for r in found.residuals]
        kind = int(np.argmax([f.max() for f in far]))
        row, name = int(np.argmax(far[kind])), KINDS[kind]
        if far[kind][row] < _MISFIT:
            break
        inflated = {key: value.copy() for key, value in found.inflated.items()}
        own = inflated.setdefault(name, np.zeros(far[kind].size))
        own[row] = _NOTHING * float(np.mean(found.variances[kind][row]))
        again = fitted(found.problem, found.parameters, found.noise, inflated, found.attitudes)
        if again.log_evidence - found.log_evidence < _ODDS:
            break
        found = again
    return found


def _with_effects(found: StaticEstimate, tell: StepProgress) -> StaticEstimate:
    """Return the estimate with effects that the data show, the clearest first."""
    usual = found
    first: dict[str, StaticEstimate] = {}
    candidates = [c for c in CANDIDATES if "temperature" not in c or found.problem.imu.temperature is not None]
    while True:
        trials = {}
        for group in candidates:
            if group in found.problem.effects:
                continue
            problem = found.problem.with_effects((*found.problem.effects, group))
            trials[group] = fitted(problem, found.parameters, found.noise, found.inflated, found.attitudes, steps=1)
            first.setdefault(group, trials[group])
        best = max(trials, key=lambda group: trials[group].log_evidence, default="")
        if not best or trials[best].log_evidence - found.log_evidence < MIN_GAIN:
            break
        one = trials[best]
        found = fitted(one.problem, one.parameters, one.noise, found.inflated, one.attitudes)
        tell(0.7)
    considered = [_considered(group, one, usual, found) for group, one in first.items()]
    undecided = [_undecided(found, one) for one in trials.values()]
    return replace(
        found,
        considered=tuple(sorted(considered, key=lambda c: -c.gain)),
        undecided=np.column_stack(undecided) if undecided else found.undecided,
    )


def _undecided(found: StaticEstimate, trial: StaticEstimate) -> Array:
    """Return what an effect that is not estimated would do to the parameters, (P,), by the chance that there is one."""
    odds = USUAL_ODDS * np.exp(min(trial.log_evidence - found.log_evidence, MIN_GAIN))
    problem = found.problem
    change = problem.values(problem.room(trial.parameters)) - problem.values(found.parameters)
    return np.asarray(np.sqrt(odds / (1.0 + odds)) * change)


def _considered(group: str, trial: StaticEstimate, without: StaticEstimate, final: StaticEstimate) -> Considered:
    included = group in final.problem.effects
    best = final if included else trial
    layout = best.problem.layout
    d = layout[group]
    usual = without.problem
    shift = (usual.values(trial.parameters) - usual.values(without.parameters)) / without.deviation
    place = int(np.argmax(np.abs(shift)))
    return Considered(
        group, best.parameters.stored(group), best.deviation[d], trial.log_evidence - without.log_evidence, included,
        float(abs(shift[place])), usual.names[place],
    )  # fmt: skip
