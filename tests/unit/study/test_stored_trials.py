"""Trials on disk, their summary, and the map that spreads them: nothing lost, nothing counted twice."""

import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import SettingsError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.simulation.cell_settings import Cell
from kreisel.study.dask import dask_map
from kreisel.study.stored_trials import Results
from kreisel.study.summary import summarise
from kreisel.study.trial import Trial

NAMES = (*(f"accelerometer.offset[{i}]" for i in range(3)), "timing.offset")


def trial(number, scale=1.0, *, accepted=True, failure=""):
    rng = np.random.default_rng(number)
    sd = np.array([1e-4, 2e-4, 3e-4, 1e-5])
    error = scale * sd * rng.normal(size=4)
    names = () if failure else NAMES
    e, s = (np.empty(0), np.empty(0)) if failure else (error, sd)
    return Trial(number, names, e, s, float(np.sum((error / sd) ** 2)), 1.0, 0.9, accepted, 1.5, failure)


def same(a, b):
    assert (a.number, a.names, a.accepted, a.failure, a.nees) == (b.number, b.names, b.accepted, b.failure, b.nees)
    np.testing.assert_array_equal(a.error, b.error)
    np.testing.assert_array_equal(a.deviation, b.deviation)


def test_trials_come_back_as_they_were(tmp_path):
    results = Results(tmp_path, Cell(), CalibrationSettings())
    given = [trial(2), trial(0), trial(7, failure="no motion, nothing to see"), trial(1, accepted=False)]
    for one in given:
        results.add(one)
    again = Results(tmp_path, Cell(), CalibrationSettings())
    assert again.done == {0, 1, 2, 7}
    for back, one in zip(again.trials(), sorted(given, key=lambda t: t.number), strict=True):
        same(back, one)


@pytest.mark.parametrize("left", [1, 5, 20, 40, 90, 200])
def test_what_a_killed_study_left_half_done_is_dropped(tmp_path, left):
    """The files end anywhere in the last trial's rows: that trial runs again, all others stand."""
    results = Results(tmp_path, Cell(), CalibrationSettings())
    results.add(trial(0))
    whole = {name: (tmp_path / name).read_bytes() for name in ("trials.csv", "parameters.csv")}
    results.add(trial(1))
    rows = (tmp_path / "parameters.csv").read_bytes()
    cut = rows[: min(len(whole["parameters.csv"]) + left, len(rows))]
    (tmp_path / "parameters.csv").write_bytes(cut)
    (tmp_path / "trials.csv").write_bytes(whole["trials.csv"] + b"1,3.14")
    again = Results(tmp_path, Cell(), CalibrationSettings())
    assert again.done == {0}
    again.add(trial(1))
    again.add(trial(1))
    found = Results(tmp_path, Cell(), CalibrationSettings()).trials()
    assert [one.number for one in found] == [0, 1]
    for one in found:
        same(one, trial(one.number))


def test_another_study_is_refused(tmp_path):
    Results(tmp_path, Cell(), CalibrationSettings())
    with pytest.raises(SettingsError, match="another cell"):
        Results(tmp_path, Cell(seed=2), CalibrationSettings())
    with pytest.raises(SettingsError, match="other settings"):
        Results(tmp_path, Cell(), CalibrationSettings(update_interval=0.24))


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_summary_of_normal_errors(scale):
    """400 trials: the mean square of 1200 scores has a standard error of 4 per cent, its root one of 2."""
    summary = summarise([trial(k, scale) for k in range(400)])
    offset = next(g for g in summary.groups if g.title == "accelerometer offset")
    assert offset.ratio == pytest.approx(scale, rel=0.08)
    assert offset.ratio_bounds[0] < offset.ratio < offset.ratio_bounds[1]
    assert summary.consistent == (scale == 1.0)
    assert offset.coverage["68 %"] == pytest.approx(0.68 if scale == 1.0 else 0.383, abs=0.05)
    assert offset.coverage["95 %"] == pytest.approx(0.95 if scale == 1.0 else 0.673, abs=0.05)


def test_rejected_and_failed_trials_are_told():
    summary = summarise([trial(0), trial(1, accepted=False), trial(2, failure="why")])
    assert (summary.trials, summary.failed, summary.rejected) == (3, 1, 1)
    assert summarise([trial(0, failure="why")]) is None


def dying(folder, number):
    """Square a number; the first worker that is given 3 dies of it."""
    mark = Path(folder) / "dead"
    if number == 3 and not mark.exists():
        mark.touch()
        os._exit(1)
    return number * number


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # a worker that dies leaves its sockets to be collected
def test_a_worker_that_dies_takes_nothing_along(tmp_path):
    found = sorted(dask_map(partial(dying, str(tmp_path)), range(8), scheduler=None, workers=2))
    assert (tmp_path / "dead").exists()
    assert found == [k * k for k in range(8)]


def test_no_scheduler_answers(monkeypatch):
    monkeypatch.setattr("kreisel.study.dask._ANSWER", 1.0)
    with pytest.raises(SettingsError, match="no scheduler answers"):
        list(dask_map(abs, range(2), scheduler="tcp://127.0.0.1:9", workers=1))
