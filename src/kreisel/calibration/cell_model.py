"""The cell as the filter sees it: how its state moves between updates and what the reference then shows."""

from __future__ import annotations

import numpy as np

from kreisel._kernels import composition, rotation
from kreisel.calibration.parameters import GROUPS, CellParameters, sensor_columns
from kreisel.calibration.problem import Problem, Update
from kreisel.estimation.state import StateLayout
from kreisel.geometry.rotation import Array, conjugate, matrix
from kreisel.inertial import strapdown
from kreisel.inertial.strapdown import Increment, SensorColumns


class CellModel:
    """A `Transition` from one update to the next.

    Parameters
    ----------
    problem
        What is estimated from what.
    known
        Values of the groups that are not in the state.
    """

    def __init__(self, problem: Problem, known: CellParameters) -> None:
        self.problem = problem
        self.layout: StateLayout = problem.layout
        self._known = {group: known.stored(group)[:, None] for group in GROUPS}
        self._update: Update
        self._columns: SensorColumns
        self._increment: Increment
        self._q_first: Array

    def aim(self, update: Update) -> None:
        """Set the update the next step goes to."""
        self._update = update

    def values(self, points: Array) -> dict[str, Array]:
        """Return every group's stored numbers (size, points), estimated or known."""
        return {
            group: points[self.layout.stored(group)] if group in self.layout else known
            for group, known in self._known.items()
        }

    def parameters(self, x: Array) -> CellParameters:
        """Return the parameters in a state (size,)."""
        values = self.values(x[:, None])
        return CellParameters.from_stored({group: value[:, 0].copy() for group, value in values.items()})

    def propagate(self, points: Array) -> Array:
        """Return the sigma points at the update; only distinct sensor parameters are integrated."""
        p, n, s = self.problem, self.layout.degrees, self.problem.sensor_degrees
        distinct = np.concatenate([[0], np.arange(1, s + 1), np.arange(n + 1, n + s + 1)])
        which = np.zeros(points.shape[1], dtype=np.int64)
        which[distinct] = np.arange(distinct.size)
        self._columns = SensorColumns.stack(
            p.settings.size_effect, *sensor_columns(self.values(points[:, distinct]), p.settings.polynomial_order)
        )
        step = strapdown.preintegrate(
            p.signal, self._update.first, self._update.last, self._columns, p.settings.size_effect
        )
        self._increment = step.spread(which)
        out = points.copy()
        q, v, r = (
            np.ascontiguousarray(points[self.layout.stored(name)]) for name in ("attitude", "velocity", "position")
        )
        self._q_first = q.copy()
        gravity, earth_rate = self._environment(points)
        composition.compose(
            step.duration, self._increment.dq, self._increment.dv, self._increment.dp, gravity, earth_rate, q, v, r
        )
        out[self.layout.stored("attitude")] = q
        out[self.layout.stored("velocity")] = v
        out[self.layout.stored("position")] = r
        return out

    def _environment(self, points: Array) -> tuple[Array, Array]:
        """Return gravity and Earth rate in r, (3, points) each."""
        values = self.values(points)
        m = points.shape[1]
        q_rn = _columns(values["alignment"], m)
        gravity, earth_rate = np.zeros((3, m)), np.zeros((3, m))
        gravity[2] = values["gravity"]
        rotation.rotate(q_rn, gravity, gravity)
        if self.problem.site.earth_rate_n is not None:
            level, _, down = self.problem.site.earth_rate_n
            earth_rate[:2] = level * values["north"]
            earth_rate[2] = down
            rotation.rotate(q_rn, earth_rate, earth_rate)
        return gravity, earth_rate

    def process_noise(self, centre: Array) -> Array:  # noqa: ARG002 - the increment already stands for it
        """Return the factor of sensor noise in velocity, position and attitude, and of offsets that walk."""
        p, u = self.problem, self._update
        Q = strapdown.noise_covariance(p.signal, u.first, u.last, self._increment, self._columns)
        C_first = matrix(self._q_first[:, 0])
        back = matrix(conjugate(self._increment.dq[:, 0]))
        T = np.zeros((9, 9))
        T[0:3, 3:6] = C_first
        T[3:6, 6:9] = C_first
        T[6:9, 0:3] = back
        Q = T @ Q @ T.T
        scale = np.sqrt(np.maximum(np.diag(Q), 1e-300))
        L = np.linalg.cholesky(Q / np.outer(scale, scale) + 1e-13 * np.eye(9))
        walks = [name for name, density in p.offset_walk.items() if density > 0.0 and name in self.layout]
        factor = np.zeros((self.layout.degrees, 9 + 3 * len(walks)))
        factor[-9:, :9] = scale[:, None] * L
        for i, name in enumerate(walks):
            step = p.offset_walk[name] * np.sqrt(self._increment.duration)
            factor[self.layout[name], 9 + 3 * i : 12 + 3 * i] = step * np.eye(3)
        return factor

    def observe(self, points: Array) -> Array:
        """Return the measurements the points predict, as distances from that of the first point."""
        q, p, v = self._pose(points)
        rows = []
        if self.problem.reference.positions is not None:
            rows.append(p - p[:, :1])
        if self.problem.reference.quaternions is not None:
            turned = np.empty((3, q.shape[1]))
            rotation.minus(q, q[:, :1].copy(), turned)
            rows.append(turned)
        if self._update.rest is not None:
            rows.append(v - v[:, :1])
        return np.vstack(rows)

    def innovation(self, centre: Array) -> Array:
        """Return the measurement's distance from what the state predicts."""
        q, p, v = self._pose(centre[:, None])
        reference, pose = self.problem.reference, self._update.pose
        rows = []
        if reference.positions is not None:
            rows.append(reference.positions[pose] - p[:, 0])
        if reference.quaternions is not None:
            turned = np.empty((3, 1))
            rotation.minus(reference.quaternions[pose][:, None].copy(), q, turned)
            rows.append(turned[:, 0])
        if self._update.rest is not None:
            rows.append(-v[:, 0])
        return np.concatenate(rows)

    def _pose(self, points: Array) -> tuple[Array, Array, Array]:
        """Return attitude, position and velocity the reference should show, at its own time."""
        signal, last, step = self.problem.signal, self._update.last, self._increment
        m = points.shape[1]
        # points beyond the sigma points (process noise) share the centre's sensor parameters
        which = np.where(np.arange(m) < step.dq.shape[1], np.arange(m), 0)
        values = self.values(points)
        t = values["time_offset"][0] + (1.0 + values["time_skew"][0]) * self._update.tau
        dt = np.full(m, t - signal.stamps[last])
        q, v, p = (
            np.ascontiguousarray(points[self.layout.stored(name)]) for name in ("attitude", "velocity", "position")
        )
        gravity, earth_rate = self._environment(points)
        q_out, p_out = np.empty((4, m)), np.empty((3, m))
        q_first, omega, alpha, u_end = (
            np.take(a, which, axis=-1) for a in (self._q_first, step.omega_end, step.alpha_end, step.u_end)
        )
        before, after = np.diff(signal.stamps[last - 1 : last + 2])
        composition.pose_at(dt, before, after, q_first, omega, alpha, u_end, gravity, earth_rate, q, v, p, q_out, p_out)
        if self._update.rest is not None and "rest_position" in self.layout:
            p_out += points[self.layout.stored("rest_position")]
            turned = points[self.layout.stored("rest_orientation")]
            rotation.plus(q_out.copy(), turned, q_out)
        return q_out, p_out, v

    def measurement_factor(self, centre: Array) -> Array:
        """Return the factor (m, k) of the reference's noise at this update.

        Stamps that were rounded put an error along the motion: velocity and rate times the stamp's error.
        """
        noise, reference = self.problem.noise, self.problem.reference
        at_rest = self._update.rest is not None
        deviation: list[float] = []
        if reference.positions is not None:
            deviation += 3 * [noise.jitter_position if at_rest else noise.position]
        if reference.quaternions is not None:
            deviation += 3 * [noise.jitter_orientation if at_rest else noise.orientation]
        if at_rest:
            return np.diag([*deviation, *(3 * [noise.velocity])])
        if noise.stamp == 0.0:
            return np.diag(deviation)
        motion = [centre[self.layout.stored("velocity")]] if reference.positions is not None else []
        motion += [self.rate(centre)] if reference.quaternions is not None else []
        return np.column_stack([np.diag(deviation), noise.stamp * np.concatenate(motion)])

    def rate(self, centre: Array) -> Array:
        """Return the angular rate of b at the update for the state's parameters, (3,)."""
        p = self.parameters(centre).sensors
        w = self.problem.signal.rate_powers[self._update.last, 1]
        x = w + p.k_w[0] + sum(p.k_w[i] * w ** (i + 1) for i in range(1, p.k_w.shape[0]))
        return np.asarray(p.K_omega @ x)


def _columns(stored: Array, m: int) -> Array:
    """Return stored numbers (size, 1 or m) with one contiguous column for each of m points."""
    if stored.shape[1] == m:
        return np.ascontiguousarray(stored)
    return np.repeat(stored, m, axis=1)
