"""Recordings whose IMU readings are wrong, and what is to be said of each."""

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import apply, exp

from .breaking import between, handled, imu, poses, put, refused, rejected, samples, with_accelerations, with_rates

MIDDLE = 4000
"""A sample in the middle of a move."""


@handled("missing: imu0: of 8001 samples, 1 without a number (w_y = nan) (first: line 3002)", "left out")
def not_a_number(r):
    return with_rates(r, put((3000, 1), np.nan))


@handled("of 8001 samples, 2 without a number (a_z = -inf) (first: line 3002)", "left out")
def infinite(r):
    return with_accelerations(r, put((slice(3000, 3002), 2), -np.inf))


@refused(
    "imu0/data.csv, line 502: of 8001 samples, 2000 without a number (w_x = nan)", "25 % are missing, at most 20 %"
)
def too_much_without_numbers(r):
    return with_rates(r, put(slice(500, 2500), np.nan))


@refused("pose0/data.csv, line 2: of", "without a number (p_x = nan)", "100 % are missing")
def positions_without_numbers(r):
    return poses(r, positions=np.full_like(r.reference.positions, np.nan))


@refused("imu0/data.csv, line 4002: w_x = 1e+300", "not a possible reading")
def absurd_number(r):
    return with_rates(r, put((4000, 0), 1e300))


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


@handled("8 of which all accelerations are exactly zero (first: line 102)", "left out")
def lost_samples_filled_with_zeros(r):
    lost = slice(100, None, 1000)
    return with_accelerations(with_rates(r, put(lost, 0.0)), put(lost, 0.0))


@handled("masked: line 2002: a spike in a_x", "156.9", "this sample is left out")
def spike(r):
    return with_accelerations(r, put((2000, 0), 156.9))


@refused("imu0/data.csv, line 4: a spike in a_x", "156.9", "and in 199 more places", "delete")
def many_spikes(r):
    return with_accelerations(r, put((slice(2, None, 40), 0), 156.9))


@handled("masked: line", "w_x is saturated", "navigation starts anew after them")
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


@refused("imu0/data.csv, line 1", "gravity instead of specific force", "change the sign of all three", "left-handed")
def gravity_for_specific_force(r):
    return imu(r, accelerations=-r.imu.accelerations)


@refused("imu0/data.csv, line 1", "left-handed", "wrong sign")
def one_gyro_with_the_wrong_sign(r):
    return imu(r, rates=r.imu.rates * [1.0, -1.0, 1.0])


@refused("imu0/data.csv, line 1", "left-handed", "swapped")
def two_gyros_swapped(r):
    return imu(r, rates=r.imu.rates[:, [1, 0, 2]])


@refused("imu0/data.csv, line 1", "rotated by 180 deg", "-a_x lies along w_x", "same order")
def two_gyros_with_the_wrong_sign(r):
    return imu(r, rates=r.imu.rates * [-1.0, -1.0, 1.0])


@refused("imu0/data.csv, line 1", "left-handed", "-a_z lies along w_z")
def one_accelerometer_with_the_wrong_sign(r):
    return imu(r, accelerations=r.imu.accelerations * [1.0, 1.0, -1.0])


@refused("imu0/data.csv, line 1", "left-handed", "a_y lies along w_x, a_x lies along w_y")
def two_accelerometers_swapped(r):
    return imu(r, accelerations=r.imu.accelerations[:, [1, 0, 2]])


@refused("imu0/data.csv, line 1", "rotated by 121 deg", "same order")
def accelerometers_in_another_order(r):
    return imu(r, accelerations=r.imu.accelerations[:, [1, 2, 0]])


@refused("imu0/data.csv, line 1", "put rates first")
def accelerations_in_place_of_rates(r):
    return imu(r, rates=r.imu.accelerations, accelerations=r.imu.rates)


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


@handled("standard deviations contain", "as large as the poses show")
def mount_that_slips(r):
    """Of an arm of which nothing is stated: its poses may err as much, and deviations contain both mounts."""
    late = r.imu.seconds > 20.0
    turn = np.broadcast_to(exp(np.array([0.0, 0.02, 0.0])), (int(late.sum()), 4))
    r = with_rates(r, put(late, apply(turn, r.imu.rates[late])))
    return with_accelerations(r, put(late, apply(turn, r.imu.accelerations[late])))
