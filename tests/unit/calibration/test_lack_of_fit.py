"""Scatter of what parts of a recording say: against closed forms of linear regression, and against refits of parts."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.lack_of_fit import (
    degrees_of,
    lack_of_fit,
    lack_of_fit_disagreement,
    larger_deviations,
    scatter,
    within_subsets,
)
from kreisel.fitting.blocks import Blocks, increments
from kreisel.fitting.partition import block_ends
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.problem import part_of
from kreisel.refinement.iteration import estimate
from kreisel.refinement.noise_adaptation import StatedFigures
from kreisel.refinement.parameter_walk import with_walks

from ...small_problem import camera_problem

BLOCKS, ROWS, PARAMETERS = 40, 6, 3


@pytest.fixture(scope="module")
def designs():
    return np.random.default_rng(7).normal(size=(BLOCKS, ROWS, PARAMETERS))


def regression(designs, noise):
    """Return blocks of y = A x + noise about the estimate, its covariance, and its error; x = 0, unit noise assumed."""
    information = np.einsum("bri,brj->bij", designs, designs)
    P = np.linalg.inv(information.sum(axis=0))
    x = P @ np.einsum("bri,br->i", designs, noise)
    score = np.einsum("bri,br->bi", designs, noise - designs @ x)
    return Blocks(np.arange(PARAMETERS), np.arange(1, BLOCKS + 1), information, score), P, x


def test_where_the_model_is_right_the_scatter_is_what_is_expected(designs):
    rng, found = np.random.default_rng(0), []
    for _ in range(600):
        blocks, P, _ = regression(designs, rng.normal(size=(BLOCKS, ROWS)))
        lack = scatter(blocks, P)
        found.append(lack.influence.T @ lack.influence)
    mean, sd = np.mean(found, axis=0), np.std(found, axis=0) / 600**0.5
    assert (np.abs(mean - lack.expected) < 4.0 * sd).all()
    assert 0.6 * BLOCKS < lack.degrees <= BLOCKS


def test_degrees_of_freedom_are_those_of_a_sum_of_squares():
    """Of alike vectors their number times that of components; of others by draws, mean and variance."""
    np.testing.assert_allclose(degrees_of(np.tile(2.5 * np.eye(3), (7, 1, 1))), 21.0)
    rng = np.random.default_rng(5)
    roots = rng.normal(size=(4, 3, 3)) * np.array([3.0, 1.0, 0.3, 0.1])[:, None, None]
    drawn = np.einsum("bij,rbj->rbi", roots, rng.normal(size=(200_000, 4, 3)))
    sums = np.sum(drawn**2, axis=(1, 2))
    want = 2.0 * np.mean(sums) ** 2 / np.var(sums)
    np.testing.assert_allclose(degrees_of(roots @ np.swapaxes(roots, 1, 2)), want, rtol=0.02)
    assert degrees_of(np.zeros((4, 3, 3))) == 1.0


def test_where_blocks_err_each_in_its_own_way_it_is_the_variance_of_the_estimate(designs):
    """Each block has an error common to its rows, which the model lacks."""
    rng, found, errors = np.random.default_rng(1), [], []
    for _ in range(600):
        noise = rng.normal(size=(BLOCKS, ROWS)) + 2.0 * rng.normal(size=(BLOCKS, 1))
        blocks, P, x = regression(designs, noise)
        found.append(np.diag(scatter(blocks, P).found))
        errors.append(x**2)
    true, said = np.mean(errors, axis=0), np.mean(found, axis=0)
    assert (true > 1.3 * np.diag(P)).all()  # the model's own is too small
    np.testing.assert_allclose(said, true, rtol=0.25)


def test_blocks_that_say_nothing_scatter_not():
    empty = Blocks(
        np.arange(PARAMETERS), np.arange(1, 9), np.zeros((8, PARAMETERS, PARAMETERS)), np.zeros((8, PARAMETERS))
    )
    lack = scatter(empty, np.eye(PARAMETERS))
    assert lack.degrees == 1.0
    assert not lack.found.any()


def test_a_change_between_the_halves_is_no_scatter_within_them(designs):
    """A slip in the middle makes all blocks scatter; about what their own half says they do not."""
    rng, within, about = np.random.default_rng(3), [], []
    shift = np.where(np.arange(BLOCKS)[:, None] < BLOCKS // 2, 0.5, -0.5) * np.ones(PARAMETERS)
    for _ in range(200):
        noise = rng.normal(size=(BLOCKS, ROWS)) + np.einsum("brj,bj->br", designs, shift)
        blocks, P, _ = regression(designs, noise)
        lack = scatter(blocks, P)
        about.append(np.diag(lack.found) / np.diag(lack.expected))
        within.append(np.diag(within_subsets(lack, lack.blocks.ends <= BLOCKS // 2)) / np.diag(lack.expected))
    assert np.mean(about) > 2.0
    assert 0.8 < np.mean(within) < 0.6 * np.mean(about)


def test_increments_are_those_of_a_recursive_estimate(designs):
    noise = np.random.default_rng(2).normal(size=(BLOCKS, ROWS))
    wanted, _, x = regression(designs, noise)
    prior = np.eye(PARAMETERS)
    information = prior + np.concatenate([[0.0 * prior], np.cumsum(wanted.information, axis=0)])
    gradient = np.concatenate([np.zeros((1, PARAMETERS)), np.cumsum(np.einsum("bri,br->bi", designs, noise), axis=0)])
    means = np.linalg.solve(information, gradient[..., None])[..., 0]
    blocks = increments(wanted.parameters, wanted.ends, means - x, np.linalg.inv(information))
    np.testing.assert_allclose(blocks.information, wanted.information, atol=1e-9)
    np.testing.assert_allclose(blocks.score, wanted.score, atol=1e-9)


@pytest.fixture(scope="module")
def found():
    return estimate(camera_problem(), StatedFigures(reference=True, imu=True), KalmanFilter())


@pytest.mark.parametrize(("share", "counts"), [(0.1, True), (2.0, False)])
def test_offsets_that_hardly_walk_are_constant(found, share, counts):
    """By the walk over the recording, in deviations of the offset."""
    problem, deviation = found.problem, found.run.belief.standard_deviation
    part, stamps = problem.layout["gyro_offset"], problem.sensor.readings.stamps
    seconds = stamps[problem.schedule.updates[-1].last] - stamps[problem.schedule.updates[0].first]
    density = share * float(deviation[part].max()) * seconds**-0.5
    walking = with_walks(problem, problem.noise.offset_walk | {"gyro_offset": density})
    assert set(range(part.start, part.stop)) <= set(walking.constant(deviation).tolist()) or not counts
    assert counts or not set(range(part.start, part.stop)) & set(walking.constant(deviation).tolist())


def test_blocks_cover_a_recording_once(found):
    ends = block_ends(found.problem)
    assert ends == sorted(set(ends))
    assert ends[-1] == len(found.problem.schedule.updates)
    resting = {i + 1 for i, update in enumerate(found.problem.schedule.updates) if update.new_standstill}
    assert len(resting & set(ends)) >= len(ends) // 2


def test_a_short_recording_is_divided_into_enough_blocks_for_their_scatter(found):
    """Ten, but none is shorter than a second."""
    problem = found.problem
    stamps, updates = problem.sensor.readings.stamps, problem.schedule.updates
    times = stamps[np.array([update.last for update in updates])]
    for seconds, most in ((20.0, 10), (6.0, 6)):
        part = part_of(problem, slice(0, int(np.searchsorted(times, times[0] + seconds))))
        ends = np.array(block_ends(part))
        assert 0.7 * most <= ends.size <= most
        begins = np.append(0, ends[:-1] - 1)
        assert np.diff(times[begins]).min() >= max(1.0, 0.95 * seconds / 10.0)


def test_blocks_say_together_what_the_whole_says(found):
    """Their information and that of the prior is that of the fit; half of them move it to where a refit of it lies."""
    problem, constant = found.problem, found.problem.constant(found.run.belief.standard_deviation)
    ends = block_ends(problem)
    blocks = found.estimator.blocks(problem, found.run, ends)
    factor = found.run.belief.factor[constant]
    P = factor @ factor.T
    prior = np.zeros((len(problem.parameter_names),) * 2)
    for group in problem.groups:
        prior[problem.layout[group], problem.layout[group]] = problem.prior.covariance[group]
    stated = np.linalg.inv(prior)[np.ix_(constant, constant)]  # groups are independent
    together = np.linalg.inv(blocks.information.sum(axis=0) + stated)
    np.testing.assert_allclose(np.sqrt(np.diag(together)), np.sqrt(np.diag(P)), rtol=0.05)
    middle = len(ends) // 2
    half = found.estimator.refit(part_of(problem, slice(0, ends[middle - 1])), found.run)
    moved = problem.layout.minus(half.belief.mean[:, None], found.run.belief.mean)[constant, 0]
    own = np.linalg.inv(blocks.information[:middle].sum(axis=0) + stated)
    centre = problem.layout.minus(
        np.asarray(found.estimator.refit(problem, found.run).belief.mean)[:, None], found.run.belief.mean
    )[constant, 0]
    assert np.abs(centre / np.sqrt(np.diag(P))).max() < 0.1
    # the stated prior pulls by P_0^-1 (centre of the prior less the fit): at the fit, the opposite of all scores
    newton = own @ (blocks.score[:middle].sum(axis=0) - blocks.score.sum(axis=0))
    deviation = np.sqrt(np.diag(own))
    assert np.abs((newton - moved) / deviation).max() < 0.35
    assert np.sqrt(np.mean(((newton - moved) / deviation) ** 2)) < 0.1


@pytest.fixture(scope="module")
def lack(found):
    factor = found.run.belief.factor[found.problem.constant(found.run.belief.standard_deviation)]
    return scatter(found.estimator.blocks(found.problem, found.run, block_ends(found.problem)), factor @ factor.T)


def test_an_honest_cell_pays_nothing(found, lack):
    assert (larger_deviations(found, lack) == 1.0).all()
    assert (larger_deviations(found, None) == 1.0).all()
    assert lack_of_fit(found) is None  # less than a minute: too few parts


def test_scatter_beyond_chance_makes_deviations_larger(found, lack):
    factor = larger_deviations(found, replace(lack, found=9.0 * lack.expected))
    assert factor.max() == pytest.approx(3.0, rel=0.01)
    added = lack_of_fit_disagreement(found, factor)
    part = found.problem.layout["gyro_cross_coupling"]
    own = np.sum(found.as_noisy[part] ** 2, axis=1)
    np.testing.assert_allclose(added.contributions[0].variance[part], 8.0 * own, rtol=0.03)
    assert "gyro_cross_coupling 3.0" in added.warnings[0].message
