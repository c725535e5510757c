"""How much the data speak for families of terms: amplitudes of unknown size, judged by the marginal likelihood.

A family's amplitudes are drawn from a normal distribution of a size that is the family's own. Its size is that with
which the data are most likely when the amplitudes are integrated out (MacKay 1992, automatic relevance determination);
a family that explains nothing then has the size zero, and costs nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kreisel.fitting.terms import Linearisation, Scores
from kreisel.geometry.rotation import Array, Indices, Mask

MIN_GAIN = 10.0
"""Minimum logarithm of the ratio of evidences with which a family is part of the model: 1 : 22,000."""

MIN_PREDICTED = 3.0
"""Minimum gain in log-likelihood of parts of the recording by a family's amplitudes from all other parts."""

ODDS, RARE_ODDS = 1.0 / 50.0, 1.0 / 1000.0
"""Odds, before any look at the data, that a device or a reference has errors of a family, and of one that is rare."""

_HOPELESS = 1.0
"""Gain of a family below which it is not looked at further."""

_ROUNDS, _FIRST_ROUNDS, _SETTLED = 30, 4, 0.1
"""Rounds of the sizes at most, at last and while families are left out; change of their logarithms when settled."""

_FAR = 0.2
"""Share of the gain that is needed, below which a family is left out before sizes are settled."""

_SIZES = np.exp(np.linspace(-9.0, 12.0, 43))
"""Sizes of a family that are tried alone, in those with which one amplitude is as large as its deviation."""

_LEAST_DEGREES = 0.02
"""Amplitudes that the data determine, of a family, below which its size is zero."""

_LARGE = 5.0
"""Factor between the noise without families and with all, from which they explain most of what is there. Chosen: it is
1 to 3 in recordings of an industrial arm, and 60 where a range is exceeded."""

_FAR_SCORE, _FAR_SUM = 3.5, 1.5
"""Deviations of one score, and of a family's sum of squares from its mean, beyond which a family is looked at: one of
ten by chance."""

_ROUNDING = 1e-8
"""Share of an information matrix's largest eigenvalue that is lost in rounding."""


@dataclass(frozen=True)
class _Data:
    """A linearisation in units in which each amplitude's information is one, and what families are expected to be.

    Attributes
    ----------
    information : (m, m), score : (m,)
        Of the amplitudes in these units.
    unit : (m,)
        Deviation of each amplitude, alone.
    expected : (m,)
        Relative size of the amplitude in its family, in these units.
    family : (m,)
    part_information : (p, m, m), part_scores : (p, m)
        What each part of the recording adds; the scores in these units.
    misfit, degrees, least
        Normalised innovations squared without terms, their number, and the smallest factor on the noise.
    """

    information: Array
    score: Array
    unit: Array
    expected: Array
    family: Indices
    part_information: NDArray[np.float32]
    part_scores: Array
    misfit: float
    degrees: float
    least: float


@dataclass(frozen=True)
class Weighed:
    """What the data say of all families.

    Attributes
    ----------
    chosen : (f,)
        Which families are part of the model.
    gain : (f,)
        Logarithm of the ratio of evidences with and without a family, beside those that are chosen.
    amplitude : (m,), covariance : (m, m)
        Of the terms of chosen families, zero for others.
    noise
        Factor on the variance of all noise that is left.
    rest
        What the data say beside the chosen families, for `undecided`.
    """

    chosen: Mask
    gain: Array
    amplitude: Array
    covariance: Array
    noise: float
    rest: _Data

    @property
    def families(self) -> list[int]:
        """Numbers of the families that are part of the model, that with the largest gain first."""
        chosen = np.flatnonzero(self.chosen)
        return [int(f) for f in chosen[np.argsort(-self.gain[chosen])]]


@dataclass(frozen=True)
class _State:
    """Sizes of families and what follows from them.

    Attributes
    ----------
    variance : (f,)
        Of each family's amplitudes, in units of what is expected; zero for families that are left out.
    noise
    places : (k,)
        Terms of the other families.
    value : (k,), P : (k, k)
        Their amplitudes' mean and covariance, in units of the prior's deviations.
    """

    variance: Array
    noise: float
    places: Indices
    value: Array
    P: Array


