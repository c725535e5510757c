"""Noise that standstills show: what nobody states is found by the evidence of the data, and its uncertainty is kept.

Five figures: errors of the force and of the rate that are new at each standstill (hand, table, temperature), the walks
of both offsets, and errors in proportion to the rate, new from sample to sample: of when a sample was taken, of the
rate between two samples. Of several laws (the angle turned, the way, no dependence) this one describes turns by hand of
three devices best, by 4 to 40 in the logarithm of the evidence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kreisel._kernels.node_elimination import NODE
from kreisel.geometry.rotation import Array
from kreisel.static.rest_chain import ACCEL_WALK, ATTITUDE, GYRO_WALK, Solution, solve
from kreisel.static.rest_equations import Linear
from kreisel.static.rest_problem import RestProblem

_YAW, _ANY = 1e-4, 10.0
"""rad: deviation of the first standstill's heading, which is a choice, and of attitudes of which nothing is known."""

_GRID = 2.0 ** np.arange(-3.0, 13.0)
"""Sizes of a figure that are compared, in units of what the white noise hides. Chosen: an eighth of that is nothing."""

_BELOW = 7.0
"""Weight of the smallest size, of one for each other: a thousandth of what white noise hides is as likely as any size,
and the data are the same for all that are smaller than an eighth. Chosen: devices that lie still have none."""

_LARGE, _UNSURE = 10, np.log(3.0)
"""Place in it of a size that explains everything, and deviation of the logarithm of a figure that is usual."""

_SWEEPS, _SETTLED = 6, 0.1
"""Rounds over the figures at most, and relative change of all of them with which they end."""


@dataclass(frozen=True)
class RestNoise:
    """Noise figures of standstills and turns, SI.

    Attributes
    ----------
    force, rate
        Errors that are new at each standstill, m/s^2 and rad/s.
    gyro_walk, accel_walk
        Of the offsets, per second and root hertz.
    turn
        Error of a turn over the root of the integral of the squared rate, sqrt(s).
    known
        Of what is known of the attitudes besides, in its order.
    """

    force: float
    rate: float
    turn: float
    gyro_walk: float
    accel_walk: float
    known: tuple[float, ...] = ()


NO_NOISE = RestNoise(0.0, 0.0, 0.0, 0.0, 0.0)
"""Where nothing is known yet."""

FIGURES = ("force", "rate", "turn", "gyro_walk", "accel_walk")
"""Names of the figures, in the order of the equations they belong to."""


_RATE, _TURN, _GYRO_WALK = 1, 2, 3
"""Places of these among figures and equations."""

_BRIDGE = 1.0 / 12.0
"""Of a walk by one in one second, known at both ends of it: variance of its mean."""


@dataclass(frozen=True)
class Weighing:
    """How equations are weighed: white noise of each row, and what a unit of each figure adds to its variance.

    Attributes
    ----------
    white, share : (k, 3), for each kind of equations
        Variances; white noise times what was inflated.
    seconds : (k,)
        Duration of turns. The offset of a turn errs as those of standstills do, all the time that it lasts, and walks
        away from the mean of both.
    """

    white: tuple[Array, ...]
    share: tuple[Array, ...]
    seconds: Array

    @property
    def units(self) -> Array:
        """Size of each figure that white noise just hides, nothing where there is none, (K,)."""
        hidden = [
            np.sqrt(np.median(w[s > 0.0] / s[s > 0.0])) if np.any(s > 0.0) else 1.0
            for w, s in zip(self.white, self.share, strict=True)
        ]
        return np.array(hidden)

    def variances(self, figures: Array) -> list[Array]:
        """Return the variances of the rows, (S, k, 3) for each kind, by noise figures (S, K).

        They are (1, k, 3) where the figures of a kind are the same in all sets.
        """
        squares = [np.square(own if np.ptp(own) > 0.0 else own[:1])[:, None, None] for own in figures.T]
        out = [white + squares[k] * share for k, (white, share) in enumerate(zip(self.white, self.share, strict=True))]
        T = self.seconds[:, None]
        out[_TURN] = out[_TURN] + squares[_RATE] * T**2 + _BRIDGE * squares[_GYRO_WALK] * T**3
        return out


def weighing(problem: RestProblem, linear: Linear, inflated: Mapping[str, Array]) -> Weighing:
    """Return how a problem's equations are weighed.

    inflated: further variances of rows (k,), by kind, of standstills and turns that do not fit.
    """
    rests, turns = problem.rests, linear.turns
    T = rests.durations[:, None]
    at = linear.turn.node
    force = rests.density_a**2 / T + (rests.creep**2 / 3.0)[:, None] + rests.rounding_a
    rate = rests.density_w**2 / T + rests.rounding_w
    force = force + inflated.get("force", np.zeros(1))[:, None]
    rate = rate + inflated.get("rate", np.zeros(1))[:, None]
    mean = np.mean(rests.density_w**2)
    turn = np.repeat(mean * turns.seconds[at][:, None], 3, axis=1) + inflated.get("turn", np.zeros(1))[:, None]
    between = np.repeat(np.diff(rests.seconds)[:, None], 3, axis=1)
    one = np.ones((rests.count, 3))
    known = [k.white + inflated.get(k.kind, np.zeros(1))[:, None] for k in problem.known]
    return Weighing(
        (force, rate, turn, np.zeros_like(between), np.zeros_like(between), *known),
        (one, one, np.repeat(turns.agitation[at][:, None], 3, axis=1), between, between,
         *(k.share for k in problem.known)),
        turns.seconds[at],
    )  # fmt: skip


