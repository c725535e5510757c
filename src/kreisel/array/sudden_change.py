"""Whether an IMU of an array turned on the body, or its clock jumped, at some moment of a recording.

Its rates then differ from the others' before and after: by a rotation of the rates, or along their derivative. A
constant rotation and delay, a matrix that errs, and clocks of another rate are in all of the recording alike; offsets
drift slowly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.estimation.robust import normal_scale
from kreisel.geometry.rotation import Array, Indices, Mask, skew

PARTS, _EDGE = 60, 3
"""Parts of a recording between which a change is looked for, and those at either end in which it is not."""

SURE = 60.0
"""Chi-square, over the scatter of the parts, from which a change counts. Chosen: that of noise alone is beyond it with
a probability of 1e-10, and what vibrates or bends differs from part to part by as much as it scatters."""

_TURN, _DELAY = 2e-3, 1e-3
"""rad and s: smallest change that counts. Chosen: on a public board of eight units that nothing touched, delays
differed by 0.9 ms from part to part, and rotations by 4 mrad between slow and fast ones."""

ALONE, OF_TWO = 1.6, 3.0
"""By how much the change of one unit must exceed that of any other, and of two units the smallest one that counts: of
three units the other two change by half of it."""

RICH = 0.03
"""Share of the information of usual parts that a part must have to show a change by itself."""

_FEWEST = 5
"""Pieces by whose scatter a change is judged. Chosen: of four steps three are without it, and the median is theirs."""

_SIZES = (0.03, 0.4)
"""Rates, over those of the fastest part, from which a part is a slow one, and a fast one."""

DRIFT = 3
"""Degree of offsets that drift. Chosen: units that warm up are no units that turn."""

_SPIKE = 10.0
"""Deviations from neighbours from which a difference is a spike, and says nothing. Chosen: motion is smooth."""

_MEDIANS = {1: 0.455, 3: 2.366}
"""Medians of chi-square, by degrees of freedom."""


@dataclass(frozen=True)
class SuddenChange:
    """A change of one IMU.

    Attributes
    ----------
    number
        Of the IMU.
    seconds
        When.
    size
        rad, or s.
    weight
        Chi-square by which the data show it, over the scatter of the parts.
    explained
        Chi-square by which it is seen, over noise alone.
    turn
        Whether it is a rotation, and not a delay.
    """

    number: int
    seconds: float
    size: float
    weight: float
    explained: float
    turn: bool

    @property
    def text(self) -> str:
        """What is said of it."""
        if self.turn:
            return f"turns against the others by {1e3 * self.size:.2g} mrad at about {self.seconds:.0f} s: fasten it"
        return f"its clock jumps by {1e3 * self.size:.2g} ms at about {self.seconds:.0f} s"


def sudden_change(seconds: Array, rates: Array, slope: Array) -> SuddenChange | None:
    """Return the clearest change of an IMU against all others, if there is one; of two, the second one changes.

    Parameters
    ----------
    seconds : (n,)
    rates : (N, n, 3)
        In common axes.
    slope : (n, 3)
        Derivative of their mean.
    """
    count, total = len(rates), rates.sum(axis=0)
    units = range(1 if count == 2 else 0, count)
    changes = [_changes(k, seconds, rates[k], (total - rates[k]) / (count - 1), slope) for k in units]
    found = []
    for turn, least in ((True, _TURN), (False, _DELAY)):
        own = sorted((one for each in changes for one in each if one.turn is turn), key=lambda one: -one.size)
        usual = own[1].size * ALONE if len(own) > 1 else least * (OF_TWO if count == 2 else 1.0)
        if own and own[0].size > max(usual, least):
            found.append(own[0])
    return max(found, key=lambda change: change.explained, default=None)


def _changes(number: int, seconds: Array, own: Array, others: Array, slope: Array) -> list[SuddenChange]:
    """Return the clearest turn and the clearest delay of an IMU against the others' mean (n, 3), if there are any."""
    late, part = in_parts(seconds)
    bend = np.gradient(slope, seconds, axis=0)
    out: dict[bool, SuddenChange] = {}
    for group in alike_parts(others, part):
        used = group[part]
        if not used.any():
            continue
        lasting = _lasting(others[used], slope[used], bend[used], late[used])
        left = own[used] - others[used]
        smooth = ~spikes_in(left)[:, None]
        lasting, left = lasting * smooth[:, :, None], left * smooth
        left = without(lasting, left)
        for turn, X in ((True, -skew(others[used])), (False, slope[used][:, :, None])):
            sums = sums_of(part[used], X * smooth[:, :, None], lasting, left)
            k, size, weight, explained = clearest(*sums, np.flatnonzero(group))
            if weight > max(SURE, out[turn].weight if turn in out else 0.0):
                when = float(seconds[0] + (seconds[-1] - seconds[0]) * k / PARTS)
                out[turn] = SuddenChange(number, when, size, weight, explained, turn)
    return list(out.values())


