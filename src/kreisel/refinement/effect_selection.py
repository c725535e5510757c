"""Which effects a recording shows: all that are possible are linearised once, together, and weighed by their evidence.

What the data say of the parameters of all candidates, all others estimated, is a normal distribution, and so is what
they say of some of them with the rest zero. The evidence for a candidate is the ratio of the likelihoods of the data
with and without it, each a mean over the prior: an effect with a wide prior has to gain more. No further pass is needed
to compare models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from kreisel.estimation.belief import Belief
from kreisel.estimation.consistency import mean_normalised
from kreisel.fitting.fit import Estimator, Fit, Linearised
from kreisel.fitting.result_change import result_moved, with_unit_of_data
from kreisel.fitting.stored_state import parameters_of, stored_state
from kreisel.geometry.rotation import Array, Indices
from kreisel.inertial.effects import EFFECTS, OF_TEMPERATURE, RawReadings
from kreisel.model.calibration_settings import BY_CHOICE, CUBES
from kreisel.model.considered_terms import MIN_GAIN, USUAL_ODDS, Considered
from kreisel.model.groups import group_named
from kreisel.model.parameters import GROUPS, POSE_GROUPS, ROBOT_GROUPS
from kreisel.model.problem import Problem, usual_covariance, with_groups, with_nominal, without_groups
from kreisel.progress import StepProgress
from kreisel.refinement.correlated_innovations import correlation_factor
from kreisel.refinement.named_terms import OFFSET_OF, has_offsets, named_terms
from kreisel.tasks import Executor, sequential

UNLIKELY_ODDS, LIKELY_ODDS, EXPECTED_ODDS = 1e-3, 1.0, 20.0
"""Odds, before any look at the data, that a device has an effect that contradicts what the user states, one that is
common in devices like it, and one that its grade states; of any other they are `USUAL_ODDS`."""

_CAREFUL = 0.25
"""Power of the tempering by which more evidence is needed."""

_GATE = 100.0
"""Factor on the gate: noise may be larger than assumed."""

_TRUSTED = 0.7
"""Tempering of a linearisation above which it is taken as it is: below, effects may be too large for it."""

_ENOUGH = 10_000
"""Samples that show the mean of a reading."""

_MIN_TEMPERATURE_CHANGE = 0.5
"""K."""

_JOINTS_OF_FRAMES = 2
"""The first and the last joint: errors of their zeros are errors of the base and the tool frame."""

_OF_MOUNT, _CLEARLY = ("mount_bending", "mount_deflection"), 15.0
"""Effects with many parameters that follow whatever turns with gravity, and how much more evidence than others they
need. Chosen: a mount that bends by 0.3 mrad/g shows by 100 and more; errors on no list were taken for one by 20."""

_OF_POSITIONS = ("position_scale", "position_heading", "mount_deflection")
_POLYNOMIALS = ("gyro_polynomial", "accel_polynomial")


def candidates(problem: Problem) -> tuple[str, ...]:
    """Return the effects that a problem may have beyond those that are in its state or fixed."""
    reference, order, out = problem.reference, problem.settings.polynomial_order, []
    for group in (*BY_CHOICE, *_POLYNOMIALS):
        needs_positions = group in (*_OF_POSITIONS, *ROBOT_GROUPS) or group.startswith("accel")
        possible = reference.positions is not None or not needs_positions
        possible &= reference.quaternions is not None or group not in POSE_GROUPS
        possible &= problem.robot is not None or group not in ROBOT_GROUPS
        possible &= not group_named(group).rare or group in problem.prior.expected
        possible &= group not in OF_TEMPERATURE or _temperature_changes(problem)
        possible &= group != "position_scale" or problem.robot is None  # the arm's lengths are its own
        possible &= group != "position_heading" or group in problem.prior.likely  # one device has one frame for both
        possible &= group != "gyro_cubic" or "gyro_polynomial" not in problem.layout or order < CUBES
        possible &= group != "robot_zeros" or problem.joints > _JOINTS_OF_FRAMES
        possible &= group not in EFFECTS or has_offsets(problem, OFFSET_OF[EFFECTS[group].sensor])
        if possible and group not in problem.layout and group not in problem.settings.fixed:
            out.append(group)
    return tuple(group for group in GROUPS if group in out)


def _temperature_changes(problem: Problem) -> bool:
    """Return whether a temperature was recorded, and changes by more than thermometers err."""
    temperature_difference = problem.sensor.readings.temperature_difference
    return temperature_difference is not None and float(np.ptp(temperature_difference)) > _MIN_TEMPERATURE_CHANGE


@dataclass(frozen=True)
class Survey:
    """What the data say of all candidates.

    Attributes
    ----------
    before, fit
        The problem without candidates, and its fit.
    groups
        The candidates.
    change : (n, c)
        Of the fit's parameters, for units of theirs, one group after another.
    information : (c, c), score : (c,)
        What the data say of theirs, all others estimated, about zero.
    usual
        Covariance of each candidate's prior, for devices of which nothing is known.
    temper
        Factor on the information of the data: the innovations are correlated in time.
    """

    before: Problem
    fit: Fit
    groups: tuple[str, ...]
    change: Array
    information: Array
    score: Array
    usual: dict[str, Array]
    temper: float

    def places(self, groups: tuple[str, ...]) -> Indices:
        """Return the numbers of the parameters of groups."""
        sizes = [len(self.usual[group]) for group in self.groups]
        begin = dict(zip(self.groups, np.cumsum([0, *sizes]).tolist(), strict=False))
        own = [np.arange(begin[g], begin[g] + len(self.usual[g])) for g in self.groups if g in groups]
        return np.concatenate([np.zeros(0, dtype=np.int64), *own])

    def gain(self, groups: tuple[str, ...]) -> float:
        """Return the logarithm of the ratio of the evidences with some candidates and without any."""
        if not groups:
            return 0.0
        D, eta = self._data_about(groups)
        value, _ = self.alone(groups)
        return float(0.5 * eta @ value - 0.5 * np.linalg.slogdet(np.eye(eta.size) + self._prior(groups) @ D)[1])

    def lost(self, groups: tuple[str, ...]) -> dict[str, float]:
        """Return by how much the gain of some candidates falls without each of them."""
        value, P = self.alone(groups)
        out, begin = {}, 0
        for group in groups:
            own = slice(begin, begin + len(self.usual[group]))
            out[group], begin = _evidence(value[own], P[own, own], self._priors[group]), own.stop
        return out

    def alone(self, groups: tuple[str, ...]) -> tuple[Array, Array]:
        """Return estimate and covariance of some candidates with all others zero."""
        D, eta = self._data_about(groups)
        P = np.linalg.inv(np.linalg.inv(self._prior(groups)) + D)
        return np.asarray(P @ eta), np.asarray(P)

    def conditioned(self, groups: tuple[str, ...]) -> tuple[Problem, Fit]:
        """Return the problem with some candidates, and its fit with all others zero.

        The prior of one that is larger than usual is as wide as its estimate: what is usual for many devices must not
        pull at one that is found in the data.
        """
        chosen = tuple(group for group in self.groups if group in groups)
        larger = with_groups(self.before, chosen, {group: self._priors[group] for group in chosen})
        (value, P), columns = self._untempered.alone(chosen), self._columns(chosen)
        moved = result_moved(self.before, self.fit, (columns @ value)[: len(self.before.parameter_names)])
        known = moved.parameters.with_order(larger.settings.polynomial_order)
        before, after = self.before.layout, larger.layout
        mean, covariance = np.empty(after.size), np.zeros((after.degrees, after.degrees))
        own = _places(larger, chosen)
        kept = np.concatenate([np.r_[after[part.name]] for part in before])
        for part in before:
            mean[after.stored(part.name)] = moved.belief.mean[before.stored(part.name)]
        mean[np.concatenate([own[:0], *(np.r_[after.stored(group)] for group in chosen)])] = value
        covariance[np.ix_(kept, kept)] = self.fit.belief.covariance + columns @ P @ columns.T
        covariance[np.ix_(kept, own)] = columns @ P
        covariance[np.ix_(own, kept)] = P @ columns.T
        covariance[np.ix_(own, own)] = P
        belief = Belief(mean, _factor(covariance))
        return larger, replace(moved, belief=belief, parameters=parameters_of(larger, known, mean))

    def shift(self, group: str) -> tuple[float, str]:
        """Return the largest change of a sensor's parameter by one candidate, in deviations, and its name."""
        n = self.before.sensor_degrees
        if n == 0:
            return 0.0, ""
        value, P = self._untempered.alone((group,))
        columns = self._columns((group,))[:n]
        variance = self.fit.belief.standard_deviation[:n] ** 2 + np.sum((columns @ P) * columns, axis=1)
        change = np.abs(columns @ value) / np.sqrt(variance)
        worst = int(np.argmax(change))
        return float(change[worst]), self.before.parameter_names[worst]

    def undecided(self) -> Array:
        """Return columns (degrees of the problem without candidates, k) for effects that may be there or not.

        The square of a column is what an effect that is left out may add to the covariance, times the probability that
        it is there: its shift of the result, and the uncertainty of that.
        """
        columns = [np.zeros((self.before.layout.degrees, 0))]
        for group in self.groups:
            odds = self._odds(group) * np.exp(min(self.gain((group,)), MIN_GAIN))
            value, P = self._untempered.alone((group,))
            own = self._columns((group,))
            part = np.hstack([(own @ value)[:, None], own @ np.linalg.cholesky(P)])
            columns.append((odds / (1.0 + odds)) ** 0.5 * part)
        return np.hstack(columns)

    def _odds(self, group: str) -> float:
        """Return the odds, before any look at the data, that the device has an effect."""
        prior, robot = self.before.prior, self.before.robot
        if group == "robot_zeros" and robot is not None and robot.stated:
            return UNLIKELY_ODDS
        if group == "gyro_cubic":  # one that is not estimated leaves scale factors that hold for such rates
            return UNLIKELY_ODDS
        return EXPECTED_ODDS if group in prior.expected else LIKELY_ODDS if group in prior.likely else USUAL_ODDS

    @cached_property
    def _untempered(self) -> Survey:
        """The same by data that count as they are."""
        return replace(self, temper=1.0)

    def _columns(self, groups: tuple[str, ...]) -> Array:
        """Return what units of the parameters of groups change in the state, (degrees, k); only in its parameters."""
        out = np.zeros((self.before.layout.degrees, self.places(groups).size))
        change = self.change[:, self.places(groups)]
        out[: len(change)] = change
        return out

    def _data_about(self, groups: tuple[str, ...]) -> tuple[Array, Array]:
        """Return information matrix and vector of the data about some candidates, all else estimated."""
        i = self.places(groups)
        return self.temper * self.information[np.ix_(i, i)], self.temper * self.score[i]

    def _prior(self, groups: tuple[str, ...]) -> Array:
        """Return the covariance of the candidates' prior, as wide as the data ask for."""
        return _block_diagonal([self._priors[group] for group in groups])

    @cached_property
    def _priors(self) -> dict[str, Array]:
        """Covariance of each candidate's prior: the usual one, or wider by the size of its estimate.

        What is usual for many devices must not pull at an effect that is found in the data.
        """
        return {group: self._as_wide_as_asked(group) for group in self.groups}

    def _as_wide_as_asked(self, group: str) -> Array:
        usual = self.before.prior.covariance.get(group, self.usual[group])
        D, eta = self._data_about((group,))
        root = np.linalg.cholesky(usual)
        seen, strength = np.linalg.eigh(root.T @ D @ root)
        shown = seen > 1.0  # by data, not by the prior
        if not shown.any():
            return usual
        along = strength[:, shown].T @ (root.T @ eta) / seen[shown]
        factor = float(np.mean(along**2 - 1.0 / seen[shown]))
        return usual * max(1.0, factor)


