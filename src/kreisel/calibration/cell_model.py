"""The cell as the filter sees it: how its state moves between updates and what the reference then shows."""

from __future__ import annotations

import numpy as np

from kreisel._kernels import composition, rotation
from kreisel.calibration.parameters import GROUPS, ROBOT_GROUPS, CellParameters
from kreisel.calibration.problem import LASTING, PATH_ERROR, Problem, Update
from kreisel.estimation.state import StateLayout
from kreisel.geometry.rotation import Array, Indices
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
        self._known = {group: known.stored(group) for group in GROUPS}
        self._gyro = _Rows(self, [g for g in GROUPS if g.startswith("gyro")])
        self._accel = _Rows(self, [g for g in GROUPS if g.startswith("accel") or g == "lever_arms"])
        self._surroundings = _Rows(self, ["alignment", "north", "gravity", "time_offset", "time_skew"])
        self._robot = _Rows(self, list(ROBOT_GROUPS))
        n, g, s = self.layout.degrees, problem.gyro_degrees, problem.sensor_degrees
        # Sigma points that do not touch the gyros' parameters turn as the centre does.
        turning = [0, *range(1, g + 1), *range(n + 1, n + g + 1)]
        sharing = [*range(g + 1, s + 1), *range(n + g + 1, n + s + 1)]
        self._turning, self._distinct = np.array(turning), np.array(turning + sharing)
        self._which = np.zeros(2 * n + 1, dtype=np.int64)
        self._which[self._distinct] = np.arange(self._distinct.size)
        self._regressor: dict[int, Array] = {}
        if problem.robot is not None:
            poses = np.array([update.pose for update in problem.updates])
            self._regressor = dict(zip(poses.tolist(), problem.robot.regressor(poses), strict=True))
        self._update: Update
        self._columns: SensorColumns
        self._increment: Increment
        self._q_first: Array
        self._around: tuple[Array, Array, Array]

    def aim(self, update: Update) -> None:
        """Set the update the next step goes to."""
        self._update = update

    def values(self, points: Array) -> dict[str, Array]:
        """Return every group's stored numbers (size, points), estimated or known."""
        return {
            group: points[self.layout.stored(group)] if group in self.layout else known[:, None]
            for group, known in self._known.items()
        }

    def parameters(self, x: Array) -> CellParameters:
        """Return the parameters in a state (size,)."""
        values = self.values(x[:, None])
        return CellParameters.from_stored({group: value[:, 0].copy() for group, value in values.items()})

    def propagate(self, points: Array) -> Array:
        """Return the sigma points at the update; only distinct sensor parameters are integrated."""
        p, u = self.problem, self._update
        gyro, accel = self._gyro.of(points, self._turning), self._accel.of(points, self._distinct)
        order = p.settings.polynomial_order
        self._columns = SensorColumns.stack(
            p.settings.size_effect,
            gyro[:9].reshape(3, 3, -1),
            gyro[9:].reshape(order, 3, -1),
            accel[:9].reshape(3, 3, -1),
            accel[9:-9].reshape(order, 3, -1),
            accel[-9:].reshape(3, 3, -1),
        )
        step = self._increment = strapdown.preintegrate(p.signal, u.first, u.last, self._columns)
        out = points.copy()
        q, v, r = (out[self.layout.stored(name)] for name in ("attitude", "velocity", "position"))
        self._q_first = q.copy()
        gravity, earth_rate, _ = self._around = self._environment(points)
        composition.compose(step.duration, self._which, step.dq, step.dv, step.dp, gravity, earth_rate, q, v, r)
        for part in PATH_ERROR:
            if part.name in self.layout:
                out[self.layout.stored(part.name)] *= self._kept
        return out

    @property
    def _kept(self) -> float:
        """What is left of a lasting error from the update before."""
        return float(np.exp(-self._increment.duration / self.problem.correlation_time))

    def _environment(self, points: Array) -> tuple[Array, Array, Array]:
        """Return gravity and Earth rate in r, (3, points) each, and where the reference's stamp lies, IMU seconds."""
        m = points.shape[1]
        values = self._surroundings.of(points, np.arange(m))
        gravity, earth_rate = np.empty((3, m)), np.empty((3, m))
        rate = self.problem.site.earth_rate_n
        level, down = (0.0, 0.0) if rate is None else (float(rate[0]), float(rate[2]))
        composition.environment(level, down, values[:4], values[4:6], values[6], gravity, earth_rate)
        return gravity, earth_rate, values[7] + (1.0 + values[8]) * self._update.tau

    def process_noise(self) -> Array:
        """Return the factor of noise in velocity, position and attitude, and in lasting errors of the reference."""
        u, step = self._update, self._increment
        Q = strapdown.noise_covariance(self.problem.signal, u.first, u.last, step, self._columns)
        factor = np.empty((9, 9))
        composition.navigation_noise(Q, self._q_first[:, 0].copy(), step.dq[:, 0].copy(), factor)
        lasting = [part.name for part in PATH_ERROR if part.name in self.layout]
        if not lasting:
            return factor
        fresh = np.sqrt(LASTING * (1.0 - self._kept**2))
        both = np.zeros((3 * len(lasting) + 9,) * 2)
        for i, name in enumerate(lasting):
            size = self.problem.noise.position if name == "path_position" else self.problem.noise.orientation
            both[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = fresh * size * np.eye(3)
        both[-9:, -9:] = factor
        return both

    def observe(self, points: Array) -> tuple[Array, Array]:
        """Return the poses the points predict, and the reference's, as distances from that of the first point."""
        reference, u = self.problem.reference, self._update
        q, p, v = self._pose(points)
        rows, measured = [], []
        if reference.positions is not None:
            rows.append(p - p[:, :1])
            measured.append(reference.positions[u.pose] - p[:, 0])
        if reference.quaternions is not None:
            centre, both = q[:, :1].copy(), np.empty((3, q.shape[1] + 1))
            rotation.minus(np.column_stack([q, reference.quaternions[u.pose]]), centre, both)
            rows.append(both[:, :-1])
            measured.append(both[:, -1])
        if u.rest is not None:
            rows.append(v - v[:, :1])
            measured.append(-v[:, 0])
        return np.vstack(rows), np.concatenate(measured)

    def _pose(self, points: Array) -> tuple[Array, Array, Array]:
        """Return attitude, position and velocity the reference should show, at its own time."""
        signal, last, step = self.problem.signal, self._update.last, self._increment
        m, sigma_points = points.shape[1], self._which.size
        # points beyond the sigma points (process noise) share all with the centre but their navigation
        which, own = np.zeros((2, m), dtype=np.int64)
        which[:sigma_points] = self._which
        own[:sigma_points] = np.arange(sigma_points)
        gravity, earth_rate, t = self._around
        q, v, p = (points[self.layout.stored(name)] for name in ("attitude", "velocity", "position"))
        q_out, p_out = np.empty((4, m)), np.empty((3, m))
        t_before, t_last, t_after = signal.stamps[last - 1 : last + 2].tolist()
        composition.pose_at(
            t - t_last, t_last - t_before, t_after - t_last, which, own, self._q_first, step.omega_end,
            step.alpha_end, step.u_end, gravity, earth_rate, q, v, p, q_out, p_out,
        )  # fmt: skip
        if self._update.rest is not None and "rest_position" in self.layout:
            p_out += points[self.layout.stored("rest_position")]
            turned = points[self.layout.stored("rest_orientation")]
            rotation.plus(q_out.copy(), turned, q_out)
        if self._update.rest is None and "path_position" in self.layout:
            p_out += points[self.layout.stored("path_position")]
        if self._update.rest is None and "path_orientation" in self.layout:
            rotation.plus(q_out.copy(), points[self.layout.stored("path_orientation")], q_out)
        if self.problem.robot is not None:
            # The reported pose is the nominal arm's: the tool's own, less what the arm's errors add to it.
            errors = self._robot.of(points, np.arange(m))
            added = self._regressor[self._update.pose] @ errors
            p_out -= added[:3]
            rotation.plus(q_out.copy(), -added[3:], q_out)
        return q_out, p_out, v

    def measurement_factor(self, centre: Array) -> Array:
        """Return the factor (m, k) of the reference's noise at this update.

        Stamps that were rounded put an error along the motion: velocity and rate times the stamp's error.
        """
        noise, reference = self.problem.noise, self.problem.reference
        at_rest = self._update.rest is not None
        fresh = np.sqrt(1.0 - LASTING) if self.problem.correlation_time > 0.0 else 1.0
        deviation: list[float] = []
        if reference.positions is not None:
            deviation += 3 * [noise.jitter_position if at_rest else fresh * noise.position]
        if reference.quaternions is not None:
            deviation += 3 * [noise.jitter_orientation if at_rest else fresh * noise.orientation]
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


class _Rows:
    """Stored numbers of some groups for many points: those of the state, or the known ones."""

    def __init__(self, model: CellModel, groups: list[str]) -> None:
        layout, known = model.layout, model._known
        source = [
            np.arange(layout.size)[layout.stored(g)] if g in layout else np.full(known[g].size, -1) for g in groups
        ]
        self._source = np.concatenate(source).astype(np.int64)
        self._known = np.concatenate([known[g] for g in groups])

    def of(self, points: Array, columns: Indices) -> Array:
        """Return the numbers (size, columns) of the chosen points."""
        out = np.empty((self._source.size, columns.size))
        composition.gather(points, columns, self._source, self._known, out)
        return out
