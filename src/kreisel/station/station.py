"""The work of a station: record a unit, calibrate it, judge it, keep everything."""

from __future__ import annotations

import asyncio
import re
import signal
import time
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from kreisel._version import __version__
from kreisel.acquisition.recorder import Status, record
from kreisel.batch.attempt import CALIBRATING, ENDED, INTERRUPTED, RECORDING, Attempt
from kreisel.batch.execution import Batch, calibrate_one
from kreisel.batch.job_result import Run
from kreisel.batch.jobs import Job
from kreisel.batch.lot import units_of
from kreisel.batch.outcomes import GOOD
from kreisel.batch.result_store import Store
from kreisel.batch.unit_document import NAME, reasons_of, write_unit
from kreisel.calibration.limits import Decision
from kreisel.calibration.result import Calibration
from kreisel.certificate.certificate_page import html
from kreisel.certificate.content import certificate_of, fields_of
from kreisel.certificate.statement import digest_of
from kreisel.errors import KreiselError, SettingsError, reason_of
from kreisel.files import write_whole
from kreisel.station.golden_unit import golden_check
from kreisel.station.production_line import Line
from kreisel.station.retest import outcome_of, recent_tests

SILENT = 3.0
"""Seconds without readings after which an attempt ends. Chosen: devices that connect again need one or two."""

PATIENCE = 20.0
"""Seconds to wait for the first readings. Chosen: an IMU that starts up needs ten."""

_RECENT = 12
"""Attempts that the page lists."""


