"""Estimators side by side: what is compared, and in which units."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.by_method import (
    ByMethod,
    differences,
    document_of,
    document_of_all,
    expected,
    largest,
    over_expected,
    parameters_in,
    scores,
    too_sure,
)
from kreisel.calibration.method_comparison import compare_methods
from kreisel.report.comparison_page import chi_squares, over_recordings

from ...small_problem import recorded


def test_numbers_have_the_paths_of_the_result_file():
    document = {
        "gyroscope": {"cross_coupling": [[1.0, 2.0], [3.0, 4.0]], "polynomial": {"2": [5.0]}, "note": "text"},
        "timing": {"offset": 6, "base": None},
        "site": {"latitude": 7.0},
    }
    assert parameters_in(document) == {
        "gyroscope.cross_coupling[0,0]": 1.0, "gyroscope.cross_coupling[0,1]": 2.0,
        "gyroscope.cross_coupling[1,0]": 3.0, "gyroscope.cross_coupling[1,1]": 4.0,
        "gyroscope.polynomial.2[0]": 5.0, "timing.offset": 6.0,
    }  # fmt: skip


def test_differences_and_errors_are_in_deviations():
    sd = {"gyroscope.offset[0]": 0.1, "gyroscope.offset[1]": 0.2, "timing.offset": 0.0}
    one = ByMethod("a", 1.0, dict.fromkeys(sd, 1.0), sd)
    other = ByMethod("b", 1.0, one.estimate | {"gyroscope.offset[1]": 1.4}, sd)
    found = differences(other, one)
    assert found == {"gyroscope.offset[0]": 0.0, "gyroscope.offset[1]": pytest.approx(2.0)}
    assert largest(found, "gyroscope.offset") == pytest.approx(2.0)
    assert np.isnan(largest(found, "magnetometer"))
    assert scores(one, {"gyroscope.offset[1]": 1.4, "other": 1.0}) == {"gyroscope.offset[1]": pytest.approx(-2.0)}


def test_an_estimator_that_knows_less_differs_by_what_it_does_not_know():
    """Means of all and of half of some numbers: the variance of their difference is the difference of theirs."""
    rng = np.random.default_rng(5)
    names = [f"gyroscope.offset[{i}]" for i in range(400)]
    data = rng.normal(size=(400, 100))
    whole, half = (
        ByMethod(
            "x", 1.0, dict(zip(names, part.mean(axis=1), strict=True)), dict.fromkeys(names, part.shape[1] ** -0.5)
        )
        for part in (data, data[:, :50])
    )
    assert expected(half, whole)["gyroscope.offset[0]"] == pytest.approx(1.0)
    assert over_expected(half, whole) == pytest.approx(1.0, abs=0.15)
    assert np.isnan(over_expected(whole, whole))
    sure = replace(half, standard_deviation=dict.fromkeys(names, 0.02))
    assert np.isnan(over_expected(sure, whole))
    assert too_sure(sure, whole) == pytest.approx(5.0)
    assert too_sure(half, whole) == 1.0


def test_three_estimators_agree_and_one_that_fails_says_why():
    compared = compare_methods(recorded()[1], ("spkf", "ekf", "batch"))
    first = compared.first
    for one in compared.found[1:]:
        assert max(map(abs, differences(one, first).values())) < 0.3
        assert one.drift is not None
        assert one.drift == pytest.approx(first.drift, rel=0.05)
    failed = ByMethod("other", 0.1, error="no such thing")
    document = document_of(replace(compared, found=(*compared.found, failed)))["methods"]
    assert set(document["ekf"]) == {
        "estimate", "standard_deviation", "accepted", "reasons", "seconds", "passes", "drift", "difference",
        "expected_difference",
    }  # fmt: skip
    assert set(document["ekf"]["estimate"]) >= {"gyroscope.offset[0]", "timing.offset"}
    assert document["other"] == {"error": "no such thing", "seconds": 0.1, "passes": pytest.approx(0.1 / compared.unit)}
    both = document_of_all([compared, compared], ["one", "two"])
    assert both["recordings"]["two"] == document_of(compared)
    assert document_of_all([compared], ["one"]) == document_of(compared)


def test_results_over_recordings_have_a_chi_square():
    compared = compare_methods(recorded()[1], ("spkf", "ekf"))
    assert over_recordings([compared]) == {}
    columns, rows = chi_squares(over_recordings([compared, compared]))
    assert columns == ("quantity", "spkf", "ekf", "99 % band")
    assert max(float(row[1]) for row in rows) < 1e-12  # a recording against itself
    rejected = replace(compared, found=tuple(replace(one, accepted=False) for one in compared.found))
    assert over_recordings([compared, rejected]) == {}
