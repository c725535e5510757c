"""Errors of known shape: each by its own formula, and without a linear part in what is recorded."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.inertial.sensor_model import linear_columns
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell, Unlisted
from kreisel.simulation.shaped_errors import of_poses, of_readings

T = np.arange(0.0, 20.0, 0.005)
RATES = np.column_stack([np.sin(T), 2.0 * np.cos(0.7 * T), 0.5 * np.sin(3.0 * T)])
FORCES = np.column_stack([9.0 * np.cos(0.3 * T), 4.0 * np.sin(0.5 * T), 2.0 + np.sin(T)])
KEYS = ("gyro_cubic", "accel_products", "scale_drift", "hysteresis", "dead_zone")


def shaped(**keys):
    return of_readings(Unlisted(**keys), np.random.default_rng(1), T, RATES, FORCES)


def test_a_cubic_term():
    gyro, accel = shaped(gyro_cubic=1e-3)
    np.testing.assert_allclose(np.abs(gyro), 1e-3 * np.abs(RATES) ** 3, rtol=1e-12)
    assert not accel.any()


def test_products_of_axes():
    _, accel = shaped(accel_products=1e-5)
    products = np.column_stack([FORCES[:, 1] * FORCES[:, 2], FORCES[:, 2] * FORCES[:, 0], FORCES[:, 0] * FORCES[:, 1]])
    coefficients, left, *_ = np.linalg.lstsq(products, accel, rcond=None)
    assert left.max() < 1e-20
    assert 1e-6 < np.abs(coefficients).max() < 5e-5


def test_scale_factors_that_drift():
    gyro, accel = shaped(scale_drift=1e-3)
    for value, own in ((gyro, RATES), (accel, FORCES)):
        np.testing.assert_allclose(np.abs(value[-1]), 0.5e-3 * np.abs(own[-1]), rtol=1e-12)
        np.testing.assert_allclose(value[0] * own[-1], -value[-1] * own[0], rtol=1e-9, atol=1e-15)


def test_a_play():
    """Within the play a follower stands; at a steady pace it is half the width behind."""
    gyro, _ = shaped(hysteresis=0.1)
    width = 0.05 * np.sqrt(np.mean(RATES**2, axis=0))
    assert np.abs(gyro).max(axis=0) == pytest.approx(width, rel=1e-9)
    rising = np.gradient(RATES[:, 1], T) > 1.0
    np.testing.assert_allclose(gyro[rising][20:, 1].max(), width[1], rtol=1e-9)


def test_a_dead_zone():
    gyro, _ = shaped(dead_zone=0.05)
    small = np.abs(RATES) < 0.05
    np.testing.assert_allclose((RATES + gyro)[small], 0.0, atol=1e-15)


def test_poses():
    p = np.column_stack([np.sin(T), np.cos(T), 0.1 * T])

    def of(**keys):
        return of_poses(Unlisted(**keys), np.random.default_rng(2), T, p)

    scaled = of(axis_scale=1e-3)
    np.testing.assert_allclose(scaled[:, 2], 1e-3 * (p[:, 2] - p[:, 2].mean()), atol=1e-15)
    assert not scaled[:, [1, 3, 4, 5]].any()
    tilted = of(base_tilt=1e-3)
    np.testing.assert_allclose(tilted[:, 3], -1e-3 * p[:, 1])
    np.testing.assert_allclose(tilted[:, :3], np.cross(tilted[:, 3:], p), atol=1e-15)
    jumped = of(reference_jump=0.01)
    assert len(np.unique(jumped[:, 0])) == 2
    drifted = of(reference_drift=1e-3)
    np.testing.assert_allclose(np.diff(drifted[:, 0]).std(), 1e-3 * 0.005**0.5, rtol=0.1)


@pytest.mark.parametrize("key", KEYS)
def test_nothing_linear_is_left(key):
    size = {"dead_zone": 5e-3, "accel_products": 1e-5}.get(key, 1e-3)
    cells = ({"seed": 3, "seconds": 30.0, "imu": {"noise": False}, "unlisted": own} for own in ({}, {key: size}))
    (_, plain), (_, other) = (simulate(Cell.model_validate(cell), Path("x")) for cell in cells)
    columns = linear_columns(plain.imu.rates, plain.imu.accelerations, np.gradient(plain.imu.rates, 0.005, axis=0))
    columns = columns[:, 1:7]  # readings themselves
    for after, before in ((other.imu.rates, plain.imu.rates), (other.imu.accelerations, plain.imu.accelerations)):
        change = after - before
        size_of_it = np.linalg.norm(change, axis=0).max()
        if size_of_it > 0.0:
            share = columns.T @ change / np.linalg.norm(columns, axis=0)[:, None]
            assert np.abs(share).max() < 0.02 * size_of_it
    assert (other.imu.rates != plain.imu.rates).any() or (other.imu.accelerations != plain.imu.accelerations).any()
