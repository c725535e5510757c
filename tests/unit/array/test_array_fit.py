"""Places of IMUs that were turned and shaken by hand, against truth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from kreisel.array import array_fit
from kreisel.array.array_fit import fit_array
from kreisel.array.contrary_forces import contrary_forces
from kreisel.array.hand_motion import hand_motion, matrix_deviation
from kreisel.array.left_out import check_copy
from kreisel.array.sudden_slide import sudden_slide
from kreisel.array.without_reference import _check_turn, _clipped, rest_rotations
from kreisel.errors import RecordingError, SynchronizationError
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


def motion_of(imus, good=None):
    clocks = [Clock(1e-3 * (k > 0)) for k in range(len(imus))]
    good = good or [np.ones(imu.stamps_ns.size, bool) for imu in imus]
    return hand_motion(imus, [SensorParameters.ideal()] * len(imus), clocks, good)


def found_of(imus, gyro=1e-6, *, calibrated=True, good=None):
    motion = motion_of(imus, good)
    return fit_array(motion, np.full(9, gyro), [calibrated] * len(motion.axes)), motion


def chi_square(fit, k):
    apart = fit.positions[k] - PLACES[k]
    return float(apart @ np.linalg.solve(fit.covariance[k][:3, :3], apart)) / 3.0


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


SIGN, ALL_SIGNS, SWAPPED = np.diag([-1.0, 1.0, 1.0]), -np.eye(3), np.eye(3)[[1, 0, 2]]


@pytest.mark.parametrize("wrong", [SIGN, ALL_SIGNS, SWAPPED], ids=["a sign", "all signs", "two columns"])
@pytest.mark.parametrize("number", [0, 2])
def test_an_imu_whose_accelerations_contradict_the_others_is_named(wrong, number, tmp_path):
    imus, _ = array(7, 4, tmp_path)
    assert contrary_forces(motion_of(imus)) == ()
    imus[number] = replace(imus[number], accelerations=imus[number].accelerations @ wrong.T)
    assert contrary_forces(motion_of(imus)) == (number,)
    assert contrary_forces(motion_of([imus[number], imus[1]])) is None


@pytest.mark.parametrize(("count", "number"), [(2, 1), (4, 2)])
def test_an_imu_that_slides_is_named(count, number, tmp_path):
    imus, axes = array(8, count, tmp_path)
    assert sudden_slide(motion_of(imus)) is None
    own, at = imus[number], round(0.6 * SECONDS * RATE)
    C, moved = axes[number], np.array([4e-3, -3e-3, 0.0])
    rates = imus[0].rates
    slope = np.gradient(rates, 1.0 / RATE, axis=0)
    more = (np.cross(slope, moved) + np.cross(rates, np.cross(rates, moved))) @ C
    more[:at] = 0.0
    imus[number] = replace(own, accelerations=own.accelerations + more)
    found = sudden_slide(motion_of(imus))
    assert found is not None
    assert found.number == number
    assert found.size == pytest.approx(5e-3, rel=0.2)
    assert found.seconds == pytest.approx(0.6 * SECONDS, abs=1.5)
    assert "slides on the others' body by " in found.text


def test_a_copy_of_another_imu_is_named(tmp_path):
    imus, _ = array(7, 2, tmp_path)
    check_copy(imus[0], {"imu1": imus[1]})
    with pytest.raises(RecordingError, match="holds the readings of imu1"):
        check_copy(replace(imus[1], source=tmp_path), {"imu0": imus[0], "imu1": imus[1]})


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


def test_what_a_filter_takes_of_the_rates_is_found(tmp_path):
    """Without it distances are 0.4 % too long; with the gyros' derivatives they are six times as certain as without."""
    imus, _ = array(13, 4, tmp_path)
    unfiltered, _ = found_of(imus)
    share = 1.0 - np.exp(-2.0 * np.pi * 20.0 / RATE)
    smoothed = [replace(imu, rates=lfilter([share], [1.0, share - 1.0], imu.rates, axis=0)) for imu in imus]
    fit, _ = found_of(smoothed)
    assert max(chi_square(fit, k) for k in (1, 2, 3)) < 3.0
    assert fit.lag[0] > 3.5e-3
    for found in (fit, unfiltered):
        assert np.sqrt(np.trace(found.covariance[1][:3, :3])) < 2e-4


@pytest.mark.parametrize("number", [0, 1])
def test_a_unit_whose_gyros_alone_are_late_is_where_it_is(number, tmp_path):
    """By 4 ms: its clock follows the gyros, and its accelerometers are early, which was 0.1 mm of its place."""
    imus, _ = array(15, 3, tmp_path)
    t = imus[number].seconds
    late = [np.interp(t - 4e-3, t, rate) for rate in imus[number].rates.T]
    imus[number] = replace(imus[number], rates=np.column_stack(late))
    fit, motion = found_of(imus)
    assert abs(motion.clocks[1].start) == pytest.approx(4e-3, abs=3e-4)
    assert max(chi_square(fit, k) for k in (1, 2)) < 5.0
    assert np.abs(fit.positions - PLACES[:3]).max() < 5e-5


def test_derivatives_that_do_not_fit_do_not_count(tmp_path):
    """Gyros read vibration as rates of 21 Hz, with slopes of 8 rad/s^2, that nothing does."""
    imus, _ = array(14, 4, tmp_path)
    shake = 0.06 * np.sin(2.0 * np.pi * 21.0 * imus[0].seconds)[:, None] * np.array([1.0, -0.8, 0.6])
    fit, _ = found_of([replace(imu, rates=imu.rates + shake) for imu in imus])
    assert max(chi_square(fit, k) for k in (1, 2, 3)) < 5.0  # 8 if they count


