"""Noise of reported poses beside that of their stamps, which lies along the motion."""

from __future__ import annotations

import numpy as np

from kreisel.fitting.update_history import History
from kreisel.geometry.rotation import Array, Mask

_STEPS, _SETTLED = 12, 0.02
"""Largest number of Fisher's scoring steps; they end once no variance moves by more than this share of it."""

_LEFT_OUT, _SMALLEST = 0.02, 0.02
"""Share of the updates, those with the largest products, that does not count; of a variance that a step leaves."""

_RANGE = (1e-2, 1e4)
"""Of variances, in units of what is assumed. Chosen: noise is adapted again in the next pass; far below, the motion
alone would be left of a covariance, which has no inverse."""


def pose_factors(history: History, rows: Mask, deviations: tuple[float, float], stamps: Array) -> tuple[float, float]:
    """Return the factors between observed and assumed noise of positions and orientations, that of stamps known.

    Parameters
    ----------
    rows : (u,)
        Which updates count.
    deviations
        Assumed for positions (m) and orientations (rad).
    stamps : (u,)
        Assumed deviations of the stamps of updates, s.

    Notes
    -----
    The products of innovations and residuals after the update have the measurement noise as their expectation
    (Desroziers, Berre, Chapnik and Poli 2005): diag(a s_p^2, b s_q^2) + s_t^2 m m^T with the motion m. a and b are
    those that are most likely if the products were sample covariances of as much normal noise.
    """
    known = np.asarray(np.isfinite(history.innovation[rows, :6]).all(axis=0))
    size = np.repeat(deviations, 3)[known]
    innovation, residual, motion = (
        columns[rows][:, :6][:, known] / size for columns in (history.innovation, history.residual, history.passing)
    )
    kinds = np.flatnonzero(known[::3])
    of_poses = np.array([np.diag((np.arange(6) // 3 == kind)[known].astype(float)) for kind in kinds])
    motion = stamps[rows, None] * motion
    of_stamps = motion[:, :, None] * motion[:, None, :]
    variances = np.ones(kinds.size)
    for _ in range(_STEPS):
        before = variances
        found = _scored(innovation, residual, of_poses, of_stamps, before)
        variances = np.clip(found, np.maximum(_SMALLEST * before, _RANGE[0]), _RANGE[1])
        if np.all(np.abs(variances - before) < _SETTLED * variances):
            break
    factors = np.ones(2)
    factors[kinds] = np.sqrt(variances)
    return float(factors[0]), float(factors[1])


def _scored(innovation: Array, residual: Array, of_poses: Array, of_stamps: Array, variances: Array) -> Array:
    """Return the variances after a step of Fisher's scoring."""
    inverse = np.linalg.inv(np.tensordot(variances, of_poses, 1) + of_stamps)
    left, right = (np.einsum("uij,uj->ui", inverse, x) for x in (innovation, residual))
    size = np.sum(left * residual, axis=1)
    used = size <= np.quantile(size, 1.0 - _LEFT_OUT)
    inverse, left, right, of_stamps = inverse[used], left[used], right[used], of_stamps[used]
    by = np.einsum("uij,pjk->puik", inverse, of_poses)
    information = np.einsum("puij,quji->pq", by, by)
    gradient = np.einsum("ui,pij,uj->p", left, of_poses, right)
    stamps = np.einsum("puij,ujk,uki->p", by, inverse, of_stamps)
    return np.asarray(np.linalg.solve(information, gradient - stamps))
