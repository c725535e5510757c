"""The total of an account: a sum of covariances, in any order, that leaves the estimator's own as it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kreisel.errors import EstimationError
from kreisel.estimation.belief import Belief
from kreisel.estimation.uncertainty import Contribution, along, each, scaling, total
from kreisel.estimation.uncertainty_budget import Source

DEGREES = 6


def made(rng, cause, columns):
    scale = 10.0 ** rng.uniform(-6.0, 3.0, size=(DEGREES, 1))
    return Contribution(cause, Source.MISFIT, scale * rng.normal(size=(DEGREES, columns)))


@given(st.integers(0, 2**32 - 1), st.integers(0, 5))
def test_the_order_of_contributions_does_not_matter(seed, count):
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-6.0, 3.0, size=(DEGREES, 1))
    belief = Belief(np.zeros(DEGREES), scale * np.linalg.cholesky(np.cov(rng.normal(size=(DEGREES, 20)))))
    account = [made(rng, str(i), int(rng.integers(1, 9))) for i in range(count)]
    want = belief.covariance + sum((one.covariance for one in account), np.zeros((DEGREES, DEGREES)))
    size = np.sqrt(np.outer(np.diag(want), np.diag(want)))
    for order in (account, account[::-1], [account[i] for i in rng.permutation(count)]):
        np.testing.assert_allclose(total(belief, order).covariance / size, want / size, atol=1e-12)


def test_without_contributions_the_total_is_the_estimators_own():
    belief = Belief(np.zeros(DEGREES), np.eye(DEGREES))
    assert total(belief, []) is belief


@pytest.mark.parametrize("factor", [1.0, 1.5, 30.0])
def test_a_factor_on_deviations_as_a_contribution(factor):
    root = np.tril(np.random.default_rng(1).normal(size=(DEGREES, DEGREES)))
    more = scaling("correlated innovations", Source.PATH, root, factor)
    both = total(Belief(np.zeros(DEGREES), root), [more])
    np.testing.assert_allclose(both.covariance, factor**2 * root @ root.T, rtol=1e-12, atol=1e-13)


def test_errors_of_one_part():
    part = slice(1, 4)
    np.testing.assert_array_equal(along(DEGREES, part, [1.0, -2.0, 3.0]).T, [[0.0, 1.0, -2.0, 3.0, 0.0, 0.0]])
    one = Contribution("walk", Source.SENSOR, each(DEGREES, part, 0.5))
    np.testing.assert_array_equal(one.variance, [0.0, 0.25, 0.25, 0.25, 0.0, 0.0])
    np.testing.assert_array_equal(one.covariance, np.diag(one.variance))


def test_what_is_not_finite_is_no_contribution():
    with pytest.raises(EstimationError, match="the uncertainty by 'walks' is not a finite number"):
        Contribution("walks", Source.MISFIT, np.array([[1.0], [np.nan]]))
