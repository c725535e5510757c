"""A unit's parameters by a known motion, against truth; and where an error of the motion's calibration goes."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.array.relative_pose import pose_derivatives
from kreisel.array.resampled import clipped_samples, resampled
from kreisel.array.unit_clock import clock_of
from kreisel.array.unit_fit import Common, fit_unit
from kreisel.calibration.device_axes import vector_of, with_vector
from kreisel.errors import EstimationError, SynchronizationError
from kreisel.geometry.rotation import exp, from_matrix, log, matrix
from kreisel.inertial.correction import Block
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.simulation.elastic_mount import ElasticMount
from kreisel.simulation.imu import ideal_readings
from kreisel.synchronization.clock import Clock

from ...rigid_array import readings_at, recorded, shaken

RATE, SECONDS = 200.0, 60.0


def sensors(rng, place):
    mount = matrix(exp(0.1 * rng.normal(size=3)))
    return SensorParameters(
        mount @ (np.eye(3) + 3e-3 * rng.normal(size=(3, 3))),
        1e-2 * rng.normal(size=(1, 3)),
        mount @ (np.eye(3) + 3e-3 * rng.normal(size=(3, 3))),
        0.1 * rng.normal(size=(1, 3)),
        place + 2e-3 * rng.normal(size=(3, 3)),
    )


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """A body's motion, an ideal IMU at its origin, and a unit beside it with a clock of its own."""
    rng = np.random.default_rng(3)
    position, attitude = shaken(rng, SECONDS)
    t = np.arange(round(SECONDS * RATE)) / RATE
    rates, forces = readings_at(position, attitude, np.zeros(3), np.eye(3), t)
    raw = Block(t, rates, forces)
    unit = sensors(rng, np.array([0.1, -0.05, 0.03]))
    own = t[40:-40] + 1.7e-3
    w, f = readings_at(position, attitude, np.zeros(3), np.eye(3), own)
    alpha = (readings_at(position, attitude, np.zeros(3), np.eye(3), own + 1e-3)[0]
             - readings_at(position, attitude, np.zeros(3), np.eye(3), own - 1e-3)[0]) / 2e-3  # fmt: skip
    folder = tmp_path_factory.mktemp("unit")
    return raw, unit, (own, w, alpha, f), folder


def imu_of(cell, rng, noise, *, turned=None):
    _, unit, (own, w, alpha, f), folder = cell
    rates, forces = ideal_readings(w, alpha, f, unit)
    if turned is not None:
        late = (own > 0.5 * SECONDS)[:, None]
        C = matrix(exp(turned))
        other = replace(unit, K_omega=C @ unit.K_omega, K_a=C @ unit.K_a)
        rates, forces = (
            np.where(late, b, a) for a, b in zip((rates, forces), ideal_readings(w, alpha, f, other), strict=True)
        )
    rates = rates + noise * rng.normal(size=rates.shape)
    forces = forces + 10.0 * noise * rng.normal(size=forces.shape)
    return recorded(own, rates, forces, folder, drift=2e-5)


def common_of(raw, sensors):
    return Common.of(raw, sensors, lambda change: with_vector(sensors, vector_of(sensors) + change), 33)


def fitted(cell, imu):
    raw, unit, (own, *_), _ = cell
    common = common_of(raw, SensorParameters.ideal())
    start = replace(unit, K_omega=unit.K_omega + 1e-3, K_a=unit.K_a - 1e-3, lever_arms=unit.lever_arms + 5e-3)
    return fit_unit(imu, Clock(float(own[0]) + 2e-3), common, start, {})


def test_parameters_and_clock_are_found(cell):
    unit = cell[1]
    errors, deviations = [], []
    for seed in range(6):
        fit = fitted(cell, imu_of(cell, np.random.default_rng(seed), 1e-3))
        errors.append(vector_of(fit.sensors) - vector_of(unit))
        deviations.append(np.sqrt(np.diag(fit.covariance))[:33])
        assert fit.clock.start == pytest.approx(0.2 + 1.7e-3, abs=5e-6)
        assert fit.clock.skew == pytest.approx(-2e-5, abs=1e-6)
    ratio = np.sqrt(np.mean((np.array(errors) / np.array(deviations)) ** 2))
    assert 0.8 < ratio < 1.2
    assert np.median(np.array(deviations)[:, 24:]) < 2e-4


