"""All units of a batch: outcomes, outliers, the table, the file of results, and what is not done twice."""

import csv
import json
import sqlite3
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest

from kreisel.batch.batch_pages import write_batch, write_history
from kreisel.batch.capability import capabilities
from kreisel.batch.execution import Batch, calibrate_all, calibrate_one, one_after_another, waiting_in
from kreisel.batch.job_result import Run
from kreisel.batch.jobs import jobs_in, leaving
from kreisel.batch.lot import counts, devices, good, table, units_of
from kreisel.batch.result_store import Store
from kreisel.calibration.limits import Limits
from kreisel.calibration.result_sections import Measured, Verdict
from kreisel.errors import RecordingError
from kreisel.model.calibration_settings import CalibrationSettings

from ..calibration.example import calibration


def run(k: int, bias: float = 0.0, sd: float = 0.1, *, accepted: bool = True, error: str | None = None) -> Run:
    if error is not None:
        return Run(f"k{k}", f"u{k:03d}", f"{k}", "m", "t", None, error, None)
    own = replace(
        calibration(),
        derived={"accel_bias_mg": Measured(np.array([bias, 0.0, 1e-17]), np.full(3, sd))},
        verdict=Verdict(accepted, () if accepted else ("it does not fit",)),
    )
    return Run(f"k{k}", f"u{k:03d}", f"{k}", "m", "t", "2026-01-01", None, json.dumps(own.document))


LIMITS = Limits({"accel_bias_mg": (10.0,) * 3}, file="limits.toml")


def test_outcomes_and_yield():
    runs = [run(0, 1.0), run(1, 9.95), run(2, 12.0), run(3, accepted=False), run(4, error="no IMU")]
    units = units_of(runs, LIMITS)
    assert [unit.outcome for unit in units] == ["conforms", "no decision", "does not conform", "rejected", "failed"]
    assert counts(units) == dict.fromkeys(["conforms", "no decision", "does not conform", "rejected", "failed"], 1)
    assert good(units) == 1
    assert [unit.outcome for unit in units_of(runs, None)][:3] == ["accepted"] * 3
    assert good(units_of(runs, None)) == 3


def test_a_unit_far_from_its_lot_is_an_outlier():
    rng = np.random.default_rng(4)
    runs = [run(k, float(rng.normal())) for k in range(40)] + [run(40, 8.0)]
    units = units_of(runs, None)
    found = [unit.run.name for unit in units if unit.outliers]
    assert found == ["u040"]
    (outlier,) = units[40].outliers
    assert outlier.axis == 0
    values = [unit.run.parts.derived["accel_bias_mg"].value[0] for unit in units]
    middle = np.median(values)
    spread = 1.4826022 * np.median(np.abs(values - middle))
    assert outlier.score == pytest.approx((8.0 - middle) / np.hypot(spread, 0.1))
    # an unsure one is none
    unsure = [*runs[:40], run(40, 8.0, sd=3.0)]
    assert not any(unit.outliers for unit in units_of(unsure, None))
    # another type is another lot
    assert not units_of([*runs[:40], replace(runs[40], type="other")], None)[40].outliers


def test_a_good_lot_of_few_units_seldom_has_an_outlier():
    """4.5 robust deviations had named one in four lots of eight by three figures."""
    rng = np.random.default_rng(7)
    lots = [units_of([run(k, float(rng.normal()), 1e-3) for k in range(8)], None) for _ in range(100)]
    assert sum(any(unit.outliers for unit in lot) for lot in lots) <= 3
    far = units_of([run(k, 0.1 * k) for k in range(8)] + [run(8, 20.0)], None)
    assert [unit.run.name for unit in far if unit.outliers] == ["u008"]


def test_a_unit_that_is_calibrated_several_times_counts_once():
    runs = [replace(run(k, float(k % 3)), unit=f"{k % 3}") for k in range(9)]
    units = units_of([*runs, replace(run(9, 12.0), unit="2")], LIMITS)
    assert [unit.run.name for unit in devices(units)] == ["u006", "u007", "u009"]
    assert good(devices(units)) == 2
    assert capabilities(units, LIMITS) == []


def test_few_units_are_no_lot():
    assert not any(unit.outliers for unit in units_of([run(k, 100.0 * (k == 3)) for k in range(7)], None))


def test_the_table_has_every_digit():
    runs = [run(0, 0.1 + 0.2), run(1, error="a, b\nc")]
    rows = list(csv.DictReader(StringIO(table(units_of(runs, LIMITS)))))
    assert float(rows[0]["accel_bias_mg.x"]) == 0.1 + 0.2
    assert rows[0]["accel_bias_mg.z"] == "1e-17"
    assert rows[1]["error"] == "a, b\nc"
    assert rows[1]["accel_bias_mg.x"] == ""
    assert "mounting" not in table([])


