"""Lines of vibrations are found at their frequency and size, and taken out without taking noise along."""

import numpy as np
import pytest

from kreisel.inertial.allan import noise_figures
from kreisel.inertial.lines import without_lines

RATE = 200.0


def white(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


def test_white_noise_and_walks_have_no_lines():
    for seed in range(20):
        values = white(20_000, seed)
        assert without_lines(values, 1.0 / RATE)[1] == ()
        assert without_lines(values + 0.02 * white(20_000, seed + 100).cumsum(axis=0), 1.0 / RATE)[1] == ()


@pytest.mark.parametrize("size", [0.1, 1.0, 100.0])
def test_a_line_is_found_and_the_noise_is_left(size):
    t = np.arange(120_000) / RATE
    wave = np.sqrt(2.0) * size * np.sin(2.0 * np.pi * 43.21 * t + 0.5 * np.sin(0.1 * t))
    noise = white(t.size, 7)
    left, found = without_lines(noise + np.outer(wave, [0.0, 1.0, 0.0]), 1.0 / RATE)
    largest = max(found, key=lambda one: one.size)
    assert {one.axis for one in found} == {1}
    assert largest.frequency == pytest.approx(43.21, abs=0.02)
    assert largest.size == pytest.approx(size, rel=0.05 if size < 1.0 else 0.02)
    np.testing.assert_array_equal(left[:, [0, 2]], noise[:, [0, 2]])
    assert left[:, 1].std() == pytest.approx(1.0, abs=0.02)


def test_a_line_is_not_quantisation():
    """The Allan deviation of a line falls as that of quantisation does; without it the density is that of the noise."""
    t = np.arange(240_000) / RATE
    values = white(t.size, 8) + np.outer(np.sin(2.0 * np.pi * 43.0 * t), np.ones(3))
    quiet, _ = without_lines(values, 1.0 / RATE)
    found = noise_figures(quiet, 1.0 / RATE)
    assert not found.shown["quantisation"].any()
    np.testing.assert_allclose(found.density, RATE**-0.5, rtol=0.03)


def test_short_recordings_are_left_as_they_are():
    values = white(300, 9)
    left, found = without_lines(values, 1.0 / RATE)
    assert found == ()
    np.testing.assert_array_equal(left, values)
