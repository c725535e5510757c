"""Estimation from standstills in many attitudes: first values, Gauss-Newton, noise, effects, and what does not fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, Indices
from kreisel.inertial.effects import OF_TEMPERATURE
from kreisel.model.considered_terms import MIN_GAIN, USUAL_ODDS, Considered
from kreisel.model.parameters import CellParameters
from kreisel.progress import StepProgress
from kreisel.static.rest_chain import ACCEL_WALK, ATTITUDE, GYRO_WALK, Equations, Solution
from kreisel.static.rest_equations import Linear, attitudes_by, linearised, moved
from kreisel.static.rest_noise import NO_NOISE, RestNoise, Weighing, as_row, find_noise, solution, weighing
from kreisel.static.rest_problem import RestProblem, begun
from kreisel.static.turns import turns_between

_ITERATIONS, _SEARCHES, _SETTLED = 20, 4, 0.01
"""Steps of Gauss-Newton at most; noise is estimated in so many first steps, and then once in so many; change of every
parameter, in deviations, with which the steps end."""

KINDS = ("force", "rate", "turn")
"""Names of what is measured at standstills and between them, in the order of the equations; what is known follows."""

_MISFIT, _ODDS, _NOTHING = 3.5, 3.0, 1e4
"""Deviations of a row beyond which a standstill or a turn is suspected, gain of evidence with which it is left out, and
variance with which a row says nothing, over its own."""

_LARGE_FORCE, _LARGE_TURN, _SOME, _TRIED = 0.05, 0.01, 1.3, 6
"""m/s^2 and sqrt(s): noise figures from which on a single row may have made them large. Deviations from which on rows
are then left out by turns, and their largest number; the evidence decides. Chosen: usual figures are a tenth."""

_NOTHING_FITS = (
    "the readings do not fit standstills and turns: are rates and accelerations of one device, in rad/s and m/s^2?"
)
"""What is said of readings from which no finite numbers come."""

_FAR = 50.0
"""Logarithm of odds beyond which they count as certain."""

CANDIDATES = (
    "gyro_polynomial", "gyro_asymmetry", "gyro_cubic", "gyro_axis_smoothing", "gyro_temperature",
    "gyro_scale_temperature", "accel_polynomial", "accel_asymmetry", "accel_temperature", "accel_scale_temperature",
)  # fmt: skip
"""Effects that are looked for; those of temperature where it was recorded. A cubic term of accelerometers is not among
them: in a public recording it took twice of what a second accelerometer beside the first confirms."""

_EVEN, _ENOUGH_FACES = ("accel_polynomial", "accel_asymmetry"), 10
"""Effects that six faces show by the faces' tilts alone, and faces that show how large these are. Chosen: six have
twelve tilts, nine of which go into the case and the offsets; by three of them effects were found that are not there."""


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
        rows = self.rows
        return tuple((k, int(n)) for k, v in self.inflated.items() for n in rows[k].node[v > 0.0])

    @property
    def rows(self) -> dict[str, Equations]:
        """Equations by kind, without those of walks."""
        linear = self.linear
        own = zip(KINDS, linear.all, strict=False)
        return {**dict(own), **{k.kind: e for k, e in zip(self.problem.known, linear.known, strict=True)}}

    @property
    def walks(self) -> tuple[Array, Array]:
        """How far the offsets of gyros and accelerometers are from those in the middle, (M, 3) each."""
        return self._nodes[:, GYRO_WALK], self._nodes[:, ACCEL_WALK]

    @property
    def residuals(self) -> dict[str, Array]:
        """What is left by kind, (k, 3) each, in deviations of a row."""
        x, out = self._nodes, {}
        change = self._step.parameters[0]  # along what nothing shows, and attitudes follow
        for kind, one in self.rows.items():
            left = one.residual + np.einsum("kia,ka->ki", one.of_node, x[one.node]) + one.of_parameters @ change
            if one.of_next is not None:
                left += np.einsum("kia,ka->ki", one.of_next, x[one.node + 1])
            out[kind] = left / np.sqrt(self.variances[kind])
        return out

    @property
    def variances(self) -> dict[str, Array]:
        """Variances of the rows of each kind but walks, (k, 3)."""
        own = [variance[0] for variance in self.weighing.variances(as_row(self.noise))]
        return dict(zip(self.rows, [*own[:3], *own[5:]], strict=True))

    @cached_property
    def _step(self) -> Solution:
        """The step that follows the last one."""
        zero = np.zeros(self.problem.layout.degrees)
        return solution(self.problem, self.linear, self.weighing, as_row(self.noise), zero)

    @property
    def _nodes(self) -> Array:
        """What is left of every standstill's unknowns about the estimate, (M, NODE)."""
        return self._step.nodes[0]


