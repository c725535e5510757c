"""Means of functions over samples, beside means of their values sample by sample."""

import numpy as np

from kreisel.refinement.sample_groups import SampleGroups


def test_means_between_samples_are_those_of_all_values_there():
    rng = np.random.default_rng(3)
    stamps = 0.0025 * np.arange(200_003)  # more groups than are computed together, and a shorter last one
    groups = SampleGroups.of(stamps)
    of_group = rng.standard_normal((groups.count, 3))
    first = np.sort(rng.integers(0, stamps.size, 400))
    last = np.minimum(first + rng.integers(0, 700, 400), stamps.size)
    each = np.repeat(of_group, np.diff(np.append(groups.begin, stamps.size)), axis=0)
    expected = [each[a:b].mean(axis=0) if b > a else np.zeros(3) for a, b in zip(first, last, strict=True)]
    np.testing.assert_allclose(groups.mean(of_group.__getitem__, first, last), expected, atol=1e-11)
