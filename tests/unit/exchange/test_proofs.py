"""Each format proved by numbers: a random true motion is made to readings by the formula that the target publishes,
with the numbers in the exported file, read here by plain means; what `Calibration.correct` makes of them is the truth.

Where a target has no formula for readings but for their correction, its corrected readings are compared with ours.
What the format cannot hold is left out of the calibration first, or compared with what the export tells of it.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from ruamel.yaml import YAML

from kreisel.calibration.result import Calibration
from kreisel.exchange.exported import ExportRequest
from kreisel.exchange.exported_noise import NAMES, ExportNoise
from kreisel.exchange.targets import TARGETS, read_from
from kreisel.geometry.rotation import exp, matrix

from ...oracle.motion import AnalyticMotion, inertial_truth
from ..calibration.example import calibration

T = 0.0025 * np.arange(2000)
STAMPS = (1e9 * T).round().astype(np.int64)
OMEGA, ALPHA, F = inertial_truth(AnalyticMotion(np.random.default_rng(7)), T, np.array([0.0, 0.0, -9.81]), np.zeros(3))
NOISE = ExportNoise(dict.fromkeys(NAMES, 1e-3), dict.fromkeys(NAMES, "a test"))
MISSED = 3e-5  # m/s^2 that cubics miss of this motion, with arms of 2 cm
INNER = slice(3, -3)


def device(*, arms: bool = False, sensitive: bool = False, biased: bool = True) -> Calibration:
    """Return a calibration in its own axes with offsets and matrices, and what else a format holds."""
    own = calibration().in_axes("imu")
    s = own.sensors
    G = np.random.default_rng(11).normal(0.0, 1e-4, 9)
    sensors = replace(
        s,
        k_w=s.k_w[:1] * biased,
        k_a=s.k_a[:1] * biased,
        lever_arms=s.lever_arms * arms,
        others={"gyro_g_sensitivity": G} if sensitive else {},
    )
    return replace(own, sensors=sensors)


def exported(target: str, what: Calibration) -> tuple[dict[str, str], tuple[str, ...]]:
    done = TARGETS[target].export(ExportRequest(what, NOISE, rate_hz=400.0))
    return done.files, done.lost


def corrected(what: Calibration, w: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return what.correct(w, a, STAMPS)


def in_frame(C: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the motion in a frame into which C turns vectors."""
    return OMEGA @ C.T, ALPHA @ C.T, F @ C.T


# Kalibr


