"""Which parameters of several recordings of one device are the same numbers, and how each recording's follow."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from kreisel.calibration.fusion import (
    SHIFT_SD,
    TURN_SD,
    Contribution,
    Gaussian,
    conditioned,
    turned,
)
from kreisel.calibration.outcome import Outcome
from kreisel.estimation.state import Part, StateLayout
from kreisel.fitting.result_change import result_moved
from kreisel.geometry.rotation import Array, from_matrix, nearest_rotation
from kreisel.model.groups import group_named
from kreisel.model.parameters import PASSING_GROUPS, REFERENCE_GROUPS, ROBOT_GROUPS, SENSOR_GROUPS
from kreisel.refinement.estimate import Estimate

SHARED = ("offsets", "mount", "robot", "site", "reference")
"""What recordings of one device may have in common besides the device."""

DEFAULT = ("robot", "site", "reference")
"""What they have in common unless the user says otherwise: errors that would else count as independent."""

_OFFSETS = ("gyro_offset", "accel_offset")
_COMMON = 0.8**0.5
"""Share of the errors of a robot's frames that motions of the same robot have in common. What errors of joints do to a
tool depends on the posture: of simulated arms of 0.3 mm and 0.3 mrad, two motions turn the tool 0.25 mrad apart."""

_ERRORS = "errors of the reference"


class Sharing:
    """Which parameters of the recordings are the same numbers, and how each recording's follow from them.

    Attributes
    ----------
    layout
        The common parameters, and the mounts of all recordings but the first.
    """

    def __init__(self, outcomes: Sequence[Outcome], common: Collection[str]) -> None:
        self._found = [one.estimate for one in outcomes]
        self._temperature = [one.recording.imu.usual_temperature for one in outcomes]
        oriented = [one.problem.reference.quaternions is not None for one in outcomes]
        self._mounts = [i for i in range(1, len(outcomes)) if "mount" not in common or not oriented[i]]
        device = [
            group
            for group in SENSOR_GROUPS
            if group not in PASSING_GROUPS
            and ("offsets" in common or group not in _OFFSETS)
            and all(_alike(one, self._found[0], group) for one in self._found)
        ]
        self._names = [{g: g for g in device} | _named_by_owner(one, common) for one in outcomes]
        shared = "robot" in common
        errors = [_COMMON * one.common if shared and one.common.size else np.zeros((0, 0)) for one in self._found]
        self._errors = [found.shape[1] for found in errors]
        sizes = {
            name: _degrees(one, group)
            for one, names in zip(self._found, self._names, strict=True)
            for group, name in names.items()
        }
        sizes |= {_ERRORS: max(self._errors)} if max(self._errors) else {}
        parts = [Part(name, size) for name, size in sizes.items()]
        mounts = [part for i in self._mounts for part in (Part(turn_of(i), 3, rotation=True), Part(shift_of(i), 3))]
        self.layout = StateLayout([*parts, *mounts])
        self._whole = [self._with_errors(i, columns) for i, columns in enumerate(errors)]

    def _with_errors(self, i: int, columns: Array) -> Gaussian:
        """Return the result of a recording: all parameters, then the errors it shares with others."""
        found = self._found[i]
        n, k = len(found.problem.parameter_names), columns.shape[1]
        P = np.eye(n + k)
        P[:n, :n] = found.belief.covariance[:n, :n]
        if k:
            P[:n, n:], P[n:, :n] = columns[:n], columns[:n].T
        return Gaussian(np.append(values_of(found), np.zeros(k)), P)

    def _index(self, i: int) -> Array:
        """Return the places of the shared numbers in a recording's result."""
        layout, whole = self._found[i].problem.layout, self._whole[i].mean.size
        groups = [np.r_[layout[group]] for group in self._names[i]]
        return np.concatenate([*groups, np.arange(whole - self._errors[i], whole)]).astype(np.int64)

    def _part(self, i: int) -> Gaussian:
        index = self._index(i)
        return Gaussian(self._whole[i].mean[index], self._whole[i].covariance[np.ix_(index, index)])

    def _prior_of(self, i: int, group: str) -> Gaussian:
        problem = self._found[i].problem
        return Gaussian(problem.stored(problem.prior.value, group), problem.prior.covariance[group])

    def contributions(self) -> list[Contribution]:
        """Return what each recording contributes."""
        out = []
        for i, names in enumerate(self._names):
            priors = [self._prior_of(i, group) for group in names]
            prior = Gaussian(np.concatenate([one.mean for one in priors]), _block_diagonal(priors))
            part, n = self._part(i), prior.mean.size
            index, columns = self._index(i)[:n], part.covariance[:n, n:]
            filtered = Gaussian(part.mean[:n], self._found[i].run.belief.covariance[np.ix_(index, index)])
            errors = np.hstack([np.zeros((index.size, 0)), *(c.columns[index] for c in self._found[i].contributions)])
            added = errors @ errors.T - columns @ columns.T
            out.append(Contribution(filtered, prior, columns, added, partial(self._predict, i)))
        return out

    def prior(self) -> dict[str, Gaussian]:
        """Return what is known of the common parameters before any data: once, however many recordings there are."""
        out: dict[str, Gaussian] = {}
        for i, names in enumerate(self._names):
            for group, name in names.items():
                out.setdefault(name, self._prior_of(i, group))
        if _ERRORS in self.layout:
            size = self.layout[_ERRORS].stop - self.layout[_ERRORS].start
            out[_ERRORS] = Gaussian(np.zeros(size), np.eye(size))
        start = self.start()
        for i in self._mounts:
            out[turn_of(i)] = Gaussian(np.zeros(3), TURN_SD**2 * np.eye(3))
            out[shift_of(i)] = Gaussian(start[self.layout.stored(shift_of(i))], SHIFT_SD**2 * np.eye(3))
        return out

    def start(self) -> Array:
        """Return the common parameters as the recordings alone give them, as stored."""
        x = np.zeros(self.layout.size)
        for found, names in zip(reversed(self._found), reversed(self._names), strict=True):
            for group, name in names.items():
                x[self.layout.stored(name)] = found.problem.stored(found.run.parameters, group)
        first = self._found[0].run.parameters.sensors
        for i in self._mounts:
            own = self._found[i].run.parameters.sensors
            C = nearest_rotation(own.K_omega) @ nearest_rotation(first.K_omega).T
            x[self.layout.stored(turn_of(i))] = from_matrix(C)
            x[self.layout.stored(shift_of(i))] = (own.lever_arms - first.lever_arms @ C.T).mean(axis=0)
        return x

    def _predict(self, i: int, x: Array) -> Array:
        """Return the shared numbers of a recording that follow from the common parameters."""
        found = self._found[i]
        values = {group: found.run.parameters.stored(group).copy() for group in self._names[i]}
        for group, name in self._names[i].items():
            values[group][found.problem.layout.present(group)] = x[self.layout.stored(name)]
        if i in self._mounts:
            values = turned(values, x[self.layout.stored(turn_of(i))], x[self.layout.stored(shift_of(i))])
        values = self._at_temperature(i, values)
        errors = x[self.layout.stored(_ERRORS)] if self._errors[i] else np.zeros(0)
        return np.concatenate([*(found.problem.columns(group, value) for group, value in values.items()), errors])

    def _at_temperature(self, i: int, values: dict[str, Array]) -> dict[str, Array]:
        """Return the device's values at the temperature that a recording's parameters belong to."""
        here, there = self._temperature[i], self._temperature[0]
        if here is None or there is None:
            return values
        out = dict(values)
        for kind in ("gyro", "accel"):
            scale = 1.0 + (here - there) * values.get(f"{kind}_scale_temperature", np.zeros(3))
            drift = (here - there) * values.get(f"{kind}_temperature", np.zeros(3))
            if (K := f"{kind}_cross_coupling") in out:
                out[K] = (out[K].reshape(3, 3) * scale).ravel()
            if (k0 := f"{kind}_offset") in out:
                out[k0] = (out[k0] + drift) / scale
        return out

    def estimate(self, i: int, part: Gaussian, factor: float) -> Estimate:
        """Return the estimate of a recording in which the shared parameters are the common ones."""
        found, whole = self._found[i], self._whole[i]
        n = len(found.problem.parameter_names)
        step, covariance = conditioned(whole, self._index(i), self._part(i), part)
        total = replace(found.run, belief=found.belief)
        run = result_moved(found.problem, total, step[:n], factor**2 * covariance[:n, :n])
        return replace(found, run=run, contributions=())