def _block_diagonal(blocks: list[Array]) -> Array:
    """Return a matrix of blocks along its diagonal, zero elsewhere."""
    out, at = np.zeros((sum(map(len, blocks)),) * 2), 0
    for block in blocks:
        out[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return out


def _places(problem: Problem, groups: tuple[str, ...]) -> Indices:
    layout = problem.layout
    return np.array([i for g in groups for i in range(layout[g].start, layout[g].stop)], dtype=np.int64)


def _distance(problem: Problem, run: Fit, groups: tuple[str, ...]) -> Array:
    """Return the distance of a run's estimate from one with groups zero, for every degree of freedom."""
    zero = stored_state(problem, with_nominal(problem, run.parameters, groups))
    return np.asarray(problem.layout.minus(run.belief.mean[:, None], zero)[:, 0])


def _conditioned(problem: Problem, run: Fit, groups: tuple[str, ...]) -> tuple[Array, Array]:
    """Return mean and covariance of a run conditioned on zero values of groups."""
    i, P = _places(problem, groups), run.belief.covariance
    gain = np.linalg.solve(P[np.ix_(i, i)], P[i]).T
    change = -(gain @ _distance(problem, run, groups)[i])
    return problem.layout.plus(run.belief.mean, change[:, None])[:, 0], P - gain @ P[i]


def _with_zero(problem: Problem, run: Fit, smaller: Problem, groups: tuple[str, ...]) -> Fit:
    """Return a run as one over a smaller problem, that without groups, which are zero."""
    all_of, P = _conditioned(problem, run, groups)
    before, after = problem.layout, smaller.layout
    kept = np.concatenate([np.r_[before[part.name]] for part in after])
    mean = np.empty(after.size)
    for part in after:
        mean[after.stored(part.name)] = all_of[before.stored(part.name)]
    known = with_nominal(problem, run.parameters, groups)
    belief = Belief(mean, _factor(P[np.ix_(kept, kept)]))
    return replace(run, belief=belief, parameters=parameters_of(smaller, known, mean))


def without_needless(problem: Problem, run: Fit, included: tuple[str, ...]) -> tuple[Problem, Fit] | None:
    """Return the problem without the included effect that has least evidence, and the run with it zero.

    None if there is evidence for each: one that was found with others may be needless with them.
    """
    gains = {group: gain_of(problem, run, group) for group in included}
    least = min(gains, key=lambda group: gains[group], default="")
    if not gains or gains[least] >= 0.0:
        return None
    smaller = without_groups(problem, (least,))
    return smaller, _with_zero(problem, run, smaller, (least,))


def _deviations(P: Array) -> Array:
    """Return the standard deviations of a covariance matrix that may have lost rank in rounding."""
    return np.asarray(np.sqrt(np.maximum(np.diag(P), 1e-300)))


def _factor(P: Array) -> Array:
    """Return the lower triangular factor of a covariance matrix that may have lost rank in rounding."""
    scale = _deviations(P)
    correlation = P / np.outer(scale, scale)
    return np.asarray(scale[:, None] * np.linalg.cholesky(0.5 * (correlation + correlation.T) + 1e-12 * np.eye(len(P))))


def survey(
    problem: Problem,
    near: Fit,
    linearised: Callable[[], Linearised],
    estimator: Estimator,
    progress: StepProgress | None = None,
    executor: Executor = sequential,
) -> Survey | None:
    """Return what the data say of all candidates beyond a fit's parameters; None if there are none.

    If the innovations are too large or correlated even with all of them, something else is missing too: the evidence is
    then tempered.

    Parameters
    ----------
    near
        The problem's fit.
    linearised
        Returns the problem's linearisation about that.
    estimator
        Makes a pass with all candidates, if the linearisation is too far from it.
    executor
        Runs what does not depend on each other.
    """
    groups = candidates(problem)
    if not groups:
        return None
    # A grade may state that there is hardly such an effect. Here its prior is wide: it must not hide what the data say.
    usual = {g: usual_covariance(g, problem) for g in groups}
    usual |= {g: problem.prior.covariance[g] for g in groups if g in problem.prior.covariance and not _has_usual(g)}
    linear, (terms, combined) = executor([linearised, partial(named_terms, problem, near, groups)])
    whole = linear.about(terms, innovations=True)
    found = Survey(
        problem, near, groups, whole.change @ combined, combined.T @ whole.information @ combined,
        combined.T @ whole.score, usual, 1.0,
    )  # fmt: skip
    found.score[found.places(("position_scale",))] -= linear.fit.history.pull_of_unit
    value, _ = found.alone(groups)
    added = whole.innovations @ (combined @ value).astype(np.float32)
    whitened = linear.fit.history.whitened - added
    history = replace(linear.fit.history, whitened=whitened, nis=np.nansum(whitened**2, axis=1))
    found = replace(found, temper=_temper(replace(linear.fit, history=history)))
    return found if found.temper > _TRUSTED else _relinearised(found, estimator, progress)


def _relinearised(found: Survey, estimator: Estimator, progress: StepProgress | None) -> Survey:
    """Return a survey linearised about the fit with all candidates, where the first one is too far from it to tell."""
    problem, near, groups = found.before, found.fit, found.groups
    larger = with_groups(problem, groups, found.usual)
    n, before, after = len(problem.parameter_names), problem.layout, larger.layout
    parameters = near.parameters.with_order(larger.settings.polynomial_order)
    P = np.zeros((after.degrees, after.degrees))
    for part in after:
        d = after[part.name]
        P[d, d] = larger.prior.covariance[part.name] if part.name in groups else np.eye(d.stop - d.start)
    names = [part.name for part in before if before[part.name].stop <= n]
    old, new = (np.concatenate([np.r_[layout[g]] for g in names]) for layout in (before, after))
    P[np.ix_(new, new)] = near.belief.covariance[np.ix_(old, old)]
    T = _kept_mean(larger, groups)
    begun = replace(near, belief=Belief(stored_state(larger, parameters), _factor(T @ P @ T.T)), parameters=parameters)
    run = with_unit_of_data(larger, estimator.refit(larger, begun, gate=_GATE, progress=progress))
    own = _places(larger, groups)
    others, P = np.setdiff1d(np.arange(len(larger.parameter_names)), own), run.belief.covariance
    scale = np.sqrt(np.diag(P)[own])
    information = np.linalg.inv(P[np.ix_(own, own)] / np.outer(scale, scale)) / np.outer(scale, scale)
    prior = _block_diagonal([np.asarray(np.linalg.inv(larger.prior.covariance[group])) for group in groups])
    return replace(
        found, fit=_with_zero(larger, run, problem, groups), change=P[np.ix_(others, own)] @ information,
        information=information - prior, score=information @ _distance(larger, run, groups)[own],
        temper=_temper(run),
    )  # fmt: skip


def _kept_mean(problem: Problem, groups: tuple[str, ...]) -> Array:
    """Return the change of a state (degrees, degrees) in which offsets take back what effects add on average.

    So the readings' mean stays as it is, and with it all that the data already showed: an effect that is hardly
    distinguished from an offset starts as such.
    """
    layout, readings, known = problem.layout, problem.sensor.readings, problem.known_places
    T = np.eye(layout.degrees)
    thinned = slice(None, None, max(1, readings.stamps.size // _ENOUGH))
    raw = RawReadings(
        readings.stamps[thinned],
        readings.rates[thinned],
        readings.accelerations[thinned],
        np.zeros_like,  # derivatives are zero on average
        np.zeros_like,
        np.zeros(readings.stamps[thinned].size)
        if readings.temperature_difference is None
        else readings.temperature_difference[thinned],
    )
    for group in groups:
        effect = EFFECTS.get(group)
        if effect is None or OFFSET_OF[effect.sensor] not in layout:
            continue
        offset, own = layout[OFFSET_OF[effect.sensor]].start, layout[group]
        size = own.stop - own.start
        means = effect.features(raw, size).mean(axis=1)
        for mean, places in zip(means, effect.places(size), strict=True):
            for i, axis in enumerate(layout.present(OFFSET_OF[effect.sensor])):
                if places[axis] >= 0 and not known[offset + i]:
                    T[offset + i, own.start + places[axis]] -= mean
    return T


def _has_usual(group: str) -> bool:
    return group_named(group).usual_sd is not None


def _temper(run: Fit) -> float:
    """Return the factor on the information of data, by the innovations with all candidates."""
    return 1.0 / (correlation_factor(run) ** 2 * max(1.0, _size(run)))


def _size(run: Fit) -> float:
    """Return the mean normalised innovation squared per degree of freedom."""
    return run.excess * mean_normalised(run.history.nis, run.history.degrees)


def selected(found: Survey, threshold: float = MIN_GAIN) -> tuple[str, ...]:
    """Return the candidates that the recording shows.

    From all of them, the one without which least evidence is lost is left out, again and again, as long as that is
    little. So an effect is not taken for another one that is similar, as it would be if they were added one by one.
    Where the evidence is tempered, more of it is needed: by how much it must be tempered is not known exactly.
    """
    chosen, threshold = found.groups, threshold * found.temper**-_CAREFUL
    while chosen:
        lost = found.lost(chosen)
        needed = {g: 0.0 if g in found.before.prior.expected else threshold for g in chosen}
        needed |= {g: threshold + _CLEARLY for g in chosen if g in _OF_MOUNT}
        least = min(lost, key=lambda g: lost[g] - needed[g])
        if lost[least] >= needed[least]:
            break
        chosen = tuple(g for g in chosen if g != least)
    return chosen


def gain_of(problem: Problem, run: Fit, group: str) -> float:
    """Return the logarithm of the ratio of the evidences with and without a group of the state."""
    d = problem.layout[group]
    value, P = problem.stored(run.parameters, group), run.belief.covariance[d, d]
    return _evidence(value, P, problem.prior.covariance[group])


def _evidence(value: Array, P: Array, prior: Array) -> float:
    """Return the logarithm of the ratio of the evidences with parameters and with zero, by their estimate.

    It is that of the densities of prior and estimate at zero (Savage and Dickey; Verdinelli and Wasserman 1995).
    """
    return float(0.5 * value @ np.linalg.solve(P, value) + 0.5 * np.linalg.slogdet(np.linalg.solve(prior, P))[1])


def considered(found: Survey | None, problem: Problem, run: Fit, included: tuple[str, ...]) -> tuple[Considered, ...]:
    """Return all effects: those that are part of a model, with their run's result, and those that were left out."""
    out = []
    for group in included:
        value, sd = problem.stored(run.parameters, group), run.belief.standard_deviation[problem.layout[group]]
        gain, (shift, name) = gain_of(problem, run, group), _shift_without(problem, run, group)
        out.append(Considered(group, value, sd, gain, included=True, shift=shift, shifted=name))
    if found is not None:
        for group in found.groups:
            value, P = found.alone((group,))
            sd, (shift, name) = _deviations(P), found.shift(group)
            gain = found.gain((group,))
            out.append(Considered(group, value, sd, gain, included=False, shift=shift, shifted=name))
    return tuple(sorted(out, key=lambda effect: -effect.gain))


def _shift_without(problem: Problem, run: Fit, group: str) -> tuple[float, str]:
    """Return the largest change of a sensor's parameter if a group were zero, in deviations, and its name."""
    d, P = problem.layout[group], run.belief.covariance
    others = [i for i in range(problem.sensor_degrees) if not d.start <= i < d.stop]
    change = P[others, d] @ np.linalg.solve(P[d, d], problem.stored(run.parameters, group))
    score = np.abs(change) / np.sqrt(np.diag(P)[others])
    worst = int(np.argmax(score))
    return float(score[worst]), problem.parameter_names[others[worst]]
