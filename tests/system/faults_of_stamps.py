"""Recordings whose stamps or clocks are wrong, or that have gaps, and what is to be said of each."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kreisel.recording.recording import Recording

from .breaking import Break, between, handled, imu, poses, refused, samples


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


@refused("factors of", "another run")
def nothing_in_common(r):
    return samples(replace(r, reference=r.reference.part(between(r, 22.0, 99.0))), slice(4000))


@handled("have 16.9 s in common")
def half_in_common(r):
    return samples(replace(r, reference=r.reference.part(between(r, 8.0, 99.0))), slice(5000))


@handled("the clocks jumped by -19", "s after the first pose")
def clock_that_leaps(r):
    late = between(r, 20.0, 99.0)
    return poses(r, stamps_ns=r.reference.stamps_ns + 200_000_000 * late)


@handled("the clocks jumped by -199.", "s after the first pose")
def samples_lost_without_a_gap(r):
    s = r.imu.stamps_ns[: 8001 - 40]
    return imu(samples(r, np.r_[:3400, 3440:8001]), stamps_ns=s)


@refused("pose0/data.csv: the clocks of reference and IMU differ by -4.76 %", "2 %")
def clock_five_per_cent_off(r):
    s = r.reference.stamps_ns
    return poses(r, stamps_ns=s[0] + (s - s[0]) * 21 // 20)


def stamp(k: int, value: Callable[[np.ndarray], int]) -> Break:
    def change(r: Recording) -> Recording:
        stamps = r.imu.stamps_ns.copy()
        stamps[k] = value(stamps)
        return imu(r, stamps_ns=stamps)

    return change


@handled("order: imu0: 2 of 8001 samples were not in the order of their stamps, in 1 place, the first at line 4002")
def unsorted(r):
    return imu(r, stamps_ns=r.imu.stamps_ns[np.r_[:4000, 4001, 4000, 4002:8001]])


@refused("imu0/data.csv, line 4002: the stamp 1019995000000 occurs twice", "delete the duplicates")
def stamp_twice(r):
    return stamp(4000, lambda s: s[3999])(r)


@handled("repeated: imu0: 100 of 8101 samples are written twice, the first at", "repeated: pose0: 2 of")
def rows_written_twice(r):
    order = np.sort(np.r_[np.arange(8001), np.arange(1000, 1100)])
    poses = np.sort(np.r_[np.arange(r.reference.stamps_ns.size), 7, 9])
    return replace(samples(r, order), reference=r.reference.part(poses))


@handled("repeated: imu0: 8001 of 16002 samples are written twice")
def every_row_written_twice(r):
    return samples(r, np.repeat(np.arange(8001), 2))


@handled("order: imu0: 60 of 8001 samples", "in 10 places, the first at line 1002", "order: pose0: 40 of")
def packets_swapped(r):
    """Packets of three samples, or of two poses, that arrive after the next one."""
    order, turned = np.arange(8001), np.arange(r.reference.stamps_ns.size)
    for k in range(1000, 2000, 100):
        order[k : k + 6] = np.roll(order[k : k + 6], 3)
        turned[k : k + 4] = np.roll(turned[k : k + 4], 2)
    return replace(samples(r, order), reference=r.reference.part(turned))


@refused("imu0/data.csv, line 4002: stamps run backwards by 0.0475 s", "split the recording where the clock was reset")
def clock_set_back_a_little(r):
    """Samples then lie twice as densely over an interval: sorting them would be wrong."""
    return imu(r, stamps_ns=r.imu.stamps_ns - np.where(np.arange(8001) < 4000, 0, 52_500_000))


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
