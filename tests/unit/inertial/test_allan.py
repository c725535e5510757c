"""Noise figures of readings at rest: of noises drawn, and of curves in closed form."""

import numpy as np
import pytest

from kreisel.inertial.allan import allan_deviation, noise_figures, usual_clusters
from kreisel.inertial.noise_figures import noise


def test_figures_of_drawn_noise_are_found():
    """Two hours at 50 Hz; the curve's long end has few independent parts: B and K within a third, N within 2 %."""
    n, rate = 360_000, 50.0
    found = noise_figures(noise(np.random.default_rng(2), n, rate, 1e-3, 3e-4, 2e-5), 1.0 / rate)
    np.testing.assert_allclose(np.mean(found.density), 1e-3, rtol=0.02)
    np.testing.assert_allclose(np.mean(found.instability), 3e-4, rtol=0.33)
    np.testing.assert_allclose(np.sqrt(np.mean(found.walk**2)), 2e-5, rtol=0.33)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
def test_white_noise_alone_has_hardly_anything_else(unit):
    found = noise_figures(unit * noise(np.random.default_rng(1), 100_000, 100.0, 1e-3, 0.0, 0.0), 0.01)
    np.testing.assert_allclose(found.density, unit * 1e-3, rtol=0.05)
    assert np.all(found.instability < 0.3 * unit * 1e-3)


def test_a_ramp_has_its_closed_form():
    """Of a ramp of slope s the Allan deviation is s tau / sqrt(2)."""
    t = 0.01 * np.arange(10_000)
    clusters = np.array([10, 100, 1000])
    found = allan_deviation(np.outer(t, [1.0, 2.0, 3.0]), clusters)
    np.testing.assert_allclose(found, np.outer(0.01 * clusters, [1.0, 2.0, 3.0]) / np.sqrt(2.0), rtol=1e-9)


def test_clusters_end_at_a_tenth():
    assert usual_clusters(100_000)[-1] == 10_000
    assert usual_clusters(100_000)[0] == 1
    assert np.all(np.diff(usual_clusters(1000)) > 0)
