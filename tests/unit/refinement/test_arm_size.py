"""Size of an arm's errors by probabilities that are made up."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.model.assumed_noise import PoseError
from kreisel.refinement.arm_size import most_likely_size, with_arm_size, with_larger_frames

from ...small_problem import small_problem, with_noise


@pytest.mark.parametrize("size", [0.4, 1.0, 1.3, 3.0, 20.0])
def test_the_most_likely_size_is_found(size):
    """Of a parabola in the logarithm as steep as data make it, whose prior is wide: its vertex."""
    assert most_likely_size(lambda s: -500.0 * np.log(s / size) ** 2) == pytest.approx(size, rel=0.01)


def test_sizes_beyond_all_that_are_tried_end_there():
    assert most_likely_size(lambda s: -100.0 * np.log(s / 1e-3) ** 2) == 0.125
    assert most_likely_size(lambda s: -100.0 * np.log(s / 1e4) ** 2) == 64.0


def test_data_that_say_nothing_leave_the_usual_size():
    assert most_likely_size(lambda _: 0.0) == 1.0


ARM = PoseError(4e-3, 3e-3, 4.0, reached=0.5)
NOISE = with_noise(small_problem(), frame_sd=(2e-3, 1e-3), pose_error=ARM).noise


@pytest.mark.parametrize(("size", "frames"), [(0.2, 0.4), (0.7, 1.0), (3.0, 3.0)])
def test_quiet_gyros_show_the_errors_of_any_arm(size, frames):
    """In moves that reach half of all, errors of frames are twice those of poses, up to the usual ones."""
    found = with_arm_size(NOISE, size, 1e-6)
    assert (found.pose_error.position, found.pose_error.orientation) == pytest.approx((size * 4e-3, size * 3e-3))
    assert np.divide(found.frame_sd, NOISE.frame_sd) == pytest.approx(frames)


def test_noise_of_gyros_hides_small_errors_but_not_large_ones():
    """Over 4 s, gyros with 1e-4 rad/s/Hz^0.5 walk by 0.2 mrad; errors of 0.6 mrad may be hidden, of 9 mrad not."""
    assert with_arm_size(NOISE, 0.2, 1e-4) is NOISE
    assert with_arm_size(NOISE, 3.0, 1e-4).pose_error.orientation == pytest.approx(9e-3)


@pytest.mark.parametrize(
    ("before", "size", "frames"), [(1.0, 0.2, 1.0), (1.4, 1.2, 1.4), (0.4, 0.3, 0.6), (1.0, 3.0, 3.0)]
)
def test_a_later_look_at_the_size_makes_frames_larger_only(before, size, frames):
    """Errors of poses stay as they were."""
    taken = replace(NOISE, frame_sd=(before * 2e-3, before * 1e-3))
    found = with_larger_frames(taken, NOISE, size)
    assert np.divide(found.frame_sd, NOISE.frame_sd) == pytest.approx(frames)
    assert found.pose_error == taken.pose_error
