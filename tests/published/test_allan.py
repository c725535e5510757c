"""Overlapping Allan variances of an ADIS16405 at rest, as the SMAC group published them with their recording.

imudata, unit 1 (CC BY-NC-SA 4.0), 2.78 h at 100 Hz; `adis16405/README.md` beside the data.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from kreisel.inertial.allan import allan_deviation as own
from kreisel.inertial.allan import noise_figures

from ..oracle.allan import allan_deviation

FOLDER = Path(os.environ.get("KREISEL_DATA", Path(__file__).resolve().parents[3] / "shared")) / "allan" / "adis16405"
INTERVAL = 0.01  # s

pytestmark = pytest.mark.recordings


@pytest.fixture(scope="module")
def counts():
    if not FOLDER.is_dir():
        pytest.skip(f"no recording at {FOLDER}; set KREISEL_DATA to the folder that holds allan/")
    with np.load(FOLDER / "counts.npz") as data:
        return {"gyro": data["gyro"] * 0.05, "accel": data["accel"] * 0.00333}  # deg/s and g


@pytest.fixture(scope="module")
def published(counts):
    return np.genfromtxt(FOLDER / "published_allan_variance.csv", delimiter=",", skip_header=1)


@pytest.mark.parametrize(("sensor", "columns"), [("gyro", slice(1, 4)), ("accel", slice(4, 7))])
def test_all_published_variances(counts, published, sensor, columns):
    """Ten digits are printed; an independent implementation differs by 6e-6 of the value."""
    clusters = np.round(published[:, 0] / INTERVAL).astype(int)
    np.testing.assert_allclose(clusters * INTERVAL, published[:, 0], rtol=1e-9)
    found = allan_deviation(counts[sensor], INTERVAL, clusters) ** 2
    assert found.shape == (18, 3)
    np.testing.assert_allclose(found, published[:, columns], rtol=1e-5)
    np.testing.assert_allclose(own(counts[sensor], clusters) ** 2, published[:, columns], rtol=1e-5)


def test_angle_random_walk_read_off(counts):
    """2.45, 2.58 and 2.32 deg/sqrt(h): sixty times the deviation at 1 s, to the digits given and the other noises.

    Between 0.3 and 3 s the curve falls like 1 / sqrt(tau); its flicker and rounding are below 3 % of it there.
    """
    clusters = np.array([32, 64, 128, 256])
    found = allan_deviation(counts["gyro"], INTERVAL, clusters) * np.sqrt(clusters * INTERVAL)[:, None] * 60.0
    np.testing.assert_allclose(np.median(found, axis=0), [2.45, 2.58, 2.32], rtol=0.03)


def test_the_angle_random_walk_read_off(counts):
    """2.45, 2.58 and 2.32 deg/sqrt(h) in its README; the sensor filters, so that the line fits within a tenth only."""
    found = noise_figures(counts["gyro"], INTERVAL)
    np.testing.assert_allclose(60.0 * found.density, [2.45, 2.58, 2.32], rtol=0.08)
