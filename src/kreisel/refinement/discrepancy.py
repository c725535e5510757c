"""Model discrepancy: errors that are on no list, found as smooth functions, estimated and taken out of the data.

After all named effects, one linearisation tells how much a few hundred generic terms would explain (Kennedy and O'Hagan
2001). Families that the data ask for are estimated with amplitudes of a size that the data show. Readings and poses are
corrected by them, and the usual parameters found again; what the terms leave uncertain is a part of their uncertainty.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from kreisel.estimation.uncertainty import Contribution
from kreisel.estimation.uncertainty_budget import Source
from kreisel.fitting.fit import Fit, Linearised
from kreisel.fitting.terms import ACCEL_ROWS, Linearisation, Terms
from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.model.parameters import OF_EARTH
from kreisel.model.problem import Problem
from kreisel.recording.recording import DataWarning
from kreisel.refinement.discrepancy_evidence import Weighed, undecided, weigh, worth_weighing
from kreisel.refinement.discrepancy_terms import FIELD, PRODUCTS, RANGE, SIGN, DiscrepancyTerms, Family, FoundFamily
from kreisel.units import DEG, MG, MM, MRAD, MS

LONGEST = 3.0 * 3600.0
"""s; recordings beyond this are not searched: functions of all their readings would take gigabytes."""

MAX_ROUNDS = 3
"""Linearisations at most, each about a better estimate."""

_ATTRIBUTED = 0.5
"""Share of what a family does to the parameters that counts as a deviation. Chosen: results with it and without it then
lie within two deviations, of which at least one is right. On average 0.15 to 0.26 of it is wrong, but where it is, all
of it is: with half as much three more of 104 random runs were accepted beyond four deviations. Whose error it is, a
sensor's or the reference's, a recording does not tell: an arm that sways looks like an accelerometer that responds to
jerk."""

_FAINT = 100.0
"""Gain of products of rates below which they are not looked for. Chosen: it was thousands where a device takes out
centripetal forces, a quarter of them too, and 14 to 64 where they stood for errors of something else."""

_DEPENDENT = 1e-3
"""Share of the largest mean square of functions in a span, below which one is a sum of the others."""

_MOVED = 0.3
"""Change of a parameter by a further linearisation, in standard deviations, below which it is the last."""


@dataclass(frozen=True)
class Discrepancy:
    """What was looked for in a problem.

    Attributes
    ----------
    found
        Families that are part of the model.
    columns, undecided, remainder, attribution : (n, k)
        Errors of the parameters by the amplitudes' uncertainty, by families that may be there or not, by what the
        functions of those that are there do not reach, and by families that take another's error for theirs, or a
        share of the offsets at rest.
    """

    found: tuple[FoundFamily, ...] = ()
    columns: Array = field(default_factory=lambda: np.zeros((0, 0)))
    undecided: Array = field(default_factory=lambda: np.zeros((0, 0)))
    remainder: Array = field(default_factory=lambda: np.zeros((0, 0)))
    attribution: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def contributions(self, degrees: int) -> list[Contribution]:
        """Return what terms add to the uncertainty of a state."""
        out = []
        for cause, columns in (
            ("model discrepancy", self.columns),
            ("undecided model discrepancy", self.undecided),
            ("remainder of the model discrepancy", self.remainder),
            ("attribution of the model discrepancy", self.attribution),
        ):
            padded = np.zeros((degrees, columns.shape[1]))
            padded[: len(columns)] = columns
            out.append(Contribution(cause, Source.MISFIT, padded))
        return out

    @property
    def warnings(self) -> list[DataWarning]:
        """What was found, in words."""
        if not self.found:
            return []
        words = "; ".join(describe(one) for one in self.found)
        return [DataWarning("discrepancy", f"errors that are on no list, estimated as smooth functions: {words}")]


Settle = Callable[[Problem, Fit], tuple[Problem, Fit]]
"""Fits a problem near an earlier fit until nothing moves."""


def prepared_terms(problem: Problem) -> DiscrepancyTerms | None:
    """Return the terms that a problem may have, at its updates, too; None where none are looked for."""
    if problem.settings.passes is not None or float(np.ptp(problem.sensor.readings.stamps)) > LONGEST:
        return None
    terms = DiscrepancyTerms(problem)
    if not terms.families:
        return None
    terms.terms(problem.schedule)
    return terms


def find_discrepancy(
    recorded: Problem,
    near: Fit,
    linearise: Callable[[Problem, Fit], Linearised],
    settle: Settle,
    least_noise: Callable[[Problem], float],
    prepared: DiscrepancyTerms | None = None,
    left_out: Sequence[str] = (),
) -> Discrepancy:
    """Return what the data ask for. The last problem that was settled is without it.

    Parameters
    ----------
    recorded
        The problem with the data as recorded, and the noise that they ask for without terms.
    near
        Its fit.
    linearise
        Linearises a problem about a fit.
    least_noise
        Factor on the variance of a problem's noise that is left at least: noise that was found explains what terms
        would.
    prepared
        Terms that may serve the problem.
    left_out
        What an error may depend on, by the families' names for it, that is not looked for.
    """
    terms = prepared if prepared is not None and prepared.serves(recorded) else prepared_terms(recorded)
    if terms is None:
        return Discrepancy()
    problem, fit, amplitude = recorded, near, np.zeros(terms.family.size)
    worth = np.zeros(0, dtype=np.int64)
    for _ in range(MAX_ROUNDS):
        linear, every = linearise(problem, fit), terms.terms(problem.schedule)
        least = least_noise(problem)
        worth = np.union1d(worth, worth_weighing(linear.scores(every), terms.family, terms.weight, least))
        worth = worth[[terms.families[f].of not in left_out for f in worth]]
        own = np.flatnonzero(np.isin(terms.family, worth))
        if own.size == 0:
            return Discrepancy()
        family, weight = np.searchsorted(worth, terms.family[own]), terms.weight[own]
        whole = _about_zero(linear.about(every.some(own)), amplitude[own])
        weighed = weigh(whole, family, weight, least)
        if any(terms.families[worth[f]].of == PRODUCTS and weighed.gain[f] < _FAINT for f in weighed.families):
            return find_discrepancy(recorded, near, linearise, settle, least_noise, terms, (*left_out, PRODUCTS))
        if not weighed.chosen.any() or (amplitude.any() and _moved(whole, weighed, amplitude[own]) < _MOVED):
            break
        amplitude[own] = weighed.amplitude
        problem, fit = settle(terms.corrected(problem, amplitude), fit)
    amplitude[own] = weighed.amplitude
    found = tuple(
        FoundFamily(terms.families[worth[f]], float(weighed.gain[f]), terms.size(amplitude, int(worth[f])))
        for f in weighed.families
    )
    columns = _root(whole.change @ weighed.covariance @ whole.change.T)
    return Discrepancy(
        found,
        columns,
        undecided(
            _beside_rotation(recorded, whole.change, [terms.families[f] for f in worth[family]]),
            weighed,
            np.array([terms.families[f].odds for f in worth]),
        ),
        _remainder(every.some(own), family, 1.0 / weight, terms.ends[own], whole.change, weighed),
        np.hstack(
            [
                _ATTRIBUTED * _by_family(family, whole.change, weighed),
                *(_like_arms(terms.families[worth[f]], family == f, whole.change, weighed) for f in weighed.families),
                _ATTRIBUTED * _offsets_at_rest(recorded, terms.at_rest(amplitude), len(columns)),
            ]
        ),
    )


def _beside_rotation(problem: Problem, change: Array, families: Sequence[Family]) -> Array:
    """Return the change of parameters (n, m) by terms of families, (m,), where a field is no rotation of the Earth.

    A rate of the gyros that is constant in the cell is one: nothing but a field's prior says how much of it is not.
    """
    out, layout = change.copy(), problem.layout
    rotation = [i for group in OF_EARTH if group in layout for i in range(layout[group].start, layout[group].stop)]
    constant = [family.owner == "gyroscope" and family.of == FIELD for family in families]
    out[np.ix_(rotation, constant)] = 0.0
    return out


def _offsets_at_rest(problem: Problem, added: Array, count: int) -> Array:
    """Return columns (n, 3) by what terms add to the gyros at rest: their offsets there are not those of the whole.

    A linear description that fits best over a recording and one of the sensor at rest differ by it, and either is used.
    Offsets that are known before any look at the data differ by no more than that.
    """
    columns = np.zeros((count, 3))
    if "gyro_offset" in problem.layout:
        first = problem.layout["gyro_offset"].start
        known = np.sqrt(np.diag(problem.prior.covariance["gyro_offset"]))
        for i, axis in enumerate(problem.layout.present("gyro_offset")):
            columns[first + i, axis] = np.clip(added[axis], -known[i], known[i])
    return columns


def _by_family(family: Indices, change: Array, weighed: Weighed) -> Array:
    """Return what each family that is found does to the parameters, (n, k)."""
    own = [family == f for f in weighed.families]
    return np.stack([change[:, i] @ weighed.amplitude[i] for i in own], axis=1) if own else change[:, :0]


def _like_arms(kind: Family, own: Mask, change: Array, weighed: Weighed) -> Array:
    """Return columns (n, k) by the part of products of rates that is that of an arm along the accelerometer's own axis.

    Such an arm adds nothing but its distance times the squares of the two other rates: how much of it the device adds
    is known by the size of all its products alone.
    """
    if kind.of != PRODUCTS or np.count_nonzero(own) != 6 * len(kind.rows):
        return change[:, :0]
    squares = [0, 3, 5]  # of x, y and z among the products
    patterns = np.zeros((len(kind.rows), len(kind.rows), 6))
    for i, row in enumerate(kind.rows):
        patterns[i, i, [at for axis, at in enumerate(squares) if axis != row - ACCEL_ROWS.start]] = 1.0
    size = float(np.sqrt(np.mean(weighed.amplitude[own] ** 2)))
    return np.asarray(size * change[:, own] @ patterns.reshape(len(kind.rows), -1).T)


def _remainder(own: Terms, family: Indices, degree: Array, ends: Mask, change: Array, weighed: Weighed) -> Array:
    """Return columns (n, k) of what series of functions that end too early leave in the parameters.

    Where a series ends, two degrees more are taken into account. The rms falls from degree to degree as from the one
    before the last to the last, or as is expected of it, if that is less. The first of them is any function in the span
    of the one before the last, which is even or odd as it is, the second one in the span of the last; either does what
    these would if all others were estimated without it. Powers of single quantities and products of several may end at
    different degrees.
    """
    columns = [np.zeros((len(change), 0))]
    found = np.flatnonzero(np.isin(family, weighed.families))

    def effect(places: Indices) -> tuple[float, Array]:
        size, roots = _parts_of_degree(own.some(places), weighed.amplitude[places])
        others = np.setdiff1d(found, places)
        P, shared = (weighed.covariance[np.ix_(places, to)] for to in (places, others))
        return size, (change[:, places] + change[:, others] @ np.linalg.solve(P, shared).T) @ roots

    for f in weighed.families:
        places = np.flatnonzero(family == f)
        for end in np.unique(degree[places[ends[places]]]):
            falls, lower = end / (end + 1.0), degree[places][degree[places] < end]
            size, of_last = effect(places[ends[places] & (degree[places] == end)])
            alike = of_last
            if lower.size:
                larger, alike = effect(places[degree[places] == lower.max()])
                falls = min(size / max(larger, 1e-300), falls)
            columns += [falls * size * alike, falls**2 * size * of_last]
    joined = np.hstack(columns)
    return _root(joined @ joined.T)


def _parts_of_degree(own: Terms, amplitude: Array) -> tuple[float, Array]:
    """Return the rms of a sum of terms, and amplitudes (m, k) of independent functions in their span.

    Of these, all together have an rms of one, as the sum of terms has over all its rows.
    """
    rows, square, roots = np.unique(own.row), 0.0, []
    for row in rows:
        places = np.flatnonzero(own.row == row)
        values = own.functions[:, own.function[places]]
        correlation = values.T @ values / len(values)
        square += float(amplitude[places] @ correlation @ amplitude[places])
        squares, vectors = np.linalg.eigh(correlation)
        seen = squares > _DEPENDENT * squares[-1]
        root = np.zeros((len(amplitude), int(seen.sum())))
        root[places] = vectors[:, seen] / np.sqrt(squares[seen] * seen.sum() * rows.size)
        roots.append(root)
    return float(np.sqrt(square)), np.hstack(roots)


def _about_zero(about: Linearisation, amplitude: Array) -> Linearisation:
    """Return a linearisation about corrected data as one about data as recorded."""
    if not amplitude.any():
        return about
    pulled = about.information @ amplitude
    misfit = about.misfit + float(2.0 * amplitude @ about.score + amplitude @ pulled)
    parts = about.part_scores + about.part_information @ amplitude.astype(np.float32)
    return replace(about, score=about.score + pulled, part_scores=parts, misfit=misfit)


def _moved(about: Linearisation, weighed: Weighed, amplitude: Array) -> float:
    """Return the largest change of a parameter by new amplitudes, in deviations by the terms."""
    change = about.change @ (weighed.amplitude - amplitude)
    deviation = np.sqrt(np.sum((about.change @ weighed.covariance) * about.change, axis=1))
    return float(np.max(np.abs(change) / np.maximum(deviation, 1e-300), initial=0.0))


def _root(P: Array) -> Array:
    """Return columns (n, n) of a covariance matrix of any rank."""
    size = np.sqrt(np.maximum(np.diag(P), 1e-300))
    values, vectors = np.linalg.eigh(P / np.outer(size, size))
    return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


_OWNERS = {"gyroscope": "gyros", "accelerometer": "accelerometers", "reference": "reference", "robot": "robot"}
_UNITS = {"gyroscope": ("deg/s", DEG), "accelerometer": ("mg", MG), "robot": ("mrad", MRAD)}
_OF_POSES = {"position": ("mm", MM), "orientation": ("mrad", MRAD), "stamps": ("ms", MS)}


def describe(one: FoundFamily) -> str:
    """Return a family with its size, in words."""
    owner, _, of = one.family.name.partition(".")
    what, _, by = of.partition("_by_")
    unit, size = _UNITS.get(owner) or _OF_POSES[what]
    subject = f"{_OWNERS[owner]}, {what} by {by}" if by else f"{_OWNERS[owner]} by {what}"
    if what == RANGE:
        subject = f"{_OWNERS[owner]} that are cut off near the ends of their range"
    if what == SIGN:
        steps = "changes with the sign of the reading, as by truncation or a converter's step"
        subject = f"{_OWNERS[owner]} whose offset {steps}"
    if what == PRODUCTS:
        subject = f"{_OWNERS[owner]} by products of rates, as if a device took out centripetal forces"
    return f"{subject.replace('_', ' ')}, {one.size / size:.2g} {unit} rms (gain {one.gain:.0f})"