def test_the_file_of_results_is_plain_sqlite(tmp_path):
    path = tmp_path / "results.db"
    with Store(path) as store:
        for k in range(3):
            store.add(run(k, float(k)))
        store.add(run(1, 7.0))  # replaced
        store.add(run(9, error="broken"))
        assert store.calibrated() == {"k0": True, "k1": True, "k2": True, "k9": False}
        assert [one.name for one in store.runs()] == ["u000", "u001", "u002", "u009"]
        assert [one.name for one in store.runs(["k2"])] == ["u002"]
        assert store.units() == ["0", "1", "2", "9"]
        assert store.of_unit("2") == [run(2, 2.0)]
    with sqlite3.connect(path) as connection:
        rows = connection.execute(
            "select name, value from runs join quantities using (key) where quantity = 'accel_bias_mg' and axis = 0 "
            "order by name"
        ).fetchall()
    assert rows == [("u000", 0.0), ("u001", 7.0), ("u002", 2.0)]


def test_a_locked_or_damaged_file_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("kreisel.batch.result_store._PATIENCE", 0.01)
    path = tmp_path / "results.db"
    with Store(path) as store:
        store.add(run(1))
        with sqlite3.connect(path) as other:
            other.execute("begin exclusive")
            with pytest.raises(RecordingError, match="cannot be written: database is locked"):
                store.add(run(2))
            other.rollback()
    for text in ("{", '{"schema": 1}', "[1]"):
        with sqlite3.connect(path) as other:
            other.execute("update runs set document = ?", (text,))
        with Store(path) as store, pytest.raises(RecordingError, match="in the file of results is damaged"):
            _ = store.runs()[0].parts


def test_another_file_is_not_overwritten(tmp_path):
    other = tmp_path / "other.db"
    with sqlite3.connect(other) as connection:
        connection.execute("create table mine (x)")
    with pytest.raises(RecordingError, match="version 0 of the file of results, expected 2"):
        Store(other)
    text = tmp_path / "text.db"
    text.write_text("hello " * 1000)
    with pytest.raises(RecordingError, match="cannot be used as a file of results"):
        Store(text)


def folder_of(tmp_path, names):
    for name in names:
        (tmp_path / "in" / name / "imu0").mkdir(parents=True)
        (tmp_path / "in" / name / "imu0" / "data.csv").write_text("x")
    return tmp_path / "in"


def test_recordings_are_found_at_any_depth_and_the_output_is_left_out(tmp_path):
    folder = folder_of(tmp_path, ["a", "lot/b", "lot/c", "out/results/a"])
    (folder / "d.mcap").write_bytes(b"")
    (folder / "notes.txt").write_text("")
    (folder / ".hidden").mkdir()
    found = jobs_in(folder, folder / "out", CalibrationSettings())
    assert [job.name for job in found] == ["a", "d.mcap", "lot/b", "lot/c"]
    assert len({job.key for job in found}) == 4
    again = jobs_in(folder, folder / "out", CalibrationSettings())
    assert again == found
    other = jobs_in(folder, folder / "out", CalibrationSettings(polynomial_order=2))
    assert not {job.key for job in found} & {job.key for job in other}
    (folder / "a" / "imu0" / "data.csv").write_text("xy")
    changed = jobs_in(folder, folder / "out", CalibrationSettings())
    assert [a.key == b.key for a, b in zip(found, changed, strict=True)] == [False, True, True, True]
    with pytest.raises(RecordingError, match="holds no recordings"):
        jobs_in(folder / "lot" / "b" / "imu0", tmp_path / "x", CalibrationSettings())
    with pytest.raises(RecordingError, match="no such folder"):
        jobs_in(tmp_path / "none", tmp_path / "x", CalibrationSettings())


def test_links_are_followed_once_and_names_tell_equal_recordings_apart(tmp_path):
    folder = folder_of(tmp_path, ["one/a", "two/a"])
    (folder / "one" / "up").symlink_to(folder)
    (folder / "linked").symlink_to(folder_of(tmp_path / "other", ["b"]))
    (folder / "one" / "a" / "loop").symlink_to(folder / "one" / "a")
    (folder / "broken").symlink_to(tmp_path / "nowhere")
    (folder / "day").mkdir()
    (folder / "day" / "loop").symlink_to(folder / "day")
    for name in ("x.mcap", "y.mcap"):
        (folder / "day" / name).write_bytes(b"")
    (folder / "split").mkdir()
    for name in ("bag_0.mcap", "bag_1.mcap"):
        (folder / "split" / name).write_bytes(b"")
    found = jobs_in(folder, tmp_path / "out", CalibrationSettings(), links=True)
    assert [job.name for job in found] == ["day/x.mcap", "day/y.mcap", "linked/b", "one/a", "split", "two/a"]
    assert len({job.key for job in found}) == 6
    within = jobs_in(folder, tmp_path / "out", CalibrationSettings())
    assert [job.name for job in within] == ["day/x.mcap", "day/y.mcap", "one/a", "split", "two/a"]
    assert leaving(folder) == ["broken", "linked"]


