"""Poses of two devices in one log: positions that are held while attitudes change, or the other way round."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kreisel.recording.recording import ReferencePoses
from kreisel.validation.pose_checks import check_poses
from kreisel.validation.stamp_checks import Stamped

STEP, N = 20_000_000, 2000
T = 1e-9 * STEP * np.arange(N)
REST = slice(700, 1100)


def moved(t):
    """Return poses at 50 Hz of a motion by its own time (n,)."""
    p = np.sin(np.outer(t, [0.7, 0.9, 1.3]))
    q = Rotation.from_rotvec(0.4 * np.sin(np.outer(t, [0.8, 1.1, 1.7]))).as_quat(scalar_first=True)
    return ReferencePoses("pose0", 10**12 + STEP * np.arange(N), p, q, Path("run") / "pose0" / "data.csv")


@pytest.fixture(scope="module")
def poses() -> ReferencePoses:
    """Poses of a motion that never stops."""
    return moved(T)


def held(poses, part, every):
    number = np.arange(N)
    return replace(poses, **{part: getattr(poses, part)[number - number % every]})


def checked(poses):
    reference, warnings = check_poses(poses, Stamped(poses.stamps_ns, poses.source, "samples", 5.0, 20e3, None))
    return reference, [warning.message for warning in warnings if "held" in warning.message]


@pytest.mark.parametrize(("part", "name"), [("positions", "positions"), ("quaternions", "attitudes")])
def test_only_poses_with_new_values_are_used(poses, part, name):
    reference, (text,) = checked(held(poses, part, 5))
    assert f"{name} are held over 5 poses" in text
    np.testing.assert_array_equal(reference.stamps_ns, poses.stamps_ns[5::5])
    np.testing.assert_array_equal(reference.positions, poses.positions[5::5])
    np.testing.assert_allclose(reference.quaternions, poses.quaternions[5::5])


def test_of_a_rest_without_any_change_as_many_are_used(poses):
    rests = np.clip(np.arange(N) - REST.start, 0, REST.stop - REST.start)
    reference, said = checked(held(moved(T - 1e-9 * STEP * rests), "positions", 5))
    assert said
    inside = (reference.stamps_ns >= poses.stamps_ns[REST][0]) & (reference.stamps_ns <= poses.stamps_ns[REST][-1])
    assert np.count_nonzero(inside) == pytest.approx(400 / 5, rel=0.2)  # some of them only repeat the one before


def test_what_is_held_while_the_body_moves_on_is_not_used(poses):
    """A receiver that loses its satellites for two seconds."""
    whole = held(poses, "positions", 5)
    p = whole.positions.copy()
    p[400:500] = p[400]
    reference, said = checked(replace(whole, positions=p))
    assert said
    lost = (reference.stamps_ns > poses.stamps_ns[400]) & (reference.stamps_ns < poses.stamps_ns[500])
    assert not lost.any()


def test_few_digits_and_turns_about_a_point_are_not_held(poses):
    slow = replace(poses, positions=np.round(0.02 * poses.positions, 3))
    still = replace(poses, positions=np.zeros((N, 3)))
    for one in (poses, slow, still):
        reference, said = checked(one)
        assert not said
        assert reference.stamps_ns.size == N