def kalibr_readings(
    text: str, biases: tuple[np.ndarray, np.ndarray], C_ib: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return readings by the formulas in Kalibr's IccSensors.py, model scale-misalignment-size-effect."""
    imu = YAML(typ="safe").load(text)["imu0"]
    assert imu["model"] == "scale-misalignment-size-effect"
    M, M_w = np.array(imu["accelerometers"]["M"]), np.array(imu["gyroscopes"]["M"])
    A, C_gyro_i = np.array(imu["gyroscopes"]["A"]), np.array(imu["gyroscopes"]["C_gyro_i"])
    for triangular in (M, M_w):
        np.testing.assert_array_equal(triangular, np.tril(triangular))
    assert imu["accelerometers"]["rx_i"] == [0.0, 0.0, 0.0]
    omega, alpha, f = in_frame(C_ib)
    total = f.copy()
    for k, axis in enumerate("xyz"):
        r = np.array(imu["accelerometers"][f"r{axis}_i"])
        total[:, k] += (np.cross(alpha, r) + np.cross(omega, np.cross(omega, r)))[:, k]
    a = total @ M.T + biases[1]
    w = omega @ C_gyro_i.T @ M_w.T + f @ C_gyro_i.T @ A.T + biases[0]
    return w, a


def to_kalibr_frame(what: Calibration) -> np.ndarray:
    """Return the rotation into Kalibr's frame i by Gram and Schmidt on the sensitive axes x, y, z."""
    x, y, _ = np.linalg.inv(what.sensors.K_a)
    x = x / np.linalg.norm(x)
    y = y - (y @ x) * x
    y = y / np.linalg.norm(y)
    return np.array([x, y, np.cross(x, y)])


@pytest.mark.parametrize("sensitive", [False, True])
def test_kalibr(sensitive):
    what = device(sensitive=sensitive)
    C = to_kalibr_frame(what)
    G, p = what.sensors.others.get("gyro_g_sensitivity", np.zeros(9)).reshape(3, 3), what.sensors
    biases = (-p.k_w[0] + G @ p.k_a[0], -p.k_a[0])
    files, lost = exported("kalibr", what)
    # the biases are in a comment, and told as not held
    said = next(line for line in files[""].splitlines() if "gyroscope [" in line)
    written = [[float(x) for x in part.split("]")[0].split(",")] for part in said.split("[")[1:]]
    np.testing.assert_allclose(written, biases, rtol=1e-8)
    assert any(text.startswith("the accelerometers' bias") for text in lost)
    # readings in axes of the device, made from the true motion in Kalibr's frame
    w, a = kalibr_readings(files[""], biases, C)
    omega, f = corrected(what, w, a)
    np.testing.assert_allclose(omega, OMEGA, atol=1e-12)
    np.testing.assert_allclose(f, F, atol=1e-11)


def test_kalibr_with_arms_is_right_but_for_what_it_tells():
    """Its size effect takes components in i, not along sensitive axes: the difference is told."""
    what = device(arms=True)
    C = to_kalibr_frame(what)
    files, lost = exported("kalibr", what)
    w, a = kalibr_readings(files[""], (-what.sensors.k_w[0], -what.sensors.k_a[0]), C)
    omega, f = corrected(what, w, a)
    # the origin of i is accelerometer x; ours is the middle of the three
    r = what.sensors.lever_arms[0]
    there = F - np.cross(ALPHA, r) - np.cross(OMEGA, np.cross(OMEGA, r))
    told = next(float(t.split(": ")[1].split(" mg")[0]) for t in lost if "not orthogonal" in t) * 9.80665e-3
    field = (np.linalg.norm(ALPHA, axis=1) + np.linalg.norm(OMEGA, axis=1) ** 2).max()
    error = np.abs(f - there)[INNER].max()
    assert error < told * field / np.deg2rad(100.0) ** 2 + MISSED
    assert error > 10.0 * MISSED  # so that the bound above is about something
    np.testing.assert_allclose(omega, OMEGA, atol=1e-12)


def test_kalibr_in_axes_of_the_tool_has_the_mounting_and_the_sign_of_the_time():
    from kreisel.calibration.result_sections import Timing

    tool = replace(calibration(), timing=Timing(offset=0.0371))
    s = tool.sensors
    tool = replace(tool, sensors=replace(s, k_w=s.k_w[:1], k_a=s.k_a[:1]))
    imu = YAML(typ="safe").load(exported("kalibr", tool)[0][""])["imu0"]
    T_i_b = np.array(imu["T_i_b"])
    # Kalibr: p_i = T_i_b p_b; accelerometer x is the origin of i
    np.testing.assert_allclose(T_i_b @ [*tool.sensors.lever_arms[0], 1.0], [0.0, 0.0, 0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(T_i_b[:3, :3], to_kalibr_frame(tool), atol=1e-14)
    ry = T_i_b @ [*tool.sensors.lever_arms[1], 1.0]
    np.testing.assert_allclose(imu["accelerometers"]["ry_i"], ry[:3], atol=1e-14)
    # Kalibr: t_imu0 = t_imu1 + time_offset; ours: t_imu = t_reference + offset
    assert imu["time_offset"] == pytest.approx(-0.0371)
    own = YAML(typ="safe").load(exported("kalibr", device())[0][""])["imu0"]
    assert own["T_i_b"] == np.eye(4).tolist()
    assert own["time_offset"] == 0.0


# OpenVINS


@pytest.mark.parametrize("sensitive", [False, True])
def test_openvins(sensitive):
    """Readings of a true motion, corrected by the lines of Propagator.cpp and with the biases that it estimates."""
    what = device(sensitive=sensitive)
    p = what.sensors
    text = exported("openvins", what)[0][""]
    assert text.startswith("%YAML:1.0\n")
    imu = YAML(typ="safe").load(text.partition("\n")[2])["imu0"]
    Tw, Ta, Tg, R_w, R_a = (np.array(imu[n]) for n in ("Tw", "Ta", "Tg", "R_IMUtoGYRO", "R_IMUtoACC"))
    Dw, Da = np.tril(np.linalg.inv(Tw)), np.tril(np.linalg.inv(Ta))  # VioManagerOptions.h keeps these triangles
    G = p.others.get("gyro_g_sensitivity", np.zeros(9)).reshape(3, 3)
    bias_g, bias_a = -p.k_w[0] + G @ p.k_a[0], -p.k_a[0]
    # raw readings by our model, turned round
    a = F @ np.linalg.inv(p.K_a).T - p.k_a[0]
    w = OMEGA @ np.linalg.inv(p.K_omega).T - p.k_w[0] - a @ G.T
    a_hat = (a - bias_a) @ Da.T @ R_a
    w_hat = (w - bias_g - a_hat @ Tg.T) @ Dw.T @ R_w
    C = to_kalibr_frame(what)
    np.testing.assert_allclose(a_hat, F @ C.T, atol=1e-12)
    np.testing.assert_allclose(w_hat, OMEGA @ C.T, atol=1e-12)


# Autopilots


def px4(text: str, w: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what Accelerometer.hpp and Gyroscope.hpp make of readings, without rotation."""
    rows = [line.split("\t") for line in text.splitlines() if not line.startswith("#")]
    assert all(len(row) == 5 and row[0] == row[1] == "1" and row[4] == "9" for row in rows)
    value = {row[2]: float(row[3]) for row in rows}
    accel = np.array([value[f"CAL_ACC0_{x}OFF"] for x in "XYZ"]), np.array([value[f"CAL_ACC0_{x}SCALE"] for x in "XYZ"])
    return w - [value[f"CAL_GYRO0_{x}OFF"] for x in "XYZ"], (a - accel[0]) * accel[1]


def ardupilot(text: str, w: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what AP_InertialSensor_Backend.cpp makes of readings, without rotations and temperature."""
    rows = [line.replace(",", " ").split() for line in text.splitlines() if not line.startswith("#")]
    assert all(len(row) == 2 for row in rows)
    value = {name: float(x) for name, x in rows}
    offset, scale = (np.array([value[f"INS_ACC{kind}_{x}"] for x in "XYZ"]) for kind in ("OFFS", "SCAL"))
    return w - [value[f"INS_GYROFFS_{x}"] for x in "XYZ"], (a - offset) * scale


@pytest.mark.parametrize(("target", "apply"), [("px4", px4), ("ardupilot", ardupilot)])
def test_autopilots(target, apply):
    """With scales and offsets alone: the truth. With all errors: it differs by no more than is told."""
    what = device()
    K_a = np.diag([1.01, 0.98, 1.003])
    simple = replace(what, sensors=replace(what.sensors, K_omega=np.eye(3), K_a=K_a))
    a = F @ np.linalg.inv(K_a).T - simple.sensors.k_a[0]
    w = OMEGA - simple.sensors.k_w[0]
    omega, f = apply(exported(target, simple)[0][""], w, a)
    np.testing.assert_allclose(omega, OMEGA, atol=1e-9)
    np.testing.assert_allclose(f, F, atol=1e-7)  # nine digits are written
    assert exported(target, simple)[1] == ()
    files, lost = exported(target, what)
    p = what.sensors
    a = F @ np.linalg.inv(p.K_a).T - p.k_a[0]
    omega, f = apply(files[""], OMEGA @ np.linalg.inv(p.K_omega).T - p.k_w[0], a)
    told = {text.split(":")[0]: float(text.split(": ")[1].split()[0]) for text in lost}
    worst = 1e-6 * told["the accelerometers' scale factors"] + 1e-3 * told["the accelerometers' misalignment"]
    error = np.linalg.norm(f - F, axis=1) / np.linalg.norm(F, axis=1)
    assert error.max() < 1.8 * worst  # told by axis; all three together can be sqrt(3) of it
    assert error.max() > 0.3 * worst
    worst = 1e-6 * told["the gyros' scale factors"] + 1e-3 * told["the gyros' misalignment"]
    error = np.linalg.norm(omega - OMEGA, axis=1) / np.linalg.norm(OMEGA, axis=1)
    assert 0.3 * worst < error.max() < 1.8 * worst


# imu_tk, ROS, JSON


def imu_tk(text: str, raw: np.ndarray) -> np.ndarray:
    """Return T K (X - B), read as imu_tk's load does: 9, 9 and 3 numbers, row by row."""
    numbers = [float(x) for x in text.split()]
    assert len(numbers) == 21
    T, K, B = np.reshape(numbers[:9], (3, 3)), np.reshape(numbers[9:18], (3, 3)), np.array(numbers[18:])
    np.testing.assert_allclose(np.diag(T), 1.0)
    np.testing.assert_array_equal(K, np.diag(np.diag(K)))
    return (raw - B) @ (T @ K).T


def test_imu_tk():
    what = device()
    files, lost = exported("imu_tk", what)
    assert lost == ()
    T = np.reshape([float(x) for x in files["_acc"].split()][:9], (3, 3))
    np.testing.assert_array_equal(T, np.triu(T))
    a = F @ np.linalg.inv(what.sensors.K_a).T - what.sensors.k_a[0]
    w = OMEGA @ np.linalg.inv(what.sensors.K_omega).T - what.sensors.k_w[0]
    np.testing.assert_allclose(imu_tk(files["_acc"], a), F, atol=1e-12)
    np.testing.assert_allclose(imu_tk(files["_gyro"], w), OMEGA, atol=1e-12)


def test_imu_calib_of_ros():
    what = device()
    file = YAML(typ="safe").load(exported("ros", what)[0][""])
    SM, bias = np.reshape(file["SM"], (3, 3)), np.array(file["bias"])
    a = F @ np.linalg.inv(what.sensors.K_a).T - what.sensors.k_a[0]
    np.testing.assert_allclose(a @ SM.T - bias, F, atol=1e-12)


def test_json_is_the_result_file():
    what = device(arms=True, sensitive=True)
    document = json.loads(exported("json", what)[0][""])
    assert document["axes"] == "imu"
    K, k = np.array(document["gyroscope"]["cross_coupling"]), np.array(document["gyroscope"]["offset"])
    G = (
        np.array(document["gyroscope"]["g_sensitivity"])
        if "g_sensitivity" in document["gyroscope"]
        else np.zeros((3, 3))
    )
    np.testing.assert_array_equal(K, what.sensors.K_omega)
    np.testing.assert_array_equal(k, what.sensors.k_w[0])
    assert G.shape == (3, 3)


# Read back


@pytest.mark.parametrize("target", ["kalibr", "openvins", "px4"])
def test_what_is_read_back_corrects_as_before(target, tmp_path):
    what = device(arms=target == "kalibr", sensitive=target != "px4", biased=target == "px4")
    if target == "px4":
        what = replace(what, sensors=replace(what.sensors, K_omega=np.eye(3), K_a=np.diag([1.01, 0.98, 1.003])))
    path = tmp_path / "file"
    path.write_text(exported(target, what)[0][""])
    read = read_from(target, path)
    p = what.sensors
    a, w = F @ np.linalg.inv(p.K_a).T - p.k_a[0], OMEGA @ np.linalg.inv(p.K_omega).T - p.k_w[0]
    omega, f = corrected(what, w, a)
    found_omega, found_f = corrected(read, w, a)
    C = np.eye(3) if target == "px4" else to_kalibr_frame(what)
    np.testing.assert_allclose(found_omega, omega @ C.T, atol=1e-8)
    if target == "kalibr":  # its origin is accelerometer x
        alpha = np.gradient(omega, T, axis=0, edge_order=2)
        r = p.lever_arms[0]
        f = f + np.cross(alpha, r) + np.cross(omega, np.cross(omega, r))
    np.testing.assert_allclose(found_f[INNER], (f @ C.T)[INNER], atol=1e-3 if target == "kalibr" else 1e-8)
    assert read.in_axes("imu").sensors.K_a[1, 0] == 0.0


def test_a_mirrored_triad_keeps_rotations():
    what = device()
    K_a = what.sensors.K_a @ np.diag([1.0, 1.0, -1.0])
    mirrored = replace(what, sensors=replace(what.sensors, K_a=matrix(exp([0.1, 0.2, 0.3])) @ K_a))
    imu = YAML(typ="safe").load(exported("kalibr", mirrored)[0][""])["imu0"]
    assert np.linalg.det(imu["gyroscopes"]["C_gyro_i"]) == pytest.approx(1.0)
    assert np.linalg.det(imu["accelerometers"]["M"]) < 0.0