def spikes_in(left: Array) -> Mask:
    """Return where differences of rates (n, 3) have a spike, (n,), with the samples beside it."""
    bend = left[1:-1] - 0.5 * (left[:-2] + left[2:])
    sharp = np.any(np.abs(bend) > _SPIKE * normal_scale(bend), axis=1)
    out = np.zeros(len(left), dtype=bool)
    for shift in range(3):
        out[shift : len(left) - 2 + shift] |= sharp
    return out


def in_parts(seconds: Array) -> tuple[Array, Indices]:
    """Return times (n,) from 0 to 1, and the parts that they are in."""
    late = (seconds - seconds[0]) / (seconds[-1] - seconds[0])
    return late, np.minimum((late * PARTS).astype(int), PARTS - 1)


def lasting_difference(own: Array, others: Array, slope: Array, late: Array) -> Array:
    """Return what is left of the difference of rates (n, 3) beside what is alike all the time.

    Parameters
    ----------
    slope : (n, 3)
        Derivative of the rates.
    late : (n,)
        Time, from 0 to 1.
    """
    return without(_lasting(others, slope, np.gradient(slope, late, axis=0), late), own - others)


def without(lasting: Array, values: Array) -> Array:
    """Return values (n, 3) without the combination of columns (n, 3, q) that is nearest to them."""
    return np.asarray(values - lasting @ _least_squares(lasting, values))


def _lasting(rates: Array, slope: Array, bend: Array, late: Array) -> Array:
    """Return what is alike all the time, or changes slowly, (n, 3, 24).

    A matrix, offsets and their drift, a delay and what it gains, and a filter's second order.
    """
    X = np.zeros((len(rates), 3, 24))
    drift = late[:, None] ** np.arange(DRIFT + 1)
    for j in range(3):
        X[:, j, 3 * j : 3 * j + 3] = rates
        X[:, j, 9 + 4 * j : 13 + 4 * j] = drift
    X[:, :, 21], X[:, :, 22], X[:, :, 23] = slope, late[:, None] * slope, bend
    return X


def _least_squares(X: Array, y: Array) -> Array:
    """Return the least squares solution (p,) for columns X (n, 3, p) and values y (n, 3)."""
    rows = X.reshape(-1, X.shape[2])
    size = np.sqrt(np.mean(rows**2, axis=0)) + 1e-12
    A, b = rows.T @ rows / size[:, None] / size, rows.T @ y.ravel() / size
    return np.asarray(np.linalg.lstsq(A, b, rcond=1e-12)[0] / size)


def alike_parts(rates: Array, part: Indices) -> list[Mask]:
    """Return the parts (parts,) that are slow, and those that are fast, by the means of squared rates (n, 3) in them.

    Gyros that are not linear turn rates of another size by another angle: only like parts are compared.
    """
    power = np.bincount(part, np.sum(rates**2, axis=1), PARTS) / np.maximum(np.bincount(part, minlength=PARTS), 1)
    size = np.sqrt(power / power.max())
    return [(size > low) & (size <= high) for low, high in zip(_SIZES, (*_SIZES[1:], 1.0), strict=True)]


