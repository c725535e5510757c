"""Numbers in YAML as readers of YAML 1.1 take them: 5e-05, without a point, is a text to PyYAML."""

import re
from io import StringIO

import pytest
from ruamel.yaml import YAML

from kreisel.calibration.result import write_document
from kreisel.exchange.kalibr import dumped

FLOAT = re.compile(r"[-+]?[0-9][0-9_]*\.[0-9_]*(?:[eE][-+][0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)")
"""Of YAML 1.1, as PyYAML resolves it; numbers of base 60 aside."""

VALUES = [5e-5, -2e-6, 1e22, 1.5e-7, 0.0, 3.0, -0.25, float("inf"), float("nan")]


@pytest.mark.parametrize("form", ["calibration", "kalibr"])
def test_every_number_is_one_to_readers_of_yaml_1_1(form, tmp_path):
    if form == "kalibr":
        text = dumped({"values": list(VALUES), "one": 5e-5})
    else:
        write_document({"values": list(VALUES), "one": 5e-5}, tmp_path / "x.yaml")
        text = (tmp_path / "x.yaml").read_text()
    cells = re.findall(r"[^\s\[\],:]+", text.replace("values", "").replace("one", ""))
    assert len(cells) == len(VALUES) + 1
    assert all(FLOAT.fullmatch(cell) for cell in cells), cells
    read = YAML(typ="safe").load(StringIO(text))
    assert read["one"] == 5e-5
    assert read["values"][:8] == VALUES[:8]
