"""Capability of a production, and the workbook and documents of its units."""

import csv
import json
import zipfile
from dataclasses import replace
from importlib import resources
from io import StringIO
from xml.etree import ElementTree

import jsonschema
import numpy as np
import pytest

from kreisel.batch.capability import capabilities, capability_table
from kreisel.batch.lot import table, units_of
from kreisel.batch.unit_document import unit_document, write_unit
from kreisel.batch.workbook import write_workbook
from kreisel.calibration.limits import Limits

from .test_lot import LIMITS, run

SCHEMA = json.loads(resources.files("kreisel.batch").joinpath("unit-schema.json").read_text())


def lot(values):
    return [run(i, value) for i, value in enumerate(values)]


def test_capability_by_its_definition():
    values = np.array([1.0, 2.0, 3.0, 4.0, 2.0, 3.0, 2.5, 2.5, 1.5, 3.5])
    units = units_of(lot(values), LIMITS)
    x = next(one for one in capabilities(units, LIMITS) if one.axis == 0)
    sd = values.std(ddof=1)
    assert x.count == 10
    assert x.cp == pytest.approx(20.0 / (6.0 * sd))  # limits of 10 mg on either side
    assert x.cpk == pytest.approx(min(10.0 - values.mean(), values.mean() + 10.0) / (3.0 * sd))
    assert x.cpk_interval[0] < x.cpk < x.cpk_interval[1]
    assert "Cpk" in capability_table([x]).columns


def test_the_interval_of_cpk_covers_the_true_one():
    rng = np.random.default_rng(1)
    limit, mean, sd, inside, trials = 10.0, 4.0, 2.0, 0, 100
    true = (limit - mean) / (3.0 * sd)
    limits = Limits({"accel_bias_mg": (limit, np.inf, np.inf)})
    for _ in range(trials):
        (one,) = capabilities(units_of(lot(rng.normal(mean, sd, 25)), limits), limits)
        inside += one.cpk_interval[0] < true < one.cpk_interval[1]
    assert inside / trials > 0.88  # 95 %, three standard deviations of 100 trials below


def test_few_units_and_no_limits_have_none():
    assert capabilities(units_of(lot([1.0, 2.0]), LIMITS), LIMITS) == []
    assert capabilities(units_of(lot(range(20)), None), None) == []


def test_documents_of_all_outcomes_follow_the_schema(tmp_path):
    names = ("good", "bad", "near", "none")
    runs = [
        replace(run(i, bias), name=name)
        for i, (name, bias) in enumerate(zip(names, (1.0, 99.0, 9.95, 0.0), strict=True))
    ]
    runs[3] = replace(runs[3], text=None, error="no poses")
    found = {}
    for unit in units_of(runs, LIMITS):
        document = unit_document(unit, LIMITS)
        jsonschema.validate(document, SCHEMA)
        found[unit.run.name] = document
        write_unit(unit, LIMITS, tmp_path / unit.run.name)
        assert json.loads((tmp_path / unit.run.name / "unit.json").read_text()) == document
    assert {name: (one["outcome"], one["status"]) for name, one in found.items()} == {
        "good": ("conforms", 0), "bad": ("does not conform", 3), "near": ("no decision", 4), "none": ("failed", 1),
    }  # fmt: skip
    assert found["none"]["reasons"] == ["no poses"]
    assert "99 ±" in found["bad"]["reasons"][0]
    assert found["good"]["reasons"] == []
    assert {(one["axis"], one["limit"]) for one in found["good"]["figures"] if one["name"] == "accel_bias_mg"} == {
        ("x", 10.0), ("y", 10.0), ("z", 10.0),
    }  # fmt: skip
    again = unit_document(units_of(runs, LIMITS)[0], LIMITS, decided=("does not conform", "the mean of 2 tests"))
    assert (again["outcome"], again["status"], again["reasons"]) == ("does not conform", 3, ["the mean of 2 tests"])
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**found["good"], "status": 2}, SCHEMA)


def test_the_workbook_holds_the_table_as_numbers_and_never_formulas(tmp_path):
    runs = [replace(run(0, 1.0), name="=1+1", unit="0042"), run(1, 2.0)]
    units = units_of(runs, LIMITS)
    write_workbook(units, LIMITS, tmp_path / "table.xlsx")
    with zipfile.ZipFile(tmp_path / "table.xlsx") as file:
        sheet = ElementTree.fromstring(file.read("xl/worksheets/sheet1.xml"))
        texts = ["".join(one.itertext()) for one in ElementTree.fromstring(file.read("xl/sharedStrings.xml"))]
    space = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
    assert sheet.find(f".//{space}f") is None
    rows = list(csv.reader(StringIO(table(units))))
    for row, expected in zip(sheet.iter(f"{space}row"), rows, strict=True):
        for cell in row:
            column = (
                sum((ord(c) - 64) * 26**i for i, c in enumerate(reversed([c for c in cell.get("r") if c.isalpha()])))
                - 1
            )
            value = cell.find(f"{space}v").text
            if cell.get("t") == "s":
                assert texts[int(value)] == expected[column]
            else:
                assert float(value) == float(expected[column])
    assert "0042" in texts
