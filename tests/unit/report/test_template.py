"""Compiled templates are kept where they may be, and pages are the same where they may not."""

import sys

from jinja2 import DictLoader, Environment

from kreisel.report.template import _Compiled


def rendered(folder):
    kept = _Compiled()
    kept.directory = str(folder)
    environment = Environment(loader=DictLoader({"a.html": "{{ 6 * x }}"}), bytecode_cache=kept, autoescape=True)
    return environment.get_template("a.html").render(x=7)


def test_templates_are_kept(tmp_path):
    assert [rendered(tmp_path), rendered(tmp_path)] == ["42", "42"]
    assert len(list(tmp_path.iterdir())) == 1


def test_nothing_is_kept_where_it_may_not_be(tmp_path, monkeypatch):
    assert rendered(tmp_path / "missing") == "42"
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    assert rendered(tmp_path) == "42"
    assert not list(tmp_path.iterdir())


def test_a_damaged_file_is_replaced(tmp_path):
    rendered(tmp_path)
    (file,) = tmp_path.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    assert rendered(tmp_path) == "42"
    assert file.read_bytes() == whole
