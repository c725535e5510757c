"""Random smooth errors: what they are orthogonal to, how large they are, and that each number gives one of its own."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.geometry.rotation import matrix
from kreisel.simulation import random_physics
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.situations import RANDOM, random_situation

from ...felt import run

SECONDS = 30.0


def waves(t):
    """Return a constant and slow half waves."""
    return np.cos(np.pi * np.linspace(0.0, 1.0, t.size)[:, None] * np.arange(17))


def cell(**tables):
    return run(SECONDS, seed=11, imu={"noise": False, "errors": False}, **tables)[1]


@pytest.fixture(scope="module")
def plain():
    return cell()


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_a_sensors_function_is_none_of_its_usual_model(sensor, plain, monkeypatch):
    """Gone are a constant, what is linear in readings, and what lever arms do; what is left is not small."""
    monkeypatch.setattr(random_physics, "_some", lambda rng, count: rng.choice(count - 2, size=2, replace=False))
    changed = cell(unlisted={sensor: 3})
    kind, other = ("rates", "accelerations") if sensor == "gyro" else ("accelerations", "rates")
    np.testing.assert_array_equal(getattr(changed.imu, other), getattr(plain.imu, other))
    added = getattr(changed.imu, kind) - getattr(plain.imu, kind)
    w, a, t = plain.imu.rates, plain.imu.accelerations, plain.imu.seconds
    alpha = np.gradient(w, t, axis=0)
    usual = np.column_stack([np.ones(t.size), w, a, alpha, w[:, 0] * w[:, 1], w[:, 2] ** 2])
    coefficients, *_ = np.linalg.lstsq(usual, added, rcond=None)
    rms = np.sqrt(np.mean(added**2))
    assert rms > 1e-6
    assert np.abs(usual @ coefficients).max() < 0.05 * rms  # filters and sampling leave some


def test_a_drift_alone_is_no_function_of_the_readings(plain, monkeypatch):
    monkeypatch.setattr(random_physics, "_some", lambda _rng, count: [count - 1])
    added = cell(unlisted={"gyro": 1}).imu.rates - plain.imu.rates
    slow = waves(plain.imu.seconds)
    left = added - slow @ np.linalg.lstsq(slow, added, rcond=None)[0]
    assert np.std(left) < 0.02 * np.std(added)
    assert np.abs(added.mean(axis=0)).max() < 0.01 * np.std(added)


def test_what_depends_on_the_past_shares_nothing_with_fast_readings(plain, monkeypatch):
    monkeypatch.setattr(random_physics, "_some", lambda _rng, count: [count - 2])
    added = cell(unlisted={"accel": 1}).imu.accelerations - plain.imu.accelerations
    fast, slow = np.column_stack([plain.imu.rates, plain.imu.accelerations]), waves(plain.imu.seconds)
    fast = fast - slow @ np.linalg.lstsq(slow, fast, rcond=None)[0]
    shared = fast @ np.linalg.lstsq(fast, added, rcond=None)[0]
    assert np.std(added) > 1e-4
    assert np.std(shared) < 0.05 * np.std(added)
    assert np.abs(added.mean(axis=0)).max() < 0.01 * np.std(added)


def test_a_references_function_moves_no_frame(plain):
    changed = cell(unlisted={"reference": 2})
    p, q = plain.reference.positions, plain.reference.quaternions
    added = changed.reference.positions - p
    C = matrix(q)
    tool, *_ = np.linalg.lstsq(
        np.vstack([np.column_stack([C[:, k], np.eye(3)[[k] * len(p)]]) for k in range(3)]),
        added.T.ravel(), rcond=None,
    )  # fmt: skip
    rms = np.sqrt(np.mean(added**2))
    assert 1e-5 < rms < 4e-3
    assert np.abs(tool).max() < 0.05 * rms


def test_a_clock_and_joints_change_the_poses_alone(plain):
    for unlisted in ({"clock": 1}, {"joints": 1}):
        changed = cell(unlisted=unlisted)
        np.testing.assert_array_equal(changed.imu.rates, plain.imu.rates)
        assert 1e-7 < np.abs(changed.reference.positions - plain.reference.positions).max() < 0.02


def test_every_number_is_a_situation_of_its_own():
    cells = [random_situation(number, 30.0) for number in range(1, 200)]
    assert len({str(one.cell) for one in cells}) > 100
    counts = [sum(one.cell["unlisted"].values()) for one in cells]
    assert (min(counts), max(counts)) == (1, 5)
    assert {one.name for one in cells} == {RANDOM}
    assert random_situation(7, 30.0) == random_situation(7, 30.0)
    for one in cells[:30]:
        Cell.model_validate(one.cell)
    _, recording = simulate(Cell.model_validate({**cells[0].cell, "seed": 1}), Path("random"))
    assert np.isfinite(recording.imu.rates).all()
