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
from kreisel.geometry.rotation import apply, conjugate, exp, log, multiply
from kreisel.preparation.imu_noise import imu_noise_of, readings_of
from kreisel.recording import recording as module
from kreisel.recording.header import UNITS, HeaderUnits
from kreisel.recording.recording import ImuSamples, JointAngles, Recording, ReferencePoses
from kreisel.robot import description, kinematics
from kreisel.units import DEG, STANDARD_GRAVITY
from kreisel.validation.checks import check_streams
from kreisel.validation.joint_checks import angles_at
from kreisel.validation.stamp_checks import Stamped, check_rate

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
@pytest.mark.parametrize("piece", [600, module.CHUNK])
def test_a_sound_recording_passes_untouched(
    monkeypatch: pytest.MonkeyPatch, noise: float, digits: float, piece: int
) -> None:
    """Also one without any noise, whose readings repeat while it rests, and one with few digits."""
    monkeypatch.setattr(module, "CHUNK", piece)
    want = recording(noise, digits)
    got = check_streams(want)
    assert got.warnings == ()
    np.testing.assert_array_equal(got.imu.rates, want.imu.rates)
    np.testing.assert_array_equal(got.reference.positions, want.reference.positions)
    np.testing.assert_allclose(got.reference.quaternions, want.reference.quaternions, atol=1e-15)


@pytest.mark.parametrize("row", [5, 599, 600, 1100, 2395])
def test_a_fault_in_a_later_piece_keeps_its_place(monkeypatch: pytest.MonkeyPatch, row: int) -> None:
    monkeypatch.setattr(module, "CHUNK", 600)
    r = recording()
    rates = r.imu.rates.copy()
    rates[row, 1] += 5.0
    got = check_streams(with_imu(r, rates=rates))
    (warning,) = got.warnings
    assert warning.message.startswith(f"line {row + 2}: a spike in w_y")
    np.testing.assert_array_equal(got.imu.stamps_ns, np.delete(r.imu.stamps_ns, row))


@pytest.mark.parametrize("piece", [600, module.CHUNK])
def test_spikes_of_all_sizes_are_found_one_behind_the_other(monkeypatch: pytest.MonkeyPatch, piece: int) -> None:
    """Large spikes make small ones look usual."""
    monkeypatch.setattr(module, "CHUNK", piece)
    r = recording(noise=1e-3)
    rates = r.imu.rates.copy()
    spiked = np.arange(40, 2380, 60)
    rates[spiked, 2] += 10.0 ** np.linspace(0.0, 6.0, spiked.size)
    got = check_streams(with_imu(r, rates=rates))
    np.testing.assert_array_equal(got.imu.stamps_ns, np.delete(r.imu.stamps_ns, spiked))


def test_a_few_saturated_samples_are_left_out_and_break_the_motion() -> None:
    r = recording(noise=2e-4)
    rates = r.imu.rates.copy()
    limit = np.sort(rates[:, 0])[-6]
    cut_off = np.flatnonzero(rates[:, 0] >= limit)
    got = check_streams(with_imu(r, rates=np.minimum(rates, [limit, np.inf, np.inf])))
    assert set(r.imu.stamps_ns[cut_off]) <= set(got.imu.broken_ns)
    assert not set(got.imu.broken_ns) & set(got.imu.stamps_ns)
    assert "navigation starts anew after them" in got.warnings[0].message
    segments = readings_of(got, imu_noise_of(got)).segments
    edges = [got.imu.stamps_ns[stop] for _, stop in segments[:-1]]
    for stamp in got.imu.broken_ns:  # no segment contains one
        assert any(edge < stamp for edge in edges)
    assert 1 < len(segments) <= 1 + got.imu.broken_ns.size


def test_samples_that_repeat_are_left_out_across_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """A log twice as fast as its sensor, cut into pieces anywhere."""
    r = recording()
    half = np.arange(r.imu.stamps_ns.size) // 2 * 2
    doubled = with_imu(r, rates=r.imu.rates[half], accelerations=r.imu.accelerations[half])
    kept = []
    for piece in (601, 4000):
        monkeypatch.setattr(module, "CHUNK", piece)
        kept.append(check_streams(doubled).imu.stamps_ns)
    np.testing.assert_array_equal(*kept)
    assert kept[0].size == r.imu.stamps_ns.size // 2 + 1  # what repeats at the very end may yet go on