def test_an_error_of_the_motion_goes_where_it_says(cell):
    raw, unit = cell[0], cell[1]
    imu = imu_of(cell, np.random.default_rng(1), 0.0)
    fit = fitted(cell, imu)
    change = np.zeros(33)
    change[[0, 5, 9, 12, 16, 22, 24, 31]] = [1e-3, -5e-4, 1e-4, 5e-4, 1e-3, 1e-2, 1e-3, -1e-3]
    wrong = with_vector(SensorParameters.ideal(), vector_of(SensorParameters.ideal()) + change)
    moved = fit_unit(imu, fit.clock, common_of(raw, wrong), unit, {})
    seen = vector_of(moved.sensors) - vector_of(fit.sensors)
    foretold = (fit.by_motion @ change)[:33]
    assert np.abs(seen - foretold).max() < 0.03 * np.abs(seen).max()
    assert np.abs(seen).max() > 5e-4


def test_a_turn_on_the_mount_is_found_and_nothing_else_is_taken_for_one(cell):
    turn = np.array([1e-3, -5e-4, 2e-4])
    found = fitted(cell, imu_of(cell, np.random.default_rng(4), 3e-4, turned=turn)).turn
    assert found is not None
    assert found.seconds == pytest.approx(0.5 * SECONDS, abs=4.0)
    assert np.abs(found.angle - turn).max() < 5.0 * found.deviation.max() + 5e-5
    imu = imu_of(cell, np.random.default_rng(4), 3e-4)
    assert fitted(cell, imu).turn is None
    late = imu.seconds > 0.5 * SECONDS
    jumped = replace(
        imu, accelerations=imu.accelerations + 0.02 * late[:, None], rates=imu.rates + 1e-3 * late[:, None]
    )
    assert fitted(cell, jumped).turn is None


def test_a_mount_that_bends_is_found_and_does_no_harm(cell):
    """The bent motion is that of the virtual cell, by differences of its path."""
    _, unit, (own, *_), folder = cell
    rng = np.random.default_rng(3)
    position, attitude = shaken(rng, SECONDS)
    mount = ElasticMount(np.array([[0.0, 1.0, -0.5], [-1.0, 0.3, 0.2], [0.4, 0.0, -0.3]]) * 1e-5, np.zeros((3, 3)))

    def of_tool(t):
        (before, _), (rates, forces), (after, _) = (
            readings_at(position, attitude, np.zeros(3), np.eye(3), t + step) for step in (-1e-3, 0.0, 1e-3)
        )
        return rates, (after - before) / 2e-3, forces

    w, alpha, f = mount.moved(of_tool, attitude, SECONDS)(own)
    rates, forces = ideal_readings(w, alpha, f, unit)
    rates = rates + 3e-4 * rng.normal(size=rates.shape)
    fit = fitted(cell, recorded(own, rates, forces + 3e-3 * rng.normal(size=forces.shape), folder, drift=2e-5))
    assert np.abs((fit.bending - mount.bending) / fit.bending_sd).max() < 4.0
    assert fit.bending_sd.max() < 1e-5
    score = (vector_of(fit.sensors) - vector_of(unit)) / np.sqrt(np.diag(fit.covariance))[:33]
    assert np.abs(score).max() < 4.0
    assert fit.turn is None
    rigid = fitted(cell, imu_of(cell, np.random.default_rng(1), 3e-4))
    assert not rigid.bending.any()
    assert "mount.bending[0,1]" in fit.names
    assert "mount.bending[0,1]" not in rigid.names


def test_a_motion_about_one_axis_does_not_determine_a_unit(cell, tmp_path):
    t = np.arange(4000) / RATE
    rates, forces = np.zeros((4000, 3)), np.tile([0.0, 0.0, 9.81], (4000, 1))
    rates[:, 2] = np.sin(t)
    raw = Block(t, rates, forces)
    common = common_of(raw, SensorParameters.ideal())
    with pytest.raises(EstimationError, match="turn about all axes|does not change"):
        fit_unit(recorded(t, rates, forces, tmp_path), Clock(0.0), common, SensorParameters.ideal(), {})


