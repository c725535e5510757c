"""Attempts of stations in the file of results, and files of version 1."""

import sqlite3
from dataclasses import replace

from kreisel.batch.attempt import ENDED, Attempt
from kreisel.batch.result_store import Store

from .test_lot import run

BEGUN = Attempt(0, "0042", "unit", "west", "ada", "2026-01-01T08:00:00+00:00")


def test_attempts_and_events_are_kept(tmp_path):
    with Store(tmp_path / "results.db") as store:
        first = store.begin(BEGUN)
        second = store.begin(replace(BEGUN, unit="0043"))
        assert (first.id, second.id) == (1, 2)
        store.change(replace(first, state=ENDED, outcome="conforms", key="k"))
        store.note("2026-01-01T08:00:00+00:00", "west", "started")
    with Store(tmp_path / "results.db") as store:
        assert store.attempts() == [replace(first, state=ENDED, outcome="conforms", key="k"), second]
        assert store.attempts("0043") == [second]
        assert store.events() == [("2026-01-01T08:00:00+00:00", "west", "started")]


def test_a_file_of_version_1_gets_the_new_tables_and_keeps_its_runs(tmp_path):
    path = tmp_path / "results.db"
    with Store(path) as store:
        store.add(run(1, 2.0))
    with sqlite3.connect(path) as old:
        old.executescript("drop table attempts; drop table events; pragma user_version = 1;")
    with Store(path) as store:
        assert [one.unit for one in store.runs()] == ["1"]
        assert store.begin(BEGUN).id == 1
