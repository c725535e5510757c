"""The virtual cell against its own poses, by a route that shares no code with it; and each of its errors alone.

Simulator and estimator must not share an error of sign or order. What an IMU should feel is therefore formed here
from nothing but the reported poses: differentiated numerically, with gravity, Earth rate and the sensor model
written out anew in plain NumPy.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import kreisel
from kreisel.errors import SettingsError
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell

from ..felt import (
    CORNER_FORCE,
    CORNER_RATE,
    LEVEL,
    MARGIN,
    START_NS,
    agreement,
    felt,
    inside_chi_square,
    local_site,
    run,
)


@pytest.fixture(scope="module")
def faultless():
    return run()


DEVICES = {
    "as it comes": {},
    "turned, bent and far off": {
        "grade": "consumer-mems",
        "mounting_deg": (110.0, -60.0, 75.0),
        "lever_arm": (0.3, -0.2, 0.15),
        "lever_arm_spread": 0.05,
        "quadratic_gyro_sd": 5e-3,
        "quadratic_accel_sd": 5e-4,
    },
    "faultless at the tool": {"errors": False, "lever_arm": (0.0, 0.0, 0.0)},
}


@pytest.mark.parametrize("device", list(DEVICES))
def test_readings_are_what_the_poses_make_an_imu_feel(device):
    truth, recording = run(35.0, imu=DEVICES[device], site=LEVEL)
    gravity, earth = local_site()
    np.testing.assert_allclose(truth.gravity_r, gravity, rtol=0, atol=1e-6)
    np.testing.assert_allclose(truth.earth_rate_r, earth, rtol=0, atol=1e-15)
    reference = recording.reference
    agreement(truth, recording, reference.positions, reference.quaternions, gravity, earth)


def test_a_faultless_device_at_the_tool_shows_rates_and_forces_themselves():
    """No sensor model at all between poses and readings: signs of the readings in their own frame."""
    truth, recording = run(25.0, imu={"errors": False, "lever_arm": (0, 0, 0), "lever_arm_spread": 0.0}, site=LEVEL)
    reference, imu = recording.reference, recording.imu
    omega, _, force = felt(reference.positions, reference.quaternions, *local_site(), 6)
    first = np.searchsorted(imu.stamps_ns, reference.stamps_ns[0]) + 4
    rows = slice(first, first + len(omega))
    np.testing.assert_allclose(imu.rates[rows], omega, rtol=0, atol=CORNER_RATE)
    np.testing.assert_allclose(imu.accelerations[rows], force, rtol=0, atol=CORNER_FORCE)
    # at rest the accelerometers show what holds them up
    up = Rotation.from_quat(reference.quaternions[0], scalar_first=True).as_matrix()[2]
    np.testing.assert_allclose(imu.accelerations[0], 9.8094 * up, rtol=0, atol=1e-3)
    assert not np.any(truth.sensors.lever_arms)


def test_another_arm_another_place():
    site = {"latitude_deg": -33.9, "height_m": 50.0, "heading_deg": 200.0, **LEVEL}
    truth, recording = run(25.0, seed=2, robot={"model": "ur10e"}, site=site, motion={"smoothing": 0.03})
    reference = recording.reference
    agreement(truth, recording, reference.positions, reference.quaternions, *local_site(-33.9, 50.0, 200.0))


def test_a_tilted_base_tilts_gravity_and_earth_rate_alike():
    sd = 0.02
    tilts = []
    for seed in range(40):
        truth, _ = run(10.0, seed, site={"tilt_sd": sd}, motion={"first_rest": 10.0}, reference={"interval": 1.0})
        g, earth = local_site()
        assert np.linalg.norm(truth.gravity_r) == pytest.approx(-g[2], abs=1e-6)
        assert np.linalg.norm(truth.earth_rate_r) == pytest.approx(7.292115e-5, rel=1e-12)
        assert truth.gravity_r @ truth.earth_rate_r == pytest.approx(g @ earth, rel=1e-6)
        tilts.append(truth.gravity_r[:2] / 9.81)
    assert inside_chi_square(tilts, sd)


def test_tilted_readings_follow_the_tilted_truth():
    truth, recording = run(25.0, seed=3, site={"tilt_sd": 0.1})
    assert np.degrees(np.arccos(-truth.gravity_r[2] / np.linalg.norm(truth.gravity_r))) > 1.0
    reference = recording.reference
    agreement(truth, recording, reference.positions, reference.quaternions, truth.gravity_r, truth.earth_rate_r)


# Clocks


def test_time_convention(faultless):
    """t_imu = t_ref + offset + skew (t_ref - first), both ways.

    A spline through poses 2.5 ms apart is good to 5/384 H^4 of 12 500 m/s^4, 6e-9 m, and twice that at corners;
    stamps are rounded to 1 ns, 2e-9 m. Seconds wrong by a millionth of the skew would show.
    """
    _, recording = faultless
    path = CubicSpline((recording.reference.stamps_ns - START_NS) * 1e-9, recording.reference.positions)
    for offset, ppm in ((-1.7, 300.0), (0.4, -2000.0), (0.0371, 0.0)):
        drifting, other = run(reference={"interval": 0.012, "clock_offset": offset, "clock_drift_ppm": ppm})
        assert (drifting.time_offset, drifting.time_skew) == (offset, pytest.approx(ppm * 1e-6, rel=1e-12))
        t_ref = (other.reference.stamps_ns - START_NS) * 1e-9
        t_imu = t_ref + offset + ppm * 1e-6 * (t_ref - t_ref[0])
        assert t_imu[0] == pytest.approx(MARGIN, abs=1e-9)
        assert 30.0 - MARGIN - 0.013 < t_imu[-1] < 30.0 - MARGIN + 1e-9
        np.testing.assert_allclose(other.reference.positions, path(t_imu), rtol=0, atol=2e-8)
        np.testing.assert_array_equal(other.imu.rates, recording.imu.rates)
        np.testing.assert_array_equal(other.joints.stamps_ns, other.reference.stamps_ns)


def test_stamps_of_the_imu(faultless):
    _, recording = faultless
    assert recording.imu.stamps_ns[0] == START_NS
    np.testing.assert_array_equal(np.diff(recording.imu.stamps_ns), 2_500_000)
    assert recording.imu.stamps_ns.size == 30 * 400 + 1


# One error changes nothing else


NOISY = {"imu": {"noise": True}, "errors": {"path_position_sd": 5e-4, "repeatability_position_sd": 1e-4}}


@pytest.mark.parametrize(
    "change",
    [
        {"errors": {"path_position_sd": 2e-3, "path_orientation_sd": 1e-3}},
        {"errors": {"path_correlation_time": 0.0, "repeatability_position_sd": 1e-3}},
        {"errors": {"servo_lag": 0.02, "encoder_step": 1e-4}},
        {"errors": {"gear_eccentricity_sd": 1e-4, "sag_sd": 1e-4}},
        {"reference": {"jitter": 5e-4, "drop_share": 0.3, "clock_offset": 3.0, "interval": 0.012}},
        {"reference": {"measures": "position", "kind": "mocap"}},
    ],
)
def test_what_the_controller_reports_does_not_touch_the_imu(change):
    before, recording = run(12.0, seed=5, **NOISY)
    errors = {**NOISY["errors"], **change.get("errors", {})}
    after, other = run(12.0, seed=5, **{**NOISY, **change, "errors": errors})
    np.testing.assert_array_equal(other.imu.stamps_ns, recording.imu.stamps_ns)
    np.testing.assert_array_equal(other.imu.rates, recording.imu.rates)
    np.testing.assert_array_equal(other.imu.accelerations, recording.imu.accelerations)
    np.testing.assert_array_equal(after.sensors.K_a, before.sensors.K_a)
    np.testing.assert_array_equal(after.gravity_r, before.gravity_r)


@pytest.mark.parametrize(
    "imu",
    [{"noise": False}, {"grade": "fog"}, {"rate": 200.0}, {"errors": False}, {"drop_share": 0.2}, {"bandwidth": 50.0}],
)
def test_the_device_does_not_touch_the_poses(imu):
    _, recording = run(12.0, seed=5, **NOISY)
    _, other = run(12.0, seed=5, errors=NOISY["errors"], imu={"noise": True, **imu})
    np.testing.assert_array_equal(other.reference.positions, recording.reference.positions)
    np.testing.assert_array_equal(other.reference.quaternions, recording.reference.quaternions)


def test_errors_of_the_reports_add_up():
    """Path and repeatability together are each alone, with the same draws; positions round at 1e-16 of 3 m."""
    common = {"seconds": 20.0, "reference": {"interval": 0.012}}
    path, rest = {"path_position_sd": 1e-3}, {"repeatability_position_sd": 1e-3}
    at_path, at_rest, at_both, at_none = (
        run(errors=errors, **common)[1].reference.positions for errors in (path, rest, {**path, **rest}, {})
    )
    np.testing.assert_allclose(at_both - at_none, (at_path - at_none) + (at_rest - at_none), rtol=0, atol=5e-15)
    doubled = run(errors={"path_position_sd": 2e-3}, **common)[1].reference.positions
    np.testing.assert_allclose(doubled - at_none, 2.0 * (at_path - at_none), rtol=0, atol=5e-15)
    assert np.abs(at_path - at_none).max() > 1e-3


def test_noise_of_the_device_is_added():
    """The same draws, whatever the device measures."""
    noises = []
    for imu in ({"mounting_deg": (0.0, 0.0, 0.0)}, {"mounting_deg": (50.0, 20.0, -70.0), "lever_arm": (0.1, 0.2, 0.3)}):
        quiet, noisy = (run(12.0, imu={**imu, "noise": noise})[1].imu for noise in (False, True))
        noises.append(np.hstack([noisy.rates - quiet.rates, noisy.accelerations - quiet.accelerations]))
    np.testing.assert_allclose(noises[0], noises[1], rtol=0, atol=1e-13)
    assert np.all(noises[0].std(axis=0) > 1e-4)


def test_seeds_and_trials_are_different_cells():
    def positions(**which):
        return run(12.0, reference={"interval": 0.1}, **which)[1].reference.positions

    np.testing.assert_array_equal(positions(seed=5), positions(seed=5))
    np.testing.assert_array_equal(positions(seed=5, trial=1), positions(seed=5, trial=1))
    cells = [positions(seed=5), positions(seed=6), *(positions(seed=5, trial=k) for k in range(3))]
    for k, one in enumerate(cells):
        for other in cells[:k]:
            assert np.abs(one - other).max() > 0.1


# Closure


@pytest.mark.parametrize(("seed", "joints"), [(1, True), (4, True), (1, False)])
def test_a_faultless_minute_is_calibrated_without_error(seed, joints):
    """What is left is integration between samples, 400 a second: some hundredths of a millionth.

    Gravity is stated as known; by latitude and height alone it is uncertain, and K_a with it.
    """
    truth, recording = run(60.0, seed, reference={"interval": 0.012, "clock_offset": 0.0371, "joints": joints})
    site = recording.settings.site.model_copy(
        update={"gravity": float(np.linalg.norm(truth.gravity_r)), "gravity_sd": 1e-7}
    )
    recording = replace(recording, settings=recording.settings.model_copy(update={"site": site}))
    calibration = kreisel.calibrate(recording)
    found, true = calibration.sensors, truth.sensors
    assert np.abs(found.k_a - true.k_a).max() < 1e-5  # m/s^2
    assert np.abs(found.K_omega - true.K_omega).max() < 2e-8
    assert np.abs(found.K_a - true.K_a).max() < 2e-8
    assert np.abs(found.lever_arms - true.lever_arms).max() < 1e-6  # m
    assert np.abs(found.k_w - true.k_w).max() < 1e-8  # rad/s, 0.002 deg/h
    assert calibration.document["timing"]["offset"] == pytest.approx(0.0371, abs=1e-7)
    assert calibration.accepted


def test_a_level_base_and_jittered_poses():
    """No tilt at all, and moments taken out of their order: every number stays one."""
    cell = Cell.model_validate({"seconds": 12, "site": {"tilt_sd": 0}, "reference": {"jitter": 0.004}})
    _, recording = simulate(cell, Path("x"))
    assert np.isfinite(recording.reference.positions).all()
    assert np.isfinite(recording.imu.accelerations).all()


def test_coefficients_without_a_reading_are_refused():
    cell = Cell.model_validate({"seed": 2, "seconds": 20, "imu": {"noise": False, "quadratic_gyro_sd": 0.1,
                                                                  "quadratic_accel_sd": 0.01}})  # fmt: skip
    with pytest.raises(SettingsError, match="no reading corresponds"):
        simulate(cell, Path("x"))


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [("imu", "quadratic_gyro_sd", 1e-3), ("errors", "sag_sd", 1e-4), ("reference", "jitter", 1e-6)],
)
def test_further_errors_leave_other_draws_alone(table, key, value):
    plain, other = (simulate(Cell.model_validate({"seconds": 12, table: {key: v}}), Path("x")) for v in (0.0, value))
    np.testing.assert_array_equal(plain[0].sensors.K_a, other[0].sensors.K_a)
    np.testing.assert_array_equal(plain[0].sensors.lever_arms, other[0].sensors.lever_arms)
    np.testing.assert_array_equal(plain[0].arm.lag, other[0].arm.lag)
    apart = np.abs(plain[1].reference.positions - other[1].reference.positions).max()
    assert apart < 1e-3  # repeatability drawn anew would move poses by 0.3 mm and more; sag and jitter by less
