"""Fusion of Gaussian results of several recordings: what they have in common counts once.

A result contains the data and the prior, and its deviations may have been made larger. The prior is taken out of every
result and put back once. What remains is a least squares problem in the common parameters, and in where the body b of
each recording lies against that of the first one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.estimation.state import StateLayout
from kreisel.geometry.rotation import Array, matrix

TURN_SD, SHIFT_SD = 0.5, 0.5
"""rad and m; standard deviations of a mount against the first one, about the first estimate of it."""

_MIN_INFORMATION = 1e-3
"""Of a direction in which data count, in units of the prior's information."""

_MIN_SHARE = 0.05
"""Of the variance of a direction, by which it must decrease for a comparison."""

_STEPS, _SETTLED = 20, 1e-6
"""Largest number of Gauss-Newton steps, and size of a step, in deviations, with which they end. Chosen: the dependence
is at most bilinear, so that steps shrink quickly; a millionth of a deviation is shown nowhere."""

_DIFFERENCE = 1e-4
"""SI; step of central differences by a common parameter. Chosen: they are exact for a bilinear dependence; for
rotations the square of it is the error, 1e-8, and 1e-16 over it that by rounding, 1e-12."""


@dataclass(frozen=True)
class Gaussian:
    """Mean (n,) and covariance (n, n)."""

    mean: Array
    covariance: Array


@dataclass(frozen=True)
class Said:
    """What the data of one recording say about shared parameters.

    Attributes
    ----------
    H, b : (r, n), (r,)
        `H s = b`, each row with noise of unit variance.
    excess : (n, n)
        Uncertainty of the result in directions about which the data say nothing, beyond that of the prior.
    """

    H: Array
    b: Array
    excess: Array


@dataclass(frozen=True)
class Contribution:
    """The result of one recording, of the parameters that it shares with others.

    Attributes
    ----------
    filtered
        Its result by data and prior.
    prior
        That prior.
    columns : (n, k)
        Effect of errors on the result that recordings share, each of unit variance; they follow the parameters in
        what `predict` returns.
    added : (n, n)
        Covariance of further errors of the result, by which its deviations were made larger.
    predict
        Function from the stored common parameters to the recording's, and the shared errors.
    """

    filtered: Gaussian
    prior: Gaussian
    columns: Array
    added: Array
    predict: Callable[[Array], Array]


@dataclass(frozen=True)
class Misfit:
    """What the data of a recording say, against all of them.

    Attributes
    ----------
    chi_square, degrees
        Sum of squares, and the number expected.
    largest
        Of a single direction, in standard deviations.
    """

    chi_square: float
    degrees: int
    largest: float


@dataclass(frozen=True)
class Fused:
    """The common parameters of all recordings.

    Attributes
    ----------
    layout, mean, covariance
        Of the common parameters, and of the mounts of all recordings but the first.
    parts
        The parameters of each recording, as they follow. Where a recording's own result is worse than its prior, so are
        they: what made its deviations larger is not known better by other recordings.
    chi_square, degrees
        Sum of squares of what does not fit, and the number expected.
    misfits
        What does not fit, for each recording.
    """

    layout: StateLayout
    mean: Array
    covariance: Array
    parts: tuple[Gaussian, ...]
    chi_square: float
    degrees: int
    misfits: tuple[Misfit, ...]

    def of(self, name: str) -> tuple[Array, Array]:
        """Return the stored value of a part, and its standard deviations."""
        d = self.layout[name]
        return self.mean[self.layout.stored(name)], np.sqrt(np.diag(self.covariance)[d])


def said_by(one: Contribution) -> Said:
    """Return what the data of a recording say, by a result that contains a prior.

    Notes
    -----
    With the prior as the unit, the information of the result has the eigenvalues l >= 1; that of the data is d = l - 1.
    The result lies y from the prior's centre; the data alone lie l / d y from it. A row of the data with noise e moves
    the result by sqrt(d) / l e; an error of the result is therefore one of l / sqrt(d) times its size in that row.
    """
    prior, n = one.prior, one.prior.mean.size
    root, whiten = _root(prior.covariance)
    P = whiten @ one.filtered.covariance @ whiten.T
    inverse, V = np.linalg.eigh(0.5 * (P + P.T))
    information = 1.0 / np.maximum(inverse, 1e-15)
    kept = information - 1.0 > _MIN_INFORMATION
    own, data = V[:, kept].T @ whiten, information[kept] - 1.0
    H = np.hstack([np.sqrt(data)[:, None] * own, (information[kept] / np.sqrt(data))[:, None] * (own @ one.columns)])
    b = np.sqrt(data) * (own @ prior.mean)
    b = b + information[kept] / np.sqrt(data) * (own @ (one.filtered.mean - prior.mean))
    noise = (information[kept] / np.sqrt(data))[:, None] * (own @ one.added @ own.T) * information[kept] / np.sqrt(data)
    unit = np.linalg.inv(np.linalg.cholesky(np.eye(b.size) + 0.5 * (noise + noise.T)))
    back = root @ V[:, ~kept]
    rest = V[:, ~kept].T @ whiten
    excess = np.zeros((H.shape[1],) * 2)
    excess[:n, :n] = back @ (rest @ one.added @ rest.T) @ back.T
    return Said(unit @ H, unit @ b, excess)


