"""Trays in a batch: one job and one run for each unit, written together, done again together."""

from dataclasses import replace

import pytest

from kreisel.batch.batch_pages import write_batch
from kreisel.batch.execution import Batch, calibrate_all, calibrate_runs, one_after_another, waiting_in
from kreisel.batch.jobs import jobs_in
from kreisel.batch.lot import pages_of, units_of
from kreisel.batch.result_store import Store
from kreisel.errors import RecordingError, SettingsError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.stated_parameters import parse_fixed

from .test_lot import run

SETTINGS = CalibrationSettings()


def tray_in(folder, *data):
    for k, text in enumerate(data):
        (folder / f"imu{k}").mkdir(parents=True)
        (folder / f"imu{k}" / "data.csv").write_text(text)


@pytest.fixture
def jobs(tmp_path):
    tray_in(tmp_path / "in" / "day" / "tray", *["x"] * 11)
    tray_in(tmp_path / "in" / "one", "x")
    return jobs_in(tmp_path / "in", tmp_path / "out", SETTINGS)


def runs_for(job, errors=()):
    return [
        replace(run(k, float(k), error="no" if k in errors else None), key=key, name=name)
        for k, (key, name) in enumerate(job.runs.items())
    ]


def test_a_tray_is_one_job_with_a_run_for_each_unit(jobs):
    tray, one = jobs
    assert list(tray.runs.values()) == [f"day/tray/imu{k}" for k in range(11)]
    assert len(tray.runs) == 11
    assert one.runs == {one.key: "one"}
    assert {found.tray for found in runs_for(tray)} == {"day/tray"}
    assert {found.tray for found in runs_for(one)} == {""}
    assert replace(run(0), name="day/imu0").tray == ""


def test_settings_for_one_imu_are_refused_before_the_work(tmp_path):
    tray_in(tmp_path / "in" / "tray", "x", "x")
    with pytest.raises(SettingsError, match=r"^--fix gyro_offset is for one IMU, and the folder has trays \(tray\);"):
        jobs_in(tmp_path / "in", tmp_path / "out", replace(SETTINGS, fixed=parse_fixed(["gyro_offset"])))


def test_a_tray_is_waiting_until_all_of_its_runs_and_files_are_there(jobs, tmp_path):
    tray = jobs[0]
    batch = Batch([tray], SETTINGS, tmp_path / "results", reports=True)
    folder = tmp_path / "results" / "day" / "tray"
    files = ["array.yaml", "covariance.csv", "units_covariance.npz", "report.html"]
    files += ["mean/calibration.yaml", "mean/report.html"]
    files += [f"imu{k}/calibration.yaml" for k in range(11) if k != 4]
    with Store(tmp_path / "r.db") as store:
        assert waiting_in(batch, store) == [0]
        store.add(*runs_for(tray, errors=[4])[:-1])
        assert waiting_in(batch, store) == [0]
        store.add(*runs_for(tray, errors=[4]))
        for file in files:
            assert waiting_in(batch, store) == [0]
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text("")
        assert waiting_in(batch, store) == []
        store.add(*runs_for(tray, errors=range(11)))
    with Store(tmp_path / "r.db") as store:
        assert waiting_in(replace(batch, results=tmp_path / "none"), store) == []


def test_runs_of_a_tray_are_written_together_or_not_at_all(jobs, tmp_path):
    first, *others = runs_for(jobs[0])
    with Store(tmp_path / "r.db") as store:
        with pytest.raises(RecordingError, match="cannot be written"):
            store.add(first, *others, replace(first, name=None))
        assert store.calibrated() == {}
        store.add(first, *others)
        store.add(first, *others)
        assert len(store.runs()) == 11
        assert store.of_unit("7") == [others[6]]


def test_units_are_in_the_order_of_their_numbers(jobs, tmp_path):
    batch = Batch(jobs, SETTINGS, tmp_path / "out", reports=False)
    seen = []
    with Store(tmp_path / "r.db") as store:
        runs = calibrate_all(batch, store, one_after_another, seen.append)
        assert [one.name for one in runs] == [*(f"day/tray/imu{k}" for k in range(11)), "one"]
        assert [one.name for one in seen] == [one.name for one in runs]
        assert all(one.error for one in runs)
        assert waiting_in(batch, store) == []


def test_of_units_that_cannot_be_read_each_has_its_reason(tmp_path):
    tray_in(tmp_path / "in" / "tray", "x", "", "#timestamp [ns]\n1\n2\n")
    batch = Batch(jobs_in(tmp_path / "in", tmp_path / "out", SETTINGS), SETTINGS, tmp_path / "out", reports=False)
    runs = calibrate_runs(batch, 0)
    assert [f"imu{k}/data.csv" in one.error for k, one in enumerate(runs)] == [True] * 3
    assert [one.unit for one in runs] == ["tray/imu0", "tray/imu1", "tray/imu2"]


def test_the_last_unit_that_can_be_read_is_not_calibrated_alone(tmp_path):
    rows = [f"{k * 10_000_000},0,0,0,0,0,9.8" for k in range(1000)]
    tray_in(tmp_path / "in" / "tray", "x", "\n".join(["#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z", *rows]))
    batch = Batch(jobs_in(tmp_path / "in", tmp_path / "out", SETTINGS), SETTINGS, tmp_path / "out", reports=False)
    first, second = calibrate_runs(batch, 0)
    assert "imu0/data.csv" in first.error
    assert "of its 2 IMUs only imu1 can be read" in second.error


def test_pages_of_trays_are_linked(jobs, tmp_path):
    tray, one = (runs_for(job, errors=[2]) for job in jobs)
    lost = [replace(found, key=f"key/imu{k}", name=f"lost & <found>/imu{k}", error="no", text=None)
            for k, found in enumerate(tray[:2])]  # fmt: skip
    runs = [*tray, *one, *lost]
    pages = pages_of(runs, reports=False)
    assert set(pages) == {found.key for found in tray}
    assert pages[tray[2].key] == "../report.html"
    assert pages_of(runs, reports=True)[one[0].key] == "report.html"
    write_batch(units_of(runs, None), None, "lead", False, tmp_path / "batch.html")
    page = (tmp_path / "batch.html").read_text()
    assert page.count('<a href="results/day/tray/report.html">') == 12  # its own row, and those of its units
    assert page.count('<a href="results/day/tray/mean/report.html">') == 1
    assert "lost &amp; &lt;found&gt;/imu1" in page
    assert 'href="results/lost' not in page