class Station:
    """One station; it is the source of its page's messages.

    Parameters
    ----------
    store
        The file of results, open for this station.
    now
        The time, UTC.
    """

    def __init__(self, line: Line, store: Store, now: Callable[[], datetime] = partial(datetime.now, UTC)) -> None:
        self.line = line
        self._store = store
        self._now = now
        self._current: Attempt | None = None
        self._last: Attempt | None = None
        self._task: asyncio.Task[None] | None = None
        self._stop = asyncio.Event()
        self._why = ""
        self._progress: dict[str, Any] = {}
        self._today: dict[str, str] = {}
        self._message: dict[str, Any] = {}
        self._sent: dict[str, Any] = {}
        self._recent: list[Mapping[str, Any]] = []
        self._due = ""
        self._workers = _workers()

    def announce(self) -> None:
        """Note that the station begins.

        Raises
        ------
        RecordingError
            If the file of results cannot be written.
        """
        self._note(f"station started, kreisel {__version__}")

    # what the page asks for

    def start(self, serial: str, operator: str = "") -> Attempt:
        """Begin an attempt with a unit.

        Raises
        ------
        SettingsError
            If the station is busy, the serial number is none, the known unit has to be checked first, or the unit was
            tested often enough.
        """
        serial, operator = _printable(serial), _printable(operator)
        if self._current is not None:
            raise SettingsError(f"unit {self._current.unit} is at work; stop it first (Esc)")
        if not 0 < len(serial) <= 100:
            raise SettingsError("scan or type a serial number of 1 to 100 characters")
        golden = self.line.golden
        kind = "golden" if golden is not None and serial == golden.serial else "unit"
        if kind == "unit":
            if due := self.golden_due():
                raise SettingsError(due)
            tests = len(recent_tests(self._store.attempts(serial), self._now()))
            if tests > self.line.retests:
                raise SettingsError(f"unit {serial} was tested {_times(tests)}, as often as allowed: set it aside")
        begun = self._now().isoformat(timespec="seconds")
        attempt = self._store.begin(Attempt(0, serial, kind, self.line.name, operator, begun))
        attempt = replace(attempt, recording=f"recordings/{_name_of(attempt)}.mcap")
        self._store.change(attempt)
        self._begin(attempt, self._recorded(attempt))
        return attempt

    def stop(self) -> None:
        """End the attempt at work, if there is one that records; its data are kept."""
        self._why = "stopped by the operator"
        self._stop.set()

    def printed(self, number: int) -> None:
        """Note that a certificate was printed."""
        attempt = self._attempt(number)
        self._change(replace(attempt, printed=attempt.printed + 1))
        self._note(f"certificate of attempt {number}, unit {attempt.unit}, printed")
        self._reload()
        self.refresh()

    def certificate(self, number: int) -> Path:
        """Return the certificate of an attempt; the file need not exist."""
        return self.line.output / "certificates" / f"{_name_of(self._attempt(number))}.html"

    def report(self, number: int) -> Path:
        """Return the report of an attempt; the file need not exist."""
        return self._result(self._attempt(number)) / "report.html"

    def document(self, number: int) -> Path:
        """Return the JSON document of an attempt; the file need not exist."""
        return self._result(self._attempt(number)) / NAME

    def golden_due(self) -> str:
        """Return why the known unit has to be checked now; empty if it need not be."""
        golden = self.line.golden
        if golden is None:
            return ""
        own = self._store.attempts(golden.serial)
        last = [one for one in own if one.kind == "golden" and one.state == ENDED and one.outcome != INTERRUPTED]
        if not last:
            return f"check the station first: scan the known unit {golden.serial}"
        if last[-1].outcome != Decision.CONFORMS.value:
            why = last[-1].reason
            return f"the known unit {golden.serial} did not agree: {why}; mend the station, and scan it again"
        ended = datetime.fromisoformat(last[-1].ended or last[-1].begun)
        if self._now() - ended > timedelta(hours=golden.hours):
            return f"the last check is older than {golden.hours:g} h: scan the known unit {golden.serial}"
        return ""

    # messages to the page; see `dashboard.app.Source`

    def refresh(self) -> None:
        """Make the message of what is so now.

        While an attempt records, the file of results is not read: another program may hold it for a minute, and
        nothing would be received as long.
        """
        golden = self.line.golden
        if self._current is None or self._current.state != RECORDING:
            self._reload()
        due = self._due
        self._message = {
            "kind": "station",
            "station": self.line.name,
            "phase": "ready" if self._current is None else self._current.state,
            "attempt": None if self._current is None else _plain(self._current),
            "seconds": self.line.seconds,
            "progress": self._progress,
            "last": None if self._last is None else {**_plain(self._last), **self._files(self._last)},
            "recent": self._recent,
            "units": len(self._today),
            "good": sum(outcome in GOOD for outcome in self._today.values()),
            "golden": "" if golden is None else due or f"station checked with unit {golden.serial}",
            "golden_due": bool(due),
            "limits": "" if self.line.limits is None else self.line.limits.grade or self.line.limits.file,
            "software": f"kreisel {__version__}",
        }

    def _reload(self) -> None:
        self._recent, self._due = [_plain(one) for one in self._store.recent(_RECENT)], self.golden_due()

    def news(self) -> list[dict[str, Any]]:
        """Return the message if it is a new one."""
        if self._message == self._sent:
            return []
        self._sent = self._message
        return [self._sent]

    def look(self) -> None:
        """Return nothing: there are no estimates on the way."""

    def so_far(self) -> list[dict[str, Any]]:
        """Return the message."""
        return [self._message]

    # the work

    @asynccontextmanager
    async def at_work(self) -> AsyncIterator[None]:
        """Take up what an earlier station left, and end what is at work when it ends."""
        self._take_up()
        looking = asyncio.ensure_future(self._look_again())
        try:
            yield
        finally:
            looking.cancel()
            if self._task is not None:
                self._why = "the station was ended"
                self._stop.set()
                await asyncio.gather(self._task, return_exceptions=True)
            self._note("station ended")
            self._workers.shutdown(cancel_futures=True)

    def _take_up(self) -> None:
        """End attempts that a killed station left; calibrate what was recorded whole."""
        recent = self._store.recent(_RECENT)
        self._last = next((one for one in recent if one.state == ENDED), None)
        today = self._now().date().isoformat()
        for attempt in self._store.attempts_since(today):
            self._count(attempt)
        for attempt in reversed(recent):
            if attempt.state == RECORDING and attempt.station == self.line.name:
                file = self.line.output / attempt.recording
                kept = "its data up to then are kept" if file.is_file() and file.stat().st_size else "nothing was kept"
                self._end(attempt, INTERRUPTED, f"the station was killed while it recorded; {kept}; test it again")
            elif attempt.state == CALIBRATING and attempt.station == self.line.name and self._current is None:
                self._begin(attempt, self._calibrated(attempt))

    async def _look_again(self) -> None:
        """Make the message again each second: a check of the station runs out by time."""
        while True:
            self.refresh()
            await asyncio.sleep(1.0)

    def _count(self, attempt: Attempt) -> None:
        if attempt.kind == "unit" and attempt.state == ENDED and attempt.outcome != INTERRUPTED:
            self._today[attempt.unit] = attempt.outcome

    def _begin(self, attempt: Attempt, work: Any) -> None:
        self._current, self._why, self._progress = attempt, "", {}
        self._stop.clear()
        self._note(f"attempt {attempt.id}, {attempt.kind} {attempt.unit}: {attempt.state}")
        self._reload()
        self._task = asyncio.ensure_future(self._guarded(attempt, work))
        self.refresh()

    async def _guarded(self, attempt: Attempt, work: Any) -> None:
        """Do the work; whatever goes wrong ends the attempt, not the station."""
        try:
            await work
        except KreiselError as error:
            self._end(self._current or attempt, INTERRUPTED, self._why or str(error))
        except BrokenProcessPool:
            self._workers = _workers()
            self._end(self._current or attempt, INTERRUPTED, "the calibration was killed; its recording is kept")
        except Exception as error:
            self._end(self._current or attempt, INTERRUPTED, reason_of(error))
        finally:
            self._current, self._task = None, None
            self.refresh()

    async def _recorded(self, attempt: Attempt) -> None:
        line, stated = self.line, self.line.settings
        device = stated.device.model_copy(update={"serial_number": attempt.unit})
        certificate = stated.certificate
        if attempt.operator:
            certificate = certificate.model_copy(update={"operator": attempt.operator})
        status = await record(
            line.imu, line.robot, line.output / attempt.recording, seconds=line.seconds,
            settings=stated.model_copy(update={"device": device, "certificate": certificate}), urdf=line.urdf,
            stop=self._stop, show=_Watch(self).show,
        )  # fmt: skip
        if self._why:
            self._end(attempt, INTERRUPTED, self._why)
            return
        if not status.complete(with_robot=True):
            missing = "the IMU" if not status.imu.count else "the robot"
            self._end(attempt, INTERRUPTED, f"no readings came from {missing}: {' '.join(status.notes[-1:])}")
            return
        attempt = replace(attempt, state=CALIBRATING)
        self._current, self._progress = attempt, {}
        self._change(attempt)
        await self._calibrated(attempt)

    async def _calibrated(self, attempt: Attempt) -> None:
        line, name = self.line, _name_of(attempt)
        job = Job(name, line.output / attempt.recording, f"station-{name}-{attempt.begun}")
        batch = Batch([job], line.calibration, (line.output / "results").resolve(), reports=True)
        run: Run = await asyncio.get_running_loop().run_in_executor(self._workers, calibrate_one, batch, 0)
        self._store.add(run)
        (unit,) = units_of([run], line.limits)
        if attempt.kind == "golden":
            self._end_golden(attempt, run)
            return
        tests = {one.key for one in recent_tests(self._store.attempts(attempt.unit), self._now())}
        earlier = [one for one in self._store.of_unit(attempt.unit) if one.key in tests - {run.key}]
        outcome, reason = outcome_of(unit, earlier, line.limits)
        report = "report.html" if run.parts is not None else None
        write_unit(unit, line.limits, batch.results / name, report, (outcome, reason))
        if outcome in GOOD:
            reason = self._certify(attempt)
        self._end(replace(attempt, key=run.key), outcome, reason or "; ".join(reasons_of(unit)))

    def _end_golden(self, attempt: Attempt, run: Run) -> None:
        attempt = replace(attempt, key=run.key)
        golden = self.line.golden
        if run.parts is None or golden is None:
            self._end(attempt, "failed", run.error or "it is no longer the known unit")
            return
        found = golden_check(golden.reference, run.parts)
        outcome = Decision.CONFORMS.value if found.passed else Decision.FAILS.value
        text = f"agrees with what is known of it, largest difference {found.worst:.1f} deviations"
        self._end(attempt, outcome, text if found.passed else "; ".join(found.reasons))

    def _certify(self, attempt: Attempt) -> str:
        """Write the certificate of a good unit; return why there is none, empty where there is one."""
        result, path = self._result(attempt), self.line.output / "certificates" / f"{_name_of(attempt)}.html"
        try:
            calibration = Calibration.load(result)
            today = self._now().astimezone().date()
            fields, digest = fields_of(calibration, {}), digest_of(result)
            made = certificate_of(calibration, fields, self.line.limits, self.line.language, today, digest)
            write_whole(path, html(made))
        except (KreiselError, OSError) as error:
            return f"no certificate: {error}"
        return ""

    def progress(self, status: Status) -> None:
        """Take the recorder's status for the page."""
        self._progress = {
            "seconds": status.seconds,
            "imu_hz": status.imu.rate, "imu_count": status.imu.count, "imu_missing": status.imu.missing,
            "robot_hz": status.robot.rate, "robot_count": status.robot.count, "robot_missing": status.robot.missing,
            "lacks": status.excitation.missing(),
            "note": status.notes[-1] if status.notes else "",
        }  # fmt: skip
        self.refresh()

    def give_up(self, why: str) -> None:
        """End the attempt at work for a fault."""
        self._why = why
        self._stop.set()

    def _end(self, attempt: Attempt, outcome: str, reason: str) -> None:
        ended = self._now().isoformat(timespec="seconds")
        self._last = replace(attempt, state=ENDED, ended=ended, outcome=outcome, reason=reason)
        self._change(self._last)
        self._count(self._last)
        self._current = None
        self._note(f"attempt {attempt.id}, {attempt.kind} {attempt.unit}: {outcome}{f': {reason}' if reason else ''}")

    def _change(self, attempt: Attempt) -> None:
        self._store.change(attempt)
        if self._last is not None and self._last.id == attempt.id:
            self._last = attempt

    def _note(self, text: str) -> None:
        self._store.note(self._now().isoformat(timespec="seconds"), self.line.name, text)

    def _attempt(self, number: int) -> Attempt:
        found = self._store.attempt(number)
        if found is None:
            raise SettingsError(f"no attempt {number}")
        return found

    def _result(self, attempt: Attempt) -> Path:
        return self.line.output / "results" / _name_of(attempt)

    def _files(self, attempt: Attempt) -> dict[str, bool]:
        result = self._result(attempt)
        return {
            "has_certificate": self.certificate(attempt.id).is_file(),
            "has_report": (result / "report.html").is_file(),
            "has_document": (result / NAME).is_file(),
        }


