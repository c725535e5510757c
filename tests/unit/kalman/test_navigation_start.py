"""How uncertain navigation is where it starts: no more certain than the pose it starts at."""

from dataclasses import replace

import numpy as np

from kreisel.fitting.stored_state import navigation_deviations

from ...small_problem import camera_problem, small_problem, with_noise

PRECISE = {"attitude": 0.02, "velocity": 0.3, "position": 0.02}


def with_reference(problem, **size):
    return with_noise(problem, reference=replace(problem.noise.reference, **size))


def test_beside_an_arm_the_start_is_far_less_certain_than_the_pose():
    assert navigation_deviations(small_problem()) == PRECISE


def test_noise_of_poses_is_noise_of_the_start():
    problem = with_reference(small_problem(), position=0.1, orientation=0.03)
    found = navigation_deviations(problem)
    span = max(0.1, problem.reference.interval)
    expected = {"attitude": 0.09, "velocity": 3.0 * 2**0.5 * 0.1 / span, "position": 0.3}
    assert found.keys() == expected.keys()
    np.testing.assert_allclose(list(found.values()), list(expected.values()))
    assert navigation_deviations(with_reference(problem, orientation=1.0))["attitude"] == 0.2


def test_the_frame_of_positions_by_satellites_may_be_turned():
    """Turned by a degree, a place half a kilometre from the mean is nine metres away."""
    problem = with_noise(camera_problem(), volume_sd=1e-3)
    far = replace(problem, reference=replace(problem.reference, positions=500.0 * problem.reference.positions))
    extent = float(np.ptp(far.reference.positions, axis=0).max())
    found = navigation_deviations(far)
    assert np.isclose(found["position"], 0.05 * extent)
    assert found["velocity"] > PRECISE["velocity"]
    alone = replace(problem, reference=replace(problem.reference, positions=None))
    assert navigation_deviations(alone) == PRECISE