def _root(P: Array) -> tuple[Array, Array]:
    """Return the lower triangular root of a covariance matrix, and its inverse, by its correlations."""
    scale = np.sqrt(np.diag(P))
    L = np.linalg.cholesky(P / np.outer(scale, scale))
    return scale[:, None] * L, np.linalg.inv(L) / scale


def fuse(
    contributions: Sequence[Contribution], layout: StateLayout, start: Array, prior: Mapping[str, Gaussian]
) -> Fused:
    """Return the common parameters that fit all recordings best.

    Parameters
    ----------
    layout
        The common parameters.
    start
        Their values at first, as stored.
    prior
        What is known of them before any data, for each part; of a rotation as a right perturbation of the start.

    Notes
    -----
    Gauss-Newton; the dependence on the common parameters is at most bilinear.
    """
    said = [said_by(one) for one in contributions]
    whiten, centre = np.zeros((layout.degrees, layout.degrees)), start.copy()
    for part in layout:
        d, known = layout[part.name], prior[part.name]
        whiten[d, d] = _root(known.covariance)[1]
        if not part.rotation:
            centre[layout.stored(part.name)] = known.mean
    x = start.copy()
    for _ in range(_STEPS):
        A = np.vstack([*(one.H @ _jacobian(layout, c.predict, x) for one, c in zip(said, contributions, strict=True)),
                       whiten])  # fmt: skip
        r = _residual(layout, contributions, said, whiten, centre, x)
        size = np.linalg.norm(A, axis=0)
        step = np.linalg.lstsq(A / size, r, rcond=None)[0] / size
        x = layout.plus(x, step[:, None])[:, 0]
        covariance = np.linalg.inv((A / size).T @ (A / size)) / np.outer(size, size)
        if np.max(np.abs(step) / np.sqrt(np.diag(covariance))) < _SETTLED:
            break
    rest = _residual(layout, contributions, said, whiten, centre, x)
    fitted, misfits = [], []
    for one, own in zip(contributions, said, strict=True):
        J = _jacobian(layout, one.predict, x)
        follows = Gaussian(one.predict(x), J @ covariance @ J.T)
        misfits.append(_misfit(own, follows))
        fitted.append(Gaussian(follows.mean, follows.covariance + own.excess))
    return Fused(layout, x, covariance, tuple(fitted), float(rest @ rest), rest.size - layout.degrees, tuple(misfits))


def _misfit(said: Said, fitted: Gaussian) -> Misfit:
    """Return what does not fit of a recording.

    Directions that other recordings say little about do not count.

    Notes
    -----
    What all say contains what the recording says: residuals r have the covariance 1 - H S H^T, with the covariance S of
    what all say.
    """
    C = np.eye(said.b.size) - said.H @ fitted.covariance @ said.H.T
    share, V = np.linalg.eigh(0.5 * (C + C.T))
    kept = share > _MIN_SHARE
    along = V[:, kept].T @ (said.b - said.H @ fitted.mean) / np.sqrt(share[kept])
    if along.size == 0:
        return Misfit(0.0, 0, 0.0)
    return Misfit(float(along @ along), along.size, float(np.max(np.abs(along))))


def _residual(
    layout: StateLayout,
    contributions: Sequence[Contribution],
    said: Sequence[Said],
    whiten: Array,
    centre: Array,
    x: Array,
) -> Array:
    rows = [one.b - one.H @ c.predict(x) for one, c in zip(said, contributions, strict=True)]
    return np.concatenate([*rows, whiten @ layout.minus(centre[:, None], x)[:, 0]])


def _jacobian(layout: StateLayout, predict: Callable[[Array], Array], x: Array) -> Array:
    steps = _DIFFERENCE * np.eye(layout.degrees)
    ahead, back = layout.plus(x, steps), layout.plus(x, -steps)
    columns = [predict(ahead[:, k]) - predict(back[:, k]) for k in range(layout.degrees)]
    return np.array(columns).T / (2.0 * _DIFFERENCE)


def turned(values: Mapping[str, Array], q: Array, shift: Array) -> dict[str, Array]:
    """Return sensor parameters in another body: groups that depend on the mount, flat.

    Parameters
    ----------
    values
        Groups, as stored, in the body b.
    q, shift
        Rotation of vectors from b to the other body (quaternion), and the position of b's origin in it, m.
    """
    C = matrix(q)
    out = dict(values)
    for group in ("gyro_cross_coupling", "accel_cross_coupling"):
        if group in out:
            out[group] = (C @ out[group].reshape(3, 3)).ravel()
    if "lever_arms" in out:
        out["lever_arms"] = (out["lever_arms"].reshape(3, 3) @ C.T + shift).ravel()
    return out


def conditioned(result: Gaussian, index: Array, part: Gaussian, new: Gaussian) -> tuple[Array, Array]:
    """Return the change of a Gaussian's mean, and its covariance, where some of its numbers are known otherwise.

    Parameters
    ----------
    index
        Places of these numbers in the whole.
    part, new
        Their distribution in the whole, and the better one.
    """
    P = result.covariance
    scale = np.sqrt(np.diag(part.covariance))
    S = part.covariance / np.outer(scale, scale)
    gain = np.linalg.solve(S, (P[:, index] / scale).T).T / scale
    covariance = P - gain @ (part.covariance - new.covariance) @ gain.T
    return gain @ (new.mean - part.mean), 0.5 * (covariance + covariance.T)