def test_a_folder_of_links_says_how_they_are_taken(tmp_path):
    folder = tmp_path / "links"
    folder.mkdir()
    (folder / "a").symlink_to(folder_of(tmp_path, ["a"]) / "a")
    with pytest.raises(RecordingError, match="links out of it are not followed without --links"):
        jobs_in(folder, tmp_path / "out", CalibrationSettings())


def test_a_result_whose_files_are_missing_is_made_again(tmp_path):
    jobs = jobs_in(folder_of(tmp_path, ["a", "b", "c"]), tmp_path / "out", CalibrationSettings())
    results = tmp_path / "results"
    with Store(tmp_path / "r.db") as store:
        for k, job in enumerate(jobs):
            store.add(replace(run(k, error="broken" if job.name == "b" else None), key=job.key))
        (results / "a").mkdir(parents=True)
        (results / "a" / "calibration.yaml").write_text("")
        batch = Batch(jobs, CalibrationSettings(), results, False)
        assert waiting_in(batch, store) == [2]
        assert waiting_in(replace(batch, reports=True), store) == [0, 2]


def test_what_is_done_is_not_done_again_and_a_failure_is_kept(tmp_path):
    folder = folder_of(tmp_path, ["a", "b"])
    jobs = jobs_in(folder, tmp_path / "out", CalibrationSettings())
    batch = Batch(jobs, CalibrationSettings(), tmp_path / "out" / "results", False)
    seen: list[str] = []
    with Store(tmp_path / "r.db") as store:
        runs = calibrate_all(batch, store, one_after_another, lambda one: seen.append(one.name))
        assert seen == ["a", "b"]
        assert all("has no header line" in (one.error or "") or "header" in (one.error or "") for one in runs)
        again = calibrate_all(batch, store, one_after_another, lambda one: seen.append(one.name))
        assert seen == ["a", "b"]
        assert again == runs


def test_pages_are_complete_and_escape_names(tmp_path):
    hostile = "<b>&"
    runs = [replace(run(k, float(k % 5)), name=hostile if k == 0 else f"u{k}") for k in range(12)]
    write_batch(units_of(runs, LIMITS), LIMITS, "lead", False, tmp_path / "batch.html")
    page = (tmp_path / "batch.html").read_text()
    assert "&lt;b&gt;&amp;" in page
    assert "<b>&<" not in page
    assert "12 of 12 units within all limits" in page
    from kreisel.batch.unit_history import history_of

    dated = [replace(one, date=f"20{10 + k}-05-01") for k, one in enumerate(runs)]
    found = history_of(hostile, dated, LIMITS)
    write_history(found, LIMITS, tmp_path / "history.html")
    assert "<h1>&lt;b&gt;&amp;</h1>" in (tmp_path / "history.html").read_text()


def test_repeated_runs_of_few_units_are_no_lot():
    runs = [replace(run(k, 5.0 * (k % 4)), unit=f"unit-{k % 4}") for k in range(12)]
    assert not any(unit.outliers for unit in units_of(runs, None))


def test_a_fault_of_the_program_ends_one_unit_and_not_the_batch(tmp_path, monkeypatch):
    for name in ("a", "b"):
        (tmp_path / "in" / name / "imu0").mkdir(parents=True)
        (tmp_path / "in" / name / "imu0" / "data.csv").write_text("x")

    def fault(path):
        raise ZeroDivisionError(f"in {path.name}")

    monkeypatch.setattr("kreisel.formats.loading.load", fault)
    settings = CalibrationSettings()
    batch = Batch(jobs_in(tmp_path / "in", tmp_path / "out", settings), settings, tmp_path / "out", reports=False)
    runs = [calibrate_one(batch, k) for k in range(2)]
    assert [one.error for one in runs] == ["unexpected ZeroDivisionError: in a", "unexpected ZeroDivisionError: in b"]


def test_settings_beside_a_file_are_part_of_its_work(tmp_path):
    (tmp_path / "run.mcap").write_text("x")
    keys = set()
    for text in (None, "[site]\n", "[site]\nlatitude_deg = 3.0\n"):
        if text is not None:
            (tmp_path / "run.toml").write_text(text)
        (job,) = jobs_in(tmp_path, tmp_path / "out", CalibrationSettings())
        keys.add(job.key)
    assert len(keys) == 3
