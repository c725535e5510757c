"""Smooth functions of what sensors and reference go through: terms for errors that are on no list.

A family is one kind of error, such as an error of the gyros that depends on the acceleration: polynomials of a few
quantities, or waves in time, each with an unknown amplitude for every component. What the usual model already has is
taken out of each function over the recording: of a sensor's a constant and the readings, of an accelerometer's the
angular acceleration and the products of rates too, of a reference's what another frame or tool point would do. So the
usual parameters are those of the linear description that fits best over the recording, and a family adds to it what is
not linear. What changes slowly, with time, temperature or the past, is like slow changes of the readings by chance:
of it a constant is taken out, and what it shares with faster changes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kreisel.fitting.terms import ACCEL_ROWS, GYRO_ROWS, POSE_ROWS, Terms
from kreisel.geometry.rotation import Array, Indices, Mask, conjugate, exp, log, matrix, multiply
from kreisel.inertial.sensor_model import linear_columns, rate_products
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem, with_readings
from kreisel.model.schedule import Schedule
from kreisel.recording.recording import ReferencePoses
from kreisel.refinement.discrepancy_evidence import ODDS, RARE_ODDS
from kreisel.refinement.sample_groups import STEP, SampleGroups, blocks
from kreisel.refinement.term_functions import (
    WAVES,
    Basis,
    Functions,
    Usual,
    changes,
    cosines,
    ends_of_range,
    of_angles,
    of_own_angle,
    polynomials,
    remembered,
    scales,
    signs,
    some,
    waves,
)
from kreisel.robot import kinematics

_AROUND = 0.05
"""s; before and after a pose, for its velocity."""


@dataclass(frozen=True)
class Family:
    """One kind of error.

    Attributes
    ----------
    owner
        gyroscope, accelerometer, reference or robot.
    of
        What the error depends on; a name for files.
    rows
        What its functions add to: `fitting.terms.GYRO_ROWS` and the others, and directions after them.
    """

    owner: str
    of: str
    rows: tuple[int, ...]

    @property
    def name(self) -> str:
        """Name in files."""
        return f"{self.owner}.{self.of}"

    @property
    def odds(self) -> float:
        """Odds, before any look at the data, that there are errors of it: few devices follow a field, or truncate."""
        return RARE_ODDS if self.of in (FIELD, SIGN, RANGE, PRODUCTS) else ODDS

    @property
    def paired(self) -> bool:
        """Whether each row has functions of its own, instead of all functions in each row."""
        return self.of in (_OWN_ANGLE, _SCALE, RANGE, SIGN)


@dataclass(frozen=True)
class FoundFamily:
    """A family of terms that the data ask for.

    Attributes
    ----------
    family
    gain
        Logarithm of the ratio of evidences with and without it.
    size
        Rms over the recording: rad/s, m/s^2, m, rad or s.
    """

    family: Family
    gain: float
    size: float


class DiscrepancyTerms:
    """All families that a problem may have, with their functions, by its readings and poses as recorded."""

    def __init__(self, problem: Problem) -> None:
        self._recorded, self._grid = problem, SampleGroups.of(problem.sensor.readings.stamps)
        self._families: list[Family] = []
        self._functions: list[Functions] = []
        self._sensors(problem)
        self._poses(problem)
        self._last: tuple[Schedule, Terms] | None = None

    def serves(self, problem: Problem) -> bool:
        """Return whether a problem has the same data and sensors, whatever its noise, effects and updates are."""
        own, other = self._recorded, problem
        same = own.reference is other.reference and own.robot is other.robot
        values = ("stamps", "rates", "accelerations", "temperature_difference")
        same &= all(getattr(own.sensor.readings, name) is getattr(other.sensor.readings, name) for name in values)
        return same and all(
            (group in own.layout) == (group in other.layout)
            and (group not in own.layout or np.array_equal(own.layout.present(group), other.layout.present(group)))
            for group, _, _ in _SENSORS.values()
        )

    @property
    def families(self) -> tuple[Family, ...]:
        """The families, in the order of their numbers."""
        return tuple(self._families)

    @cached_property
    def family(self) -> Indices:
        """Number of each term's family, (m,)."""
        return np.concatenate([np.full(self._size(i), i) for i in range(len(self._families))])

    @cached_property
    def weight(self) -> Array:
        """How large an amplitude is expected to be beside others of its family, (m,): less for higher degrees."""
        return self._each(lambda functions: 1.0 / functions.degree)

    @cached_property
    def ends(self) -> Mask:
        """Whether a term's series ends with it, (m,): the next degree would be another function."""
        return np.asarray(self._each(lambda functions: functions.ends), dtype=bool)

    def _each(self, of: Callable[[Functions], NDArray[Any]]) -> NDArray[Any]:
        """Return what every term has from its function, (m,)."""
        return np.concatenate([
            np.tile(of(f), self._size(i) // f.degree.size) for i, f in enumerate(self._functions)
        ])  # fmt: skip

    def terms(self, schedule: Schedule) -> Terms:
        """Return the terms at the updates of a schedule; those of the last one are kept."""
        if self._last is None or self._last[0] is not schedule:
            self._last = schedule, self._at(schedule)
        return self._last[1]

    def _at(self, schedule: Schedule) -> Terms:
        (first, last), pose = schedule.samples, schedule.poses
        means: dict[Callable[[Indices], Array], Array] = {}  # sensors have functions in common
        for family, functions in zip(self._families, self._functions, strict=True):
            for of in (functions.raw, functions.usual) if family.owner in _SENSORS else ():
                if of not in means:
                    means[of] = self._grid.mean(of, first, last)
        columns = [
            functions.without_usual(means[functions.raw], means[functions.usual])
            if family.owner in _SENSORS
            else functions(pose)
            for family, functions in zip(self._families, self._functions, strict=True)
        ]
        begin = np.cumsum([0, *(column.shape[1] for column in columns)])
        function, row = [], []
        for i, family in enumerate(self._families):
            own = np.arange(begin[i], begin[i + 1])
            function.append(own if family.paired else np.tile(own, len(family.rows)))
            row.append(np.repeat(family.rows, self._size(i) // len(family.rows)))
        return Terms(np.hstack(columns), np.concatenate(function), np.concatenate(row), self._directions(pose))

    def corrected(self, problem: Problem, amplitudes: Array) -> Problem:
        """Return a problem with readings and poses as recorded, corrected by terms."""
        recorded = self._recorded
        readings, reference = recorded.sensor.readings, recorded.reference
        gyro, accel = (self._of_sensor(amplitudes, owner) for owner in _SENSORS)
        changed = problem.sensor.readings.with_values(
            rates=readings.rates + gyro, accelerations=readings.accelerations + accel
        )
        moved = self._of_poses(amplitudes, len(reference.stamps_ns))
        if reference.positions is not None:
            reference = replace(reference, positions=reference.positions + moved[:, :3])
        if reference.quaternions is not None:
            reference = reference.with_quaternions(multiply(reference.quaternions, exp(moved[:, 3:])))
        noise = replace(problem.noise, unlisted=(self._of_kind(amplitudes, 0), self._of_kind(amplitudes, 3)))
        return replace(with_readings(problem, changed), reference=reference, noise=noise)

    def at_rest(self, amplitudes: Array) -> Array:
        """Return means of what terms of the motion add to the gyros at standstill, (3,), rad/s; zero without any."""
        of_motion = np.array([family.of not in (*_DRIFTS, _SCALE, FIELD) for family in self._families])
        t, resting = self._recorded.sensor.readings.stamps, np.zeros(self._grid.samples, dtype=bool)
        for standstill in self._recorded.schedule.standstills:
            resting |= (t >= standstill.start) & (t <= standstill.stop)
        own = np.where(of_motion[self.family], amplitudes, 0.0)
        if not resting.any() or not own.any():
            return np.zeros(3)
        return np.asarray(self._of_sensor(own, "gyroscope")[resting].mean(axis=0))

    def size(self, amplitudes: Array, family: int) -> float:
        """Return the rms of what a family adds, over the recording: rad/s, m/s^2, m, rad or s.

        Functions depend on each other: what they add together is not the sum of their squares.
        """
        kind, own = self._families[family], amplitudes[self.family == family]
        of_poses = kind.owner not in _SENSORS
        count = self._recorded.reference.seconds.size if of_poses else self._grid.count
        functions = self._functions[family](some(count))
        if kind.paired:
            added = (functions * own).reshape(len(functions), len(kind.rows), -1).sum(axis=2)
        else:
            added = functions @ self._chosen(amplitudes, family).T
        return float(np.sqrt(np.mean(added**2)))

    def _of_kind(self, amplitudes: Array, first: int) -> float:
        """Return the rms of all errors of the reference's positions (first: 0) or orientations (3), m or rad."""
        own = [i for i, family in enumerate(self._families) if family.rows[0] == POSE_ROWS.start + first]
        found = [i for i in own if amplitudes[self.family == i].any()]
        return float(np.sqrt(sum(self.size(amplitudes, i) ** 2 for i in found)))

    def _size(self, i: int) -> int:
        """Return the number of a family's terms."""
        own, family = self._functions[i].degree.size, self._families[i]
        return own if family.paired else own * len(family.rows)

    def _add(self, family: Family, functions: Functions) -> None:
        if functions.kept.size:
            self._families.append(family)
            self._functions.append(functions)

    def _sensors(self, problem: Problem) -> None:
        """Find the families of the sensors."""
        readings, grid = problem.sensor.readings, self._grid
        rates, forces = grid.average(readings.rates), grid.average(readings.accelerations)
        t = grid.average(readings.stamps[:, None])[:, 0]
        alpha, jerk = np.gradient(rates, t, axis=0), np.gradient(forces, t, axis=0)
        # a gyro has no lever arm: by its axes, angular accelerations and products of rates are errors of its own
        one = np.ones((t.size, 1))
        usual = {"gyroscope": np.hstack([one, rates, forces]), _OF_RATES: np.hstack([one, rates])}
        usual["accelerometer"] = linear_columns(rates, forces, alpha)
        for columns in usual.values():
            columns *= t.size**0.5 / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        known = {owner: Usual(columns.__getitem__, t.size) for owner, columns in usual.items()}
        slow = np.linalg.qr(cosines(t, np.arange(2 * WAVES + 1))(some(t.size)))[0]
        drifting = {owner: replace(one, slow=slow) for owner, one in known.items()}
        memories = [remembered(np.abs(values)) for values in (rates, forces)]
        quantities = {
            "rate": polynomials(rates.__getitem__, t.size, 3, 6),
            "acceleration": polynomials(forces.__getitem__, t.size, 3, 6),
            "angular_acceleration": changes(alpha, np.gradient(alpha, t, axis=0)),
            "jerk": changes(jerk, np.gradient(jerk, t, axis=0)),
            "past_rate": polynomials(memories[0].__getitem__, t.size, 2),
            "past_acceleration": polynomials(memories[1].__getitem__, t.size, 2),
            TIME: waves(t),
        }
        if readings.temperature_difference is not None:
            difference = grid.average(readings.temperature_difference[:, None])
            quantities["temperature"] = polynomials(difference.__getitem__, t.size, 3)
        if problem.reference.quaternions is not None:
            level = axes_of_n(problem, problem.prior.start, t)[:, :, :2].reshape(t.size, -1)
            quantities[FIELD] = Basis(level.__getitem__, np.ones(level.shape[1]), apart=True)
        values = {name: basis.of(some(t.size)) for name, basis in quantities.items()}
        for owner, (group, rows, names) in _SENSORS.items():
            if group not in problem.layout:
                continue
            axes = problem.layout.present(group)
            own = (rates if owner == "gyroscope" else forces)[:, axes]
            own_rows = tuple(rows[axis] for axis in axes)
            common = {name: quantities[name] for name in names if name in quantities}
            alone = {_SCALE: scales(own, t), RANGE: ends_of_range(own)}
            if owner == "accelerometer":
                products = rate_products(rates)
                alone[PRODUCTS] = Basis(products.__getitem__, np.ones(products.shape[1]), apart=True, alike=True)
            noise = np.sqrt(readings.noise[0 if owner == "gyroscope" else 1, axes] / STEP)
            alone[SIGN] = signs(own, noise)
            for name, basis in {**common, **alone}.items():
                of_rates = owner == "gyroscope" and name in ("rate", "angular_acceleration")
                usual_of = known[_OF_RATES] if of_rates else (drifting if name in _DRIFTS else known)[owner]
                functions = usual_of.without(basis, values.get(name))
                if name not in alone or functions.kept.size == basis.degree.size:
                    self._add(Family(owner, name, own_rows), functions)

    def _poses(self, problem: Problem) -> None:
        """Find the families of reference and robot."""
        reference, robot = problem.reference, problem.robot
        p, q, tau = reference.positions, reference.quaternions, reference.seconds

        def usual(which: Indices) -> Array:
            frames = [np.ones((which.size, 1))]
            frames += [] if q is None else [matrix(q[which]).reshape(-1, 9)]
            frames += [] if p is None else [p[which] - p[0]]
            return np.hstack(frames)

        known = Usual(usual, tau.size)
        quantities = {"motion": polynomials(lambda which: _motion(reference, which), tau.size, 1)}
        if p is not None:
            quantities["position"] = polynomials(p.__getitem__, tau.size, 3)
        if q is not None:
            axes = [0, 3, 6, 2, 5, 8]  # of the tool, in r: the first and the third
            quantities["attitude"] = polynomials(lambda which: matrix(q[which]).reshape(-1, 9)[:, axes], tau.size, 2)
        if robot is not None:
            quantities["joints"] = of_angles(robot.angles)
        rows = {"position": tuple(POSE_ROWS)[:3], "orientation": tuple(POSE_ROWS)[3:]}
        present = {"position": p is not None, "orientation": q is not None}
        for name, basis in quantities.items():
            functions = known.without(basis)
            for what in (w for w in rows if present[w]):
                self._add(Family("reference", f"{what}_by_{name}", rows[what]), functions)
        late, constant = POSE_ROWS.stop, Usual(lambda which: np.ones((which.size, 1)), tau.size)
        self._add(Family("reference", "stamps_by_time", (late,)), constant.without(waves(tau)))
        if robot is not None:
            own = constant.without(of_own_angle(robot.angles))
            each = own.degree.size // robot.joints
            if own.kept.size == each * robot.joints:
                self._add(Family("robot", _OWN_ANGLE, tuple(range(late + 1, late + 1 + robot.joints))), own)

    def _directions(self, pose: Indices) -> Array:
        """Return what the directions do to poses, (u, 6, d)."""
        components = np.broadcast_to(np.eye(6), (pose.size, 6, 6))
        motion = _motion(self._recorded.reference, pose)
        return np.concatenate([components, motion[:, :, None], self._jacobian(pose)], axis=2)

    def _jacobian(self, which: Indices) -> Array:
        """Return what small changes of the joint angles do to poses, (n, 6, j)."""
        robot = self._recorded.robot
        if robot is None:
            return np.zeros((which.size, 6, 0))
        return kinematics.derivatives(robot.arm, robot.angles[which]).jacobian

    def _chosen(self, amplitudes: Array, i: int) -> Array:
        """Return a family's amplitudes by rows and functions, (r, k)."""
        own = amplitudes[self.family == i]
        return own.reshape(-1, self._functions[i].degree.size)

    def _of_sensor(self, amplitudes: Array, owner: str) -> Array:
        """Return what the terms of a sensor add to its readings, (n, 3)."""
        total, begin = np.zeros((self._grid.count, 3)), _SENSORS[owner][1].start
        for i, family in enumerate(self._families):
            if family.owner == owner and amplitudes[self.family == i].any():
                axes = [row - begin for row in family.rows]
                for block in blocks(self._grid.count):
                    value = self._functions[i](block)
                    if family.paired:
                        own = amplitudes[self.family == i]
                        added = (value * own).reshape(block.size, len(axes), -1).sum(axis=2)
                    else:
                        added = value @ self._chosen(amplitudes, i).T
                    total[block[:, None], axes] += added
        return self._grid.at_samples(total)

    def _of_poses(self, amplitudes: Array, count: int) -> Array:
        """Return what the terms add to poses, (n, 6)."""
        return np.concatenate([self._added(amplitudes, block) for block in blocks(count)])

    def _added(self, amplitudes: Array, which: Indices) -> Array:
        """Return what the terms add to some poses, (n, 6)."""
        total = np.zeros((which.size, 6))
        for i, family in enumerate(self._families):
            own = amplitudes[self.family == i]
            if family.owner in _SENSORS or not own.any():
                continue
            value = self._functions[i](which)
            if family.paired:
                each = value.shape[1] // len(family.rows)
                angle = (value * own).reshape(which.size, len(family.rows), each).sum(axis=2)
                total += np.einsum("nij,nj->ni", self._jacobian(which), angle)
            elif family.rows[0] >= POSE_ROWS.stop:
                total += _motion(self._recorded.reference, which) * (value @ own)[:, None]
            else:
                places = [row - POSE_ROWS.start for row in family.rows]
                total[:, places] += value @ self._chosen(amplitudes, i).T
        return total


_OWN_ANGLE, _SCALE = "own_angle", "scale_by_time"

_OF_RATES = "gyroscope by rates"
"""Of gyros by their rates: what they have in common with forces, as on an arm of the hand, is no response to these."""

FIELD = "attitude"
"""What the error of a sensor depends on that follows a field fixed in the cell."""

SIGN = "sign"
"""Of a sensor whose readings are truncated to zero."""

PRODUCTS = "products_of_rates"
"""Of accelerometers whose response to the rotation is not that of a lever arm: a device computes centripetal forces of
its own, or vibrates the more the faster it turns."""

RANGE = "range"
"""Of a sensor whose readings are cut off near their ends."""

TIME = "time"
"""What an error depends on that drifts."""

_DRIFTS = ("past_rate", "past_acceleration", TIME, "temperature")
"""What a sensor's drifts depend on."""

_SENSORS: dict[str, tuple[str, range, Sequence[str]]] = {
    "gyroscope": (
        "gyro_offset",
        GYRO_ROWS,
        ("rate", "acceleration", "angular_acceleration", FIELD, "past_rate", TIME, "temperature"),
    ),
    "accelerometer": (
        "accel_offset",
        ACCEL_ROWS,
        ("rate", "acceleration", "jerk", FIELD, "past_acceleration", TIME, "temperature"),
    ),
}
"""By sensor: its offset, in which its terms enter, axis by axis, its rows, and what its error may depend on."""


def _motion(reference: ReferencePoses, which: Indices) -> Array:
    """Return velocity in r and rate in b at some poses, by the poses themselves, (n, 6); zero where not given."""
    tau = reference.seconds
    width = max(1, round(_AROUND / max(reference.interval, 1e-9)))
    before, after = np.maximum(which - width, 0), np.minimum(which + width, tau.size - 1)
    seconds, out = (tau[after] - tau[before])[:, None], np.zeros((which.size, 6))
    if reference.positions is not None:
        out[:, :3] = (reference.positions[after] - reference.positions[before]) / seconds
    if reference.quaternions is not None:
        q = reference.quaternions
        out[:, 3:] = log(multiply(conjugate(q[before]), q[after])) / seconds
    return out


def axes_of_n(problem: Problem, parameters: CellParameters, t: Array) -> Array:
    """Return the axes of n in b at IMU times t (n,), by the nearest pose, as columns (n, 3, 3).

    What follows a field that is fixed in the cell, such as a magnetic one, is a sum of these directions.
    """
    q, tau = problem.reference.quaternions, problem.reference.seconds
    assert q is not None  # noqa: S101 - for the type checker; without orientations nobody asks
    at = parameters.clock.reference_time(t)
    after = np.clip(np.searchsorted(tau, at), 1, tau.size - 1)
    nearest = np.where(at - tau[after - 1] < tau[after] - at, after - 1, after)
    return np.asarray(np.swapaxes(matrix(q[nearest]), 1, 2) @ matrix(parameters.q_rn))