def test_clocks_are_found_by_rates_and_other_motion_is_refused(cell):
    raw, *_, folder = cell
    base = recorded(raw.stamps, raw.rates, raw.forces, folder)
    imu = imu_of(cell, np.random.default_rng(2), 1e-3)
    shifted = replace(imu, stamps_ns=imu.stamps_ns + 77 * 10**9)
    assert clock_of(shifted, base).start == pytest.approx(0.2 + 1.7e-3, abs=5e-3)
    other = replace(imu, rates=np.random.default_rng(0).normal(size=imu.rates.shape))
    with pytest.raises(SynchronizationError, match="does not turn as"):
        clock_of(other, base)


def test_cubics_between_samples_are_exact_for_cubics_and_gaps_are_not_bridged(tmp_path):
    t = np.delete(np.arange(400) / 100.0, slice(200, 230))
    cube = np.column_stack([1.0 + t - 0.3 * t**2 + 0.1 * t**3, t, t**2])
    imu = recorded(t, cube, 2.0 * cube, tmp_path)
    times = np.array([0.5004, 1.2345, 2.1, 3.7771, 9.0])
    found = resampled(imu, Clock(0.0), times)
    assert found.known.tolist() == [True, True, False, True, False]
    at = times[found.known]
    assert found.rates[found.known, 0] == pytest.approx(1.0 + at - 0.3 * at**2 + 0.1 * at**3, abs=1e-9)
    assert found.forces[found.known] == pytest.approx(2.0 * found.rates[found.known])


def test_readings_of_a_higher_rate_are_smoothed_and_clipped_ones_not_used(tmp_path):
    t = np.arange(8000) / 1000.0
    motion = np.column_stack([np.sin(t), np.cos(2.0 * t), t])
    noisy = motion + 0.01 * np.random.default_rng(1).normal(size=motion.shape)
    times = np.arange(20, 780) / 100.0
    imu = recorded(t, noisy, noisy, tmp_path)
    left = [
        found.rates - np.column_stack([np.sin(times), np.cos(2.0 * times), times])
        for found in (resampled(imu, Clock(0.0), times), resampled(imu, Clock(0.0), times, smooth=True))
    ]
    assert np.std(left[1]) < 0.4 * np.std(left[0])
    assert np.abs(left[1].mean(axis=0)).max() < 5e-4
    clipped = resampled(recorded(t, np.minimum(noisy, 0.9), noisy, tmp_path), Clock(0.0), times, smooth=True)
    assert not clipped.known[(np.sin(times) > 0.93) | (times > 1.0)].any()
    assert clipped.known[(times < 0.7) & (np.cos(2.0 * times) < 0.8)].any()


def test_clipped_samples_are_those_at_an_end_that_is_reached_for_long():
    values = np.random.default_rng(1).normal(size=(1000, 3))
    assert not clipped_samples(values).any()
    clipped = np.clip(3.0 * np.sin(np.arange(1000) / 20.0), -2.0, 2.0)
    assert clipped_samples(np.column_stack([clipped, values[:, :2]])).sum() == (np.abs(clipped) == 2.0).sum()


def test_a_relative_pose_and_its_deviations_by_sampling():
    rng = np.random.default_rng(8)
    base, own = sensors(rng, np.zeros(3)), sensors(rng, np.array([0.05, 0.02, -0.01]))
    root = 1e-4 * rng.normal(size=(66, 66))
    position, rotation, J = pose_derivatives(base, own)
    drawn = []
    for _ in range(300):
        change = root @ rng.normal(size=66)
        moved = [with_vector(p, vector_of(p) + part) for p, part in zip((base, own), np.split(change, 2), strict=True)]
        there, turned, _ = pose_derivatives(*moved)
        drawn.append(np.concatenate([there - position, log(from_matrix(turned @ rotation.T))]))
    assert np.std(drawn, axis=0) == pytest.approx(np.linalg.norm(J @ root, axis=1), rel=0.15)