def sums_of(part: Indices, X: Array, lasting: Array, left: Array) -> tuple[Array, Array, Array, Array]:
    """Return sums over parts, by white noise, about changes along X (n, 3, p).

    Information (parts, p, p), that in common with what lasts (parts, p, q), score (parts, p), and the information about
    what lasts (q, q).
    """
    variance = max(normal_scale(left[np.any(left != 0.0, axis=1)]) ** 2, 1e-30)
    p, q = X.shape[2], lasting.shape[2]
    info, cross, score = np.zeros((PARTS, p, p)), np.zeros((PARTS, p, q)), np.zeros((PARTS, p))
    np.add.at(info, part, np.swapaxes(X, 1, 2) @ X / variance)
    np.add.at(cross, part, np.swapaxes(X, 1, 2) @ lasting / variance)
    np.add.at(score, part, np.einsum("nip,ni->np", X, left) / variance)
    rows = lasting.reshape(-1, q)
    return info, cross, score, rows.T @ rows / variance


def clearest(info: Array, cross: Array, score: Array, whole: Array, group: Indices) -> tuple[int, float, float, float]:
    """Return the first part after the clearest change, its size, and its chi-square over pieces' scatter, and noise.

    group: numbers of the parts that are compared; of others the sums are zero.
    """
    p = score.shape[1]
    begins = _pieces(info, RICH * float(np.trace(info.sum(axis=0))) / (p * group.size))
    if begins.size < _FEWEST:
        return 0, 0.0, 0.0, 0.0
    info, cross, score = (np.add.reduceat(values, begins) for values in (info, cross, score))
    value = np.linalg.solve(info, score[..., None])[..., 0]
    spread = np.linalg.inv(info)
    scatter = excess_of_steps(value[1:] - value[:-1], spread[1:] + spread[:-1])
    inner = (begins >= begins[0] + _EDGE) & (begins <= group[-1] + 1 - _EDGE)
    inner[[0, -1]] = False
    A, C, b = (from_here(values)[inner] for values in (info, cross, score))
    # what lasts is estimated, too: differences have no share of it
    V = A - C @ np.linalg.pinv(whole, rcond=1e-12, hermitian=True) @ np.swapaxes(C, 1, 2)
    V += 1e-6 * np.trace(A[0]) * np.eye(p)
    size = np.linalg.solve(V, b[..., None])[..., 0]
    explained = np.einsum("ki,ki->k", size, b)
    best = int(np.argmax(explained))
    found = float(explained[best])
    return int(begins[inner][best]), float(np.linalg.norm(size[best])), found / scatter, found


def _pieces(info: Array, least: float) -> Indices:
    """Return the first parts of pieces, of one part or several, that each show a change in all directions.

    A turn from attitude to attitude by hand is about one axis, and shows none about this. What is left at the end
    belongs to the last piece.
    """
    begins, own = [0], np.zeros_like(info[0])
    for k, part in enumerate(info):
        if np.linalg.eigvalsh(own)[0] > least:
            begins.append(k)
            own = np.zeros_like(own)
        own = own + part
    if np.linalg.eigvalsh(own)[0] <= least:
        begins.pop()
    return np.array(begins, dtype=int)


def excess_of_steps(steps: Array, covariances: Array) -> float:
    """Return by how much variances of steps (k, p) from part to part exceed covariances (k, p, p), 1 at least.

    By the median, so that a step where something changes does not count.
    """
    chi = np.einsum("ki,kij,kj->k", steps, np.linalg.inv(covariances), steps)
    return max(1.0, float(np.median(chi)) / _MEDIANS[steps.shape[1]])


def from_here(values: Array) -> Array:
    """Return sums of each part (k, …) and all after it."""
    return np.asarray(np.cumsum(values[::-1], axis=0)[::-1])
