"""Rows that hold nothing are left out and counted; what is really zero stays."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import RecordingError
from kreisel.formats.loading import load
from kreisel.formats.write import write_folder
from kreisel.recording.recording import NO_STAMP, JointAngles, Recording
from kreisel.validation.checks import check_streams
from kreisel.validation.empty_rows import without_missing
from kreisel.validation.recording_from_arrays import from_arrays

from .test_checks import JOINT, armed, message, recording, with_imu, with_poses


def lost_at(r: Recording, *rows: int) -> np.ndarray:
    return np.delete(r.imu.stamps_ns, rows)


def test_each_kind_is_counted_with_its_first_place() -> None:
    r = recording()
    stamps, rates, forces = r.imu.stamps_ns.copy(), r.imu.rates.copy(), r.imu.accelerations.copy()
    stamps[[700, 900]] = NO_STAMP
    rates[1000:1003, 1], forces[1001, 0] = np.nan, np.inf
    rates[1500], forces[1500] = 0.0, 0.0
    got = check_streams(with_imu(r, stamps_ns=stamps, rates=rates, accelerations=forces))
    np.testing.assert_array_equal(got.imu.stamps_ns, lost_at(r, 700, 900, 1000, 1001, 1002, 1500))
    assert [str(w) for w in got.warnings] == [
        "missing: imu0: of 2400 samples, 2 without a stamp (first: line 702), 3 without a number (w_y = nan) (first: "
        "line 1002), 1 of which all accelerations are exactly zero (first: line 1502); these rows were left out"
    ]
    assert got.imu.rows is None


def test_a_long_loss_still_splits_the_recording_and_later_faults_keep_their_lines() -> None:
    r = recording()
    rates = r.imu.rates.copy()
    rates[1000:1020] = np.nan
    rates[1800, 0] += 5.0
    said = [str(w) for w in check_streams(with_imu(r, rates=rates)).warnings]
    assert "gaps: imu0: 0.105 s without samples after line 1001; the recording is split there" in said
    assert any(text.startswith("masked: line 1802: a spike in w_x") for text in said)


@pytest.mark.parametrize("axis", [0, 1])
def test_an_axis_that_is_always_zero_is_no_fault(axis: int) -> None:
    """Nor are rates that are exactly zero at rest."""
    r = recording(digits=1e-3)
    forces = r.imu.accelerations.copy()
    forces[:, axis] = 0.0
    rates = np.where(r.imu.seconds[:, None] < 4.0, 0.0, r.imu.rates)
    flat = with_imu(r, rates=rates, accelerations=forces)
    assert without_missing(flat) is flat


def test_too_much_is_refused_with_how_much() -> None:
    r = recording()
    rates = r.imu.rates.copy()
    rates[100::3, 2] = np.nan
    said = message(with_imu(r, rates=rates))
    assert said.startswith("run/imu0/data.csv, line 102: of 2400 samples, 767 without a number (w_z = nan)")
    assert "32 % are missing, at most 20 % may be" in said
    assert "100 % are missing" in message(with_poses(r, positions=np.full_like(r.reference.positions, np.nan)))


def test_accelerations_that_are_always_zero_are_refused_as_such() -> None:
    r = recording()
    rates = r.imu.rates.copy()
    rates[100] = np.nan
    forces = np.zeros_like(rates)
    assert "all accelerations are zero: record the accelerometers too" in message(
        with_imu(r, rates=rates, accelerations=forces)
    )


@pytest.mark.parametrize("alone", [None, "positions", "quaternions"])
def test_lost_poses_are_left_out(alone: str | None) -> None:
    r = recording()
    p, q = r.reference.positions + np.array([0.5, 0.2, 1.0]), r.reference.quaternions.copy()
    stamps = r.reference.stamps_ns
    p[400:405], q[400:405] = 0.0, 0.0
    p[600], q[600] = np.nan, np.nan
    if alone is not None:
        p, q = (p, None) if alone == "positions" else (None, q)
    got = check_streams(with_poses(r, positions=p, quaternions=q))
    np.testing.assert_array_equal(got.reference.stamps_ns, np.delete(stamps, [400, 401, 402, 403, 404, 600]))
    (warning,) = got.warnings
    looks = "position of zeros" if alone == "positions" else "quaternion of zeros"
    assert f"5 with a {looks}" in str(warning)
    assert "(first: line 402)" in str(warning)


def test_poses_that_jump_to_the_origin_without_rotation_are_lost() -> None:
    """As is written by systems that begin each frame anew; a body that is led there stays."""
    r = recording()
    p, q = r.reference.positions + np.array([0.5, 0.2, 1.0]), r.reference.quaternions.copy()
    p[500:540], q[500:540] = 0.0, [1.0, 0.0, 0.0, 0.0]
    got = check_streams(with_poses(r, positions=p, quaternions=q))
    assert got.reference.stamps_ns.size == r.reference.stamps_ns.size - 40
    assert "40 with a position of zeros without rotation, to which the pose jumps" in str(got.warnings[0])


def test_a_body_that_rests_at_the_origin_is_there() -> None:
    r = recording(noise=0.0)
    assert (r.reference.positions[0] == 0.0).all()
    assert check_streams(r).reference.stamps_ns.size == r.reference.stamps_ns.size


def test_joint_angles_without_numbers_are_left_out() -> None:
    r = armed()
    angles = r.joints.angles.copy()
    angles[30:33, 1] = np.nan
    got = check_streams(replace(r, joints=JointAngles(r.joints.stamps_ns, angles, JOINT)))
    assert got.joints.stamps_ns.size == r.joints.stamps_ns.size - 3
    assert "missing: joint0: of 960 rows of joint angles, 3 without a number (q_2 = nan) (first: line 32)" in str(
        got.warnings[0]
    )


def test_empty_cells_of_a_file_are_left_out(tmp_path: Path) -> None:
    r = recording()
    write_folder(r, tmp_path / "run")
    file = tmp_path / "run" / "imu0" / "data.csv"
    lines = file.read_text().split("\n")
    lines[500] = ",".join([*lines[500].split(",")[:3], "", *lines[500].split(",")[4:]])
    lines[600] = "," + lines[600].partition(",")[2]
    lines[700] = "," * 6
    file.write_text("\n".join(lines))
    got = load(tmp_path / "run")
    np.testing.assert_array_equal(got.imu.stamps_ns, lost_at(r, 499, 599, 699))
    told = next(str(w) for w in got.warnings if w.subject == "missing")
    assert "2 without a stamp (first: line 601), 1 without a number (w_z = nan) (first: line 501)" in told


def test_a_matlab_file_with_lost_samples_is_read(tmp_path: Path) -> None:
    """Its rows cannot be deleted by hand; where rows are counted, a lost one counts."""
    scipy_io = pytest.importorskip("scipy.io")
    r = recording()
    gyro, force = r.imu.rates.copy(), r.imu.accelerations.copy()
    gyro[300:303], force[300:303] = np.nan, np.nan
    gyro[900] = force[900] = 0.0
    scipy_io.savemat(tmp_path / "run.mat", {"w": gyro, "f": force, "id": np.arange(len(gyro))})
    columns = {"imu.time": "200 Hz", "imu.rate": "w(1), w(2), w(3)", "imu.acceleration": "f(1), f(2), f(3)"}
    got = load(tmp_path / "run.mat", columns=columns)
    np.testing.assert_array_equal(got.imu.stamps_ns, lost_at(r, 300, 301, 302, 900))
    assert "3 without a number (w_x = nan) (first: row 301)" in str(got.warnings[0])


def test_arrays_may_hold_lost_samples() -> None:
    r = recording()
    stamps, rates = r.imu.seconds.copy(), r.imu.rates.copy()
    stamps[40], rates[50] = np.nan, np.nan
    got = from_arrays(stamps, rates, r.imu.accelerations)
    np.testing.assert_array_equal(got.imu.stamps_ns, lost_at(r, 40, 50))
    dates = np.datetime64("2026-01-01", "ns") + r.imu.stamps_ns.astype("timedelta64[ns]")
    dates[40] = np.datetime64("NaT")
    assert from_arrays(dates, rates, r.imu.accelerations).imu.stamps_ns.size == r.imu.stamps_ns.size - 2
    with pytest.raises(RecordingError, match="imu_stamps: 1 of 2400 are finite numbers"):
        from_arrays(np.where(np.arange(2400) < 1, 0.0, np.nan), rates, r.imu.accelerations)


def test_marks_of_lost_tracking_are_no_rotations() -> None:
    r = recording()
    q, p = r.reference.quaternions.copy(), r.reference.positions.copy()
    q[300:320], p[300:320] = -9999.0, -9999.0
    got = check_streams(with_poses(r, quaternions=q, positions=p))
    assert got.reference.stamps_ns.size == r.reference.stamps_ns.size - 20
    assert "20 with a quaternion of four times -9999, a mark of lost tracking" in str(got.warnings[0])
