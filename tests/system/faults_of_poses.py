"""Recordings whose poses are wrong, or do not belong to the readings, and what is to be said of each."""

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import conjugate, exp, multiply
from kreisel.recording.recording import Recording

from .breaking import between, handled, poses, refused, simulated


@handled("pose0: of", "1 without a number (p_y = nan) (first: line 302)", "left out")
def not_a_number_in_a_position(r):
    p = r.reference.positions.copy()
    p[300, 1] = np.nan
    return poses(r, positions=p)


@handled("pose0: of", "1 without a number (q_w = inf) (first: line 302)", "left out")
def infinite_quaternion(r):
    q = r.reference.quaternions.copy()
    q[300, 0] = np.inf
    return poses(r, quaternions=q)


@refused("pose0/data.csv, line 2: the quaternion has the length 1.5", "q_w, q_x, q_y, q_z", "normalise")
def quaternions_not_normalised(r):
    return poses(r, quaternions=1.5 * r.reference.quaternions)


@handled("1 with a quaternion of zeros", "(first: line 1002)", "left out")
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


@handled("poses are frozen, in one place, and then jump", "166 of 3326 poses were left out")
def frozen_poses(r):
    held = np.arange(r.reference.stamps_ns.size)
    held[between(r, 20.0, 22.0)] = held[between(r, 20.0, 22.0)][0]
    return poses(r, positions=r.reference.positions[held], quaternions=r.reference.quaternions[held])


@handled("poses only repeat the one before")
def log_faster_than_the_robot(r):
    held = np.arange(r.reference.stamps_ns.size) // 2 * 2
    return poses(r, positions=r.reference.positions[held], quaternions=r.reference.quaternions[held])


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
