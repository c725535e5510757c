"""A study of estimators: first errors are as stated, rows are kept, and what is counted as failed."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from kreisel.errors import SettingsError
from kreisel.report.study_page import write_methods
from kreisel.study import methods as module
from kreisel.study.method_rows import (
    CELLS,
    COLUMNS,
    METHODS,
    MethodFile,
    MethodRow,
    numbers,
    summaries,
    table,
)
from kreisel.study.methods import run_numbered, wrong_by

from ...small_problem import small_problem

ROW = MethodRow("fog-mems", "joints", "1 deg, 0.5 %", "rich", "spkf", 1, 2.0, 0.9, 2, 0.1)


def test_first_values_are_wrong_by_what_is_said():
    problem = small_problem()
    turns, shares = [], []
    for seed in range(200):
        first = wrong_by(problem, 0.02, 0.005, np.random.default_rng(seed))
        ratio = first.prior.start.sensors.K_a @ np.linalg.inv(problem.prior.start.sensors.K_a)
        turns.append(np.linalg.norm(0.5 * (ratio - ratio.T)) / 2**0.5)
        shares.append(np.diag(ratio) - 1.0)
    assert np.sqrt(np.mean(np.square(turns))) == pytest.approx(3**0.5 * 0.02, rel=0.1)
    assert np.std(shares) == pytest.approx(0.005, rel=0.2)
    np.testing.assert_allclose(
        first.prior.start_covariance["accel_cross_coupling"], (0.02**2 + 0.005**2) * np.eye(9), rtol=1e-12
    )
    assert first.prior.value is problem.prior.value  # only the start is wrong, not what is known


def test_a_run_has_a_row_for_each_estimator_and_is_kept(tmp_path):
    number = numbers(1)[CELLS.index(("fog-mems", "mocap", (1.0, 0.005), "rich"))]
    rows = run_numbered(30.0, METHODS, number)
    assert tuple(row.method for row in rows) == METHODS
    assert all(not row.failed and row.worst < 5.0 for row in rows)
    assert max(row.ratio for row in rows) < 1.02 * min(row.ratio for row in rows)
    file = MethodFile(tmp_path, 30.0)
    file.add(rows)
    assert MethodFile(tmp_path, 30.0).missing([number, number + 1]) == [number + 1]
    text = (tmp_path / "methods.csv").read_text(encoding="utf-8")
    (tmp_path / "methods.csv").write_text(text[:-10], encoding="utf-8")
    again = MethodFile(tmp_path, 30.0)
    assert again.rows() == []  # a run of which a row is missing is run again
    with (tmp_path / "methods.csv").open(encoding="utf-8") as stream:
        assert len(list(csv.reader(stream))) == 1
    with pytest.raises(SettingsError, match="another length"):
        MethodFile(tmp_path, 31.0)
    with pytest.raises(SettingsError):
        MethodFile(tmp_path, 30.0, ("ekf", "batch"))


def test_what_ends_elsewhere_is_counted_and_left_out_of_the_rest(tmp_path):
    rows = [ROW, replace(ROW, seed=2, ratio=50.0, worst=400.0), replace(ROW, seed=3, ratio=np.nan, failure="diverged")]
    found = next(one for one in summaries(rows) if one.method == "spkf")
    assert (found.runs, found.failed, found.ratio, found.worst) == (3, 2, 0.9, 2.0)
    lines = table(rows)
    assert lines[0][:4] == ["all", "spkf", "3", "2"]
    assert lines[1][:4] == ["fog-mems, joints, 1 deg, 0.5 %, rich", "spkf", "3", "2"]
    write_methods(lines, COLUMNS, rows, tmp_path / "report.html")
    assert "Runs that end elsewhere than at the truth" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_an_estimator_that_fails_is_a_row_with_its_reason(monkeypatch):
    from kreisel.errors import EstimationError

    class Broken:
        name = "broken"

        def fit(self, *_arguments, **_named):
            raise EstimationError("no such luck")

    monkeypatch.setitem(module.ESTIMATORS, "spkf", Broken())
    rows = run_numbered(20.0, METHODS, numbers(1)[CELLS.index(("fog-mems", "mocap", (1.0, 0.005), "rich"))])
    assert rows[0].failure == "no such luck"
    assert rows[0].failed
    assert not rows[1].failed