def solution(problem: RestProblem, linear: Linear, how: Weighing, figures: Array, about: Array) -> Solution:
    """Return the solutions for noise figures (S, K); about: change (P,) from the parameters to their prior."""
    weights = [1.0 / variance for variance in how.variances(figures)]
    prior = np.diag(1.0 / problem.width**2)
    found = solve(linear.all, weights, _of_nodes(problem, linear, how), (prior, prior @ about))
    # what the prior itself is worth: problems have different parameters
    before = -0.5 * float(about @ prior @ about) - float(np.sum(np.log(problem.width)))
    return replace(found, log_evidence=found.log_evidence + before)


def _of_nodes(problem: RestProblem, linear: Linear, how: Weighing) -> Array:
    """Return the information about each standstill's unknowns before, (M, NODE, NODE).

    Heading is a choice, and offsets are those in the middle of the recording.
    """
    M = problem.rests.count
    out = np.zeros((M, NODE, NODE))
    out[:, ATTITUDE, ATTITUDE] = np.eye(3) / _ANY**2
    up = linear.force.of_node[0, :, ATTITUDE]  # the heading turns nothing that the force shows
    axis = np.linalg.svd(up)[2][2]
    if not any(one.gives_heading for one in problem.known):
        out[0, ATTITUDE, ATTITUDE] += np.outer(axis, axis) / _YAW**2
    for part, white in ((GYRO_WALK, _white_of_rates(problem, how)), (ACCEL_WALK, float(np.median(how.white[0])))):
        held = 1e4 / white
        out[M // 2, part, part] += held * np.eye(3)
    return out


def _white_of_rates(problem: RestProblem, how: Weighing) -> float:
    """Return the variance of a standstill's rates by noise, also if it is not read."""
    rests = problem.rests
    if rests.silent:
        return float(np.median(rests.density_w**2) / np.median(rests.durations))
    return float(np.median(how.white[1]))


def find_noise(problem: RestProblem, linear: Linear, how: Weighing, about: Array, first: RestNoise) -> RestNoise:
    """Return the noise figures that the data show: the root of the mean square of each, over all orders of magnitude.

    That mean exceeds the likeliest value by as much as few standstills leave open, so that deviations hold for few.

    Notes
    -----
    By equation (34) of docs/explanation/model.md, one figure after the other.
    """
    rests = problem.rests
    span = max(float(rests.seconds[-1] - rests.seconds[0]), 1.0)
    hidden = how.units
    if rests.silent:  # what rates at standstill err by is unknown, and walks are those by turns
        hidden[_RATE] = np.sqrt(_white_of_rates(problem, how))
    hidden[3:5] = hidden[[1, 0]] / np.sqrt(span)
    left_out = (*((3, 4) if problem.constant_offsets else ()), *((_RATE,) if rests.silent else ()))
    looked = [k for k in range(hidden.size) if k not in left_out]
    known = as_row(first)[0]
    begin = np.maximum(np.pad(known, (0, hidden.size - known.size)), hidden * _GRID[0])
    if problem.constant_offsets:
        begin[3:5] = 1e-3 * hidden[3:5]
    if rests.silent:
        begin[_RATE] = 0.0

    def evidence(figures: Array) -> Array:
        own = solution(problem, linear, how, figures, about).log_evidence
        for k, one in enumerate(problem.known, len(FIGURES)):
            if one.usual is not None:
                own = own - 0.5 * (np.log(figures[:, k] / one.usual) / _UNSURE) ** 2
        return own

    starts = [begin]
    if not known.any():  # what one figure explains another may, too: each has its turn to be the first
        for k in looked:
            large = begin.copy()
            large[k] = hidden[k] * _GRID[_LARGE]
            starts.append(large)
    found = [_by_turns(evidence, start, hidden, looked) for start in starts]
    best = found[0] if len(found) == 1 else found[int(np.argmax(evidence(np.array(found))))]
    own = dict(zip(FIGURES, best.tolist(), strict=False))
    return RestNoise(**own, known=tuple(best[len(FIGURES) :].tolist()))


def _by_turns(evidence: Callable[[Array], Array], start: Array, hidden: Array, looked: Sequence[int]) -> Array:
    """Return the figures (K,), each in its turn the root of its mean square by the evidence for all sizes of it."""
    figures = start.copy()
    for _ in range(_SWEEPS):
        before = figures.copy()
        for k in looked:
            trial = np.repeat(figures[None], _GRID.size, axis=0)
            trial[:, k] = hidden[k] * _GRID
            own = evidence(trial)
            if not np.isfinite(own).any():
                return figures
            chance = np.exp(own - own.max())
            chance[0] *= _BELOW
            figures[k] = hidden[k] * np.sqrt(chance @ _GRID**2 / chance.sum())
        if np.all(np.abs(figures - before) <= _SETTLED * before):
            break
    return figures


def as_row(noise: RestNoise) -> Array:
    """Return the figures as a row (1, K)."""
    return np.array([[*(getattr(noise, name) for name in FIGURES), *noise.known]])
