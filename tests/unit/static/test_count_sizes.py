"""Raw converter readings: what a count is, the calibration behind it, and that nothing takes counts for quantities."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.result import Calibration
from kreisel.errors import RecordingError
from kreisel.formats.loading import load
from kreisel.formats.write import write_folder
from kreisel.inertial.counts import Counts
from kreisel.preparation.resting_noise import allan_report
from kreisel.recording.header import HeaderUnits
from kreisel.simulation.standstills import GRAVITY, HandTurns, hand_turned
from kreisel.static.count_sizes import in_quantities
from kreisel.static.static_result import calibrate_static
from kreisel.validation.checks import check_streams

RATE, FORCE = 1.3316e-4, 5.9855e-4
"""A count of an MPU-9150 at 250 deg/s and 2 g."""

UNITS = HeaderUnits("ns", "counts", "counts")


def counted(zero, seed=3, **how):
    """Return a recording in SI, and the same in counts about a zero."""
    _, recording = hand_turned(HandTurns("industrial-mems", **how), np.random.default_rng(seed))
    imu = recording.imu
    raw = replace(
        imu,
        rates=np.round(imu.rates / RATE + zero),
        accelerations=np.round(imu.accelerations / FORCE + zero),
        units=UNITS,
    )
    return recording, replace(recording, imu=raw)


@pytest.mark.parametrize("zero", [0.0, 32768.0])
def test_what_a_count_is_is_found(zero):
    recording, raw = counted(zero)
    imu, counts = in_quantities(check_streams(raw).imu, GRAVITY)
    assert counts.rate == pytest.approx(RATE, rel=0.05)
    assert counts.acceleration == pytest.approx(FORCE, rel=0.02)
    np.testing.assert_allclose(counts.acceleration_zero, zero, atol=600.0)
    np.testing.assert_allclose(counts.rate_zero, zero, atol=200.0)
    np.testing.assert_allclose(imu.accelerations, recording.imu.accelerations, atol=0.6)
    assert in_quantities(recording.imu, GRAVITY)[1] is None


@pytest.mark.parametrize("zero", [0.0, pytest.param(32768.0, marks=pytest.mark.slow)])
def test_the_calibration_of_counts_is_that_of_the_quantities(zero, tmp_path):
    recording, raw = counted(zero)
    plain, found = (calibrate_static(check_streams(one)).calibration for one in (recording, raw))
    assert found.accepted
    assert abs(found.derived["accel_scale_error_ppm"].value).max() < 3e4
    t = recording.imu.stamps_ns
    expected = plain.correct(recording.imu.rates, recording.imu.accelerations, t)
    own = found.correct(raw.imu.rates, raw.imu.accelerations, t)
    np.testing.assert_allclose(own[0], expected[0], atol=2e-3)
    np.testing.assert_allclose(own[1], expected[1], atol=0.02)
    found.save(tmp_path)
    again = Calibration.load(tmp_path)
    assert again.counts.rate == found.counts.rate
    np.testing.assert_array_equal(again.counts.acceleration_zero, found.counts.acceleration_zero)
    stream = again.stream()
    parts = [stream.push(raw.imu.rates[:4000], raw.imu.accelerations[:4000], t[:4000]), stream.close()]
    np.testing.assert_allclose(np.concatenate([part[1] for part in parts]), own[0][:4000], atol=1e-9)


def test_a_gyro_that_is_turned_and_counts_backwards_is_found_too():
    _, raw = counted(0.0)
    C = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # left-handed
    turned = replace(raw, imu=replace(raw.imu, rates=raw.imu.rates @ C.T))
    found = calibrate_static(check_streams(turned)).calibration
    assert found.accepted
    np.testing.assert_allclose(found.sensors.K_omega @ C, np.eye(3), atol=0.06)


def test_counts_are_read_from_the_header_and_refused_elsewhere(tmp_path):
    _, raw = counted(0.0)
    write_folder(raw, tmp_path / "raw")
    file = tmp_path / "raw" / "imu0" / "data.csv"
    text = file.read_text().replace("[rad s^-1]", "[counts]").replace("[m s^-2]", "[counts]")
    file.write_text(text)
    read = check_streams(load(tmp_path / "raw"))
    assert read.imu.units.counted("rate")
    assert read.imu.units.counted("acceleration")
    assert calibrate_static(read).calibration.accepted
    with pytest.raises(RecordingError, match="raw counts"):
        allan_report(read)


def test_too_few_attitudes_do_not_show_it():
    _, raw = counted(0.0, tilt=np.radians(8.0))
    with pytest.raises(RecordingError, match="need more attitudes"):
        calibrate_static(check_streams(raw))


def test_a_count_less_its_zero_has_a_size():
    counts = Counts(0.5, 2.0, np.array([1.0, 2.0, 3.0]), np.zeros(3))
    rates, forces = counts.in_si(np.array([[3.0, 2.0, 1.0]]), np.array([[1.0, 0.0, -1.0]]))
    np.testing.assert_array_equal(rates, [[1.0, 0.0, -1.0]])
    np.testing.assert_array_equal(forces, [[2.0, 0.0, -2.0]])
