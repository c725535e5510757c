"""The pose between two samples, and what the reference shows of it, against closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kreisel._kernels.filter_arguments import Gaussian, ParameterRows
from kreisel.fitting.stored_state import stored_state
from kreisel.kalman.kernel_inputs import filter_model

from ...kernel_parts.measurement_model import Motion, predict_poses, robot_motion
from ...kernel_parts.sigma_points import sample
from ...small_problem import small_problem

BEFORE, AFTER = 0.010, 0.014


def rotation(q):
    return Rotation.from_quat(np.asarray(q), scalar_first=True)


def motion_of(rng, m, earth_rate=0.0):
    """Return a motion with m columns."""
    return Motion(
        q_first=rotation(rng.normal(size=(m, 4))).as_quat(scalar_first=True).T,
        omega=rng.normal(size=(3, m)),
        alpha=np.zeros((3, m)),
        force=rng.normal(size=(3, 3, m)),
        gravity=rng.normal(size=(3, m)),
        earth_rate=earth_rate * rng.normal(size=(3, m)),
    )


def state(rng, m):
    """Return attitudes (4, m), velocities and positions (3, m)."""
    q = rotation(rng.normal(size=(m, 4))).as_quat(scalar_first=True).T
    return q, rng.normal(size=(3, m)), rng.normal(size=(3, m))


def carried(motion, dt, q, v, p):
    """Return attitude and position as the measurement model has them, without any error of the reference."""
    problem = small_problem()
    model, layout = filter_model(problem, problem.prior.start), problem.layout
    points = np.zeros((layout.size, len(dt)))
    for name, part in (("attitude", q), ("velocity", v), ("position", p)):
        points[layout.stored(name)] = part
    return predict_poses(model, motion, np.asarray(dt), BEFORE, AFTER, np.zeros((6, 0)), False, points)


@pytest.mark.parametrize("seed", range(3))
def test_a_force_quadratic_in_time_moves_by_its_value_and_its_slope(seed):
    """Forces at three samples of a parabola: the position's exact polynomial, but for the parabola's own part."""
    rng = np.random.default_rng(seed)
    motion, dt = motion_of(rng, 3), np.array([-0.008, 0.005, 0.012])
    at, slope, curve = rng.normal(size=(3, 3, 3)) * np.array([1.0, 50.0, 3000.0])[:, None, None]
    force = np.stack([at + slope * t + 0.5 * curve * t**2 for t in (-BEFORE, 0.0, AFTER)])
    motion = motion._replace(force=force)
    q, v, p = state(rng, 3)
    _, found = carried(motion, dt, q, v, p)
    turn = rotation(motion.q_first.T)
    a, jerk = turn.apply(at.T).T + motion.gravity, turn.apply(slope.T).T
    np.testing.assert_allclose(found, p + v * dt + a * dt**2 / 2.0 + jerk * dt**3 / 6.0, rtol=1e-13, atol=1e-15)


def test_a_turning_earth_bends_the_path_and_turns_the_axes():
    """An Earth rate of a radian per second, so that its terms are as large as the others."""
    rng = np.random.default_rng(1)
    motion, dt = motion_of(rng, 3, earth_rate=1.0), np.array([-0.009, 0.003, 0.013])
    q, v, p = state(rng, 3)
    q_found, p_found = carried(motion, dt, q, v, p)
    still = motion._replace(earth_rate=np.zeros((3, 3)))
    q_still, p_still = carried(still, dt, q, v, p)
    bent = -2.0 * np.cross(motion.earth_rate.T, v.T).T * dt**2 / 2.0
    np.testing.assert_allclose(p_found - p_still, bent, rtol=1e-9, atol=1e-15)
    in_b = rotation(q.T).inv().apply(motion.earth_rate.T)
    for s in range(3):
        turned = rotation(q[:, s]) * Rotation.from_rotvec((motion.omega[:, s] - in_b[s]) * dt[s])
        assert (turned.inv() * rotation(q_found[:, s])).magnitude() < 1e-14
    assert max((rotation(q_found[:, s]).inv() * rotation(q_still[:, s])).magnitude() for s in range(3)) > 1e-3


def test_an_angular_acceleration_about_the_axis_of_rotation():
    rng = np.random.default_rng(2)
    motion, dt = motion_of(rng, 2), np.array([-0.01, 0.014])
    motion = motion._replace(alpha=motion.omega * [30.0, -20.0])
    q, v, p = state(rng, 2)
    found, _ = carried(motion, dt, q, v, p)
    for s, factor in enumerate((30.0, -20.0)):
        angle = motion.omega[:, s] * (dt[s] + factor * dt[s] ** 2 / 2.0)
        assert ((rotation(q[:, s]) * Rotation.from_rotvec(angle)).inv() * rotation(found[:, s])).magnitude() < 1e-14


@pytest.mark.parametrize("at_standstill", [True, False])
def test_the_reference_shows_its_own_error_and_not_the_robots(at_standstill):
    """At the sample itself: a pose with the error of the standstill or of the path added, the robot's taken away."""
    rng = np.random.default_rng(4)
    problem = small_problem()
    layout = problem.layout
    model = filter_model(problem, problem.prior.start)
    mean = stored_state(problem, problem.prior.start)
    m = 2 * layout.degrees + 1
    points = layout.plus(mean, 0.02 * rng.normal(size=(layout.degrees, m)))
    for name in ("velocity", "position"):
        points[layout.stored(name)] += rng.normal(size=(3, m))
    motion = motion_of(rng, m)
    robot = 0.03 * rng.normal(size=(6, m))
    q, p = predict_poses(model, motion, np.zeros(m), BEFORE, AFTER, robot, at_standstill, points)
    kind = "standstill" if at_standstill else "path"
    of_position, of_attitude = (points[layout.stored(f"{kind}_{what}")] for what in ("position", "orientation"))
    shown = points[layout.stored("position")] + of_position - robot[:3]
    np.testing.assert_allclose(p, shown, rtol=1e-12, atol=1e-12)
    turned = -robot[3:]
    for s in range(m):
        expected = (
            rotation(points[layout.stored("attitude"), s])
            * Rotation.from_rotvec(of_attitude[:, s])
            * Rotation.from_rotvec(turned[:, s])
        )
        assert (expected.inv() * rotation(q[:, s])).magnitude() < 1e-12


def test_the_robots_errors_move_the_pose_by_its_regressor():
    """Two errors from rows of the state and two that are known, of points sampled from a belief."""
    rng = np.random.default_rng(5)
    problem = small_problem()
    layout, model = problem.layout, filter_model(problem, problem.prior.start)
    rows, errors = layout.stored("lever_arms"), rng.normal(size=(6, 4))
    model = model._replace(
        robot=ParameterRows(np.array([rows.start, -1, rows.start + 1, -1]), np.array([0.0, 0.03, 0.0, -0.02]))
    )
    mean = layout.plus(stored_state(problem, problem.prior.start), rng.normal(0, 0.1, (layout.degrees, 1)))[:, 0].copy()
    belief = Gaussian(mean, np.linalg.qr(rng.normal(size=(layout.degrees, layout.degrees)))[1])
    points = sample(layout.table, belief, model.weights[0], model.gyro_degrees, model.sensor_degrees)
    own = np.vstack(
        [points[rows.start], np.full(points.shape[1], 0.03), points[rows.start + 1], np.full(points.shape[1], -0.02)]
    )
    np.testing.assert_allclose(robot_motion(model, errors, belief), errors @ own, rtol=1e-12, atol=1e-12)
