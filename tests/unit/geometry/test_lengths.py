"""Vectors in rows, beside NumPy's own norms and means."""

import numpy as np
import pytest

from kreisel.geometry.rotation import lengths, mean_row


@pytest.mark.parametrize("shape", [(3,), (7, 3), (2, 5, 3), (4, 2), (0, 3)])
def test_lengths_are_those_of_numpy(shape):
    vectors = np.random.default_rng(1).standard_normal(shape)
    np.testing.assert_allclose(lengths(vectors), np.linalg.norm(vectors, axis=-1), rtol=1e-15)


def test_the_mean_of_rows_is_that_of_numpy():
    values = 9.8 + np.random.default_rng(2).standard_normal((1000, 3))
    np.testing.assert_allclose(mean_row(values), values.mean(axis=0), rtol=1e-14)
    np.testing.assert_array_equal(mean_row(np.zeros((0, 3))), np.zeros(3))
