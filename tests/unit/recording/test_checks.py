"""What sensors and robots really do must pass; what they never do must not."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kreisel.errors import RecordingError
from kreisel.geometry import exp
from kreisel.recording import ImuSamples, JointAngles, Recording, ReferencePoses
from kreisel.recording import recording as module
from kreisel.recording.checks import check_streams

IMU, POSE = Path("run/imu0/data.csv"), Path("run/pose0/data.csv")
RATE, POSE_RATE, SECONDS = 200.0, 80.0, 12.0
QUIET = 4.0
"""Seconds of rest at the start."""


def course(t: np.ndarray) -> np.ndarray:
    """Return a smooth course from rest, (n, 3), for angles and positions."""
    s = np.clip(t - QUIET, 0.0, None)
    return np.column_stack([0.4 * (1.0 - np.cos(w * s)) * s / (1.0 + s) for w in (1.1, 1.7, 2.3)])


def recording(noise: float = 1e-3, digits: float = 0.0) -> Recording:
    """Return a recording that is well; not fit for a calibration, but for checks of its streams."""
    rng = np.random.default_rng(3)
    t, tau = np.arange(0.0, SECONDS, 1.0 / RATE), np.arange(0.0, SECONDS, 1.0 / POSE_RATE)
    rates = np.gradient(course(t), t, axis=0)
    accelerations = np.gradient(rates, t, axis=0) + np.array([0.1, 0.2, 9.8])
    values = np.hstack([rates, accelerations]) + noise * rng.normal(size=(t.size, 6))
    if digits:
        values = np.round(values / digits) * digits
    imu = ImuSamples(np.round(1e9 * t).astype(np.int64), values[:, :3], values[:, 3:], IMU)
    p = course(tau) + 0.1 * noise * rng.normal(size=(tau.size, 3))
    reference = ReferencePoses("pose0", np.round(1e9 * tau).astype(np.int64), p, exp(course(tau)), POSE)
    return Recording(Path("run"), imu, reference)


def with_imu(r: Recording, **parts: object) -> Recording:
    return replace(r, imu=replace(r.imu, **parts))


def with_poses(r: Recording, **parts: object) -> Recording:
    return replace(r, reference=replace(r.reference, **parts))


def message(r: Recording) -> str:
    with pytest.raises(RecordingError) as error:
        check_streams(r)
    return str(error.value)


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-3, 0.05])
@pytest.mark.parametrize("digits", [0.0, 1e-3, 0.02])
@pytest.mark.parametrize("piece", [600, module.PIECE])
def test_a_sound_recording_passes_untouched(
    monkeypatch: pytest.MonkeyPatch, noise: float, digits: float, piece: int
) -> None:
    """Also one without any noise, whose readings repeat while it rests, and one with few digits."""
    monkeypatch.setattr(module, "PIECE", piece)
    want = recording(noise, digits)
    got = check_streams(want)
    assert got.findings == ()
    np.testing.assert_array_equal(got.imu.rates, want.imu.rates)
    np.testing.assert_array_equal(got.reference.positions, want.reference.positions)
    np.testing.assert_allclose(got.reference.quaternions, want.reference.quaternions, atol=1e-15)


@pytest.mark.parametrize("row", [5, 599, 600, 1100, 2395])
def test_a_fault_in_a_later_piece_keeps_its_place(monkeypatch: pytest.MonkeyPatch, row: int) -> None:
    monkeypatch.setattr(module, "PIECE", 600)
    r = recording()
    rates = r.imu.rates.copy()
    rates[row, 1] += 5.0
    with pytest.raises(RecordingError, match="a spike in w_y") as error:
        check_streams(with_imu(r, rates=rates))
    assert error.value.line == row + 2


def test_samples_that_repeat_are_left_out_across_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """A log twice as fast as its sensor, cut into pieces anywhere."""
    r = recording()
    half = np.arange(r.imu.stamps_ns.size) // 2 * 2
    doubled = with_imu(r, rates=r.imu.rates[half], accelerations=r.imu.accelerations[half])
    kept = []
    for piece in (601, 4000):
        monkeypatch.setattr(module, "PIECE", piece)
        kept.append(check_streams(doubled).imu.stamps_ns)
    np.testing.assert_array_equal(*kept)
    assert kept[0].size == r.imu.stamps_ns.size // 2 + 1  # what repeats at the very end may yet go on


def test_exact_rests_of_a_robot_are_no_frozen_poses() -> None:
    r = recording()
    still = r.reference.seconds < QUIET
    got = check_streams(
        with_poses(r, positions=np.where(still[:, None], r.reference.positions[0], r.reference.positions))
    )
    assert got.findings == ()
    assert got.reference.stamps_ns.size == r.reference.stamps_ns.size


def test_a_knock_that_rings_is_no_spike() -> None:
    r = recording()
    t = r.imu.seconds - 7.0
    ring = np.where(t >= 0.0, 30.0 * np.exp(-t / 0.02) * np.sin(2.0 * np.pi * 30.0 * t), 0.0)
    assert check_streams(with_imu(r, accelerations=r.imu.accelerations + ring[:, None])).findings == ()


def test_a_channel_that_turns_one_way_only_is_not_saturated_while_it_rests() -> None:
    r = recording(digits=1e-3)
    rates = np.abs(r.imu.rates) + 0.005
    assert check_streams(with_imu(r, rates=np.round(rates, 3))).findings == ()


@pytest.mark.parametrize("share", [0.5, 0.8, 0.95])
@pytest.mark.parametrize("digits", [0.0, 1e-3])
@pytest.mark.parametrize("channel", [0, 2])
def test_clipped_peaks_are_found(share: float, digits: float, channel: int) -> None:
    r = recording(noise=2e-4, digits=digits)
    rates = r.imu.rates.copy()
    limit = np.round(share * rates[:, channel].max(), 3)
    rates[:, channel] = np.minimum(rates[:, channel], limit)
    assert f"w_{'xyz'[channel]} is saturated: it stays at its largest value" in message(with_imu(r, rates=rates))


def test_without_a_reference_a_silent_channel_is_only_told() -> None:
    r = recording()
    rates = r.imu.rates.copy()
    rates[:, 1] = 0.0
    got = check_streams(replace(with_imu(r, rates=rates), reference=None))
    assert [str(f) for f in got.findings] == [
        "imu: dead channel: w_y (always 0) never changes; check the sensor and the columns, and record again"
    ]


@pytest.mark.parametrize(("length", "told"), [(1, "11.2 ms"), (9, "50.0 ms"), (11, ""), (200, "")])
def test_gaps_are_bridged_up_to_fifty_milliseconds(length: int, told: str) -> None:
    r = recording()
    keep = np.ones(r.imu.stamps_ns.size, dtype=bool)
    keep[1500 : 1500 + length] = False
    s = r.imu
    got = check_streams(
        with_imu(r, stamps_ns=s.stamps_ns[keep], rates=s.rates[keep], accelerations=s.accelerations[keep])
    )
    (finding,) = got.findings
    if told:
        assert finding.message.startswith(f"imu0: about {length} samples missing in 1 short gaps")
    else:
        assert (
            finding.message
            == f"imu0: {(length + 1) / RATE:.3f} s without samples after line 1501; the recording is split there"
        )


@pytest.mark.parametrize(("factor", "unit"), [(10**3, "us"), (10**6, "ms")])
@pytest.mark.parametrize("stream", ["imu", "reference"])
def test_stamps_of_other_units_are_recognised(stream: str, factor: int, unit: str) -> None:
    r = recording()
    part = getattr(r, stream)
    broken = replace(r, **{stream: replace(part, stamps_ns=part.stamps_ns // factor)})
    assert f"they look like [{unit}]" in message(broken)


def test_slow_poses_in_microseconds_show_by_their_length() -> None:
    r = recording()
    part = r.reference.part(slice(None, None, 40))
    broken = replace(r, reference=replace(part, stamps_ns=part.stamps_ns // 1000))
    assert "lasts 0.01" in message(broken)
    assert "they look like [us]" in message(broken)


def test_joints_at_other_stamps_are_told() -> None:
    r = recording()
    joints = JointAngles(
        r.reference.stamps_ns + 1, np.zeros((r.reference.stamps_ns.size, 6)), Path("run/joint0/data.csv")
    )
    (finding,) = check_streams(replace(r, joints=joints)).findings
    assert str(finding) == "joints: joint0: 960 of 960 poses have no joint angles of the same stamp"


def test_outliers_in_a_row_are_left_out_and_lines_stay_right() -> None:
    r = recording()
    p = r.reference.positions.copy()
    p[100] += 1.0
    p[200:203] -= 0.5
    got = check_streams(with_poses(r, positions=p))
    assert got.reference.stamps_ns.size == r.reference.stamps_ns.size - 4
    assert str(got.findings[0]).startswith("outliers: pose0: 4 of 960 poses jump away and back, by up to 1.73 m")
    p[700:] += 2.0
    assert "line 702: the pose leaps by 3.46 m" in message(with_poses(r, positions=p))


@pytest.mark.parametrize("repeats", [2, 3, 8])
def test_poses_logged_too_often_are_thinned_at_rest_too(repeats: int) -> None:
    r = recording(noise=0.0)
    held = np.arange(r.reference.stamps_ns.size) // repeats * repeats
    p, q = r.reference.positions[held], r.reference.quaternions[held]
    got = check_streams(with_poses(r, positions=p, quaternions=q))
    assert str(got.findings[0]).startswith("repeats: pose0: ")
    assert got.reference.stamps_ns.size == pytest.approx(held.size / repeats, abs=repeats)
    assert np.median(np.diff(got.reference.seconds[got.reference.seconds < QUIET])) == pytest.approx(
        repeats / POSE_RATE
    )


numbers = st.floats(allow_nan=True, allow_infinity=True) | st.sampled_from([0.0, 1.0, 9.8, -9.8, 1e-300, 1e300])


@given(
    arrays(np.int64, 30, elements=st.integers(-(2**63), 2**63 - 1) | st.integers(0, 10**10)),
    arrays(float, (30, 6), elements=numbers),
    arrays(float, (30, 7), elements=numbers),
    st.booleans(),
)
def test_any_numbers_pass_or_raise_our_error(
    stamps: np.ndarray, readings: np.ndarray, poses: np.ndarray, ordered: bool
) -> None:
    if ordered:
        stamps = 500_000_000 * np.arange(30)
    imu = ImuSamples(stamps // 10 if ordered else stamps, readings[:, :3], readings[:, 3:], IMU)
    reference = ReferencePoses("pose0", stamps, poses[:, :3], poses[:, 3:], POSE)
    for r in (Recording(Path("run"), imu, reference), Recording(Path("run"), recording().imu, reference)):
        with suppress(RecordingError):
            check_streams(r)