class _Watch:
    """Ends an attempt whose devices have become silent."""

    def __init__(self, station: Station) -> None:
        self._station = station
        self._seen: dict[str, tuple[int, float]] = {}

    def show(self, status: Status) -> None:
        """Look at the recorder's status, twice a second."""
        self._station.progress(status)
        now = time.monotonic()
        for name, count in (("IMU", status.imu.count), ("robot", status.robot.count)):
            before, since = self._seen.get(name, (-1, now))
            if count != before:
                self._seen[name] = (count, now)
            elif now - since > (SILENT if count else PATIENCE):
                self._station.give_up(
                    f"no readings of the {name} for {now - since:.0f} s: check plug, power and address, then test again"
                )


def _workers() -> ProcessPoolExecutor:
    """Return what calibrates: a process of its own, which cannot delay a recording, nor end the station."""
    return ProcessPoolExecutor(1, get_context("spawn"), initializer=_undisturbed)


def _undisturbed() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the station, which ends its worker


def _printable(text: str) -> str:
    return "".join(c for c in text if c.isprintable()).strip()


def _name_of(attempt: Attempt) -> str:
    return f"{attempt.id:06d}-{re.sub(r'[^A-Za-z0-9._-]', '_', attempt.unit)}"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _plain(attempt: Attempt) -> Mapping[str, Any]:
    names = ("id", "unit", "kind", "operator", "begun", "ended", "state", "outcome", "reason", "printed")
    return {name: getattr(attempt, name) for name in names}