def weigh(found: Linearisation, family: Indices, weight: Array, least: float = 1.0) -> Weighed:
    """Return what the data say of families.

    Parameters
    ----------
    family : (m,)
        Number of each term's family.
    weight : (m,)
        How large an amplitude is expected to be beside others of its family.
    least
        Factor on the variance of the noise that is left at least.
    """
    count = int(family.max(initial=-1)) + 1
    data = _prepared(found, family, weight, least)
    alone = [_alone(data, f, least) for f in range(count)]
    variance = np.array([size if gain > _HOPELESS else 0.0 for gain, size in alone])
    state = _solved(data, variance, max(least, data.misfit / max(data.degrees, 1.0)))
    while state.places.size:
        state = _sized(data, state, _FIRST_ROUNDS)
        weak = _weaker(data, state, _FAR * MIN_GAIN)
        if weak.size == 0:
            state = _sized(data, state, _ROUNDS)
            weak = _weaker(data, state, MIN_GAIN)[:1]
        if weak.size == 0:
            weak = _not_predictive(data, state)
        if weak.size == 0:
            break
        state = _without(data, state, weak)
    amplitude, covariance = np.zeros(family.size), np.zeros((family.size, family.size))
    scale = _prior(data, state.variance)[state.places] * data.unit[state.places]
    amplitude[state.places] = scale * state.value
    covariance[np.ix_(state.places, state.places)] = scale[:, None] * state.P * scale
    chosen, rest = state.variance > 0.0, _rest(data, amplitude)
    gains = np.where(chosen, _gains(data, state), [max(_alone(rest, f, state.noise)[0], 0.0) for f in range(count)])
    return Weighed(chosen, gains, amplitude, covariance, state.noise, rest)


def worth_weighing(scores: Scores, family: Indices, weight: Array, least: float = 1.0) -> Indices:
    """Return the families whose scores are larger than most are by chance: others gain nothing.

    A family is judged by the sum of its squared scores, in units of what is expected of its amplitudes and of what each
    is by chance, and by the largest one. least: as in `weigh`; with less noise scores are by chance smaller.

    Notes
    -----
    The first is the score of the variance of a family's amplitudes (Lin 1997), the most powerful test of a small one.
    """
    scores = replace(scores, draws=scores.draws * least**0.5)
    by_chance = np.sqrt(np.mean(scores.draws**2, axis=0)) + 1e-300
    found = []
    for f in np.unique(family):
        own = np.flatnonzero(family == f)
        far = float(np.max(np.abs(scores.value[own]) / by_chance[own])) > _FAR_SCORE
        for unit in (weight[own], 1.0 / by_chance[own]):
            drawn = np.sum((scores.draws[:, own] * unit) ** 2, axis=1)
            value = float(np.sum((scores.value[own] * unit) ** 2))
            far |= value > float(np.mean(drawn) + _FAR_SUM * np.std(drawn))
        if far:
            found.append(int(f))
    return np.array(found, dtype=np.int64)


def _rest(data: _Data, amplitude: Array) -> _Data:
    """Return what data say beside amplitudes."""
    parts = data.part_scores - data.part_information @ amplitude.astype(np.float32) * data.unit
    return replace(data, score=data.score - data.information @ (amplitude / data.unit), part_scores=parts)


def _prepared(found: Linearisation, family: Indices, weight: Array, least: float) -> _Data:
    """Return a linearisation in units of each amplitude's own deviation."""
    A = found.information
    own = np.diag(A)
    unit = 1.0 / np.sqrt(np.maximum(own, _ROUNDING * float(np.median(own)) + 1e-300))
    A = A * np.outer(unit, unit)
    A = _positive(0.5 * (A + A.T))
    expected = np.empty(family.size)
    for f in range(int(family.max(initial=-1)) + 1):
        own = family == f
        expected[own] = weight[own] / unit[own] / np.sqrt(np.mean((weight[own] / unit[own]) ** 2))
    return _Data(
        A,
        found.score * unit,
        unit,
        expected,
        family,
        found.part_information,
        found.part_scores * unit,
        found.misfit,
        found.degrees,
        least,
    )


