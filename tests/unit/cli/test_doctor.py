"""What `kreisel doctor` says of extras that are not installed."""

import json
import sys

import pytest
from typer.testing import CliRunner

from kreisel.cli import doctor
from kreisel.cli.main import app


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(doctor, "_self_check", lambda: {"passed": True})


def without(monkeypatch, *modules):
    """As if modules were not installed."""
    for module in modules:
        monkeypatch.setitem(sys.modules, module, None)
        monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name in modules else object())


def test_missing_extras_are_named_with_what_needs_them(monkeypatch):
    without(monkeypatch, "distributed", "h5py", "uvicorn")
    done = CliRunner().invoke(app, ["doctor"])
    assert done.exit_code == 0
    assert "everything works" not in done.stdout
    closing = done.stdout[done.stdout.index("calibration works; not installed is what these need:") :]
    assert "study, and batch with several --jobs: pip install 'kreisel[study]'" in closing
    assert "recordings in MATLAB and Parquet files: pip install 'kreisel[tables]'" in closing
    assert "--dashboard of record, run, watch and static: pip install 'kreisel[serve]'" in closing
    assert "certificate" not in closing


def test_without_ruckig_the_virtual_cell_is_named(monkeypatch):
    """There are platforms for which it has no wheel; kreisel is installed without it there."""
    without(monkeypatch, "ruckig")
    found = json.loads(CliRunner().invoke(app, ["doctor", "--json"]).stdout)
    assert found["missing"] == {"simulate, demo, virtual-cell, run and batch --simulate": "pip install ruckig"}


def test_with_all_extras_everything_works(monkeypatch):
    monkeypatch.setattr(doctor, "_missing", dict)
    assert CliRunner().invoke(app, ["doctor"]).stdout.endswith("everything works\n")


def test_a_failed_self_check_is_said_alone(monkeypatch):
    without(monkeypatch, "distributed")
    monkeypatch.setattr(doctor, "_self_check", lambda: {"passed": False})
    done = CliRunner().invoke(app, ["doctor"])
    assert done.exit_code == 1
    assert done.stdout.endswith("install kreisel again, and report this output\n")