def estimate_static(
    problem: RestProblem, start: CellParameters, progress: StepProgress | None = None, attitudes: Array | None = None
) -> StaticEstimate:
    """Return the estimate: usual parameters from `start`, then what does not fit is left out, then effects.

    attitudes: first ones (M, 3, 3), if something gives them.

    Raises
    ------
    RecordingError
        If nothing fits.
    """
    tell = progress or (lambda _: None)
    tell(0.1)
    found = fitted(problem, start, NO_NOISE, {}, attitudes)
    if problem.own_frame and (np.diag(found.parameters.sensors.K_a) < 0.0).any():
        found = fitted(problem, _mirrored(found.parameters), found.noise, {})
    tell(0.2)
    found = _robust(found, tell)
    tell(0.4)
    found = _with_effects(found, tell)
    tell(1.0)
    return found


def _mirrored(p: CellParameters) -> CellParameters:
    """Return parameters that explain all readings as well, with accelerometers that read positive along their axes.

    In a mirror forces are reflected, and rates, which are axial vectors, by the negative reflection.
    """
    S = np.diag(np.sign(np.diag(p.sensors.K_a)))
    sensors = replace(p.sensors, K_a=S @ p.sensors.K_a, K_omega=np.linalg.det(S) * S @ p.sensors.K_omega)
    return replace(p, sensors=sensors)


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
        if not np.isfinite(found.log_evidence).all():
            raise RecordingError(_NOTHING_FITS, file=problem.imu.source)
        if i == steps or settled.all():
            break
        change, nodes = found.parameters[0], found.nodes[0]
        p, C = problem.changed(p, change), moved(C, nodes[:, ATTITUDE])
        settled = np.abs(change) < _SETTLED / np.sqrt(np.diag(found.information[0]))
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


def part_about(found: StaticEstimate, own: Indices) -> tuple[Array, Array]:
    """Return what some standstills in a row say by themselves: a change of the parameters (P,), its covariance (P, P).

    By one step from the estimate, with the noise of all: where a part does not show a parameter, steps that follow each
    other would lead it anywhere, and few rows show little of their noise.
    """
    problem, p = found.problem.part(own), found.parameters
    inflated = {}
    for kind, variances in found.inflated.items():
        rows = found.rows[kind]
        last = rows.node if rows.of_next is None else rows.node + 1
        inflated[kind] = variances[(rows.node >= own[0]) & (last <= own[-1])]
    linear = linearised(problem, p, found.attitudes[own])
    how = weighing(problem, linear, inflated)
    found_here = solution(problem, linear, how, as_row(found.noise), np.zeros(problem.layout.degrees))
    return found_here.parameters[0], found_here.covariance[0]


def _robust(found: StaticEstimate, tell: StepProgress) -> StaticEstimate:
    """Return the estimate without standstills and turns that do not fit, one after the other.

    A row that is left out has a variance so large that it says nothing; the evidence pays for it.
    """
    most = found.problem.rests.count // 4
    for done in range(most):
        tell(0.2 + 0.2 * done / most)
        far = {kind: np.abs(r).max(axis=1) for kind, r in found.residuals.items() if r.size}
        rows = sorted(((float(r), kind, k) for kind, own in far.items() for k, r in enumerate(own)), reverse=True)
        # a noise figure that one row makes large hides this row, and others look as bad
        hidden = found.noise.force > _LARGE_FORCE or found.noise.turn > _LARGE_TURN
        doubtful = [one for one in rows[:_TRIED] if one[0] >= _SOME] if hidden else rows[:1]
        if not doubtful or (not hidden and doubtful[0][0] < _MISFIT):
            break
        again = max((_without_row(found, kind, row) for _, kind, row in doubtful), key=lambda one: one.log_evidence)
        if again.log_evidence - found.log_evidence < _ODDS:
            break
        found = again
    return found


