"""Size of an arm's errors by probabilities that are made up."""

import numpy as np
import pytest

from kreisel.model.assumed_noise import PoseError
from kreisel.refinement.arm_size import most_likely_size, with_arm_size

from ...small_problem import small_problem, with_noise


@pytest.mark.parametrize("size", [0.4, 1.0, 1.3, 3.0, 20.0])
def test_the_most_likely_size_is_found(size):
    """Of a parabola in the logarithm as steep as data make it, whose prior is wide: its vertex."""
    assert most_likely_size(lambda s: -500.0 * np.log(s / size) ** 2) == pytest.approx(size, rel=0.01)


def test_sizes_beyond_all_that_are_tried_end_there():
    assert most_likely_size(lambda s: -100.0 * np.log(s / 1e-3) ** 2) == 0.25
    assert most_likely_size(lambda s: -100.0 * np.log(s / 1e4) ** 2) == 64.0


def test_data_that_say_nothing_leave_the_usual_size():
    assert most_likely_size(lambda _: 0.0) == 1.0


def test_frames_and_poses_err_by_more_and_never_by_less():
    noise = with_noise(small_problem(), frame_sd=(2e-3, 1e-3), pose_error=PoseError(4e-3, 3e-3, 2.0)).noise
    same = with_arm_size(noise, 0.2)
    assert same.frame_sd == noise.frame_sd
    assert same.pose_error == noise.pose_error
    larger = with_arm_size(noise, 3.0)
    assert larger.pose_error == PoseError(3.0 * 4e-3, 3.0 * 3e-3, 2.0)
    ratio = np.divide(larger.frame_sd, noise.frame_sd)
    assert ratio[0] == pytest.approx(ratio[1])
    assert ratio[0] > 3.0
