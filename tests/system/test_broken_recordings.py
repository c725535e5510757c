"""Recordings whose numbers are wrong: refused in one line that helps, rejected with reasons, or handled and told."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.formats.write import write, write_folder
from kreisel.geometry.rotation import apply, conjugate, exp, multiply
from kreisel.recording.recording import Recording
from kreisel.recording.settings import RecordingSettings

from .breaking import Break, Case, Command, assert_one_line, check, command, simulated

MIDDLE = 4000
"""A sample in the middle of a move."""

FAULTS: list[Case] = []


def refused(*words: str) -> Callable[[Break], Break]:
    return lambda fault: FAULTS.append(Case(fault, 1, words)) or fault


def rejected(*words: str) -> Callable[[Break], Break]:
    return lambda fault: FAULTS.append(Case(fault, 3, words)) or fault


def handled(*words: str) -> Callable[[Break], Break]:
    return lambda fault: FAULTS.append(Case(fault, 0, words)) or fault


@pytest.fixture
def kreisel(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    return command(monkeypatch, capsys)


# ---- faults of the numbers


def imu(r: Recording, **parts: object) -> Recording:
    return replace(r, imu=replace(r.imu, **parts))


def poses(r: Recording, **parts: object) -> Recording:
    return replace(r, reference=replace(r.reference, **parts))


def with_rates(r: Recording, change: Callable[[np.ndarray], object]) -> Recording:
    """Return the recording with rates that a function has changed in place."""
    rates = r.imu.rates.copy()
    change(rates)
    return imu(r, rates=rates)


def with_accelerations(r: Recording, change: Callable[[np.ndarray], object]) -> Recording:
    accelerations = r.imu.accelerations.copy()
    change(accelerations)
    return imu(r, accelerations=accelerations)


def put(index: object, value: object) -> Callable[[np.ndarray], None]:
    return lambda array: array.__setitem__(index, value)


def samples(r: Recording, keep: object) -> Recording:
    s = r.imu
    return imu(r, stamps_ns=s.stamps_ns[keep], rates=s.rates[keep], accelerations=s.accelerations[keep])


def between(r: Recording, low: float, high: float) -> np.ndarray:
    t = r.reference.seconds
    return (t > low) & (t < high)


@refused("imu0/data.csv, line 3002: w_y = nan", "delete these rows")
def not_a_number(r):
    return with_rates(r, put((3000, 1), np.nan))


@refused("imu0/data.csv, line 3002: a_z = -inf", "and in 1 more row", "delete these rows")
def infinite(r):
    return with_accelerations(r, put((slice(3000, 3002), 2), -np.inf))


@refused("imu0/data.csv, line 4002: w_x = 1e+300", "not a possible reading")
def absurd_number(r):
    return with_rates(r, put((4000, 0), 1e300))


@refused("pose0/data.csv, line 302: p_y = nan", "delete")
def not_a_number_in_a_position(r):
    p = r.reference.positions.copy()
    p[300, 1] = np.nan
    return poses(r, positions=p)


@refused("pose0/data.csv, line 302: q_w = inf", "delete")
def infinite_quaternion(r):
    q = r.reference.quaternions.copy()
    q[300, 0] = np.inf
    return poses(r, quaternions=q)


@refused("imu0/data.csv, line", "w_x is saturated", "0.6", "larger range")
def saturated_gyro(r):
    return with_rates(r, lambda w: np.clip(w[:, 0], -0.6, 0.6, out=w[:, 0]))


@refused("a_z is saturated", "larger range")
def saturated_accelerometer(r):
    return with_accelerations(r, lambda a: np.clip(a[:, 2], -9.0, 9.0, out=a[:, 2]))


@refused("is saturated", "larger range")
def saturated_gyro_of_few_digits(r):
    return imu(r, rates=np.round(np.clip(r.imu.rates, -0.6, 0.6) / 1e-3) * 1e-3)


@refused("wrapped round", "larger")
def wrapped_gyro(r):
    return imu(r, rates=(r.imu.rates + 0.6) % 1.2 - 0.6)


@rejected("not observable with this motion: gyroscope", "the data contradict the given noise figures")
def saturated_before_noise(r):
    noise = np.random.default_rng(5).normal(0.0, 1e-4, r.imu.rates.shape)
    return imu(r, rates=np.clip(r.imu.rates, -0.6, 0.6) + noise)


@handled(f"masked: line {MIDDLE + 3}: all readings are frozen for 60 samples", "59 samples are left out")
def frozen_samples(r):
    part = slice(MIDDLE, MIDDLE + 60)
    r = with_rates(r, put(part, r.imu.rates[MIDDLE]))
    return with_accelerations(r, put(part, r.imu.accelerations[MIDDLE]))


@handled(f"masked: line {MIDDLE + 3}: w_x stays at", "59 samples are left out, and the motion is bridged")
def frozen_channel(r):
    return with_rates(r, put((slice(MIDDLE, MIDDLE + 60), 0), r.imu.rates[MIDDLE, 0]))


@refused("line 5003: w_z stays at 0", "dead channel")
def gyro_that_dies(r):
    return with_rates(r, put((slice(5000, None), 2), 0.0))


@refused("imu0/data.csv: dead channel: a_y (always 0.3)", "check the sensor")
def dead_accelerometer(r):
    return with_accelerations(r, put((slice(None), 1), 0.3))


@refused("imu0/data.csv: dead channel: w_z (always 0.01)", "check the sensor")
def dead_gyro(r):
    return with_rates(r, put((slice(None), 2), 0.01))


@refused("w_z hardly changes")
def dead_gyro_with_noise(r):
    return with_rates(r, put((slice(None), 2), np.random.default_rng(8).normal(0.01, 1e-3, len(r.imu.rates))))


@refused("accelerometers work", "agree by")
def dead_accelerometer_with_noise(r):
    noise = np.random.default_rng(8).normal(0.3, 0.01, len(r.imu.rates))
    return with_accelerations(r, put((slice(None), 1), noise))


@refused("w_x and w_y hold the same numbers")
def column_written_twice(r):
    return imu(r, rates=r.imu.rates[:, [0, 0, 2]])


@refused("imu0/data.csv, line 102: all accelerations are exactly zero", "and in 7 more rows", "delete")
def lost_samples_filled_with_zeros(r):
    lost = slice(100, None, 1000)
    return with_accelerations(with_rates(r, put(lost, 0.0)), put(lost, 0.0))


@handled("masked: line 2002: a spike in a_x", "156.9", "this sample is left out")
def spike(r):
    return with_accelerations(r, put((2000, 0), 156.9))


@refused("imu0/data.csv, line 4: a spike in a_x", "156.9", "and in 199 more places", "delete")
def many_spikes(r):
    return with_accelerations(r, put((slice(2, None, 40), 0), 156.9))


@handled("masked: line", "w_x is saturated", "navigation starts anew behind them")
def saturated_peak(r):
    highest = np.sort(r.imu.rates[:, 0])[-5]
    return with_rates(r, lambda w: np.clip(w[:, 0], None, highest, out=w[:, 0]))


@refused("imu0/data.csv, line", "w_x stays at", "check the sensor")
def channel_often_stuck(r):
    def hold(w):
        for k in range(700, 7900, 400):
            w[k : k + 60, 0] = w[k, 0]

    return with_rates(r, hold)


@handled("samples only repeat the one before", "own rate")
def log_faster_than_the_sensor(r):
    held = np.arange(len(r.imu.rates)) // 2 * 2
    return imu(r, rates=r.imu.rates[held], accelerations=r.imu.accelerations[held])


@handled("samples only repeat the one before")
def driver_that_stalls(r):
    held = np.arange(len(r.imu.rates))
    for k in range(500, 7900, 400):
        held[k : k + 7] = k
    return imu(r, rates=r.imu.rates[held], accelerations=r.imu.accelerations[held])


@handled("about 5 samples missing in 1 short gaps", "bridged")
def short_gap(r):
    return samples(r, np.r_[:3400, 3405:8001])


@handled("short gaps", "bridged")
def one_sample_in_fifty_lost(r):
    return samples(r, np.random.default_rng(3).random(8001) > 0.02)


@handled("0.505 s without samples after line 3401; the recording is split there")
def long_gap(r):
    return samples(r, np.r_[:3400, 3500:8001])


@handled("10.005 s without samples after line 3001; the recording is split there")
def very_long_gap(r):
    return samples(r, np.r_[:3000, 5000:8001])


@handled("pose0: 1 gaps of up to 6.0", "without poses")
def gap_in_the_poses(r):
    return replace(r, reference=r.reference.part(~between(r, 18.0, 24.0)))


@refused("pose0/data.csv, line 2: the quaternion has the length 1.5", "q_w, q_x, q_y, q_z", "normalise")
def quaternions_not_normalised(r):
    return poses(r, quaternions=1.5 * r.reference.quaternions)


@refused("pose0/data.csv, line 1002: a quaternion of zeros", "delete these rows")
def zero_quaternion(r):
    q = r.reference.quaternions.copy()
    q[1000] = 0.0
    return poses(r, quaternions=q)


@handled("4 changes of sign")
def quaternions_change_sign(r):
    q = r.reference.quaternions.copy()
    q[1000:1100] *= -1.0
    q[2000] *= -1.0
    return poses(r, quaternions=q)


@refused("pose0/data.csv: the quaternions fit the gyros only when read as their conjugates", "change the sign of q_x")
def conjugated(r):
    return poses(r, quaternions=conjugate(r.reference.quaternions))


@refused("pose0/data.csv: the quaternions fit the gyros only when read scalar last", "put q_w first")
def scalar_last(r):
    return poses(r, quaternions=np.roll(r.reference.quaternions, -1, axis=1))


@refused("pose0/data.csv", "scalar last and conjugated", "correct the file")
def scalar_last_and_conjugated(r):
    return poses(r, quaternions=np.roll(conjugate(r.reference.quaternions), -1, axis=1))


@refused("imu0/data.csv, line 1", "57.1 times", "[deg s^-1]")
def degrees_per_second(r):
    return imu(r, rates=np.rad2deg(r.imu.rates))


@refused("imu0/data.csv, line 1", "angles per sample", "0.005 s")
def angles_per_sample(r):
    return imu(r, rates=r.imu.rates / 200.0)


@refused("imu0/data.csv, line 1", "9.807", "[g]")
def accelerations_in_g(r):
    return imu(r, accelerations=r.imu.accelerations / 9.80665)


@refused("imu0/data.csv, line 1", "was gravity removed")
def gravity_removed(r):
    return imu(r, accelerations=np.diff(r.imu.accelerations, axis=0, append=0.0))


@refused("pose0/data.csv, line 1", "m/s", "[mm]")
def millimetres(r):
    return poses(r, positions=1e3 * r.reference.positions)


@refused("pose0/data.csv, line 1", "times as far", "[cm]")
def centimetres(r):
    return poses(r, positions=1e2 * r.reference.positions)


@refused("pose0/data.csv", "times as far", "[in]")
def inches(r):
    return poses(r, positions=r.reference.positions / 0.0254)


@refused("pose0/data.csv: the positions move 1.0", "unit and scale")
def positions_a_tenth_too_large(r):
    return poses(r, positions=1.1 * r.reference.positions)


@refused("imu0/data.csv, line 1", "gravity instead of specific force", "Change the sign")
def gravity_for_specific_force(r):
    return imu(r, accelerations=-r.imu.accelerations)


@refused("imu0/data.csv, line 1", "left-handed", "wrong sign")
def one_gyro_with_the_wrong_sign(r):
    return imu(r, rates=r.imu.rates * [1.0, -1.0, 1.0])


@refused("imu0/data.csv, line 1", "left-handed", "swapped")
def two_gyros_swapped(r):
    return imu(r, rates=r.imu.rates[:, [1, 0, 2]])


@refused("imu0/data.csv, line 1", "turned by 180 deg", "-a_x lies along w_x", "same order")
def two_gyros_with_the_wrong_sign(r):
    return imu(r, rates=r.imu.rates * [-1.0, -1.0, 1.0])


@refused("imu0/data.csv, line 1", "left-handed", "-a_z lies along w_z")
def one_accelerometer_with_the_wrong_sign(r):
    return imu(r, accelerations=r.imu.accelerations * [1.0, 1.0, -1.0])


@refused("imu0/data.csv, line 1", "left-handed", "a_y lies along w_x, a_x lies along w_y")
def two_accelerometers_swapped(r):
    return imu(r, accelerations=r.imu.accelerations[:, [1, 0, 2]])


@refused("imu0/data.csv, line 1", "turned by 121 deg", "same order")
def accelerometers_in_another_order(r):
    return imu(r, accelerations=r.imu.accelerations[:, [1, 2, 0]])


@refused("imu0/data.csv, line 1", "put rates first")
def accelerations_in_place_of_rates(r):
    return imu(r, rates=r.imu.accelerations, accelerations=r.imu.rates)


@refused("pose0/data.csv", "belong to this run")
def reference_of_another_run(r):
    return replace(r, reference=simulated(2)[1].reference)


@refused("pose0/data.csv", "same body, run and frame")
def positions_of_another_run(r):
    return poses(r, positions=simulated(2)[1].reference.positions)


@refused("pose0/data.csv, line 1665: the pose jumps by", "another run", "split")
def second_half_of_another_run(r):
    second = between(r, 19.95, np.inf)[:, None]
    p = np.where(second, simulated(2)[1].reference.positions, r.reference.positions)
    return poses(
        r, positions=p, quaternions=np.where(second, simulated(2)[1].reference.quaternions, r.reference.quaternions)
    )


@refused("pose0/data.csv", "same body, run and frame")
def positions_in_another_frame(r):
    return poses(r, positions=r.reference.positions[:, [1, 0, 2]] * [1.0, -1.0, 1.0])


@refused("pose0/data.csv", "same body, run and frame")
def positions_mirrored(r):
    return poses(r, positions=r.reference.positions * [1.0, 1.0, -1.0])


@refused("imu0/data.csv, line 1", "frames are left-handed")
def left_handed_frames(r):
    q = r.reference.quaternions * [1.0, -1.0, -1.0, 1.0]
    return poses(r, positions=r.reference.positions * [1.0, 1.0, -1.0], quaternions=q)


@refused("factors of", "another run")
def nothing_in_common(r):
    return samples(replace(r, reference=r.reference.part(between(r, 22.0, 99.0))), slice(4000))


@handled("have 16.9 s in common")
def half_in_common(r):
    return samples(replace(r, reference=r.reference.part(between(r, 8.0, 99.0))), slice(5000))


@refused("pose0/data.csv", "belong to this run")
def poses_in_reverse_order(r):
    return poses(r, positions=r.reference.positions[::-1], quaternions=r.reference.quaternions[::-1])


@refused("pose0/data.csv: the reference does not move", "while it moves")
def constant_poses(r):
    first = np.zeros(r.reference.stamps_ns.size, dtype=int)
    return poses(r, positions=r.reference.positions[first], quaternions=r.reference.quaternions[first])


@handled("quaternions were interpolated through a change of sign", "left out")
def quaternions_interpolated_through_a_change_of_sign(r):
    q = r.reference.quaternions.copy()
    for k in (700, 1500, 2600):
        q[k:] *= -1.0
        share = np.linspace(0.0, 1.0, 6)[1:-1, None]
        q[k : k + 4] = (1.0 - share) * q[k - 1] + share * q[k + 4]
    return poses(r, quaternions=q)


@refused("pose0/data.csv: poses were taken at standstills only", "during the motion")
def poses_at_standstills_only(r):
    p = r.reference
    same = (np.diff(p.positions, axis=0) == 0.0).all(axis=1)
    still = np.append(same, False) & np.append(False, same)
    return poses(r, stamps_ns=p.stamps_ns[still], positions=p.positions[still], quaternions=p.quaternions[still])


@refused("pose0/data.csv, line 1670: the pose is frozen for 167 rows", "tracking was lost", "delete")
def frozen_poses(r):
    held = np.arange(r.reference.stamps_ns.size)
    held[between(r, 20.0, 22.0)] = held[between(r, 20.0, 22.0)][0]
    return poses(r, positions=r.reference.positions[held], quaternions=r.reference.quaternions[held])


@handled("poses only repeat the one before")
def log_faster_than_the_robot(r):
    held = np.arange(r.reference.stamps_ns.size) // 2 * 2
    return poses(r, positions=r.reference.positions[held], quaternions=r.reference.quaternions[held])


@refused("pose0/data.csv", "best correlation", "did the IMU move")
def motionless_imu(r):
    rng = np.random.default_rng(4)
    shape = r.imu.rates.shape
    return imu(r, rates=rng.normal(0.0, 6e-4, shape), accelerations=rng.normal([0.0, 0.0, -9.8], 0.014, shape))


@refused("pose0/data.csv: the motion is too poor", "gyro w_", "all three axes")
def turns_about_one_axis(r):
    size, t = np.linalg.norm(r.imu.rates, axis=1), r.imu.seconds
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (size[1:] + size[:-1]) * np.diff(t))])
    z = np.array([0.0, 0.0, 1.0])
    noise = np.random.default_rng(4).normal(0.0, 6e-4, r.imu.rates.shape)
    turned = exp(np.interp(r.reference.seconds + 0.05, t, angle)[:, None] * z)
    return poses(imu(r, rates=noise + size[:, None] * z), quaternions=turned)


@refused("imu0/data.csv: lasts 4.50 s", "record longer")
def too_short(r):
    return samples(replace(r, reference=r.reference.part(between(r, -1.0, 4.5))), slice(901))


@refused("pose0/data.csv: the motion is too poor", "all three axes")
def too_few_moves(r):
    return samples(replace(r, reference=r.reference.part(between(r, -1.0, 8.0))), slice(1600))


@rejected("gyroscope scale factors", "unit and range")
def gyros_twice_too_large(r):
    return imu(r, rates=2.0 * r.imu.rates)


@rejected("accelerometer scale factors")
def one_accelerometer_twice_too_large(r):
    return imu(r, accelerations=r.imu.accelerations * [1.0, 2.0, 1.0])


@rejected("the data contradict the given noise figures")
def mount_that_slips(r):
    late = r.imu.seconds > 20.0
    turn = np.broadcast_to(exp(np.array([0.0, 0.02, 0.0])), (int(late.sum()), 4))
    r = with_rates(r, put(late, apply(turn, r.imu.rates[late])))
    return with_accelerations(r, put(late, apply(turn, r.imu.accelerations[late])))


@handled("the clocks jumped by -19", "s after the first pose")
def clock_that_leaps(r):
    late = between(r, 20.0, 99.0)
    return poses(r, stamps_ns=r.reference.stamps_ns + 200_000_000 * late)


@handled("the clocks jumped by -200", "s after the first pose")
def samples_lost_without_a_gap(r):
    s = r.imu.stamps_ns[: 8001 - 40]
    return imu(samples(r, np.r_[:3400, 3440:8001]), stamps_ns=s)


@refused("pose0/data.csv: the clocks of reference and IMU differ by -4.76 %", "1 %")
def clock_five_per_cent_off(r):
    s = r.reference.stamps_ns
    return poses(r, stamps_ns=s[0] + (s - s[0]) * 21 // 20)


@refused("pose0/data.csv, line", "jump away", "markers")
def outliers_among_a_third_of_the_poses(r):
    return outliers(r, 0.3)


@handled("poses jump away and back", "left out")
def outliers_among_few_poses(r):
    return outliers(r, 0.05)


def outliers(r: Recording, share: float) -> Recording:
    rng = np.random.default_rng(7)
    out = rng.random(r.reference.stamps_ns.size) < share
    p, q = r.reference.positions.copy(), r.reference.quaternions.copy()
    p[out] += rng.normal(0.0, 0.3, (out.sum(), 3))
    q[out] = multiply(q[out], exp(rng.normal(0.0, 0.5, (out.sum(), 3))))
    return poses(r, positions=p, quaternions=q)


@refused("pose0/data.csv, line", "180 deg", "swapped markers")
def swapped_markers(r):
    q = r.reference.quaternions.copy()
    swapped = between(r, 15.0, 19.0)
    q[swapped] = multiply(q[swapped], np.array([0.0, 0.0, 0.0, 1.0]))
    return poses(r, quaternions=q)


# ---- faults of the stamps


def stamp(k: int, value: Callable[[np.ndarray], int]) -> Break:
    def change(r: Recording) -> Recording:
        stamps = r.imu.stamps_ns.copy()
        stamps[k] = value(stamps)
        return imu(r, stamps_ns=stamps)

    return change


@refused("imu0/data.csv, line 4003: stamps run backwards by 0.005 s", "sort the rows")
def unsorted(r):
    return imu(r, stamps_ns=r.imu.stamps_ns[np.r_[:4000, 4001, 4000, 4002:8001]])


@refused("imu0/data.csv, line 4002: the stamp 1019995000000 occurs twice", "delete the duplicates")
def stamp_twice(r):
    return stamp(4000, lambda s: s[3999])(r)


@handled("the IMU's clock was set after 20.0 s", "begin 0.005 s later")
def clock_set_back(r):
    return imu(r, stamps_ns=r.imu.stamps_ns - np.where(np.arange(8001) < 4000, 0, 5_000_000_000))


@handled("the IMU's clock was set after 20.0 s", "begin 0.005 s later")
def clock_set_ahead(r):
    return imu(r, stamps_ns=r.imu.stamps_ns + np.where(np.arange(8001) < 4000, 0, 86_400_000_000_000))


@refused("imu0/data.csv, line 4002: the stamp 9223372036854775807 ns is far from all others")
def stamp_at_the_end_of_64_bits(r):
    return stamp(4000, lambda _: 2**63 - 1)(r)


@refused("imu0/data.csv, line 1", "they look like [us]", "'#timestamp [us]'")
def microseconds(r):
    return imu(r, stamps_ns=r.imu.stamps_ns // 10**3)


@refused("imu0/data.csv, line 1", "they look like [ms]")
def milliseconds(r):
    return imu(r, stamps_ns=r.imu.stamps_ns // 10**6)


@refused("imu0/data.csv, line 3: 7960 of 8001 stamps repeat", "digits")
def whole_seconds(r):
    return imu(r, stamps_ns=r.imu.stamps_ns // 10**9)


@refused("pose0/data.csv, line 1", "they look like [us]")
def poses_in_microseconds(r):
    return poses(r, stamps_ns=r.reference.stamps_ns // 10**3)


@handled("a straight line through them is used instead")
def stamps_of_arrival(r):
    k = np.arange(8001)
    return imu(r, stamps_ns=r.imu.stamps_ns[k // 4 * 4] + 1_000_000 * (k % 4))


@pytest.mark.parametrize("case", FAULTS, ids=lambda case: case.name)
def test_a_broken_recording(case: Case, kreisel: Command, tmp_path: Path) -> None:
    truth, recording = simulated()
    write_folder(case.fault(recording), tmp_path / "run")
    ended = kreisel("calibrate", tmp_path / "run", "--no-validate", "--json")
    check(case, ended, truth)
    assert case.status != 1 or str(tmp_path / "run") in ended.err


BARE = ("positions", "two", "accelerometers", "many_spikes", "clock", "dead", "millimetres")


@pytest.mark.parametrize(
    "case",
    [case for case in FAULTS if case.status == 1 and case.name.startswith(BARE)],
    ids=lambda case: case.name,
)
def test_unknown_noise_hides_no_fault(case: Case, kreisel: Command, tmp_path: Path) -> None:
    truth, recording = simulated()
    write_folder(replace(case.fault(recording), settings=RecordingSettings()), tmp_path / "run")
    check(case, kreisel("calibrate", tmp_path / "run", "--no-validate", "--json"), truth)


@pytest.mark.parametrize("half", ["positions", "quaternions"])
def test_half_a_reference_is_used_or_refused(half: str, kreisel: Command, tmp_path: Path) -> None:
    write_folder(poses(simulated()[1], **{half: None}), tmp_path / "run")
    ended = kreisel("calibrate", tmp_path / "run", "--no-validate", "--json")
    assert ended.status in (0, 1, 3)
    assert "unexpected" not in ended.err
    assert "Traceback" not in ended.err


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (not_a_number, ("run.mcap/imu/data_raw: message 3001: w_y = nan", "delete these messages")),
        (zero_quaternion, ("run.mcap/robot/pose: message 1001", "delete these messages")),
        (dead_gyro, ("run.mcap/imu/data_raw: dead channel: w_z",)),
        (degrees_per_second, ("[deg s^-1]", "ROS messages are in rad/s")),
        (stamp_twice, ("run.mcap/imu/data_raw: message 4001: the stamp 1019995000000 occurs twice",)),
        (microseconds, ("they look like [us]", "messages' headers")),
    ],
)
def test_a_fault_in_a_bag(fault: Break, words: tuple[str, ...], kreisel: Command, tmp_path: Path) -> None:
    write(fault(simulated()[1]), tmp_path / "run.mcap")
    ended = kreisel("calibrate", tmp_path / "run.mcap")
    assert ended.status == 1
    assert_one_line(ended.err, words)
    assert ", line " not in ended.err


@pytest.mark.parametrize("name", ["info", "convert"])
def test_other_commands_refuse_alike(name: str, kreisel: Command, tmp_path: Path) -> None:
    write_folder(not_a_number(simulated()[1]), tmp_path / "run")
    target = [tmp_path / "copy"] if name == "convert" else []
    ended = kreisel(name, tmp_path / "run", *target)
    assert ended.status == 1
    assert_one_line(ended.err, ("line 3002",))
