"""What the live page is told: quantities as the report has them, and the goals of whoever records."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from kreisel.calibration.result_sections import Measured, Timing
from kreisel.dashboard import online as of_online
from kreisel.dashboard.feed import Feed
from kreisel.dashboard.live_estimate import LiveEstimate
from kreisel.dashboard.live_goals import goals_of, write_goals
from kreisel.dashboard.live_quantities import quantities_of
from kreisel.dashboard.online import Targets
from kreisel.units import MM, MS

from ..calibration.example import calibration


def test_quantities_have_the_signs_and_units_of_the_report():
    own = replace(calibration().in_axes("imu"), timing=Timing(offset=0.02, offset_sd=1e-5))
    shown = quantities_of(own)
    assert set(own.derived) | {"position_x_mm", "position_y_mm", "position_z_mm", "time_offset_ms"} == set(shown)
    for name, one in own.derived.items():
        assert shown[name] == (one.value.tolist(), one.deviation.tolist())
    np.testing.assert_allclose(np.array(shown["accel_bias_mg"][0]) * 9.80665e-3, -own.sensors.k_a[0], rtol=1e-9)
    np.testing.assert_allclose(shown["position_y_mm"][0], own.sensors.lever_arms[1] / MM)
    assert shown["time_offset_ms"] == ([own.timing.offset / MS], [own.timing.offset_sd / MS])
    unknown = {**own.derived, "gyro_bias_deg_h": Measured(np.full(3, np.nan), np.full(3, np.nan))}
    assert set(shown) - set(quantities_of(replace(own, derived=unknown))) == {"gyro_bias_deg_h"}
    assert quantities_of(None) == {}


@pytest.mark.parametrize("file", ["run/recording.mcap", "run"])
def test_goals_are_beside_the_recording_and_reach_the_page(tmp_path, file):
    path = tmp_path / file
    goals = {"accelerometer.offset": 5e-4}
    assert goals_of(path) == {}
    assert not write_goals(path, goals)  # there is no such folder yet
    (tmp_path / "run").mkdir()
    assert write_goals(path, goals)
    assert goals_of(path) == goals
    assert goals_of(tmp_path / "run" / "another.mcap") == {}
    (tmp_path / "run" / "recording.mcap").write_bytes(b"")
    status = Feed(path).news()[-1]
    assert json.loads(json.dumps(status))["goals"] == goals


@pytest.mark.parametrize("text", ["", "[1]", '{"gyroscope.offset": "many"}', "null", "{"])
def test_a_damaged_file_of_goals_is_none(tmp_path, text):
    (tmp_path / "goals.json").write_text(text)
    assert goals_of(tmp_path) == {}


def test_targets_are_told_once_there_is_a_recording(tmp_path, monkeypatch):
    seen = []

    class Growing:
        def __init__(self, tail):
            self.tail = SimpleNamespace(begun=False)

        def look(self):
            seen.append(goals_of(tmp_path))
            self.tail.begun = len(seen) > 1
            targets.over = len(seen) > 3
            return LiveEstimate(1.0, ("timing.offset",), np.zeros(1), np.array([2e-4]), accepted=True, summary="so far")

    monkeypatch.setattr(of_online, "Online", Growing)
    monkeypatch.setattr(of_online.time, "sleep", lambda seconds: None)
    targets = Targets(tmp_path, {"timing.offset": 1e-3}, lambda text: None)
    targets.look()
    assert seen == [{}, {}, {"timing.offset": 1e-3}, {"timing.offset": 1e-3}]
    assert targets.reached
