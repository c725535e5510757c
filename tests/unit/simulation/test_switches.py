"""Each switch of the virtual cell alone: what it adds to a recording, written out anew, and nothing else."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from kreisel.errors import SettingsError
from kreisel.inertial.noise_figures import GRADES
from kreisel.robot.description import parse_arm
from kreisel.robot.kinematics import poses
from kreisel.simulation.cell import simulate, write_truth
from kreisel.simulation.cell_settings import Cell, parse_cell
from kreisel.simulation.controller import Sway
from kreisel.simulation.device_errors import envelope

from ...felt import FAULTLESS, START_NS, rests_of, run

SECONDS = 20.0


def cell(**tables):
    return run(SECONDS, seed=4, **tables)


@pytest.fixture(scope="module")
def plain():
    return cell()


def readings(recording):
    return recording.imu.rates, recording.imu.accelerations


def apart(recording, other):
    """Differences of gyros, accelerometers, positions (n, 3 each) and of attitudes, rad."""
    a, b = recording.reference, other.reference
    turn = Rotation.from_quat(a.quaternions, scalar_first=True).inv() * Rotation.from_quat(
        b.quaternions, scalar_first=True
    )
    return *(y - x for x, y in zip(readings(recording), readings(other), strict=True)), b.positions - a.positions, turn


# Off: as it was before there were any switches


@pytest.mark.parametrize(
    ("seed", "tables", "expected"),
    [
        (3, {},
         [-0.0336292219174, -6.66235733479, 0.65845953476, 1.07969132519]),
        (4, {"imu": {"quadratic_gyro_sd": 1e-3, "bandwidth": 40.0, "gyro_temperature_drift": 1e-3},
             "errors": {"gear_eccentricity_sd": 1e-4, "sag_sd": 1e-4, "servo_lag": 0.01,
                        "oscillation_frequency": 9.0},
             "reference": {"jitter": 1e-3, "drop_share": 0.1, "clock_drift_ppm": 30}},
         [-0.180779028099, -11.4022608049, -0.460057141319, 0.13561172507]),
        (5, {"imu": {"grade": "ring-laser"}, "reference": {"kind": "mocap", "interval": 0.01}},
         [0.00206995787893, -3.61938008296, 0.372058815167, 0.75304313303]),
    ],
)  # fmt: skip
def test_without_switches_a_recording_is_as_before(seed, tables, expected):
    """Sums that depend on every number; written down before the switches were added."""
    _, recording = simulate(Cell.model_validate({"seed": seed, "seconds": 20, **tables}), Path("x"))
    np.testing.assert_allclose(fingerprint(recording), expected, rtol=1e-7, atol=0)


def fingerprint(recording):
    reference = recording.reference
    parts = [*readings(recording), reference.positions, reference.quaternions]
    return [float(np.cos(np.arange(part.size)) @ part.ravel()) for part in parts]


# Sensors


def test_gyros_respond_to_raw_accelerations(plain):
    truth, recording = cell(imu={"gyro_g_sensitivity_sd": 1e-4})
    w, a, p, _ = apart(plain[1], recording)
    np.testing.assert_allclose(w, -recording.imu.accelerations @ truth.effects.g_sensitivity.T, rtol=0, atol=1e-14)
    assert not a.any()
    assert not p.any()


def test_scale_factors_differ_with_the_sign(plain):
    truth, recording = cell(imu={"gyro_asymmetry_sd": 1e-3, "accel_asymmetry_sd": 2e-3})
    for before, after, c in zip(
        readings(plain[1]), readings(recording), (truth.effects.gyro_asymmetry, truth.effects.accel_asymmetry),
        strict=True,
    ):  # fmt: skip
        np.testing.assert_allclose(after + c * np.abs(after), before, rtol=0, atol=1e-13)
        assert np.abs(c).max() > 1e-4


def test_all_terms_together_give_the_true_motion(plain):
    """The model from readings to true values, with every term, gives what the plain device gives."""
    imu = {"gyro_g_sensitivity_sd": 1e-4, "gyro_asymmetry_sd": 1e-3, "accel_asymmetry_sd": 1e-3,
           "quadratic_gyro_sd": 1e-3, "quadratic_accel_sd": 1e-4}  # fmt: skip
    truth, recording = cell(imu=imu)
    w, a = readings(recording)
    s, e = truth.sensors, truth.effects
    before = readings(plain[1])
    np.testing.assert_allclose(
        w + s.k_w[1] * w**2 + e.gyro_asymmetry * np.abs(w) + a @ e.g_sensitivity.T, before[0], rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(a + s.k_a[1] * a**2 + e.accel_asymmetry * np.abs(a), before[1], rtol=0, atol=1e-11)


def test_accelerometers_are_late(plain):
    shift = 4  # samples
    truth, recording = cell(imu={"accel_delay": shift * 0.0025})
    assert truth.effects.accel_delay == 0.01
    np.testing.assert_array_equal(recording.imu.rates, plain[1].imu.rates)
    np.testing.assert_allclose(
        recording.imu.accelerations[shift:], plain[1].imu.accelerations[:-shift], rtol=0, atol=1e-9
    )


def test_axes_are_sampled_one_after_another(plain):
    shift = 4  # samples
    truth, recording = cell(imu={"axis_delay": shift * 0.0025})
    np.testing.assert_allclose(truth.effects.axis_delay, [-0.01, 0.0, 0.01])
    for now, before in zip(readings(recording), readings(plain[1]), strict=True):
        np.testing.assert_allclose(now[:-shift, 0], before[shift:, 0], rtol=0, atol=1e-9)
        np.testing.assert_array_equal(now[:, 1], before[:, 1])
        np.testing.assert_allclose(now[shift:, 2], before[:-shift, 2], rtol=0, atol=1e-9)


def test_axes_have_unequal_bandwidths(plain):
    """A mean over a normal window of deviation s, sample by sample, is what z and, with s / 2, y show."""
    truth, recording = cell(imu={"axis_smoothing": 0.01})
    np.testing.assert_allclose(truth.effects.axis_smoothing, [0.0, 1.25e-5, 5e-5])
    lag = np.arange(-32, 33)
    for now, before in zip(readings(recording), readings(plain[1]), strict=True):
        np.testing.assert_array_equal(now[:, 0], before[:, 0])
        for axis, sd in ((1, 0.005), (2, 0.01)):
            window = np.exp(-0.5 * (lag * 0.0025 / sd) ** 2)
            mean = np.convolve(before[:, axis], window / window.sum(), mode="same")
            change = now[:, axis] - before[:, axis]
            left = (now[:, axis] - mean)[64:-64]
            assert np.sqrt(np.mean(left**2)) < 0.02 * np.sqrt(np.mean(change[64:-64] ** 2))


def test_accelerometers_have_their_own_bandwidth(plain):
    _, recording = cell(imu={"accel_bandwidth": 20.0})
    _, both = cell(imu={"bandwidth": 20.0})
    np.testing.assert_array_equal(recording.imu.rates, plain[1].imu.rates)
    np.testing.assert_array_equal(recording.imu.accelerations, both.imu.accelerations)


@pytest.mark.parametrize(("sensor", "column"), [("gyro", 0), ("accel", 1)])
def test_offsets_change(plain, sensor, column):
    n = plain[1].imu.rates.shape[0]
    t = 0.0025 * np.arange(n)
    for key, size in (("step", 0.02), ("warm_up", 0.03), ("walk", 1e-3)):
        truth, recording = cell(imu={f"{sensor}_{key}": size, "warm_up_time": 5.0})
        change = apart(plain[1], recording)[column]
        assert not apart(plain[1], recording)[1 - column].any()
        mean, end = (getattr(truth.offset_change, f"{sensor}_{which}") for which in ("mean", "end"))
        np.testing.assert_allclose(mean, -change.mean(axis=0), rtol=0, atol=1e-13)
        np.testing.assert_allclose(end, -change[-1], rtol=0, atol=1e-13)
        if key == "step":
            (first, *_) = np.flatnonzero(np.abs(change[:, 0]) > 0.5 * size)
            assert 0.25 < first / n < 0.75
            np.testing.assert_allclose(np.abs(change[first:]), size, rtol=0, atol=1e-12)
            np.testing.assert_allclose(change[:first], 0.0, rtol=0, atol=1e-12)
        elif key == "warm_up":
            np.testing.assert_allclose(
                np.abs(change), size * np.exp(-t / 5.0)[:, None] * np.ones(3), rtol=0, atol=1e-12
            )
        else:
            steps = np.diff(change, axis=0)
            assert steps.std() == pytest.approx(size * np.sqrt(0.0025), rel=4.0 / np.sqrt(2.0 * steps.size))


def test_flicker_noise_counts_as_an_offset():
    """The mean of the noise is that of its slow part, but for white noise: four of its standard deviations."""
    truth, noisy = cell(imu={"noise": True, "grade": "consumer-mems", "gyro_g_sensitivity_sd": 0.0})
    _, quiet = cell(imu={"noise": False, "grade": "consumer-mems"})
    grade = GRADES["consumer-mems"]
    for before, after, mean, density, step in zip(
        readings(quiet), readings(noisy), (truth.offset_change.gyro_mean, truth.offset_change.accel_mean),
        (grade.gyro_noise_density, grade.accel_noise_density), (grade.gyro_step, grade.accel_step), strict=True,
    ):  # fmt: skip
        tolerance = 4.0 * (density / np.sqrt(SECONDS) + step / np.sqrt(12.0 * len(before)))
        np.testing.assert_allclose((before - after).mean(axis=0), mean, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(truth.offset_change.gyro_end, truth.offset_change.gyro_mean)


def test_vibration_is_a_sine_while_moving(plain):
    rms, frequency = 0.5, 70.0
    _, recording = cell(imu={"vibration": rms, "vibration_frequency": frequency}, motion={"rest": 3.0})
    _, quiet = cell(motion={"rest": 3.0})
    truth, _ = plain
    w, a, p, _ = apart(quiet, recording)
    assert not p.any()
    force, rate = a @ truth.sensors.K_a.T, w @ truth.sensors.K_omega.T
    assert np.linalg.matrix_rank(rate, tol=1e-9) == 1  # one direction
    sizes = np.linalg.svd(force, compute_uv=False)
    assert sizes[1] < 2e-3 * sizes[0]  # but for 2 omega x rate x lever arm
    wave = force @ np.linalg.svd(force, full_matrices=False)[2][0]
    assert np.abs(wave).max() == pytest.approx(np.sqrt(2.0) * rms, rel=2e-3)
    spectrum = np.abs(np.fft.rfft(wave))
    assert np.argmax(spectrum) * 400.0 / wave.size == pytest.approx(frequency, abs=0.6)
    assert np.linalg.norm(rate, axis=1).max() == pytest.approx(1e-3 * np.sqrt(2.0) * rms, rel=2e-3)
    still = rests_of(quiet.joints.angles)
    stamps = quiet.reference.stamps_ns
    for mask in still:
        first, last = (stamps[mask][i] for i in (5, -5))
        inside = (quiet.imu.stamps_ns > first) & (quiet.imu.stamps_ns < last)
        np.testing.assert_allclose(wave[inside], 0.0, rtol=0, atol=1e-12)


def test_readings_are_rounded_as_said(plain):
    _, recording = cell(imu={"gyro_quantum": 1e-3, "accel_quantum": 0.02})
    for values, before, step in zip(readings(recording), readings(plain[1]), (1e-3, 0.02), strict=True):
        np.testing.assert_allclose(values / step, np.round(before / step), rtol=0, atol=1e-9)


def test_a_mount_slips(plain):
    truth, recording = cell(imu={"slip_deg": 2.0})
    assert np.degrees(np.linalg.norm(truth.slip.turn)) == pytest.approx(2.0)
    assert 0.25 * SECONDS <= truth.slip.time <= 0.75 * SECONDS
    t = (recording.imu.stamps_ns - START_NS) * 1e-9
    late = t >= truth.slip.time
    w, before = recording.imu.rates, plain[1].imu.rates
    np.testing.assert_array_equal(w[~late], before[~late])
    K, k = truth.sensors.K_omega, truth.sensors.k_w[0]
    C = Rotation.from_rotvec(truth.slip.turn).as_matrix()
    np.testing.assert_allclose((w[late] + k) @ (C @ K).T, (before[late] + k) @ K.T, rtol=0, atol=1e-12)
    np.testing.assert_allclose(truth.slip.after(truth.sensors).K_a, C @ truth.sensors.K_a, rtol=0, atol=1e-15)


def test_faulty_samples(plain):
    n = plain[1].imu.rates.shape[0]
    _, stuck = cell(imu={"stuck_share": 0.1})
    before = np.hstack(readings(plain[1]))
    after = np.hstack(readings(stuck))
    moved = np.any(after != before, axis=1)
    np.testing.assert_array_equal(after[1:][moved[1:]], after[:-1][moved[1:]])
    same = np.all(after[1:] == after[:-1], axis=1) & np.any(before[1:] != before[:-1], axis=1)
    assert np.all(moved[1:] == same)
    _, spiked = cell(imu={"spike_share": 0.01})
    after = np.hstack(readings(spiked))
    rows, columns = np.nonzero(after != before)
    assert rows.size == np.unique(rows).size == pytest.approx(0.01 * n, abs=4.0 * np.sqrt(0.01 * n))
    usual = [np.sqrt(np.mean(part**2)) for part in readings(plain[1])]
    np.testing.assert_allclose(np.abs(after[rows, columns]), 10.0 * np.take(usual, columns // 3), rtol=1e-12)


# Reference


def test_positions_are_too_long(plain):
    truth, recording = cell(reference={"position_scale_ppm": 500.0})
    np.testing.assert_allclose(recording.reference.positions, 1.0005 * plain[1].reference.positions, rtol=1e-14)
    np.testing.assert_array_equal(recording.reference.quaternions, plain[1].reference.quaternions)
    np.testing.assert_array_equal(recording.imu.rates, plain[1].imu.rates)
    assert truth.position_scale == pytest.approx(5e-4)


def turns(q):
    return Rotation.from_quat(np.roll(q, -1, axis=-1))


def flat_body_seen(q, D):
    """Return the rotation of the body, in its axes, that fits four markers of it best to where they are seen."""
    markers = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]) * 0.1
    true = turns(q).apply(markers)
    return (turns(q).inv() * Rotation.align_vectors(true + true @ D.T, true)[0] * turns(q)).as_rotvec()


def test_cameras_show_a_flat_body_in_a_distorted_volume(plain):
    _, recording = cell(reference={"distortion": 1e-3})
    p, seen = plain[1].reference.positions, recording.reference.positions
    D = np.linalg.lstsq(p, seen - p, rcond=None)[0].T
    np.testing.assert_allclose(D, D.T, atol=1e-12)
    assert abs(np.trace(D)) < 1e-12
    assert 2e-4 < np.abs(D).max() < 4e-3
    np.testing.assert_allclose(seen, p + p @ D.T, atol=1e-12)
    q, of_cameras = plain[1].reference.quaternions[::500], recording.reference.quaternions[::500]
    found = (turns(q).inv() * turns(of_cameras)).as_rotvec()
    alone = np.array([flat_body_seen(one, D) for one in q])
    # but for two frames, of the body and of the cameras
    frames = np.vstack([np.hstack([np.eye(3), C.T]) for C in turns(q).as_matrix()])
    left = (found - alone).ravel()
    assert np.abs(left - frames @ np.linalg.lstsq(frames, left, rcond=None)[0]).max() < 5e-6
    assert np.abs(alone).max() > 5e-4
    every = (turns(plain[1].reference.quaternions).inv() * turns(recording.reference.quaternions)).as_rotvec()
    assert np.abs(every.mean(axis=0)).max() < 1e-9


def test_a_frame_that_turns_evenly_turns_all_poses(plain):
    _, recording = cell(reference={"turning": 1e-5})
    seconds, before, after = plain[1].reference.seconds, plain[1].reference, recording.reference
    turns = (
        Rotation.from_quat(np.roll(after.quaternions, -1, axis=1))
        * Rotation.from_quat(np.roll(before.quaternions, -1, axis=1)).inv()
    )
    rate = turns[-1].as_rotvec() / seconds[-1]
    assert 1e-6 < np.linalg.norm(rate) < 1e-4
    np.testing.assert_allclose(turns.as_rotvec(), seconds[:, None] * rate, atol=1e-12)
    np.testing.assert_allclose(after.positions, turns.apply(before.positions), atol=1e-12)


def test_positions_are_turned_about_gravity_alone(plain):
    truth, recording = cell(reference={"position_heading_deg": 2.0})
    assert truth.position_heading == np.radians(2.0)
    turn = Rotation.from_rotvec(np.radians(2.0) * truth.gravity_r / np.linalg.norm(truth.gravity_r))
    np.testing.assert_allclose(
        recording.reference.positions, turn.apply(plain[1].reference.positions), rtol=0, atol=1e-9
    )
    np.testing.assert_array_equal(recording.reference.quaternions, plain[1].reference.quaternions)


def test_reported_poses_are_means(plain):
    """To second order: half the variance of the window, times the second derivative."""
    sd, h = 0.02, 0.0025
    truth, recording = cell(reference={"smoothing": sd})
    assert truth.reference_smoothing == sd
    half = round(np.sqrt(3.0) * sd / h)
    integral = CubicSpline(
        h * np.arange(len(plain[1].reference.positions)), plain[1].reference.positions
    ).antiderivative()
    t = h * np.arange(len(plain[1].reference.positions))[half + 2 : -half - 2]
    width = np.sqrt(3.0) * sd
    mean = (integral(t + width) - integral(t - width)) / (2.0 * width)
    np.testing.assert_allclose(recording.reference.positions[half + 2 : -half - 2], mean, rtol=0, atol=1e-6)
    assert np.abs(recording.reference.positions - plain[1].reference.positions).max() > 1e-4
    np.testing.assert_array_equal(recording.imu.rates, plain[1].imu.rates)


def test_poses_are_interpolated_linearly(plain):
    _, recording = cell(reference={"interpolation": 0.05})
    p, before = recording.reference.positions, plain[1].reference.positions
    on = np.isclose(np.mod((recording.reference.stamps_ns - START_NS) * 1e-9 + 1e-9, 0.05), 0.0, atol=1e-6)
    np.testing.assert_allclose(p[on], before[on], rtol=0, atol=1e-9)
    ticks = np.flatnonzero(on)
    assert ticks.size > 300
    for a, b in pairwise(ticks):
        share = np.linspace(0.0, 1.0, b - a + 1)[:, None]
        np.testing.assert_allclose(p[a : b + 1], (1.0 - share) * p[a] + share * p[b], rtol=0, atol=1e-9)
    assert np.abs(p - before).max() > 1e-4


def test_clocks_jump_and_walk(plain):
    path = CubicSpline((plain[1].reference.stamps_ns - START_NS) * 1e-9, plain[1].reference.positions)

    def late(recording):
        """By how much later poses were taken, where the tool moves."""
        t = (recording.reference.stamps_ns - START_NS) * 1e-9
        v = path(t, 1)
        fast = np.linalg.norm(v, axis=1) > 0.3
        moved = (recording.reference.positions - path(t))[fast]
        return t[fast], np.sum(moved * v[fast], axis=1) / np.sum(v[fast] ** 2, axis=1)

    _, jumped = cell(reference={"clock_jump": 2e-3})
    t, by = late(jumped)
    before, after = by < 1e-3, by > 1e-3
    assert t[before].max() < t[after].min()
    np.testing.assert_allclose(by[before], 0.0, rtol=0, atol=1e-6)
    np.testing.assert_allclose(by[after], 2e-3, rtol=0.1)
    _, walked = cell(reference={"clock_walk": 1e-4})
    t, by = late(walked)
    assert 1e-5 < np.abs(by).max() < 4.0 * 1e-4 * np.sqrt(SECONDS)
    np.testing.assert_array_equal(walked.imu.rates, plain[1].imu.rates)


def test_outliers_and_repeats(plain):
    n = len(plain[1].reference.positions)
    _, wild = cell(reference={"outlier_share": 0.02})
    _, _, p, turn = apart(plain[1], wild)
    size, angle = np.linalg.norm(p, axis=1), turn.magnitude()
    wrong = size > 1e-9
    assert wrong.sum() == pytest.approx(0.02 * n, abs=4.0 * np.sqrt(0.02 * n))
    np.testing.assert_allclose(size[wrong], 0.02, rtol=1e-9)
    np.testing.assert_allclose(angle[wrong], 0.02, rtol=1e-6)
    _, held = cell(reference={"held": 0.3})
    p, before = held.reference.positions, plain[1].reference.positions
    moved = np.any(p != before, axis=1)
    np.testing.assert_array_equal(p[1:][moved[1:]], p[:-1][moved[1:]])
    assert moved.mean() > 0.1


def test_poses_at_standstill_alone(plain):
    _, recording = cell(motion={"still_poses": True})
    assert 0.1 * len(plain[1].reference.positions) < len(recording.reference.positions)
    assert len(recording.reference.positions) < 0.7 * len(plain[1].reference.positions)
    same = np.isin(plain[1].reference.stamps_ns, recording.reference.stamps_ns)
    np.testing.assert_array_equal(recording.reference.positions, plain[1].reference.positions[same])
    assert recording.joints.angles.shape[0] == same.sum()


# Arm


def test_gears_have_play(plain):
    truth, recording = cell(errors={"backlash_sd": 1e-3})
    np.testing.assert_array_equal(recording.imu.rates, plain[1].imu.rates)
    angles, before = recording.joints.angles, plain[1].joints.angles
    rate = np.gradient(before, 0.0025, axis=0)
    ahead = 0.5 * truth.arm.backlash * np.tanh(rate / 0.01)
    fast = np.abs(rate) > 0.1
    np.testing.assert_allclose((angles - before)[fast], ahead[fast], rtol=0, atol=1e-8)
    still = np.concatenate([np.flatnonzero(mask)[3:-3] for mask in rests_of(before)])
    np.testing.assert_allclose(angles[still], before[still], rtol=0, atol=1e-9)


def test_the_base_sways(plain):
    """What cameras see and what the IMU feels belong to one motion, which the controller does not report."""
    table = {"sway": 1e-3, "sway_frequency": 5.0}
    truth, recording = cell(errors=table)
    np.testing.assert_array_equal(recording.reference.positions, plain[1].reference.positions)
    _, seen = cell(errors=table, reference={"kind": "mocap"})
    _, unmoved = cell(reference={"kind": "mocap"})
    moved = apart(unmoved, seen)[2]
    assert np.abs(moved[:, 2]).max() < 1e-15
    assert np.abs(moved).max() == pytest.approx(1e-3, rel=1e-2)
    C_rb = Rotation.from_quat(unmoved.reference.quaternions, scalar_first=True)
    rows = np.searchsorted(recording.imu.stamps_ns, unmoved.reference.stamps_ns)
    felt = C_rb.apply((apart(plain[1], recording)[1] @ truth.sensors.K_a.T)[rows])
    h = 0.0025
    second = (moved[2:] - 2.0 * moved[1:-1] + moved[:-2]) / h**2
    # h^2 / 12 of the fourth derivative, of which the steps of the envelope have more than the sine; Coriolis 1e-5
    np.testing.assert_allclose(felt[1:-1], second, rtol=0, atol=0.03 * np.abs(second).max())
    assert np.abs(second).max() > 0.5


def test_the_envelope_has_the_derivatives_it_says():
    class Planned:
        standstills = np.array([[0.0, 1.0], [3.0, 4.0], [4.3, 6.0]])

    t = np.linspace(0.0, 6.0, 60_001)
    share, slope, bend = envelope(Planned, t)
    assert share.min() == 0.0
    assert share.max() == 1.0
    assert not share[(t < 1.0) | (t > 4.3) | ((t > 3.0) & (t < 4.0))].any()
    np.testing.assert_allclose(np.gradient(share, t), slope, rtol=0, atol=1e-3)
    np.testing.assert_allclose(np.gradient(slope, t), bend, rtol=0, atol=1.0)  # 30 h / ramp^3 at its ends
    position, velocity, acceleration = Sway(1e-3, 4.0, np.array([0.3, 2.0])).at(Planned, t)
    np.testing.assert_allclose(np.gradient(position, t, axis=0), velocity, rtol=0, atol=1e-6)
    np.testing.assert_allclose(np.gradient(velocity, t, axis=0), acceleration, rtol=0, atol=1e-3)


def test_joints_that_are_not_named_stand_still(plain):
    _, recording = cell(motion={"joints": (4, 6)})
    moving = np.ptp(recording.joints.angles, axis=0) > 1e-9
    assert moving.tolist() == [False, False, False, True, False, True]
    with pytest.raises(SettingsError, match="joints 1 to 6"):
        cell(motion={"joints": (7,)})


# What the owner states


def stated(tables=None, **keys):
    content = {"seconds": 10, "seed": 3, **(tables or {}), "stated": keys}
    return simulate(Cell.model_validate(content), Path("x"))[1]


def test_statements_are_wrong_by_what_is_said():
    right = stated().settings
    wrong = stated(noise_factor=3.0, offset_sd_factor=0.1, reference_factor=0.3, robot_factor=10.0).settings
    assert wrong.imu.gyro_noise_density == pytest.approx(3.0 * 0.15 * np.pi / 180 / 60)
    assert wrong.imu.accel_offset_sd == pytest.approx(0.1 * 0.025 * 9.80665)
    assert wrong.imu.grade == "fog-mems"
    assert wrong.reference.position_sd == pytest.approx(0.3 * right.reference.position_sd)
    assert wrong.robot.length_sd == pytest.approx(10.0 * right.robot.length_sd)
    assert stated(grade="fog").settings.imu.grade == "fog"
    site = stated(latitude_deg=-10.0, gravity=9.8).settings.site
    assert (site.latitude_deg, site.height_m, site.gravity) == (-10.0, 200.0, 9.8)
    assert stated(place=False).settings.site.latitude_deg is None
    with pytest.raises(SettingsError, match="unknown grade 'magic'"):
        parse_cell({"stated": {"grade": "magic"}}, Path("cell.toml"))


def test_statements_are_left_out():
    silent = stated(settings=False)
    assert silent.settings == type(silent.settings)()
    assert silent.urdf is None
    assert silent.joints is not None
    bare = stated(joints=False)
    assert bare.joints is None
    assert bare.urdf is None
    assert bare.settings.robot.urdf is None
    assert bare.settings.robot.length_sd == 3e-4
    secret = stated(robot=False)
    assert secret.settings.robot.length_sd is None
    assert secret.urdf is not None


def test_the_description_is_wrong():
    right = stated({"errors": FAULTLESS})
    for keys, off in (({"urdf_length_error": 0.003}, 0.003), ({"tcp_error": 0.004}, 0.004)):
        wrong = stated({"errors": FAULTLESS}, **keys)
        np.testing.assert_array_equal(wrong.reference.positions, right.reference.positions)
        arm = parse_arm(wrong.urdf, wrong.settings.robot.tcp)
        p, _ = poses(arm, wrong.joints.angles)
        np.testing.assert_allclose(np.linalg.norm(p - wrong.reference.positions, axis=1), off, rtol=1e-6)


def test_the_truth_file_holds_the_effects(tmp_path):
    import json

    truth, _ = cell(imu={"slip_deg": 1.0, "accel_delay": 0.001, "gyro_asymmetry_sd": 1e-3, "gyro_step": 0.1})
    write_truth(truth, tmp_path / "truth.json")
    document = json.loads((tmp_path / "truth.json").read_text())
    assert document["gyroscope"]["asymmetry"] == truth.effects.gyro_asymmetry.tolist()
    assert document["gyroscope"]["g_sensitivity"] == truth.effects.g_sensitivity.tolist()
    assert document["gyroscope"]["offset_change"]["end"] == truth.offset_change.gyro_end.tolist()
    assert document["accelerometer"]["delay"] == 0.001
    assert document["slip"]["time"] == truth.slip.time
    assert len(document["robot"]["backlash"]) == 6
