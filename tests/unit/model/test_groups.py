"""The registry of parameter groups, and a group that is one entry in it."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model import groups
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.groups import REGISTRY, ParameterGroup, group_named
from kreisel.model.parameters import GROUPS, SENSOR_GROUPS, CellParameters, parameter_names

from ...navigation import corrected
from ...small_cell import simulate

DUMMY = ParameterGroup(
    "dummy_effect", "an effect that nothing uses", "d", "cell", "alignment.dummy",
    lambda _order, _joints: ("[0]", "[1]"),
    "1", 1.0, usual_sd=0.25,
)  # fmt: skip


def with_group(monkeypatch, dummy):
    """Add a group to the registry, after the last one of its owner, wherever it has been imported."""
    at = max((i for i, group in enumerate(REGISTRY) if group.owner == dummy.owner)) + 1
    registry = (*REGISTRY[:at], dummy, *REGISTRY[at:])
    meanings = {group.name: group.meaning for group in registry}
    for name, module in list(sys.modules.items()):
        if name.startswith("kreisel."):
            for attribute, value in (("REGISTRY", registry), ("GROUPS", meanings)):
                if hasattr(module, attribute):
                    monkeypatch.setattr(module, attribute, value)


@pytest.fixture
def with_dummy(monkeypatch):
    with_group(monkeypatch, DUMMY)
    return groups


@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize("joints", [0, 6])
def test_every_parameter_has_a_name_of_its_own(order, joints):
    names = [name for group in REGISTRY for name in group.names(order, joints)]
    assert len(set(names)) == len(names)
    for group in REGISTRY:
        assert group.degrees(order, joints) == len(parameter_names(group.name, order, joints))


def test_the_order_of_the_state():
    """Sensors first, gyros before accelerometers: the filter integrates in that order."""
    owners = [group.owner for group in REGISTRY]
    assert owners == sorted(owners, key=["gyroscope", "accelerometer", "cell", "reference", "robot"].index)


def test_stored_values_come_back():
    parameters = CellParameters(
        SensorParameters.ideal(2), np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.6, 0.8]), 9.81, 0.1, 1e-4, earth_down=0.5
    )
    values = {group.name: parameters.stored(group.name) for group in REGISTRY}
    again = CellParameters.from_stored(values)
    for group in REGISTRY:
        np.testing.assert_array_equal(again.stored(group.name), values[group.name])


def test_a_value_has_the_shape_of_its_group():
    for group in REGISTRY:
        if group.shape is not None:
            assert np.prod(group.shape(3)) == group.degrees(3, 0)


@pytest.mark.parametrize(
    ("owner", "name", "path"),
    [
        ("cell", "dummy_effect", "alignment.dummy"),
        ("gyroscope", "gyro_dummy", "gyroscope.dummy"),
        ("gyroscope", "warp", "gyroscope.dummy"),
        ("accelerometer", "accel_dummy", "accelerometer.dummy"),
    ],
)
def test_a_new_group_is_one_entry(monkeypatch, owner, name, path):
    """It is estimated, named, reported with its prior's deviation, and changes nothing else."""
    dummy = replace(DUMMY, owner=owner, name=name, path=path)
    with_group(monkeypatch, dummy)
    recording = simulate(np.random.default_rng(3), 40.0, Path("small"), imu_rate=100.0)[1]
    outcome = run_calibration(recording, CalibrationSettings())
    document, (tree, _) = outcome.calibration.document, path.split(".")
    assert document[tree]["dummy"] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert document["standard_deviation"][tree]["dummy"] == pytest.approx([0.25, 0.25], rel=1e-3)
    assert {f"{path}[0]", f"{path}[1]"} <= set(document["verdict"]["unobservable"])
    assert f"{path}[1]" in outcome.calibration.names
    gyro, sensor = (3 + 9 + (2 if owner == "gyroscope" else 0), 9 + 3 + 9 + (2 if owner == "accelerometer" else 0))
    assert (outcome.problem.gyro_degrees, outcome.problem.sensor_degrees) == (gyro, gyro + sensor)
    without = run_calibration(recording, CalibrationSettings(fixed=(name,)))
    assert "dummy" not in without.calibration.document[tree]
    sd = outcome.estimate.deviation
    for group in ("gyro_cross_coupling", "accel_offset", "lever_arms"):
        a, b = (one.estimate.run.parameters.stored(group) for one in (outcome, without))
        np.testing.assert_allclose(a, b, atol=1e-3 * sd[outcome.problem.layout[group]].min())


def test_a_value_of_a_new_group_is_kept(with_dummy):
    assert group_named("dummy_effect") is DUMMY
    parameters = CellParameters(SensorParameters.ideal(1), np.array([1.0, 0, 0, 0]), np.zeros(2), 9.8, 0.0, 0.0)
    stored = {name: parameters.stored(name) for name in (*(g.name for g in REGISTRY), "dummy_effect")}
    stored["dummy_effect"] = np.array([1.0, 2.0])
    moved = replace(CellParameters.from_stored(stored), skew=1e-3)
    np.testing.assert_array_equal(moved.stored("dummy_effect"), [1.0, 2.0])


@pytest.mark.parametrize("name", SENSOR_GROUPS)
def test_every_sensor_group_enters_the_corrections_outside_the_filter(name):
    """A group that only the filter knew would leave `Calibration.correct` wrong without a word."""
    rng = np.random.default_rng(0)
    w, a, alpha = rng.normal(size=(3, 20, 3))
    values = {g: group_named(g).nominal(2, 0) for g in GROUPS}
    values |= {g: np.eye(3).ravel() for g in ("gyro_cross_coupling", "accel_cross_coupling")}
    other = values | {name: values[name] + 0.1 * rng.normal(size=values[name].shape)}
    sensors = [CellParameters.from_stored(known).sensors for known in (values, other)]
    plain, changed = (corrected(np.arange(20.0), w, a, s, alpha) for s in sensors)
    assert any(np.abs(x - y).max() > 1e-3 for x, y in zip(plain, changed, strict=True))
