"""The covariance of all places of a tray: places against another unit follow from it."""

from types import SimpleNamespace

import numpy as np

from kreisel.array.tray_places import covariance_of_units, places_of_units
from kreisel.calibration.device_axes import NAMES
from kreisel.geometry.rotation import exp, matrix, skew
from kreisel.inertial.sensor_model import SensorParameters


def unit(rng, name, share):
    turn = matrix(exp(rng.normal(size=3)))
    zero = np.zeros((1, 3))
    sensors = SensorParameters(
        turn @ (np.eye(3) + 0.01 * rng.normal(size=(3, 3))), zero, turn @ (np.eye(3) + 0.01 * rng.normal(size=(3, 3))),
        zero, 0.1 * rng.normal(size=3) + 0.001 * rng.normal(size=(3, 3)),
    )  # fmt: skip
    root = 1e-4 * rng.normal(size=(33, 33))
    fit = SimpleNamespace(names=NAMES, covariance=root @ root.T, by_motion=np.eye(33) + 0.1 * rng.normal(size=(33, 33)))
    return SimpleNamespace(
        name=name, share=np.full(2, share), fit=fit, calibration=SimpleNamespace(sensors=sensors)
    )  # fmt: skip


def test_places_against_another_unit_follow_from_the_covariance():
    rng = np.random.default_rng(5)
    units = [unit(rng, f"imu{k}", share) for k, share in enumerate((0.2, 0.3, 0.5))]
    root = 1e-3 * rng.normal(size=(33, 33))
    mean = SimpleNamespace(names=NAMES, covariance=root @ root.T, sensors=units[0].calibration.sensors)
    joint = covariance_of_units(mean, units)
    poses, covariance = places_of_units(units, joint)
    np.testing.assert_allclose(covariance, covariance.T)
    one, two = poses["imu1"], poses["imu2"]
    np.testing.assert_allclose(covariance[6:, 6:], two.covariance)

    C, apart = one.rotation, two.position - one.position
    J = np.zeros((6, 12))
    J[:3, :3], J[:3, 3:6], J[:3, 6:9] = -C.T, C.T @ skew(apart), C.T
    J[3:, 3:6], J[3:, 9:] = -C.T, C.T
    others = [units[1], units[0], units[2]]
    direct, _ = places_of_units(others, covariance_of_units(mean, others))
    np.testing.assert_allclose(C.T @ apart, direct["imu2"].position, atol=1e-12)
    np.testing.assert_allclose(J @ covariance @ J.T, direct["imu2"].covariance, rtol=1e-6, atol=1e-12)


def test_units_share_what_the_mean_errs_by():
    """Two units' parameters: own noise is independent, and what errors of the mean do to both is not."""
    rng = np.random.default_rng(6)
    units = [unit(rng, f"imu{k}", 0.25) for k in range(2)]
    root = 1e-3 * rng.normal(size=(33, 33))
    mean = SimpleNamespace(names=NAMES, covariance=root @ root.T, sensors=units[0].calibration.sensors)
    joint = covariance_of_units(mean, units)
    first, second = (one.fit.by_motion for one in units)
    np.testing.assert_allclose(joint[:33, 33:], first @ mean.covariance @ second.T, atol=1e-15)
    own = joint[:33, :33] - first @ mean.covariance @ first.T
    np.testing.assert_allclose(own, units[0].fit.covariance / 0.75, atol=1e-15)
    assert np.linalg.eigvalsh(joint)[0] > -1e-15