def test_exact_rests_of_a_robot_are_no_frozen_poses() -> None:
    r = recording()
    still = r.reference.seconds < QUIET
    got = check_streams(
        with_poses(r, positions=np.where(still[:, None], r.reference.positions[0], r.reference.positions))
    )
    assert got.warnings == ()
    assert got.reference.stamps_ns.size == r.reference.stamps_ns.size


@pytest.mark.parametrize(("broken", "samples", "said"), [
    (lambda size: np.full(size, 300.0), 3, ""),
    (lambda size: 300.0 * (-1.0) ** np.arange(size), 2, ""),
    (lambda size: np.random.default_rng(1).normal(200.0, 9.0, size), 12, "these are no readings of a motion"),
])  # fmt: skip
def test_broken_packets_are_left_out_and_are_not_taken_for_readings_that_wrap_round(broken, samples, said) -> None:
    r = recording(noise=2e-4)
    forces = r.imu.accelerations.copy()
    places = [700, 1400, 2100]
    for k in places:
        forces[k : k + samples, 0] = broken(samples)
    if said:
        assert said in message(with_imu(r, accelerations=forces))
        return
    got = check_streams(with_imu(r, accelerations=forces))
    left_out = np.concatenate([k + np.arange(samples) for k in places])
    np.testing.assert_array_equal(got.imu.stamps_ns, np.delete(r.imu.stamps_ns, left_out))
    assert [w.subject for w in got.warnings] == ["masked"]


def test_a_knock_that_rings_is_no_spike() -> None:
    r = recording()
    t = r.imu.seconds - 7.0
    ring = np.where(t >= 0.0, 30.0 * np.exp(-t / 0.02) * np.sin(2.0 * np.pi * 30.0 * t), 0.0)
    assert check_streams(with_imu(r, accelerations=r.imu.accelerations + ring[:, None])).warnings == ()


def test_a_channel_that_turns_one_way_only_is_not_saturated_while_it_rests() -> None:
    r = recording(digits=1e-3)
    rates = np.abs(r.imu.rates) + 0.005
    assert check_streams(with_imu(r, rates=np.round(rates, 3))).warnings == ()


def short_stops() -> np.ndarray:
    """Return rates (n, 3) that stop for 0.6 s every 8 s, of the same motion otherwise."""
    t = np.arange(0.0, 60.0, 0.02)
    moving = np.clip(np.abs((t % 8.0) - 4.0) - 0.3, 0.0, 0.8) / 0.8
    return moving[:, None] * np.column_stack([0.5 * np.sin(w * t) for w in (1.1, 1.7, 2.3)])


def with_coarse_gyros(rates: np.ndarray) -> Recording:
    rng = np.random.default_rng(8)
    forces = np.cumsum(rates, axis=0) * 0.02 + np.array([0.1, 0.2, 9.8]) + 0.01 * rng.normal(size=rates.shape)
    rates = 1e-3 * np.round((rates + 1e-4 * rng.normal(size=rates.shape)) / 1e-3)
    stamps = 20_000_000 * np.arange(len(rates))
    return replace(recording(), imu=ImuSamples(stamps, rates, forces, IMU), reference=None)


def test_a_coarse_gyro_does_not_look_stuck_where_nothing_moves() -> None:
    assert check_streams(with_coarse_gyros(short_stops())).warnings == ()


@pytest.mark.parametrize("channels", [[1], [0, 1, 2]])
def test_a_coarse_gyro_is_stuck_where_others_move(channels: list[int]) -> None:
    r = with_coarse_gyros(short_stops())
    stuck = r.imu.rates.copy()
    stuck[300:350, channels] = stuck[300, channels]
    warnings = check_streams(with_imu(r, rates=stuck)).warnings
    assert any(f"w_{'xyz'[channels[0]]} stays at" in str(warning) for warning in warnings)


