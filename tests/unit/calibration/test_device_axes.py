"""A calibration in other axes: what it gives there, the form of its matrices, and deviations against samples drawn."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.data_sheet import gyro_to_accel
from kreisel.calibration.device_axes import (
    NAMES,
    frame_of,
    linearised,
    nearest_right_angles,
    turned,
    upper_triangular,
    vector_of,
    with_vector,
)
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_document import from_document
from kreisel.calibration.result_sections import Measured
from kreisel.errors import SettingsError
from kreisel.geometry.rotation import exp, from_matrix, log, matrix, nearest_rotation
from kreisel.inertial.sensor_model import SizeEffect

from .example import calibration

T = 0.0025 * np.arange(800)
PHASE = np.add(np.outer(T, [3.0, 5.0, 7.0]), [0.0, 1.0, 2.0])
RATES, FORCES = np.sin(PHASE), np.add(5.0 * np.cos(PHASE), [0.0, 0.0, 9.8])
OWN = ("imu", "gyro", "nominal")


@pytest.mark.parametrize("axes", OWN)
def test_the_same_motion_is_seen_from_the_other_frame(axes):
    tool = calibration()
    own = tool.in_axes(axes)
    omega, f = tool.correct(RATES, FORCES, T)
    omega_s, f_s = own.correct(RATES, FORCES, T)
    C, o = calibration().in_axes(axes).sensors, tool.sensors.lever_arms.mean(axis=0)
    C_bs = tool.sensors.K_a @ np.linalg.inv(C.K_a)
    np.testing.assert_allclose(C_bs @ C_bs.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(C_bs) == pytest.approx(1.0)
    np.testing.assert_allclose(omega_s @ C_bs.T, omega, atol=1e-12)
    # The specific force at another point of the body: rigid-body kinematics, with a derivative of its own. At the ends
    # that derivative has another error.
    alpha = np.gradient(omega, T, axis=0, edge_order=2)
    there = f + np.cross(alpha, o) + np.cross(omega, np.cross(omega, o))
    np.testing.assert_allclose((f_s @ C_bs.T)[4:-4], there[4:-4], atol=1e-4)
    np.testing.assert_allclose(own.sensors.lever_arms.mean(axis=0), 0.0, atol=1e-15)


def test_the_triad_that_defines_the_axes_is_upper_triangular():
    tool = calibration()
    for axes, name in (("imu", "K_a"), ("gyro", "K_omega")):
        K = getattr(tool.in_axes(axes).sensors, name)
        np.testing.assert_array_equal(K, np.triu(K))
        assert np.all(np.diag(K) > 0.0)
        # z of s lies along the sensitive axis z, which is row z of the inverse
        sensitive = np.linalg.inv(K)
        np.testing.assert_allclose(sensitive[2] / np.linalg.norm(sensitive[2]), [0.0, 0.0, 1.0], atol=1e-15)
        assert sensitive[1, 0] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(
    ("axes", "handed"), [("tool", 1.0), ("imu", 1.0), ("imu", -1.0), ("gyro", 1.0), ("gyro", -1.0), ("nominal", 1.0)]
)
def test_derivatives_are_those_of_central_differences(axes, handed):
    rng, signs = np.random.default_rng(8), np.diag([1.0, 1.0, handed])
    turn = matrix(exp(0.05 * rng.normal(size=3)))
    p = replace(
        calibration().sensors,
        K_omega=turn @ (np.eye(3) + 0.02 * rng.normal(size=(3, 3))) @ signs,
        K_a=turn @ (np.eye(3) + 0.02 * rng.normal(size=(3, 3))) @ signs,
        lever_arms=0.1 * rng.normal(size=(3, 3)),
    )
    C, _ = frame_of(p, axes)

    def moved(x):
        q = with_vector(p, x)
        C_moved, origin = frame_of(q, axes)
        return np.concatenate([vector_of(turned(q, C_moved, origin)), log(from_matrix(C.T @ C_moved)), origin])

    x, step = vector_of(p), 1e-6
    J = np.column_stack([(moved(x + step * e) - moved(x - step * e)) / (2.0 * step) for e in np.eye(x.size)])
    found = linearised(p, axes)
    np.testing.assert_allclose(np.vstack([found.J, found.J_mounting]), J, atol=1e-8)


def test_a_left_handed_triad_keeps_a_rotation_and_a_negative_last_entry():
    K = np.diag([1.0, 1.0, -1.0]) @ (np.eye(3) + 0.05 * np.arange(9).reshape(3, 3) / 9.0)
    C, R = upper_triangular(K)
    assert np.linalg.det(C) == pytest.approx(1.0)
    np.testing.assert_allclose(C @ R, K, atol=1e-15)
    assert (np.diag(R) > 0.0).tolist() == [True, True, False]


@pytest.mark.parametrize("axes", OWN)
def test_deviations_are_those_of_parameters_drawn_from_the_covariance(axes):
    """Mounting and triad of 4000 calibrations, drawn and split one by one: within 5 standard errors of 1.1 %."""
    tool = calibration()
    own, triad = tool.in_axes(axes), None
    P = np.zeros((33, 33))
    place = [tool.names.index(n) if n in tool.names else -1 for n in NAMES]
    for i, a in enumerate(place):
        for j, b in enumerate(place):
            P[i, j] = tool.covariance[a, b] if min(a, b) >= 0 else (i == j) * 5e-4**2
    rng = np.random.default_rng(1)
    changes = rng.multivariate_normal(np.zeros(33), P, 4000)
    K_a, K_w, arms, rotation, position = [], [], [], [], []
    C = tool.sensors.K_a @ np.linalg.inv(own.sensors.K_a)
    for change in changes:
        moved = with_vector(tool.sensors, vector_of(tool.sensors) + change)
        K = {"imu": moved.K_a, "gyro": moved.K_omega, "nominal": None}[axes]
        if K is None:
            C_moved = C
        else:  # Gram and Schmidt on the sensitive axes z, y, x
            z, y, _ = np.linalg.inv(K)[::-1]
            z = z / np.linalg.norm(z)
            y = y - (y @ z) * z
            y /= np.linalg.norm(y)
            C_moved = np.column_stack([np.cross(y, z), y, z])
        o = moved.lever_arms.mean(axis=0)
        K_a.append(C_moved.T @ moved.K_a)
        K_w.append(C_moved.T @ moved.K_omega)
        arms.append((moved.lever_arms - o) @ C_moved)
        rotation.append(log(from_matrix(C.T @ C_moved)))
        position.append(o)
    tool = replace(tool, triads=_triads(tool))
    triad = tool.triads[axes]
    pairs = [
        (triad.accel_matrix, K_a), (triad.gyro_matrix, K_w), (triad.lever_arms, arms), (triad.position, position),
    ]  # fmt: skip
    for measured, drawn in pairs:
        np.testing.assert_allclose(np.std(drawn, axis=0), measured.deviation, rtol=0.06, atol=1e-9)
        np.testing.assert_allclose(np.mean(drawn, axis=0), measured.value, atol=1e-4)
    np.testing.assert_allclose(np.std(rotation, axis=0), triad.rotation_vector.deviation, rtol=0.06, atol=1e-9)
    np.testing.assert_allclose(own.sensor_sd.K_a, triad.accel_matrix.deviation, atol=1e-12)
    np.testing.assert_allclose(matrix(exp(triad.rotation_vector.value)), triad.rotation, atol=1e-12)


def _triads(tool: Calibration):
    from kreisel.calibration.device_axes import device_triads

    return device_triads(tool.sensors, tool.sensor_sd, tool.names, tool.covariance)


def test_other_parameters_keep_their_deviations():
    tool = calibration()
    own = tool.in_axes("imu")
    assert own.names[:33] == NAMES
    assert set(own.names[33:]) == set(tool.names) - set(NAMES)
    k = tool.names.index("gyroscope.polynomial.2[1]")
    assert own.covariance[34, 34] == pytest.approx(tool.covariance[k, k])
    offset = tool.names.index("accelerometer.offset[2]")
    assert own.covariance[NAMES.index("accelerometer.offset[2]"), 34] == pytest.approx(tool.covariance[offset, k])
    assert np.linalg.eigvalsh(own.covariance).min() > -1e-18


def test_what_does_not_depend_on_axes_stays():
    own = calibration().in_axes("imu").derived
    other = calibration().in_axes("nominal").derived
    for name in ("gyro_scale_error_ppm", "accel_non_orthogonality_mrad", "accel_distances_mm"):
        np.testing.assert_allclose(own[name].value, other[name].value, rtol=1e-9)
        np.testing.assert_allclose(own[name].deviation, other[name].deviation, rtol=1e-5)


def test_the_rotation_between_the_triads_is_the_device_s_own():
    twist = np.array([2e-3, -1e-3, 5e-3])
    found = []
    for mount in ([0.0, 0.0, 0.0], [0.05, -0.1, 1.5], [2.0, 0.4, -1.0]):
        C = matrix(exp(np.array(mount)))
        found.append(gyro_to_accel(C @ matrix(exp(twist)) * 1.01, C * 0.99))
    np.testing.assert_allclose(found, np.tile(twist, (3, 1)), atol=1e-12)


def test_an_older_file_has_it_turned_from_b():
    name = "gyro_to_accel_rotation_mrad"
    own = calibration().in_axes("imu")
    own = replace(own, derived={q: Measured(np.ones(3), np.ones(3)) for q in own.derived})
    document = own.document
    del document["axes"]
    C = nearest_rotation(own.sensors.K_a)
    np.testing.assert_allclose(from_document(document).derived[name].value, C.T @ np.ones(3), atol=1e-12)
    np.testing.assert_array_equal(from_document(own.document).derived[name].value, np.ones(3))


def test_the_nominal_mounting_is_one_of_24_and_refused_far_away():
    tool = calibration(mount=(0.1, 0.05, np.pi / 2))
    C = nearest_right_angles(tool.sensors.K_a)
    np.testing.assert_allclose(C, [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-15)
    with pytest.raises(SettingsError, match=r"mounted 3\d\.\d deg away from the nearest right angles.*use --axes imu"):
        calibration(mount=(0.0, 0.0, 0.6)).in_axes("nominal")


def test_other_forms_of_the_size_effect_stay_in_axes_of_the_tool():
    printed = replace(calibration(), size_effect=SizeEffect.FOX2005)
    assert printed.in_axes("tool") is printed
    with pytest.raises(SettingsError, match="'fox2005' holds in axes of the tool only"):
        printed.in_axes("imu")


def test_axes_are_changed_once():
    own = calibration().in_axes("imu")
    assert own.in_axes("imu") is own
    with pytest.raises(SettingsError, match="in axes 'imu' already"):
        own.in_axes("gyro")
    with pytest.raises(SettingsError, match="unknown axes 'body'; known are: gyro, imu, nominal, tool"):
        own.in_axes("body")


def test_a_file_without_the_split_gets_it_from_the_covariance(tmp_path):
    tool = calibration()
    tool.save(tmp_path)
    assert "device_axes" not in (tmp_path / "calibration.yaml").read_text()
    read = Calibration.load(tmp_path)
    np.testing.assert_allclose(read.triads["imu"].accel_matrix.value, tool.in_axes("imu").sensors.K_a, atol=1e-12)
    read.in_axes("imu").save(tmp_path / "imu")
    again = Calibration.load(tmp_path / "imu")
    assert again.axes == "imu"
    np.testing.assert_array_equal(again.sensors.K_a, read.in_axes("imu").sensors.K_a)
