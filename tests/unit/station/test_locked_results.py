"""A station whose file of results another program holds, or that nobody may write."""

import sqlite3
import time
from contextlib import closing
from dataclasses import replace

import pytest

from kreisel.batch.attempt import RECORDING, Attempt
from kreisel.batch.result_store import Store
from kreisel.devices.address import IMUS, ROBOTS, parse_address
from kreisel.errors import RecordingError
from kreisel.station.production_line import Line
from kreisel.station.station import Station


def line(output):
    return Line(parse_address("csv://127.0.0.1:1", IMUS), parse_address("rtde://127.0.0.1", ROBOTS), output, 60.0, None)


def test_nothing_waits_for_the_file_of_results_while_an_attempt_records(tmp_path):
    """Readings are received by the same loop: as long as it waits they are lost."""
    with Store(tmp_path / "results.db") as store, closing(sqlite3.connect(tmp_path / "results.db")) as other:
        station = Station(line(tmp_path), store)
        station.refresh()
        attempt = store.begin(Attempt(0, "17", "unit", "one", "", "2026-01-01T00:00:00+00:00", state=RECORDING))
        station._reload()
        station._current = attempt
        other.execute("begin exclusive")
        began = time.monotonic()
        station.refresh()
        assert time.monotonic() - began < 1.0
        (message,) = station.so_far()
        assert message["phase"] == RECORDING
        assert [one["unit"] for one in message["recent"]] == ["17"]
        other.execute("rollback")
        station._current = replace(attempt, state="calibrating")
        station.refresh()


def test_a_file_of_results_that_cannot_be_written_is_named_before_the_page_is_served(tmp_path):
    with Store(tmp_path / "results.db") as store:
        store._connection.execute("pragma query_only = on")
        with pytest.raises(RecordingError, match="results.db: cannot be written"):
            Station(line(tmp_path), store).announce()
