"""What readings at rest show: as JSON, as a table of recording.toml, in words, on a page."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from kreisel.errors import RecordingError
from kreisel.inertial.noise_figures import noise, settings_table
from kreisel.preparation.resting_noise import allan_report, document_of, filter_figures
from kreisel.report.allan_page import COLUMNS, rows_of, write_allan

from ...small_problem import recorded

RATE = 20.0


def at_rest(seconds, seed=6, warm=0.0, flicker=1.0):
    recording = recorded()[1]
    rng, n = np.random.default_rng(seed), int(seconds * RATE)
    stamps = np.round(1e9 * np.arange(n) / RATE).astype(np.int64)
    rates = noise(rng, n, RATE, 1e-4, 3e-5 * flicker, 0.0) + warm * np.exp(-np.arange(n)[:, None] / (0.2 * n))
    forces = noise(rng, n, RATE, 1e-3, 3e-4 * flicker, 0.0) + np.array([0.0, 0.0, 9.8])
    imu = replace(recording.imu, stamps_ns=stamps, rates=rates, accelerations=forces)
    return replace(recording, imu=imu, reference=None, joints=None)


def test_an_hour_shows_white_noise_and_flicker(tmp_path):
    found = allan_report(at_rest(7200.0))
    document = document_of(found)
    gyro = document["gyroscope"]
    np.testing.assert_allclose(gyro["noise_density"], 1e-4, rtol=0.1)
    np.testing.assert_allclose(gyro["bias_instability"], 3e-5, rtol=0.4)
    assert gyro["quantisation"] == [None, None, None]
    assert gyro["standard_deviation"]["noise_density"][0] < 1e-5
    assert len(gyro["averaging_times"]) == len(gyro["allan_deviation"])
    table = tomllib.loads(settings_table(filter_figures(found)))["imu"]
    assert table["gyro_noise_density"] == pytest.approx(1e-4, rel=0.1)
    assert table["accel_random_walk"] > 0.0
    write_allan("rest", found, tmp_path / "allan.html")
    assert "Allan deviation" in (tmp_path / "allan.html").read_text(encoding="utf-8")
    assert all(len(row) == len(COLUMNS) for row in rows_of(found))


def test_what_the_length_cannot_show_is_null_and_said():
    found = allan_report(at_rest(120.0))
    document = document_of(found)
    assert document["gyroscope"]["bias_instability"] == [None, None, None]
    assert document["gyroscope"]["noise_density"][0] == pytest.approx(1e-4, rel=0.2)
    assert any("too short for bias instability and random walk" in remark for remark in found.remarks)
    assert "gyro_random_walk" not in document_of(allan_report(at_rest(120.0, flicker=0.0)))["filter"]


def test_a_single_reading_that_is_far_off_is_no_motion():
    quiet = at_rest(100.0)
    rates = quiet.imu.rates.copy()
    rates[500] += 1.0
    with pytest.raises(RecordingError, match="not at rest: single readings near (24|25) s are far off"):
        allan_report(replace(quiet, imu=replace(quiet.imu, rates=rates)))


def test_a_dead_axis_gaps_and_smoothed_readings_are_named():
    quiet = at_rest(600.0)
    rates = quiet.imu.rates.copy()
    rates[:, 1] = 1e-3
    rates[:, 0] = uniform_filter1d(rates[:, 0], 8)
    stamps = quiet.imu.stamps_ns + 50_000_000_000 * (np.arange(rates.shape[0]) > 5000)
    found = allan_report(replace(quiet, imu=replace(quiet.imu, rates=rates, stamps_ns=stamps)))
    assert any("readings are missing at 1 places, 50.1 s" in remark for remark in found.remarks)
    assert "gyroscope: y never changes: it has no noise figures" in found.remarks
    assert any(remark.startswith("gyroscope: x has less noise in short averages") for remark in found.remarks)
    document = document_of(found)
    assert document["gyroscope"]["noise_density"][1] is None
    assert document["filter"]["gyro_noise_density"] == pytest.approx(1e-4, rel=0.1)


def test_warming_up_is_said():
    found = allan_report(at_rest(3600.0, warm=1e-3))
    assert any("gyroscope: x, y, z changed from" in remark and "warms up" in remark for remark in found.remarks)


def test_what_is_short_or_moves_is_refused():
    with pytest.raises(RecordingError, match="lasts 10 s, expected 20 s or more at rest"):
        allan_report(at_rest(10.05))
    moving = at_rest(120.0)
    moving.imu.rates[1000:1100] += 0.1
    with pytest.raises(RecordingError, match="of the gyroscope are not at rest: near (49|54) s"):
        allan_report(moving)
