"""A small test executive, as a maker of IMUs has one: it knows exit statuses and JSON from the documents alone."""

import csv
import json
import math
import subprocess
import sys
from dataclasses import dataclass
from importlib import resources

import jsonschema
import numpy as np
import pytest

from kreisel.formats.write import write_folder
from kreisel.recording.recording_settings import DeviceTable

from ..small_cell import simulate

SCHEMA = json.loads(resources.files("kreisel.batch").joinpath("unit-schema.json").read_text())
WORDS = {0: "PASS", 1: "ERROR", 3: "FAIL", 4: "OPEN"}
"""What a status means for a unit, by docs/how-to/production.md."""


@dataclass
class Step:
    """What the executive keeps of one command."""

    word: str
    printed: dict
    said: str


class Executive:
    """Runs commands; 2 is a mistake in its own command line, and stops the line."""

    def step(self, *arguments):
        own = [sys.executable, "-m", "kreisel.cli.main", *map(str, arguments)]
        done = subprocess.run(own, capture_output=True, text=True, check=False, timeout=300)
        assert done.returncode in WORDS, (done.returncode, done.stderr)
        return Step(WORDS[done.returncode], json.loads(done.stdout) if "--json" in own else {}, done.stderr)


@pytest.fixture(scope="module")
def lot(tmp_path_factory):
    """Return a folder of three recordings: a good one, one of a moved clock of poses, one without poses."""
    folder = tmp_path_factory.mktemp("lot")
    for k, name in enumerate(("good", "bent", "short")):
        _, recording = simulate(np.random.default_rng(5 + k), 60.0, folder / name)
        settings = recording.settings.model_copy(update={"device": DeviceTable(serial_number=f"SN {k}")})
        object.__setattr__(recording, "settings", settings)
        write_folder(recording, folder / name)
    (folder / "short" / "pose0" / "data.csv").write_text("#timestamp [ns],p_x [m]\n")
    poses = folder / "bent" / "pose0" / "data.csv"
    head, *rows = poses.read_text().splitlines()
    for k, row in enumerate(rows):  # positions that swing by a centimetre: no motion of the IMU fits them
        stamp, x, rest = row.split(",", 2)
        rows[k] = f"{stamp},{float(x) + 0.01 * math.sin(k / 40.0)!r},{rest}"
    poses.write_text("\n".join([head, *rows]) + "\n")
    return folder


@pytest.fixture(scope="module")
def value(lot, tmp_path_factory):
    """Return the largest gyro bias with its expanded uncertainty, as the good unit's document states it."""
    out = tmp_path_factory.mktemp("first")
    limits = out / "limits.toml"
    limits.write_text("[limits]\ngyro_bias_deg_h = 1e6\n")
    step = Executive().step("calibrate", lot / "good", "-o", out / "r", "--limits", limits, "--json")
    assert step.word == "PASS"
    figures = json.loads((out / "r" / "unit.json").read_text())["figures"]
    own = [one for one in figures if one["name"] == "gyro_bias_deg_h"]
    worst = max(own, key=lambda one: abs(one["value"]))
    return abs(worst["value"]), worst["expanded_uncertainty"], worst["axis"]


@pytest.mark.parametrize(
    ("factor", "word", "outcome"),
    [(3, "PASS", "conforms"), (0.2, "OPEN", "no decision"), (-3, "FAIL", "does not conform")],
)
def test_one_unit_by_its_limits(lot, value, tmp_path, factor, word, outcome):
    size, uncertainty, axis = value
    limits = tmp_path / "limits.toml"
    limits.write_text(f"[limits]\ngyro_bias_deg_h = {size + factor * uncertainty!r}\n")
    step = Executive().step("calibrate", lot / "good", "-o", tmp_path / "r", "--limits", limits, "--json")
    assert step.word == word
    assert step.printed["conformity"]["decision"] == outcome
    document = json.loads((tmp_path / "r" / "unit.json").read_text())
    jsonschema.validate(document, SCHEMA)
    assert WORDS[document["status"]] == word
    assert (document["outcome"], document["unit"]) == (outcome, "SN 0")
    decided = {one["axis"]: one["decision"] for one in document["figures"] if one["name"] == "gyro_bias_deg_h"}
    assert decided[axis] == outcome
    certificate = Executive().step("certificate", tmp_path / "r", "-o", tmp_path / "c.html", "--limits", limits)
    assert certificate.word == word
    assert (tmp_path / "c.html").is_file()


def test_an_axis_without_a_limit_is_left_alone(lot, value, tmp_path):
    size, uncertainty, axis = value
    own = ["inf" if name == axis else repr(size + 9 * uncertainty) for name in "xyz"]
    limits = tmp_path / "limits.toml"
    limits.write_text(f"[limits]\ngyro_bias_deg_h = [{', '.join(own)}]\n")
    step = Executive().step("calibrate", lot / "good", "-o", tmp_path / "r", "--limits", limits, "--json")
    assert step.word == "PASS"


def test_a_rejected_unit_and_one_that_cannot_be_calibrated(lot, tmp_path):
    limits = tmp_path / "limits.toml"
    limits.write_text("[limits]\ngyro_bias_deg_h = 1e6\n")
    step = Executive().step("calibrate", lot / "bent", "-o", tmp_path / "r", "--limits", limits, "--json")
    assert step.word == "FAIL"
    assert step.printed["verdict"]["reasons"]
    document = json.loads((tmp_path / "r" / "unit.json").read_text())
    assert (document["outcome"], document["reasons"]) == ("rejected", step.printed["verdict"]["reasons"])
    step = Executive().step("calibrate", lot / "short", "-o", tmp_path / "s", "--limits", limits, "--json")
    assert step.word == "ERROR"
    assert step.printed["error"] in step.said


def test_a_lot(lot, tmp_path):
    limits = tmp_path / "limits.toml"
    limits.write_text("[limits]\ngyro_bias_deg_h = 1e6\n")
    step = Executive().step("batch", lot, "-o", tmp_path / "o", "--limits", limits, "--jobs", "1", "--xlsx", "--json")
    assert step.word == "ERROR"  # the first of 1, 3, 4 that occurs
    assert step.printed["not_good"] == {"rejected": ["bent"], "failed": ["short"]}
    outcomes = {}
    for name in ("good", "bent", "short"):
        document = json.loads((tmp_path / "o" / "results" / name / "unit.json").read_text())
        jsonschema.validate(document, SCHEMA)
        outcomes[document["unit"]] = (document["outcome"], WORDS[document["status"]])
    assert outcomes.pop("SN 0") == ("conforms", "PASS")
    assert outcomes.pop("SN 1") == ("rejected", "FAIL")
    ((_, failed),) = outcomes.items()  # a recording that cannot be read states no serial number
    assert failed == ("failed", "ERROR")
    rows = {row["recording"]: row for row in csv.DictReader((tmp_path / "o" / "table.csv").read_text().splitlines())}
    assert {name: row["outcome"] for name, row in rows.items()} == {
        "good": "conforms",
        "bent": "rejected",
        "short": "failed",
    }
    assert (tmp_path / "o" / "table.xlsx").stat().st_size > 3000
