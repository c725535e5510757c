"""Conversion of the compiled filter's record of its updates into a history."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from kreisel._kernels.cell import MEASURED, Record
from kreisel.filtering.history import History
from kreisel.geometry.rotation import Array, conjugate, log, multiply
from kreisel.model.problem import Problem
from kreisel.model.schedule import Update


def history_of(problem: Problem, updates: Sequence[Update], record: Record) -> History:
    """Return the history of some updates; its estimates are the parameters as they are stored."""
    at_standstill = np.array([item.standstill is not None for item in updates])
    reference = problem.reference
    given = [reference.positions is not None, reference.quaternions is not None]
    n = len(updates)
    degrees, nis, log_likelihood = np.empty(n), np.empty(n), np.empty(n)
    wide = np.full((4, n, MEASURED), np.nan)
    correction, variance, information = np.empty((n, 6)), np.empty((n, 6)), np.zeros(n)
    for kind in (False, True):
        which = np.flatnonzero(at_standstill == kind)
        if which.size == 0:
            continue
        present = np.flatnonzero(np.repeat([*given, kind], 3))
        m = present.size
        S, R, gain = record.factor[which, :m, :m], record.noise[which, :m, :m], record.gain[which, :, :m]
        white, innovation = record.whitened[which, :m], record.innovation[which, :m]
        # residual of an innovation: the noise's covariance times the inverse of the innovation's, times the innovation
        solved = np.linalg.solve(np.swapaxes(S, 1, 2), white[..., None])
        parts = (white, innovation, (R @ solved)[..., 0], np.diagonal(R, axis1=1, axis2=2))
        for row, part in zip(wide, parts, strict=True):
            row[np.ix_(which, present)] = part
        degrees[which] = m
        nis[which] = np.sum(white**2, axis=1)
        log_likelihood[which] = -0.5 * nis[which] - np.log(np.diagonal(S, axis1=1, axis2=2)).sum(axis=1)
        correction[which] = (gain @ white[..., None])[..., 0]
        variance[which] = np.sum(gain**2, axis=2)
        turns = np.flatnonzero((present >= 3) & (present < 6))
        if turns.size:
            inverse = np.linalg.inv(S)[:, :, turns]
            information[which] = record.used[which] * np.sum(inverse**2, axis=(1, 2))
    stored = [problem.layout.stored(group) for group in problem.groups]
    kept = record.mean[:, : max((part.stop for part in stored), default=0)].copy()
    seconds = problem.readings.stamps[[item.last for item in updates]]
    return History(
        seconds, kept, record.deviation, at_standstill, record.used, nis, degrees, log_likelihood,
        wide[0], wide[1], wide[2], wide[3], correction, variance, information,
    )  # fmt: skip


def joined(problem: Problem, parts: Sequence[History], last: Array) -> History:
    """Return the histories of all parts as one; its estimates have one number for each degree of freedom.

    Those of the alignment are distances from `last`, the final stored state (size,).
    """
    columns = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(History)}
    layout, stored, out = problem.layout, columns["parameters"], []
    for group in problem.groups:
        value = stored[:, layout.stored(group)]
        if group == "alignment":
            turned = log(multiply(conjugate(last[layout.stored(group)]), value))
            value = turned[:, : layout[group].stop - layout[group].start]
        out.append(value)
    columns["parameters"] = np.hstack(out) if out else np.empty((len(stored), 0))
    return History(**columns)