def _positive(A: Array) -> Array:
    """Return an information matrix that may have lost rank in rounding, positive definite."""
    try:
        raised = A + _ROUNDING * float(np.trace(A)) / len(A) * np.eye(len(A))
        np.linalg.cholesky(raised)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(A)
        raised = (vectors * np.maximum(values, _ROUNDING * float(values[-1]))) @ vectors.T
    return np.asarray(raised)


def _alone(data: _Data, f: int, noise: float = 1.0) -> tuple[float, float]:
    """Return the largest gain of a family by itself, and the variance of its amplitudes then."""
    own = np.flatnonzero(data.family == f)
    W = data.expected[own]
    values, vectors = np.linalg.eigh(W[:, None] * data.information[np.ix_(own, own)] * W / noise)
    y = (vectors.T @ (W * data.score[own]) / noise) ** 2
    values = np.maximum(values, 0.0)
    by_size = 1.0 + np.outer(_SIZES, values)
    gains = 0.5 * np.sum(np.outer(_SIZES, y) / by_size - np.log(by_size), axis=1)  # equation (29)
    best = int(np.argmax(gains))
    return float(gains[best]), float(_SIZES[best])


def _prior(data: _Data, variance: Array) -> Array:
    """Return the deviations of all amplitudes by the sizes of families, (m,)."""
    return np.asarray(np.sqrt(variance[data.family]) * data.expected)


def _solved(data: _Data, variance: Array, noise: float) -> _State:
    """Return the amplitudes for given sizes of families and a factor on the noise."""
    places = np.flatnonzero(variance[data.family] > 0.0)
    D = _prior(data, variance)[places]
    P = np.linalg.inv(np.eye(places.size) + D[:, None] * data.information[np.ix_(places, places)] * D / noise)
    return _State(variance, noise, places, P @ (D * data.score[places]) / noise, np.asarray(P))


def _sized(data: _Data, state: _State, rounds: int) -> _State:
    """Return the state with the sizes of families, and the noise that is left, that make the data most likely."""
    for _ in range(rounds):
        own = data.family[state.places]
        determined = np.bincount(own, 1.0 - np.diag(state.P), state.variance.size)
        square = np.bincount(own, state.value**2, state.variance.size)
        factor = np.where(determined > _LEAST_DEGREES, square / np.maximum(determined, _LEAST_DEGREES), 0.0)
        b = _amplitude(data, state)
        A = data.information[np.ix_(state.places, state.places)]
        left = data.misfit - 2.0 * data.score[state.places] @ b + b @ A @ b
        noise = max(data.least, float(left) / max(data.degrees - float(determined.sum()), 0.3 * data.degrees, 1.0))
        before, state = state, _solved(data, state.variance * factor, noise)
        kept = state.variance > 0.0
        if np.all(np.abs(np.log(factor[kept])) < _SETTLED) and np.array_equal(kept, before.variance > 0.0):
            break
    return state


def _weaker(data: _Data, state: _State, gain: float) -> Indices:
    """Return the families of a state that gain less, that with the smallest gain first."""
    gains = np.where(state.variance > 0.0, _gains(data, state), np.inf)
    return np.argsort(gains)[: int(np.sum(gains < gain))]


def _not_predictive(data: _Data, state: _State) -> Indices:
    """Return the families of a state that do not predict parts of the recording from all others.

    An error that is a function of what is measured comes back; one that is only correlated in time does not, however
    well functions follow it where it is known. Several families may be wrong together, so those that predict are
    looked for one by one, if all together do not. Where all leave a small part of what is there, one alone leaves far
    more than that, and is judged by the noise without any.
    """
    inside = np.flatnonzero(state.variance > 0.0)
    whole, without = _predicted_without_each(data, state, inside)
    if whole >= MIN_PREDICTED:
        worst = int(np.argmax(without))
        return inside[[worst]] if whole - without[worst] < MIN_PREDICTED else inside[:0]
    kept, best = inside[:0], 0.0
    before = max(data.least, data.misfit / max(data.degrees, 1.0))
    state = replace(state, noise=before) if before > _LARGE * state.noise else state
    while kept.size < inside.size:
        tried = {int(f): _predicted(data, state, np.append(kept, f)) for f in np.setdiff1d(inside, kept)}
        f = max(tried, key=lambda f: tried[f])
        if tried[f] < best + MIN_PREDICTED:
            break
        kept, best = np.append(kept, f), tried[f]
    return np.setdiff1d(inside, kept)


