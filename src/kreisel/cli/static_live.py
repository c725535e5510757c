"""`kreisel static --live`: record an IMU while saying what to do next."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kreisel.files import open_fresh

if TYPE_CHECKING:
    import asyncio

    from kreisel.acquisition.recorder import Status
    from kreisel.cli.static import Guided
    from kreisel.devices.address import Address
    from kreisel.static.guide import Advice, Guide

_PAUSE = 0.3
"""Seconds between two looks at the readings."""

RECORDING = "recording.mcap"
"""The recording, in the result's folder."""


def record_guided(address: str, output: Path, how: Guided) -> Path:
    """Record until the advice is to stop, or until interrupted; return the recording.

    Raises
    ------
    SettingsError, DeviceError, RecordingError
        For a wrong address or target, a device that does not answer, or a recording that exists.
    """
    from kreisel.acquisition.recorder import Place
    from kreisel.cli.record import check_complete
    from kreisel.cli.targets import targets
    from kreisel.cli.watch import check_page_installed, page_of
    from kreisel.devices.address import IMUS, parse_address
    from kreisel.static.guide import Guide

    of_imu = parse_address(address, IMUS)
    guide = Guide(targets(how.until), how.gravity)
    file = output / RECORDING
    if how.dashboard:
        check_page_installed()
    output.mkdir(parents=True, exist_ok=True)
    with page_of(file, how.port, wanted=how.dashboard, guide=True, host=how.host):
        status = _recorded(of_imu, file, guide, how.seconds)
    check_complete(status, (of_imu,), None, Place.of(file))
    typer.echo(f"{file}: {status.seconds:.1f} s, {status.imu.count} IMU samples", err=True)
    return file


def _recorded(of_imu: Address, file: Path, guide: Guide, seconds: float | None) -> Status:
    """Record and advise, each without waiting for the other."""
    import asyncio

    from kreisel.acquisition.recorder import record
    from kreisel.cli.record import interrupted

    async def until_stopped() -> Status:
        stop = interrupted()
        recording = asyncio.ensure_future(record(of_imu, None, file, seconds=seconds, stop=stop))
        advising = asyncio.ensure_future(_advise(guide, file, stop))
        try:
            return await recording
        finally:
            advising.cancel()
            await asyncio.gather(advising, return_exceptions=True)

    return asyncio.run(until_stopped())


async def _advise(guide: Guide, file: Path, stop: asyncio.Event) -> None:
    """Look at the readings so far again and again; set `stop` when it is enough."""
    import asyncio

    from kreisel.acquisition.tail import Tail
    from kreisel.errors import KreiselError

    tail, say = Tail(file), _Say(file.parent)

    def look() -> Advice | None:
        tail.read()
        return guide.look(tail.recording()) if tail.begun else None

    while True:
        await asyncio.sleep(_PAUSE)
        try:
            advice = await asyncio.to_thread(look)
        except KreiselError:
            continue  # too short yet
        if advice is None:
            continue
        say(advice)
        if advice.step == "done":
            stop.set()
            return


class _Say:
    """Say advice: on the terminal where it changes, and in a file for the page."""

    def __init__(self, folder: Path) -> None:
        from kreisel.dashboard.guide_feed import ADVICE

        self._file = folder / ADVICE
        self._last = ""

    def __call__(self, advice: Advice) -> None:
        waiting = self._file.with_suffix(".part")
        with open_fresh(waiting) as file:
            file.write(json.dumps(advice.document).encode())
        waiting.replace(self._file)
        text = f"{len(advice.had):3d} attitudes  {advice.text if advice.step != 'hold' else 'Hold still.'}"
        if advice.note:
            text += f" ({advice.note})"
        if text != self._last:
            self._last = text
            typer.echo(text, err=True)