def test_a_unit_that_vibrates_counts_less_and_does_not_spoil_the_others(tmp_path):
    imus, _ = array(8, 4, tmp_path, noise=2e-4)
    quiet, _ = found_of(imus)
    shake = 3.0 * np.sin(2.0 * np.pi * 31.0 * imus[2].seconds)[:, None] * np.array([1.0, 0.5, -0.7])
    imus[2] = replace(imus[2], accelerations=imus[2].accelerations + shake)
    fit, _ = found_of(imus)
    assert max(chi_square(fit, k) for k in (1, 3)) < 4.0
    for k in (1, 3):  # as far as three units determine their places, and not as three and a bad one
        sd, of_quiet = (np.sqrt(np.trace(found.covariance[k][:3, :3])) for found in (fit, quiet))
        assert sd < 12.0 * of_quiet


def test_offsets_that_no_standstill_showed_are_in_the_deviations(tmp_path):
    """Of gyros by 3 deg/s in common, of accelerometers by 50 mg, whose matrices err by 2 per cent."""
    rng = np.random.default_rng(9)
    imus, _ = array(9, 4, tmp_path, noise=2e-4)
    imus = [
        replace(
            imu, rates=imu.rates + 0.05,
            accelerations=imu.accelerations @ (np.eye(3) + 0.02 * rng.normal(size=(3, 3))) + 0.5 * rng.normal(size=3),
        ) for imu in imus
    ]  # fmt: skip
    assert max(chi_square(found_of(imus)[0], k) for k in (1, 2, 3)) > 8.0
    fit, _ = found_of(imus, calibrated=False)
    assert max(chi_square(fit, k) for k in (1, 2, 3)) < 4.0


def test_clipped_samples_of_one_axis_pull_at_no_clock(tmp_path):
    imus, _ = array(10, 3, tmp_path, noise=2e-4)
    limit = 0.6 * float(np.abs(imus[1].rates[:, 2]).max())
    rates = imus[1].rates.copy()
    rates[:, 2] = np.clip(rates[:, 2], -limit, limit)
    imus[1] = replace(imus[1], rates=rates)
    assert float(np.abs(imus[1].rates).max()) > limit  # another axis reads more
    fit, motion = found_of(imus, good=[~_clipped(imu) for imu in imus])
    assert abs(motion.clocks[1].start) < 5.0 * motion.clocks[1].start_sd
    assert max(chi_square(fit, k) for k in (1, 2)) < 4.0


def test_an_imu_with_columns_in_disorder_is_no_turned_one(tmp_path):
    imus, _ = array(11, 2, tmp_path)
    _check_turn(imus[1], Clock(0.0), imus[0], "imu0")
    swapped = replace(imus[1], rates=imus[1].rates[:, [1, 0, 2]])
    with pytest.raises(SynchronizationError, match="not those of imu0, turned: of one of the two a column is in"):
        _check_turn(swapped, Clock(0.0), imus[0], "imu0")


def test_axes_are_compared_by_the_standstills_that_both_have(tmp_path):
    """The other IMU has read in the first six of eight attitudes, and one that read in two is not compared."""
    rng = np.random.default_rng(12)
    t = np.arange(0.0, 48.0, 0.01)
    up = rng.normal(size=(8, 3))
    forces = (9.81 * up / np.linalg.norm(up, axis=1)[:, None])[(t // 6.0).astype(int)]
    forces = forces + 1e-3 * rng.normal(size=forces.shape)
    rates = 1e-4 * rng.normal(size=forces.shape)
    moved = (t % 6.0) < 1.5
    rates[moved] += rng.normal(size=(int(moved.sum()), 3))
    forces[moved] += rng.normal(size=(int(moved.sum()), 3))
    C = matrix(exp(np.array([0.2, -0.1, 0.3])))
    sd = replace(SensorParameters.ideal(), K_a=1e-4 * np.ones((3, 3)))
    known = SimpleNamespace(sensors=SensorParameters.ideal(), sensor_sd=sd)
    members = [SimpleNamespace(calibration=known)] * 3
    imus = [recorded(t, rates, forces, tmp_path)]
    imus += [recorded(t[:n], rates[:n] @ C, forces[:n] @ C, tmp_path) for n in (3700, 1300)]
    found = rest_rotations(members, imus, [Clock(0.0)] * 3)
    assert list(found) == [1]
    assert np.abs(found[1][0] - C).max() < 1e-3


def test_what_nothing_is_known_of_has_the_usual_deviation():
    assert matrix_deviation([None, None], 1e-2, 0.0) == pytest.approx(np.full(9, 1e-2 / np.sqrt(2.0)))
    assert matrix_deviation([None], 0.0, 3e-3) == pytest.approx(np.full(9, 3e-3))


def test_an_array_that_rests_is_refused(tmp_path):
    imus, _ = array(1, 2, tmp_path)
    still = [recorded(imu.seconds[:150], imu.rates[:150], imu.accelerations[:150], tmp_path) for imu in imus]
    with pytest.raises(RecordingError, match="shake the array"):
        found_of(still)


def test_gyros_that_are_not_linear_at_quick_rates_do_no_harm(tmp_path, monkeypatch):
    """A tenth of a permille at 1 rad/s, and 0.2 % at the rms of 4.6: without cubics distances are 1.8 % off."""
    imus, _ = array(17, 4, tmp_path)
    bent = [replace(imu, rates=imu.rates * (1.0 + 1e-4 * imu.rates**2)) for imu in imus]
    fit, _ = found_of(bent)
    assert max(chi_square(fit, k) for k in (1, 2, 3)) < 3.0
    monkeypatch.setitem(array_fit._PRIORS, "cubic", 1e-9)
    assert min(chi_square(found_of(bent)[0], k) for k in (1, 2, 3)) > 50.0