def _predicted(data: _Data, state: _State, families: Indices) -> float:
    """Return the gain in log-likelihood of parts of the recording by amplitudes of families from all other parts."""
    places = np.flatnonzero(np.isin(data.family, families))
    total = 0.0
    for others, score, A_part, a_part in _parts(data, state, places):
        x = np.linalg.solve(others, score)
        total += float(a_part @ x - 0.5 * x @ A_part @ x)
    return total


def _predicted_without_each(data: _Data, state: _State, families: Indices) -> tuple[float, Array]:
    """Return the gain of `_predicted` by families, and those by all but each of them.

    Amplitudes without a family are those with it, given that its own are zero.
    """
    places = np.flatnonzero(np.isin(data.family, families))
    own = [np.flatnonzero(data.family[places] == f) for f in families]
    total = np.zeros(1 + len(families))
    for others, score, A_part, a_part in _parts(data, state, places):
        V = np.linalg.inv(others)
        x = V @ score
        less = [x - V[:, i] @ np.linalg.solve(V[np.ix_(i, i)], x[i]) for i in own]
        X = np.column_stack([x, *less])
        total += a_part @ X - 0.5 * np.sum(X * (A_part @ X), axis=0)
    return float(total[0]), total[1:]


def _parts(data: _Data, state: _State, places: Indices) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Yield, for each part of the recording, information and score of all other parts with the prior, and its own.

    Of terms at some places, in units of the prior's deviations.
    """
    D, at = _prior(data, state.variance)[places], np.ix_(places, places)
    A = np.eye(places.size) + D[:, None] * data.information[at] * D / state.noise
    a, scale = D * data.score[places] / state.noise, D * data.unit[places]
    for information, score in zip(data.part_information, data.part_scores, strict=True):
        A_part = scale[:, None] * information[at] * scale / state.noise
        a_part = D * score[places] / state.noise
        yield A - A_part, a - a_part, A_part, a_part


def _without(data: _Data, state: _State, families: Indices) -> _State:
    """Return a state without families."""
    variance = state.variance.copy()
    variance[families] = 0.0
    noise = state.noise if variance.any() else max(data.least, data.misfit / max(data.degrees, 1.0))
    return _solved(data, variance, noise)


def _amplitude(data: _Data, state: _State) -> Array:
    """Return the amplitudes of a state's terms, in units of their own deviations."""
    return np.asarray(_prior(data, state.variance)[state.places] * state.value)


def _gains(data: _Data, state: _State) -> Array:
    """Return what each family of a state gains beside all others (Savage-Dickey ratio), zero for those left out."""
    out, own = np.zeros(state.variance.size), data.family[state.places]
    for f in np.unique(own):
        i = np.flatnonzero(own == f)
        x, P = state.value[i], state.P[np.ix_(i, i)]
        out[f] = 0.5 * x @ np.linalg.solve(P, x) + 0.5 * np.linalg.slogdet(P)[1]
    return out


def undecided(change: Array, weighed: Weighed, odds: Array | float = ODDS) -> Array:
    """Return columns (n, k) for families that are left out, and may be there or not.

    The square of a column is what a family would change in the parameters, and the uncertainty of that, times the
    probability that it is there.

    Parameters
    ----------
    change : (n, m)
        Of the parameters, for unit amplitudes.
    odds : (f,)
        Of each family, before any look at the data.
    """
    before = np.broadcast_to(odds, weighed.chosen.shape)
    rest, columns = weighed.rest, [np.zeros((len(change), 0))]
    for f in np.flatnonzero(~weighed.chosen):
        gain, size = _alone(rest, int(f), weighed.noise)
        if gain <= 0.0:
            continue
        variance = np.zeros(weighed.chosen.size)
        variance[f] = size
        state = _solved(rest, variance, weighed.noise)
        there = before[f] * np.exp(min(gain, _predicted(rest, state, np.array([f])), MIN_GAIN))
        U = change[:, state.places] * _prior(rest, variance)[state.places] * rest.unit[state.places]
        part = np.hstack([(U @ state.value)[:, None], U @ np.linalg.cholesky(state.P)])
        columns.append(np.sqrt(there / (1.0 + there)) * part)
    return np.hstack(columns)
