"""`kreisel static --live`: record an IMU while saying what to do next."""

from __future__ import annotations

import json
import math
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from kreisel.files import open_fresh

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterator

    from kreisel.acquisition.recorder import Status
    from kreisel.devices.address import Address
    from kreisel.recording.recording import Recording
    from kreisel.static.guide import Advice, Estimator, Guide
    from kreisel.static.static_result import StaticOutcome

_PAUSE = 0.3
"""Seconds between two looks at the readings."""

_SILENT = 5.0
"""Seconds without a reading after which that is said."""

_USELESS = 15.0
"""Seconds of lines that cannot be read, and nothing else, after which it ends."""

_LINGER = 1.0
"""Seconds for which the page is served when all is done. Chosen: twenty of the intervals at which it looks."""

_SHOWN = 10.0
"""Seconds of readings from which on they are said to be useless. Chosen: a second more than checks need."""

RECORDING = "recording.mcap"
"""The recording, in the result's folder."""


class Guided(NamedTuple):
    """What is stated of a calibration under guidance: see the options of `static`."""

    until: tuple[str, ...]
    only: str | None
    method: str | None
    seconds: float | None
    dashboard: bool
    host: str
    port: int
    as_json: bool


def record_guided(address: str, output: Path, how: Guided, calibrate: Estimator, page: ExitStack) -> Path:
    """Record until the advice is to stop, or until interrupted; return the recording.

    Parameters
    ----------
    calibrate
        By which estimates are made meanwhile.
    page
        Closes the page.

    Raises
    ------
    SettingsError, DeviceError, RecordingError
        For a wrong address or target, a device that does not answer, or a recording that exists.
    """
    from kreisel.acquisition.recorder import Place
    from kreisel.cli.record import check_complete
    from kreisel.cli.targets import targets
    from kreisel.cli.watch import check_page_installed, page_of
    from kreisel.dashboard.guide_feed import ADVICE, ended
    from kreisel.devices.address import IMUS, parse_address
    from kreisel.static.guide import Guide

    of_imu = parse_address(address, IMUS)
    guide = Guide(calibrate, targets(how.until), method=how.method, only=how.only)
    file = output / RECORDING
    if how.dashboard:
        check_page_installed()
    output.mkdir(parents=True, exist_ok=True)
    page.enter_context(
        page_of(file, how.port, wanted=how.dashboard, guide=True, host=how.host, beside_json=how.as_json)
    )
    status = _recorded(of_imu, file, guide, how.seconds)
    check_complete(status, (of_imu,), None, Place.of(file))
    typer.echo(f"{file}: {status.seconds:.1f} s, {status.imu.count} IMU samples; calibrating", err=True)
    _replaced(output / ADVICE, ended(output / ADVICE, "Recorded. Calibrating …", ""))
    return file


@contextmanager
def recording_kept(file: Path, live: str | None) -> Iterator[None]:
    """Say at an interrupt of the calibration of a device's readings what is kept, and what goes on with it."""
    try:
        yield
    except KeyboardInterrupt:
        if live is not None:
            typer.echo(f"interrupted; the recording is kept: kreisel static {file} -o OUT calibrates it", err=True)
        raise


@contextmanager
def end_shown(output: Path | None, how: Guided) -> Iterator[Callable[[StaticOutcome], None]]:
    """Show on the page how a calibration ended, for long enough that a browser receives it.

    Yields the function that takes the result; errors are shown, too.
    """
    from kreisel.errors import KreiselError

    def show(text: str, note: str) -> None:
        from kreisel.dashboard.guide_feed import ADVICE, ended

        if how.dashboard and output is not None:
            _replaced(output / ADVICE, ended(output / ADVICE, text, note))
            time.sleep(_LINGER)

    def show_outcome(outcome: StaticOutcome) -> None:
        verdict = outcome.calibration.verdict
        text = "Done: the calibration is accepted." if verdict.accepted else "The calibration is rejected."
        show(text, "; ".join(verdict.reasons) or f"Result and report are in {output}.")

    try:
        yield show_outcome
    except KreiselError as error:
        show("There is no calibration.", str(error))
        raise


def _recorded(of_imu: Address, file: Path, guide: Guide, seconds: float | None) -> Status:
    """Record and advise, each without waiting for the other."""
    import asyncio

    from kreisel.acquisition.recorder import record
    from kreisel.cli.record import interrupted

    async def until_stopped() -> Status:
        stop, say = interrupted(), _Say(file.parent)
        silence = _Silence(str(of_imu), say, stop, seconds)
        recording = asyncio.ensure_future(record(of_imu, None, file, seconds=seconds, stop=stop, show=silence))
        advising = asyncio.ensure_future(_advise(guide, file, stop, say, silence))
        try:
            return await recording
        finally:
            advising.cancel()
            await asyncio.gather(advising, return_exceptions=True)

    return asyncio.run(until_stopped())


