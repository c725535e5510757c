"""Places of IMUs that were turned and shaken by hand, against truth."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.array.array_fit import fit_array
from kreisel.array.hand_motion import hand_motion, matrix_deviation
from kreisel.errors import RecordingError
from kreisel.geometry.rotation import exp, from_matrix, log, matrix
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.synchronization.clock import Clock

from ...rigid_array import readings_at, recorded, shaken

PLACES = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.004], [0.0, 0.04, 0.0], [0.03, 0.04, -0.005]])
RATE, SECONDS = 100.0, 25.0


def array(seed, count, folder, *, noise=1e-3, jitter=0.0, gyro_scale=0.0, beyond=False):
    rng = np.random.default_rng(seed)
    position, attitude = shaken(rng, SECONDS, 2.0)
    imus, axes = [], []
    for k in range(count):
        C = np.eye(3) if k == 0 else matrix(exp(0.5 * rng.normal(size=3)))
        t = np.arange(round(SECONDS * RATE)) / RATE
        read = np.maximum(t + jitter * rng.normal(size=t.size), STEP)
        rates, forces = readings_at(position, attitude, PLACES[k], C, read)
        if beyond:  # accelerometers of an IMU lie apart, and their matrix errs
            own = 1e-3 * rng.normal(size=(3, 3))
            own -= own.mean(axis=0)
            forces = np.column_stack([
                readings_at(position, attitude, PLACES[k] + C @ own[j], C, read)[1][:, j] for j in range(3)
            ]) @ (np.eye(3) + 2e-3 * rng.normal(size=(3, 3))).T  # fmt: skip
        rates = (1.0 + gyro_scale) * rates + noise * rng.normal(size=rates.shape)
        forces = forces + 20.0 * noise * rng.normal(size=forces.shape)
        imus.append(recorded(t, rates, forces, folder, start_ns=10**9 * (1 + k), drift=1e-5 * k))
        axes.append(C)
    return imus, np.array(axes)


STEP = 1e-3


def found_of(imus, gyro=1e-6):
    clocks = [Clock(1e-3 * (k > 0)) for k in range(len(imus))]
    good = [np.ones(imu.stamps_ns.size, bool) for imu in imus]
    motion = hand_motion(imus, [SensorParameters.ideal()] * len(imus), clocks, good)
    return fit_array(motion, np.full(9, gyro), [True] * len(motion.axes)), motion


@pytest.mark.parametrize("count", [2, 4])
def test_places_and_rotations_are_found_within_their_deviations(count, tmp_path):
    squares = []
    for seed in range(2):
        imus, axes = array(seed, count, tmp_path, beyond=True)
        fit, motion = found_of(imus)
        for k in range(1, count):
            apart = fit.positions[k] - PLACES[k]
            squares.append(float(apart @ np.linalg.solve(fit.covariance[k][:3, :3], apart)) / 3.0)
            turn = log(from_matrix(fit.axes[k] @ axes[k].T))
            assert np.linalg.norm(turn) < 1e-2
            assert np.abs(apart).max() < 1e-3
            # both clocks began at the same moment
            assert motion.clocks[k].start == pytest.approx(0.0, abs=2e-5)
            assert motion.clocks[k].skew == pytest.approx(-1e-5 * k, abs=2e-6)
    assert 0.3 < np.mean(squares) < 2.5


def test_moments_of_reading_that_differ_are_found(tmp_path):
    imus, _ = array(5, 4, tmp_path, noise=2e-4, jitter=3e-4)
    fit, _ = found_of(imus)
    assert fit.delay == pytest.approx(3e-4, rel=0.3)
    assert np.abs(fit.positions - PLACES).max() < 1e-3
    steady, _ = found_of(array(5, 4, tmp_path, noise=2e-4)[0])
    assert steady.delay < 3e-5


def test_a_scale_of_all_gyros_shows_in_the_deviations_and_nowhere_else(tmp_path):
    imus, _ = array(6, 4, tmp_path, gyro_scale=5e-3)
    sure, _ = found_of(imus)
    unsure, _ = found_of(imus, gyro=5e-3)
    far = np.linalg.norm(sure.positions[3]) / np.linalg.norm(PLACES[3]) - 1.0
    # centripetal accelerations grow with the square of the rates
    assert far == pytest.approx(-1e-2, abs=3e-3)
    assert unsure.scale_deviation > 2.0 * sure.scale_deviation
    assert abs(far) < 3.0 * unsure.scale_deviation


def test_offsets_that_drift_are_not_taken_for_positions(tmp_path):
    """Without offsets in the estimate the place is 0.13 mm off, and chi-square 7 per degree of freedom."""
    imus, _ = array(7, 4, tmp_path, noise=2e-4)
    drift = np.linspace(0.0, 0.1, imus[1].seconds.size)[:, None] * np.array([1.0, -1.0, 0.5])
    imus[1] = replace(imus[1], accelerations=imus[1].accelerations + drift)
    fit, _ = found_of(imus)
    apart = fit.positions[1] - PLACES[1]
    assert apart @ np.linalg.solve(fit.covariance[1][:3, :3], apart) / 3.0 < 3.0
    assert np.abs(apart).max() < 5e-5


def test_what_nothing_is_known_of_has_the_usual_deviation():
    assert matrix_deviation([None, None], 1e-2, 0.0) == pytest.approx(np.full(9, 1e-2 / np.sqrt(2.0)))
    assert matrix_deviation([None], 0.0, 3e-3) == pytest.approx(np.full(9, 3e-3))


def test_an_array_that_rests_is_refused(tmp_path):
    imus, _ = array(1, 2, tmp_path)
    still = [recorded(imu.seconds[:150], imu.rates[:150], imu.accelerations[:150], tmp_path) for imu in imus]
    with pytest.raises(RecordingError, match="shake the array"):
        found_of(still)
