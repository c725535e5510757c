"""An elastic mount against derivatives of its path, which is written out here."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell, Imu
from kreisel.simulation.elastic_mount import ElasticMount

H = 1e-3
GRAVITY = np.array([0.0, 0.0, -9.81])
SECONDS = 12.0


def turned(t):
    angles = np.column_stack([0.9 * np.sin(1.3 * t), 0.7 * np.sin(0.9 * t + 1.0), 1.1 * np.cos(0.7 * t)])
    return Rotation.from_euler("xyz", angles)


def placed(t):
    return np.column_stack([0.3 * np.sin(2.0 * t), 0.2 * np.cos(1.7 * t), 0.25 * np.sin(1.1 * t)])


def motion_of(attitude, position, t):
    """Rate, its derivative, and specific force in b by differences of a path."""

    def rate(at):
        return (attitude(at - H).inv() * attitude(at + H)).as_rotvec() / (2.0 * H)

    acceleration = (position(t + H) - 2.0 * position(t) + position(t - H)) / H**2
    return rate(t), (rate(t + H) - rate(t - H)) / (2.0 * H), attitude(t).inv().apply(acceleration - GRAVITY)


def of_tool(t):
    return motion_of(turned, placed, t)


def quaternions(t):
    return turned(t).as_quat(scalar_first=True)


@pytest.fixture(scope="module")
def mount():
    return ElasticMount.draw(np.random.default_rng(5), Imu(mount_bending_sd=2e-4, mount_deflection_sd=2e-4))


def test_the_frame_moves_as_its_path_says(mount):
    t = np.linspace(1.0, SECONDS - 1.0, 400)
    some = np.linspace(0.0, SECONDS, 3000)
    C, force = turned(some).as_matrix(), of_tool(some)[2]
    one = np.broadcast_to(np.eye(3), C.shape)
    shifted = turned(some).apply(force @ mount.deflection.T)
    shifts = np.linalg.lstsq(np.dstack([one, C]).reshape(-1, 6), shifted.ravel(), rcond=None)[0]

    def attitude(at):
        return turned(at) * Rotation.from_rotvec((of_tool(at)[2] - force.mean(axis=0)) @ mount.bending.T)

    def position(at):
        own = of_tool(at)[2] @ mount.deflection.T - shifts[3:]
        return placed(at) + turned(at).apply(own) - shifts[:3]

    found = mount.moved(of_tool, quaternions, SECONDS)(t)
    rigid = of_tool(t)
    for own, path, without in zip(found, motion_of(attitude, position, t), rigid, strict=True):
        moved = np.abs(path - without).max()
        assert moved > 1e-3
        np.testing.assert_allclose(own, path, atol=0.02 * moved)


def test_a_mount_bends_by_torque(mount):
    """The torque of a force at an arm is across both, and a compliance is symmetric: the trace is zero."""
    assert np.trace(mount.bending) == pytest.approx(0.0, abs=1e-18)
    assert np.abs(mount.bending).max() > 1e-4


def test_a_rigid_mount_changes_nothing(tmp_path):
    assert ElasticMount.rigid().moved(of_tool, quaternions, SECONDS) is of_tool
    cells = [Cell.model_validate({"seed": 4, "seconds": 20.0, "imu": imu}) for imu in ({}, {"mount_bending_sd": 1e-4})]
    (_, plain), (truth, bent) = (simulate(cell, tmp_path) for cell in cells)
    np.testing.assert_array_equal(plain.reference.quaternions, bent.reference.quaternions)
    np.testing.assert_array_equal(plain.reference.positions, bent.reference.positions)
    assert truth.mount.bending.std() == pytest.approx(1e-4, rel=0.6)
    apart = bent.imu.rates - plain.imu.rates
    assert 1e-4 < apart.std() < 1e-2
