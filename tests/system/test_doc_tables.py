"""Tables of measurements: each page's data file is there and whole, and the table of robustness counts rightly."""

import csv
import importlib.util
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from kreisel.study.robustness import Row, RowFile

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
MARKERS = [
    (page, name)
    for page in sorted(DOCS.rglob("*.md"))
    for name in re.findall(r"<!-- table: (.*?) -->", page.read_text(encoding="utf-8"))
]


def test_pages_use_every_data_file_and_no_other():
    used = {DOCS / name for _, name in MARKERS}
    assert used == set((DOCS / "data").iterdir())


@pytest.mark.parametrize(("page", "name"), MARKERS, ids=[name for _, name in MARKERS])
def test_the_source_links_to_the_data_after_its_marker(page, name):
    file = Path(name).name
    assert f"<!-- table: {name} -->\n[{file}](../{name})\n" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", sorted((DOCS / "data").iterdir()), ids=lambda path: path.name)
def test_every_row_has_a_cell_for_each_column(path):
    with path.open(encoding="utf-8", newline="") as stream:
        header, *rows = csv.reader(stream)
    assert rows
    assert all(header)
    assert {len(row) for row in rows} == {len(header)}


def test_a_figure_has_a_point_and_a_bar_for_each_value(tmp_path):
    pytest.importorskip("latex2mathml")
    spec = importlib.util.spec_from_file_location("hooks", DOCS / "hooks.py")
    hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hooks)
    data = tmp_path / "a.csv"
    data.write_text("run,x (m),sd x (m)\na & b,1,0.5\nother,2,0.1\nempty,,\nc,-3,1\n", encoding="utf-8")
    drawn = hooks.figure(data, "size (m)", ["x (m) +- sd x (m)"], "other")
    root = ElementTree.fromstring(drawn)
    points = [circle for circle in root.iter("circle") if circle.get("r") == "3.5"]
    assert len(points) == 2
    assert float(points[0].get("cy")) < float(points[1].get("cy"))  # larger values are higher
    texts = [text.text for text in root.iter("text")]
    assert "a & b" in texts
    assert "other" not in texts
    assert {"size (m)", "x", "0"} <= set(texts)


@pytest.fixture(scope="module")
def robustness_table():
    spec = importlib.util.spec_from_file_location("robustness_table", ROOT / "design" / "robustness_table.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_table_of_robustness_is_made_from_results(robustness_table, tmp_path):
    file = RowFile(tmp_path, 60.0)
    file.add(Row("spikes", "1 %", "joints", 1, "accepted", 4.5, "k", 1.0))
    file.add(Row("spikes", "1 %", "joints", 2, "refused"))
    file.add(Row("gap of the IMU", "2 s", "joints", 1, "accepted", 2.0, "k", 0.6))
    file.add(Row("gap of the IMU", "2 s", "joints", 2, "accepted", 3.0, "k", 0.8))
    file.add(Row("gap of the IMU", "40 s", "joints", 1, "rejected", 5.0, "k", 2.0))
    rows = robustness_table.rows_of(tmp_path)
    assert [row[:7] for row in robustness_table.table(rows, "usual")[1:]] == [
        ["all", "2", "1", "1", "0", "1", "4.5"],
        ["spikes", "2", "1", "1", "0", "1", "4.5"],
    ]
    assert robustness_table.table(rows, "foreign")[1:] == [
        ["all", "3", "2", "0", "1", "0", "3.0", "0.71"],
        ["gap of the IMU, 2 s", "2", "2", "0", "0", "0", "3.0", "0.71"],
        ["gap of the IMU, 40 s", "1", "0", "0", "1", "0", "", ""],
    ]


def test_causes_named_are_counted(robustness_table):
    known = next(s for s in robustness_table.situations() if s.causes)
    place = (known.name, known.size, known.basis)
    rows = [
        Row(*place, 1, "accepted", 1.0, named=known.causes[:1]),
        Row(*place, 2, "accepted", 1.0),
        Row(*place, 3, "rejected", 9.0, named=("something else",)),
    ]
    assert robustness_table.cause_named(rows) == "1 of 2"