def values_of(found: Estimate) -> Array:
    """Return the values of the estimated parameters, (n,); zero for rotations."""
    out = np.zeros(len(found.problem.parameter_names))
    for group in found.problem.groups:
        if not group_named(group).rotation:
            out[found.problem.layout[group]] = found.problem.stored(found.run.parameters, group)
    return out


def turn_of(i: int) -> str:
    """Return the name of the rotation of a recording's mount against the first one's."""
    return f"turn of recording {i + 1}"


def shift_of(i: int) -> str:
    """Return the name of the shift of a recording's mount against the first one's."""
    return f"shift of recording {i + 1}"


def _alike(one: Estimate, other: Estimate, group: str) -> bool:
    """Return whether the same parameters of a group are in both states."""
    a, b = one.problem.layout, other.problem.layout
    return group in a and group in b and np.array_equal(a.present(group), b.present(group))


def _degrees(found: Estimate, group: str) -> int:
    d = found.problem.layout[group]
    return int(d.stop - d.start)


def _block_diagonal(blocks: Sequence[Gaussian]) -> Array:
    out = np.zeros((sum(one.mean.size for one in blocks),) * 2)
    at = 0
    for one in blocks:
        d = slice(at, at + one.mean.size)
        out[d, d] = one.covariance
        at = d.stop
    return out


def _named_by_owner(outcome: Outcome, common: Collection[str]) -> dict[str, str]:
    """Return the shared groups that are not the device's, with names that differ for different owners."""
    problem, settings = outcome.problem, outcome.recording.settings
    out = {}
    if "site" in common and "gravity" in problem.layout:
        out["gravity"] = f"gravity, {problem.site.gravity!r}, {problem.site.gravity_sd!r}"
    if "reference" in common:
        kind = settings.reference.kind or problem.reference.name
        out |= {group: f"{group}, {kind}" for group in REFERENCE_GROUPS if group in problem.layout}
    if "robot" in common and problem.robot is not None:
        arm = problem.robot.arm
        out |= {group: f"{group}, {arm.name}, {arm.tcp}" for group in ROBOT_GROUPS if group in problem.layout}
    return out
