"""The file of results: SQLite, one row for each unit of a recording, one for each quantity."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from contextlib import closing
from dataclasses import astuple, fields, replace
from pathlib import Path
from typing import Any

from kreisel.batch.attempt import Attempt
from kreisel.batch.job_result import Run
from kreisel.errors import RecordingError

SCHEMA = 2
"""Version of the tables below, `user_version` in the file; to be increased with every change of them."""

_TABLES = """
create table runs (
    key text primary key, name text not null, unit text not null, maker text not null, type text not null,
    date text, error text, document text, accepted integer not null
);
create index runs_of_unit on runs (unit, date);
create table quantities (
    key text not null references runs (key) on delete cascade, quantity text not null, axis integer not null,
    value real, standard_deviation real, primary key (key, quantity, axis)
);
"""

_TABLES_OF_STATIONS = """
create table attempts (
    id integer primary key autoincrement, unit text not null, kind text not null, station text not null,
    operator text not null, begun text not null, ended text, state text not null, outcome text not null,
    reason text not null, recording text not null, key text not null, printed integer not null
);
create index attempts_of_unit on attempts (unit);
create table events (time text not null, station text not null, text text not null);
"""
"""Version 2 added them: those of version 1 get them when they are opened."""

_COLUMNS = ", ".join("document" if field.name == "text" else field.name for field in fields(Run))


_OF_ATTEMPT = tuple(field.name for field in fields(Attempt))[1:]
"""Columns of attempts, less their number, which stands first."""

_PATIENCE = 60.0
"""Seconds to wait for another program that writes the file."""


class Store:
    """The results of batches in one file; any program for SQLite reads it.

    Parameters
    ----------
    path
        The file; it is made where there is none.

    Raises
    ------
    RecordingError
        If it is another kind of file, or of a later version.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._connection = sqlite3.connect(path, timeout=_PATIENCE)
            self._connection.execute("pragma foreign_keys = on")
            version = self._connection.execute("pragma user_version").fetchone()[0]
            tables = {name for (name,) in self._connection.execute("select name from sqlite_master where type='table'")}
            if version == 0 and not tables:
                version = self._made(_TABLES + _TABLES_OF_STATIONS)
            elif version == 1:
                version = self._made(_TABLES_OF_STATIONS)
        except (sqlite3.Error, OSError) as error:
            raise RecordingError(f"cannot be used as a file of results: {error}", file=path) from error
        if version != SCHEMA:
            raise RecordingError(f"version {version} of the file of results, expected {SCHEMA}", file=path)

    def _made(self, tables: str) -> int:
        self._connection.executescript(f"begin; {tables} pragma user_version = {SCHEMA}; commit;")
        return SCHEMA

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, *runs: Run) -> None:
        """Write runs, at once and as a whole; earlier ones of the same keys are replaced.

        Raises
        ------
        RecordingError
            If the file cannot be written.
        """
        places = ", ".join("?" * (len(fields(Run)) + 1))
        rows = [row for run in runs for row in _quantities(run)]
        try:
            with self._connection as connection:
                connection.executemany("delete from runs where key = ?", [(run.key,) for run in runs])
                connection.executemany(
                    f"insert into runs ({_COLUMNS}, accepted) values ({places})",
                    [(*astuple(run), int(run.accepted)) for run in runs],
                )
                connection.executemany("insert into quantities values (?, ?, ?, ?, ?)", rows)
        except sqlite3.Error as error:
            raise RecordingError(f"cannot be written: {error}", file=self.path) from error

    def calibrated(self) -> dict[str, bool]:
        """Return the keys of all runs, and whether they ended with a result."""
        return {key: bool(done) for key, done in self._query("select key, document is not null from runs")}

    def runs(self, keys: Iterable[str] | None = None) -> list[Run]:
        """Return all runs, or those with certain keys, by name."""
        rows = self._query(f"select {_COLUMNS} from runs order by name, key")
        wanted = None if keys is None else frozenset(keys)
        return [Run(*row) for row in rows if wanted is None or row[0] in wanted]

    def of_unit(self, unit: str) -> list[Run]:
        """Return the runs of one unit, in the order they were written."""
        return [Run(*row) for row in self._query(f"select {_COLUMNS} from runs where unit = ? order by rowid", unit)]

    def units(self) -> list[str]:
        """Return the names of all units."""
        return [unit for (unit,) in self._query("select distinct unit from runs order by unit")]

    def begin(self, attempt: Attempt) -> Attempt:
        """Write an attempt that begins, and return it with its number.

        Raises
        ------
        RecordingError
            If the file cannot be written.
        """
        places = ", ".join("?" * len(_OF_ATTEMPT))
        text = f"insert into attempts ({', '.join(_OF_ATTEMPT)}) values ({places})"
        return replace(attempt, id=self._write(text, *astuple(attempt)[1:]))

    def change(self, attempt: Attempt) -> None:
        """Write an attempt as it is now.

        Raises
        ------
        RecordingError
            If the file cannot be written.
        """
        text = f"update attempts set {', '.join(f'{name} = ?' for name in _OF_ATTEMPT)} where id = ?"
        self._write(text, *astuple(attempt)[1:], attempt.id)

    def note(self, time: str, station: str, text: str) -> None:
        """Write an event of a station."""
        self._write("insert into events values (?, ?, ?)", time, station, text)

    def events(self) -> list[tuple[str, str, str]]:
        """Return time, station and text of all events."""
        return self._query("select time, station, text from events order by rowid")

    def attempts(self, unit: str | None = None) -> list[Attempt]:
        """Return all attempts, or those of one unit, in their order."""
        return self._attempts("order by id") if unit is None else self._attempts("where unit = ? order by id", unit)

    def attempt(self, number: int) -> Attempt | None:
        """Return the attempt of a number; None where there is none."""
        return next(iter(self._attempts("where id = ?", number)), None)

    def recent(self, count: int) -> list[Attempt]:
        """Return the last attempts, the newest first."""
        return self._attempts("order by id desc limit ?", count)

    def attempts_since(self, begun: str) -> list[Attempt]:
        """Return the attempts that began on a date or later, in their order."""
        return self._attempts("where begun >= ? order by id", begun)

    def _attempts(self, chosen: str, *values: object) -> list[Attempt]:
        names = ", ".join(("id", *_OF_ATTEMPT))
        return [Attempt(*row) for row in self._query(f"select {names} from attempts {chosen}", *values)]

    def _write(self, text: str, *values: object) -> int:
        try:
            with self._connection as connection:
                return int(connection.execute(text, values).lastrowid or 0)
        except sqlite3.Error as error:
            raise RecordingError(f"cannot be written: {error}", file=self.path) from error

    def _query(self, text: str, *values: object) -> list[tuple[Any, ...]]:
        try:
            with closing(self._connection.execute(text, values)) as cursor:
                return list(cursor)
        except sqlite3.Error as error:
            raise RecordingError(f"cannot be read: {error}", file=self.path) from error


def _quantities(run: Run) -> list[tuple[str, str, int, float, float]]:
    derived = {} if run.parts is None else run.parts.derived
    return [
        (run.key, name, axis, float(value), float(sd))
        for name, found in derived.items()
        for axis, (value, sd) in enumerate(zip(found.value, found.deviation, strict=True))
    ]