def _without_row(found: StaticEstimate, kind: str, row: int) -> StaticEstimate:
    """Return the estimate in which a row says nothing."""
    inflated = {key: value.copy() for key, value in found.inflated.items()}
    own = inflated.setdefault(kind, np.zeros(len(found.variances[kind])))
    own[row] = _NOTHING * float(np.mean(found.variances[kind][row]))
    return fitted(found.problem, found.parameters, found.noise, inflated, found.attitudes)


def _with_effects(found: StaticEstimate, tell: StepProgress) -> StaticEstimate:
    """Return the estimate with effects that the data show, the clearest first."""
    usual = found
    first: dict[str, StaticEstimate] = {}
    others, unsure = [usual], () if shows_even_terms(usual.problem) else _EVEN
    candidates = [c for c in CANDIDATES if c not in OF_TEMPERATURE or found.problem.imu.temperature is not None]
    while True:
        trials = {}
        for group in candidates:
            if group in found.problem.effects:
                continue
            tell(0.4 + 0.3 * len(first) / len(candidates))
            problem = found.problem.with_effects((*found.problem.effects, group))
            trials[group] = fitted(problem, found.parameters, found.noise, found.inflated, found.attitudes, steps=1)
            first.setdefault(group, trials[group])
        others += trials.values()
        sure = [group for group in trials if group not in unsure]
        best = max(sure, key=lambda group: trials[group].log_evidence, default="")
        if not best or trials[best].log_evidence - found.log_evidence < MIN_GAIN:
            break
        one = trials[best]
        found = fitted(one.problem, one.parameters, one.noise, found.inflated, one.attitudes)
        tell(0.7)
    considered = [_considered(group, one, usual, found) for group, one in first.items()]
    undecided = [
        undecided_by(found, one, USUAL_ODDS ** (len(one.problem.effects) - len(found.problem.effects)))
        for one in others
        if one.problem.effects != found.problem.effects
    ]
    open_ = np.column_stack(undecided) if undecided else found.undecided
    if not np.isfinite(open_).all():
        raise RecordingError(_NOTHING_FITS, file=found.problem.imu.source)
    return replace(found, considered=tuple(sorted(considered, key=lambda c: -c.gain)), undecided=open_)


def shows_even_terms(problem: RestProblem) -> bool:
    """Return whether gravity, or faces enough, separate even terms of the accelerometers from their offsets."""
    faces = [len(one.white) for one in problem.known if one.kind == "face"]
    return not faces or max(faces) >= _ENOUGH_FACES or max(faces) < problem.rests.count // 2


def undecided_by(found: StaticEstimate, other: StaticEstimate, odds: float) -> Array:
    """Return what another model would do to the parameters, (P, k), by the probability that it is the right one.

    The square of the first column is that of the change, of the others what it leaves open beyond the estimate.

    odds: of the other model, before any look at the data.
    """
    problem = found.problem
    gain = other.log_evidence - found.log_evidence + np.log(odds)
    share = 1.0 / (1.0 + np.exp(-np.clip(gain, -_FAR, _FAR)))
    change = problem.values(problem.room(other.parameters)) - problem.values(found.parameters)
    names = {name: i for i, name in enumerate(other.problem.names)}
    own = np.array([i for i, name in enumerate(problem.names) if name in names])
    theirs = np.array([names[problem.names[i]] for i in own])
    size = found.deviation[own]
    open_ = (other.covariance[np.ix_(theirs, theirs)] - found.covariance[np.ix_(own, own)]) / np.outer(size, size)
    values, vectors = np.linalg.eigh(open_)
    spread = np.zeros((change.size, own.size))
    spread[own] = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(np.sqrt(share) * np.column_stack([change, spread]))


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