@pytest.mark.parametrize("share", [0.5, 0.8, 0.95])
@pytest.mark.parametrize("digits", [0.0, 1e-3])
@pytest.mark.parametrize("channel", [0, 2])
def test_clipped_peaks_are_found(share: float, digits: float, channel: int) -> None:
    r = recording(noise=2e-4, digits=digits)
    rates = r.imu.rates.copy()
    limit = np.round(share * rates[:, channel].max(), 3)
    rates[:, channel] = np.minimum(rates[:, channel], limit)
    assert f"w_{'xyz'[channel]} is saturated: it stays at its largest value" in message(with_imu(r, rates=rates))


def test_a_channel_that_changes_in_spikes_alone_is_dead_where_the_sensor_was_moved() -> None:
    r = recording()
    rates = r.imu.rates.copy()
    rates[:, 1] = 0.0
    rates[[700, 1400], 1] = 5.0
    assert "w_y (always 0 but for 2 readings) never changes" in message(with_imu(r, rates=rates))
    at_rest = check_streams(replace(with_imu(r, rates=rates), reference=None))
    assert not [one for one in at_rest.warnings if "dead channel" in str(one)]


def test_without_a_reference_a_silent_channel_is_only_told() -> None:
    r = recording()
    rates = r.imu.rates.copy()
    rates[:, 1] = 0.0
    got = check_streams(replace(with_imu(r, rates=rates), reference=None))
    assert [str(f) for f in got.warnings] == [
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
    (warning,) = got.warnings
    if told:
        assert warning.message.startswith(f"imu0: about {length} samples missing in 1 short gaps")
    else:
        assert (
            warning.message
            == f"imu0: {(length + 1) / RATE:.3f} s without samples after line 1501; the recording is split there"
        )


@pytest.mark.parametrize(("factor", "unit"), [(10**3, "us"), (10**6, "ms")])
@pytest.mark.parametrize("stream", ["imu", "reference"])
def test_stamps_of_other_units_are_recognised(stream: str, factor: int, unit: str) -> None:
    r = recording()
    part = getattr(r, stream)
    broken = replace(r, **{stream: replace(part, stamps_ns=part.stamps_ns // factor)})
    assert f"they look like [{unit}]: write '#timestamp [{unit}]' into the header" in message(broken)


SIZES = UNITS["time"]
CONFUSED = [(a, b) for a in SIZES for b in SIZES if a != b and 1e-6 <= SIZES[a] / SIZES[b] <= 1e3]
"""Units stated and true; of others stamps repeat, or jump, and that is said first."""


@pytest.mark.parametrize("every", [1, 2, 5])
@pytest.mark.parametrize(("stated", "true"), CONFUSED)
@pytest.mark.parametrize("stream", ["imu", "reference"])
def test_one_unit_is_proposed_that_fits_all_whatever_the_header_says(
    stream: str, stated: str, true: str, every: int
) -> None:
    """Stamps that are in one unit and read in another, at rates at which the rate alone leaves two to choose from."""
    r = recording()
    s = r.imu
    r = with_imu(r, stamps_ns=s.stamps_ns[::every], rates=s.rates[::every], accelerations=s.accelerations[::every])
    part = getattr(r, stream)
    step = float(np.median(np.diff(part.stamps_ns))) * SIZES[stated] / SIZES[true]
    stamps = np.arange(part.stamps_ns.size) * round(step)
    broken = replace(part, stamps_ns=stamps, units=HeaderUnits(time=stated))
    said = message(replace(r, **{stream: broken}))
    assert f"the header says [{stated}], but they look like [{true}]: write '#timestamp [{true}]'" in said


def test_poses_may_come_more_often_at_rest_than_in_motion() -> None:
    steps = np.where(np.arange(400) % 100 < 80, 10_000_000, 500_000_000)
    poses = Stamped(np.cumsum(steps), Path("pose0/data.csv"), "poses", 0.01, 20e3, uneven=True)
    check_rate(poses)
    with pytest.raises(RecordingError, match="bursts"):
        check_rate(replace(poses, uneven=False))
    with pytest.raises(RecordingError, match="bursts"):  # 100 000 a second
        check_rate(replace(poses, stamps=np.cumsum(np.where(steps > 1e8, steps, 10_000))))


def test_rate_and_duration_propose_the_same() -> None:
    """Poses so slow that their rate is possible either way."""
    r = recording()
    part = r.reference.part(slice(None, None, 40))
    slow = replace(part, stamps_ns=part.stamps_ns // 1000, units=HeaderUnits(time="us"))
    assert "lasts 0.01" in message(replace(r, reference=slow))
    assert "the header says [us], but they look like [ms]" in message(replace(r, reference=slow))


@pytest.mark.parametrize("rate", [1.0 / 6.0, 1.0, 5.0, 19.2])
@pytest.mark.parametrize(("stated", "true"), [(None, None), ("ns", "us"), ("ms", "s"), ("us", "ms"), ("s", "ms")])
def test_the_unit_of_slow_poses_is_found_by_their_duration(rate: float, stated: str | None, true: str | None) -> None:
    """No rate of poses is too low by itself; what they last shows the unit."""
    r = recording()
    n = max(15, round(12.0 * rate))
    seconds = n / rate
    t = np.arange(0.0, seconds, 1.0 / RATE)
    rng = np.random.default_rng(3)
    wave = np.column_stack([np.sin(0.3 * t + k) for k in range(6)]) + 1e-3 * rng.normal(size=(t.size, 6))
    r = with_imu(r, stamps_ns=np.round(1e9 * t).astype(np.int64), rates=wave[:, :3],
                 accelerations=wave[:, 3:] + [0.1, 0.2, 9.8])  # fmt: skip
    tau = np.arange(n) / rate
    reference = ReferencePoses("pose0", np.round(1e9 * tau).astype(np.int64), course(tau), exp(course(tau)), POSE)
    if stated is None:
        assert check_streams(replace(r, reference=reference)).reference.stamps_ns.size == n
        return
    read = np.round(reference.stamps_ns * (UNITS["time"][stated] / UNITS["time"][true])).astype(np.int64)
    broken = replace(reference, stamps_ns=read, units=HeaderUnits(time=stated))
    assert f"they look like [{true}]: write '#timestamp [{true}]'" in message(replace(r, reference=broken))


def test_large_turns_between_slow_poses_are_no_outliers() -> None:
    """Once a second, a body has turned anywhere; that cannot be told from a false pose."""
    r = recording(noise=0.0)
    tau = np.arange(0.0, SECONDS, 1.0)
    turn = np.column_stack([np.zeros_like(tau), np.zeros_like(tau), np.where(np.arange(tau.size) % 3 == 1, 1.6, 0.0)])
    q = exp(turn + 1e-3 * tau[:, None])
    poses = ReferencePoses("pose0", np.round(1e9 * tau).astype(np.int64), course(tau + QUIET), q, POSE)
    got = check_streams(replace(r, reference=poses))
    assert got.reference.stamps_ns.size == tau.size
    assert not [w for w in got.warnings if w.subject == "outliers"]


@pytest.mark.parametrize("rate", [6.0, 19.2])
def test_slow_sensors_are_read(rate: float) -> None:
    r = recording()
    every = round(RATE / rate)
    s = r.imu
    slow = with_imu(r, stamps_ns=s.stamps_ns[::every], rates=s.rates[::every], accelerations=s.accelerations[::every])
    assert check_streams(slow).imu.stamps_ns.size == s.stamps_ns[::every].size


def test_stamps_that_no_unit_makes_right_are_not_given_one() -> None:
    r = recording()
    said = message(with_imu(r, stamps_ns=r.imu.stamps_ns // 50_000))
    assert "no unit of stamps fits their rate, their duration and pose0: check how the stamps are made" in said


def test_slow_poses_in_microseconds_show_by_their_length() -> None:
    r = recording()
    part = r.reference.part(slice(None, None, 40))
    broken = replace(r, reference=replace(part, stamps_ns=part.stamps_ns // 1000))
    assert "lasts 0.01" in message(broken)
    assert "they look like [us]" in message(broken)


def test_what_the_header_says_already_is_not_proposed() -> None:
    r = recording()
    far = with_poses(r, positions=1e3 * r.reference.positions)
    assert "they look like [mm]; write [mm] into the header" in message(far)
    assert message(with_poses(far, units=HeaderUnits(length="mm"))).endswith(
        "the header says [mm], but the numbers look 1000 times too large for it; correct the header or the numbers"
    )
    for factor, stated, likely in (
        (STANDARD_GRAVITY, "g", "they look like [m s^-2]"), (1e3, "g", "they look like [mg]"),
        (1e-3, "mg", "they look like [g]"), (1.0 / STANDARD_GRAVITY, "m/s^2", "they look like [g]"),
    ):  # fmt: skip
        other = factor if stated != "mg" else 1e-3
        wrong = with_imu(r, accelerations=other * r.imu.accelerations, units=HeaderUnits(acceleration=stated))
        assert f"the header says [{stated}], but {likely}; correct the header or the numbers" in message(wrong)


JOINT = Path("run/joint0/data.csv")
SMALL_ARM = (
    '<robot name="two"><link name="base"/><link name="upper"/><link name="lower"/>'
    '<joint name="a" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.4"/>'
    '<axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="2" effort="10"/></joint>'
    '<joint name="b" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.5 0 0"/>'
    '<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="2" effort="10"/></joint></robot>'
)


def armed(unit: float = 1.0, stated: str | None = None, size: float = 2.0, source: Path = JOINT) -> Recording:
    """Return a recording of an arm of two joints, its angles in some unit."""
    r = recording()
    angles = size * course(r.reference.seconds)[:, :2]
    p, q = kinematics.poses(description.parse_arm(SMALL_ARM), angles)
    joints = JointAngles(r.reference.stamps_ns, angles / unit, source, HeaderUnits(angle=stated))
    return replace(with_poses(r, positions=p, quaternions=q), joints=joints, urdf=SMALL_ARM)


def shifted(shift: int, keep: slice = slice(None)) -> Recording:
    r = armed()
    joints = replace(r.joints, stamps_ns=r.joints.stamps_ns[keep] + shift, angles=r.joints.angles[keep])
    return replace(r, joints=joints)


@pytest.mark.parametrize("shift", [1, 1000, -1000, 100_000])
def test_joints_whose_stamps_are_rounded_are_of_the_same_instant(shift: int) -> None:
    r = check_streams(shifted(shift))
    assert r.warnings == ()
    np.testing.assert_array_equal(angles_at(r.joints, r.reference.stamps_ns), r.joints.angles)


def test_joints_at_other_stamps_are_interpolated_and_it_is_said() -> None:
    r = check_streams(shifted(3_000_000))
    (warning,) = r.warnings
    assert str(warning) == "joints: joint0: 960 of 960 poses have no joint angles of the same stamp; interpolated there"
    between = angles_at(r.joints, r.reference.stamps_ns)[1:]
    share = 3.0 * POSE_RATE / 1000.0
    np.testing.assert_allclose(between, share * r.joints.angles[:-1] + (1.0 - share) * r.joints.angles[1:], atol=1e-12)
    (warning,) = check_streams(shifted(0, slice(None, None, 2))).warnings
    assert "480 of 960 poses" in str(warning)


def test_angles_in_degrees_are_converted_where_the_poses_prove_it() -> None:
    want, got = check_streams(armed()), check_streams(armed(DEG))
    assert want.warnings == ()
    np.testing.assert_allclose(got.joints.angles, want.joints.angles, rtol=1e-14)
    (warning,) = got.warnings
    assert str(warning) == (
        "joints: joint0: joint angles are in degrees, as the poses show, and were converted; write q_1 [deg] into the "
        "header"
    )
    (warning,) = check_streams(armed(DEG, source=Path("run.mcap/robot/joint_states"))).warnings
    assert "ROS messages are in rad" in str(warning)


def test_angles_in_degrees_that_the_header_says_are_radians_are_refused() -> None:
    said = message(armed(DEG, "rad"))
    assert said == (
        "run/joint0/data.csv, line 1: the poses fit the joint angles as degrees: joint angles look like degrees; the "
        "header says [rad]: correct it, or the numbers"
    )


@pytest.mark.parametrize("without", ["urdf", "reference", "frames"])
def test_angles_that_look_like_degrees_are_refused_where_nothing_proves_it(without: str) -> None:
    r = armed(DEG)
    moved = with_poses(r, positions=r.reference.positions + 0.1)
    said = message(moved if without == "frames" else replace(r, **{without: None}))
    assert "run/joint0/data.csv, line 1: joint angles reach" in said
    assert said.endswith("joint angles look like degrees; write q_1 [deg] into the header")


def test_angles_of_axes_without_end_are_no_degrees() -> None:
    r = armed()
    endless = r.joints.angles * [1.0, 100.0]
    for joints in (replace(r.joints, angles=endless), replace(r.joints, angles=100.0 * endless, source=Path("a/b"))):
        assert check_streams(replace(r, joints=joints, urdf=None)).warnings == ()


@pytest.mark.parametrize("seconds", [0.4, 1.1])
def test_markers_that_are_taken_for_each_other_while_the_body_moves_on_are_left_out(seconds: float) -> None:
    """A half turn of the body's axes and another point of it, until they are told apart again."""
    r = recording()
    p, q = (values.copy() for values in (r.reference.positions, r.reference.quaternions))
    own = slice(800, 800 + round(seconds * POSE_RATE))
    assert np.degrees(np.linalg.norm(log(multiply(conjugate(q[own.start]), q[own.stop])))) > (
        20.0 if seconds > 1 else 0
    )
    q[own] = multiply(q[own], exp(np.array([0.0, 0.2, 3.0])))
    p[own] = p[own] + apply(q[own], np.array([0.3, -0.1, 0.05]))
    got = check_streams(with_poses(r, positions=p, quaternions=q))
    assert got.reference.stamps_ns.size == r.reference.stamps_ns.size - (own.stop - own.start)
    assert "markers were taken for each other" in "".join(str(one) for one in got.warnings)


def test_a_frame_that_is_set_anew_and_turned_again_is_none_of_these() -> None:
    r = recording()
    q = r.reference.quaternions.copy()
    q[800:860] = multiply(q[800:860], exp(np.array([0.0, 0.2, 3.0])))
    q[860:] = multiply(q[860:], exp(np.array([2.0, 0.0, 0.0])))
    assert "the pose jumps by" in message(with_poses(r, quaternions=q))


def test_a_device_may_be_shaken_but_counts_are_no_accelerations() -> None:
    r = recording()
    t = r.imu.seconds
    hard = 60.0 * np.sin(2.0 * np.pi * 3.0 * t)[:, None] * np.array([0.0, 0.6, 0.8])
    check_streams(with_imu(r, accelerations=r.imu.accelerations + hard))
    assert "are they raw counts?" in message(with_imu(r, accelerations=6.0 * r.imu.accelerations))
    swapped = message(with_imu(r, rates=r.imu.accelerations, accelerations=r.imu.rates))
    assert "the rates seem to be in their columns" in swapped


def test_outliers_in_a_row_are_left_out_and_lines_stay_right() -> None:
    r = recording()
    p = r.reference.positions.copy()
    p[100] += 1.0
    p[200:203] -= 0.5
    got = check_streams(with_poses(r, positions=p))
    assert got.reference.stamps_ns.size == r.reference.stamps_ns.size - 4
    assert str(got.warnings[0]).startswith("outliers: pose0: 4 of 960 poses jump away and back, by up to 1.73 m")
    p[700:] += 2.0
    assert "line 702: the pose jumps by 3.46 m" in message(with_poses(r, positions=p))


@pytest.mark.parametrize("repeats", [2, 3, 8])
def test_poses_logged_too_often_are_thinned_at_rest_too(repeats: int) -> None:
    r = recording(noise=0.0)
    held = np.arange(r.reference.stamps_ns.size) // repeats * repeats
    p, q = r.reference.positions[held], r.reference.quaternions[held]
    got = check_streams(with_poses(r, positions=p, quaternions=q))
    assert str(got.warnings[0]).startswith("repeats: pose0: ")
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