async def _advise(guide: Guide, file: Path, stop: asyncio.Event, say: _Say, silence: _Silence) -> None:
    """Look at the readings so far again and again; set `stop` when it is enough."""
    import asyncio

    from kreisel.acquisition.tail import Tail
    from kreisel.errors import KreiselError, RecordingError

    tail = Tail(file)
    took, estimating = 0.0, asyncio.Future[None]()
    estimating.set_result(None)

    def look() -> tuple[Recording, Advice] | None:
        tail.read()
        if not tail.begun:
            return None
        recording = tail.recording()
        return recording, guide.look(recording)

    while True:
        await asyncio.sleep(max(_PAUSE, took))  # readings of an hour take longer to look at than those of a minute
        if silence.lasts:
            continue
        began = time.monotonic()
        try:
            seen = await asyncio.to_thread(look)
        except KreiselError as error:
            if silence.recorded > _SHOWN:  # before, it is too short yet
                text = error.message if isinstance(error, RecordingError) else str(error)
                say.problem(f"These readings cannot be used: {text}")
            continue
        took = time.monotonic() - began
        if seen is None:
            continue
        recording, advice = seen
        say(advice)
        if advice.step == "done":
            stop.set()
            return
        if guide.due and estimating.done():
            estimating = asyncio.ensure_future(asyncio.to_thread(_estimate, guide, recording, advice, stop))


class _AbandonedError(Exception):
    """Ends an estimate that nobody waits for."""


def _estimate(guide: Guide, recording: Recording, advice: Advice, stop: asyncio.Event) -> None:
    """Estimate, unless the recording ends meanwhile."""

    def check(step: str, share: float) -> None:
        del step, share
        if stop.is_set():
            raise _AbandonedError

    with suppress(_AbandonedError):
        guide.estimate(recording, advice, check)


class _Silence:
    """Says what the recorder says, and when no readings come.

    Parameters
    ----------
    seconds
        After which it sets `stop`, if no reading came at all.

    Attributes
    ----------
    lasts, recorded
        Whether no readings come now; seconds of readings so far.
    """

    def __init__(self, address: str, say: _Say, stop: asyncio.Event, seconds: float | None) -> None:
        self.lasts, self.recorded = False, 0.0
        self._address, self._say, self._stop, self._seconds = address, say, stop, seconds
        self._noted, self._count, self._note = 0, 0, ""
        self._began = self._last = time.monotonic()

    def __call__(self, status: Status) -> None:
        from kreisel.devices.faults import REPEATED
        from kreisel.protocols.line import NAME

        for note in status.notes[self._noted :]:
            if not note.endswith(REPEATED):
                self._note = note
                typer.echo(note, err=True)
        self._noted, self.recorded, now = len(status.notes), status.seconds, time.monotonic()
        if status.imu.count > self._count:
            self._count, self._last = status.imu.count, now
        self.lasts = now - self._last > _SILENT
        if self.lasts:
            why = f" ({self._note})" if self._note and not self._count else ""
            self._say.problem(f"No readings come from {self._address}{why}: is it connected, and does it send?")
        useless = self._note.startswith(f"{NAME}: ")  # it sends lines, but none that can be read
        longest = min(math.inf if self._seconds is None else self._seconds, _USELESS if useless else math.inf)
        if not self._count and now - self._began > longest:
            self._stop.set()


class _Say:
    """Say advice: on the terminal where it changes, and in a file for the page."""

    def __init__(self, folder: Path) -> None:
        from kreisel.dashboard.guide_feed import ADVICE

        self._file = folder / ADVICE
        self._last = ""

    def __call__(self, advice: Advice) -> None:
        _replaced(self._file, advice.document)
        count = len(advice.had)
        standstills = "standstill " if count == 1 else "standstills"
        text = f"{count:3d} {standstills}  {advice.text if advice.step != 'hold' else 'Hold still.'}"
        if advice.note:
            text += f" ({advice.note})"
        self._print(text)

    def problem(self, text: str) -> None:
        """Say why there is no advice."""
        from kreisel.dashboard.guide_feed import problem

        _replaced(self._file, problem(text))
        self._print(text)

    def _print(self, text: str) -> None:
        if text != self._last:
            self._last = text
            typer.echo(text, err=True)


def _replaced(file: Path, document: dict[str, Any]) -> None:
    """Write a file as a whole, or not at all."""
    waiting = file.with_suffix(".part")
    with open_fresh(waiting) as stream:
        stream.write(json.dumps(document).encode())
    waiting.replace(file)
