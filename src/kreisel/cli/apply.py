"""`kreisel apply`: correct raw readings by a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import typer

from kreisel.cli import completion, options

if TYPE_CHECKING:
    from collections.abc import Callable

    from kreisel.array.fused_imu import FusedImu
    from kreisel.calibration.result import Calibration
    from kreisel.geometry.rotation import Array

    Write = Callable[[bytes], None]

_STREAM = "-"
_TOPIC = "/imu/data_calibrated"


def apply(
    calibration: Path = typer.Argument(
        ..., help="Result folder, or its calibration.yaml; with --fuse that of several IMUs."
    ),
    raw: str = typer.Argument(
        ...,
        help="Raw readings: a table, a recording folder, an .mcap file, a bag, - for a table on standard input, or the "
        "address of a device (csv://127.0.0.1:4000).",
    ),
    output: str = typer.Option(
        ..., "-o", "--output", help="What to write: the same kind, or a .csv file; - for standard output."
    ),
    axes: str | None = typer.Option(
        None,
        help="Axes of what is written: tool (by default, where there was one), or the device's: imu, gyro, nominal.",
        autocompletion=completion.one_of(completion.AXES),
    ),
    imu: str | None = typer.Option(
        None,
        help="IMU: a folder's name, or a topic (TOPIC@FRAME_ID); with --fuse, all: those on all topics.",
        autocompletion=completion.streams,
    ),
    columns: list[str] = options.COLUMNS,
    topic: str = typer.Option(_TOPIC, help="Topic of corrected readings in the copy of a bag."),
    seconds: float | None = typer.Option(None, min=0.1, help="End after so many seconds; for devices."),
    force: bool = typer.Option(
        False, "--force", help="Use a calibration that was rejected, and readings in implausible units."
    ),
    fuse: bool = typer.Option(False, "--fuse", help="Fuse all IMUs of a recording to one, with the best weights."),
    json: bool = typer.Option(False, "--json", help="With --fuse: print weights and noise as one JSON object."),
) -> None:
    """Write true angular rate and specific force of raw readings.

    Derivatives for lever arms are those of the cubic closest to seven samples: a stream is late by three samples.
    """
    from kreisel.application.corrected_files import apply_to_file, check_usable
    from kreisel.array.array_file import is_array
    from kreisel.calibration.result import Calibration
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.errors import SettingsError
    from kreisel.formats.imus import ALL
    from kreisel.progress import of_step

    if fuse:
        others = {"--axes": axes not in (None, "tool"), "--map": columns, "--seconds": seconds}
        others["--imu"] = imu not in (None, ALL)
        _refuse({**others, "--topic": topic != _TOPIC, "-o -": output == _STREAM, raw: raw == _STREAM or "://" in raw})
        _apply_fused(calibration, Path(raw), Path(output), imu, force=force, as_json=json)
        return
    if json:
        raise SettingsError("--json is for --fuse")
    if is_array(calibration):
        raise SettingsError(f"{calibration} is of several IMUs; give the folder of one in it, or --fuse")
    found = Calibration.load(calibration)
    check_usable(found, force=force)
    if found.verdict.caution:
        typer.echo(f"· {found.verdict.caution}", err=True)
    chosen = found if axes is None else found.in_axes(axes)
    _tell(chosen)
    if raw == _STREAM or "://" in raw:
        if columns or imu:
            raise SettingsError("--map and --imu are for files; a stream has the columns of a recording's table")
        if raw == _STREAM and seconds is not None:
            raise SettingsError("--seconds is for devices; a table ends by itself")
        _apply_to_stream(chosen, raw, output, seconds, force=force)
        return
    if seconds is not None:
        raise SettingsError("--seconds is for devices; a file ends by itself")
    if output == _STREAM:
        if columns or imu:
            raise SettingsError("-o - is for a table as kreisel writes them; with --map or --imu give -o FILE")
        _apply_to_pipe(chosen, Path(raw), force=force)
        return
    with progress_bar() as show:
        done = apply_to_file(
            chosen,
            Path(raw),
            Path(output),
            imu=imu,
            columns=columns,
            topic=topic,
            force=force,
            progress=of_step(show, "apply"),
        )
    for warning in done.warnings:
        typer.echo(f"· {warning}", err=True)
    typer.echo(f"written: {done.path}, {done.samples} samples", err=True)


def _refuse(options: dict[str, object]) -> None:
    """Raise an error for options that do not go with --fuse; options: whether each was given."""
    from kreisel.errors import SettingsError

    given = [name for name, value in options.items() if value]
    if given:
        raise SettingsError(
            f"{given[0]} does not go with --fuse: it writes a file of all IMUs of a recording, in axes of b"
        )


def _apply_fused(calibration: Path, raw: Path, output: Path, imu: str | None, *, force: bool, as_json: bool) -> None:
    """Write the readings of the fused IMU, and say how it consists of the units."""
    import json

    from kreisel.application.fused_files import fuse_files
    from kreisel.array.array_file import is_array, load_array
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.errors import SettingsError

    if calibration.exists() and not is_array(calibration):
        raise SettingsError(f"--fuse is for the result of several IMUs, with array.yaml; {calibration} is of one")
    array = load_array(calibration)
    with progress_bar() as show:
        done = fuse_files(array, raw, output, imu=imu, force=force, progress=show)
    for warning in done.warnings:
        typer.echo(f"· {warning}", err=True)
    if as_json:
        typer.echo(json.dumps({**done.imu.document, "warnings": list(done.warnings), "output": str(done.path)}))
    else:
        _say_fused(raw.resolve().name, done.imu)
    typer.echo(f"written: {done.path}, {done.imu.stamps_ns.size} samples", err=True)


def _say_fused(title: str, imu: FusedImu) -> None:
    """Print weights and noise of the units and of the fused IMU, and which were left out."""
    from kreisel.cli.terminal_tables import print_rows, print_sentences
    from kreisel.units import DEG_PER_ROOT_HOUR, MG

    def noise(density: Array | None) -> list[str]:
        if density is None:
            return ["-", "-"]
        return [f"{density[0] / DEG_PER_ROOT_HOUR:.3g}", f"{1e3 * density[1] / MG:.3g}"]

    rows = [
        [unit.name, *(f"{100.0 * w:.1f}" for w in unit.weight), *noise(unit.density), f"{100.0 * unit.share:.4g}"]
        for unit in imu.units
    ]
    rows.append(["fused, by the weights", "100", "100", *noise(imu.predicted), "100"])
    rows.append(["fused, measured", "", "", *noise(imu.measured), ""])
    heads = ("unit", "gyros, %", "accelerometers, %", "gyros, deg/sqrt(h)", "accelerometers, ug/sqrt(Hz)", "samples, %")
    print_rows(f"{title}: weights and noise densities", heads, rows, 1)
    how = "at standstills" if imu.at_rest else "by third differences, for there are hardly any standstills"
    lines = [f"noise densities {how}; stamps are those of {imu.units[0].name}"]
    if imu.lost:
        lines.append(f"· {imu.lost} samples were left out: no unit has readings there that are not clipped")
    lines += [f"· left out: {name}: {reason}" for name, reason in imu.left_out.items()]
    print_sentences(lines)


def _tell(calibration: Calibration) -> None:
    """Say on standard error which axes are used, and what must not be relied on."""
    from kreisel.calibration.device_axes import AXES

    typer.echo(f"axes {calibration.axes}: {AXES[calibration.axes]}", err=True)
    lost = calibration.verdict.unobservable
    if lost:
        more = f" and {len(lost) - 4} more" if len(lost) > 4 else ""
        typer.echo(f"· not observable, do not rely on {', '.join(lost[:4])}{more}", err=True)


def _standard(name: str) -> BinaryIO:
    """Return standard input or output.

    Raises
    ------
    SettingsError
        If it is closed.
    """
    import sys

    from kreisel.errors import SettingsError

    stream = {"input": sys.stdin, "output": sys.stdout}[name]
    if stream is None:
        raise SettingsError(f"standard {name} is closed; give a file in its place")
    return stream.buffer


def _apply_to_pipe(calibration: Calibration, raw: Path, *, force: bool) -> None:
    """Write a table to standard output."""
    from kreisel.application.corrected_files import apply_to_pipe

    warnings = apply_to_pipe(calibration, raw, _standard("output").write, force=force)
    for warning in warnings:
        typer.echo(f"· {warning}", err=True)


def _apply_to_stream(calibration: Calibration, raw: str, output: str, seconds: float | None, *, force: bool) -> None:
    """Correct what comes on standard input or from a device; every row is written at once."""
    from contextlib import ExitStack

    with ExitStack() as stack:
        file = _standard("output") if output == _STREAM else stack.enter_context(Path(output).open("xb"))

        def write(rows: bytes) -> None:
            file.write(rows)
            file.flush()

        if raw == _STREAM:
            _from_standard_input(calibration, write, force=force)
        else:
            _from_device(calibration, raw, write, seconds)


def _from_standard_input(calibration: Calibration, write: Write, *, force: bool) -> None:
    import os

    from kreisel.application.corrected_tables import CorrectedTable

    table = CorrectedTable(calibration, Path("standard input"), check=not force)
    descriptor = _standard("input").fileno()
    try:
        while data := os.read(descriptor, 1 << 16):
            if rows := table.feed(data):
                write(rows)
    except KeyboardInterrupt:
        pass
    rest, cut = table.close()
    write(rest)
    for note in table.notes:
        typer.echo(f"· {note}", err=True)
    if cut is not None:
        typer.echo(f"· the last line had no end and was left out: {cut[-40:]}", err=True)


def _from_device(calibration: Calibration, address: str, write: Write, seconds: float | None) -> None:
    import asyncio
    import signal
    from contextlib import suppress

    from kreisel.application.device import correct_events
    from kreisel.devices.address import IMUS, parse_address
    from kreisel.devices.opening import events

    async def run() -> None:
        work = asyncio.ensure_future(
            correct_events(
                calibration, events(parse_address(address, IMUS)), write, lambda text: typer.echo(f"· {text}", err=True)
            )
        )
        loop = asyncio.get_running_loop()
        for name in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(name, work.cancel)
        if seconds is not None:
            loop.call_later(seconds, work.cancel)
        with suppress(asyncio.CancelledError):
            await work

    asyncio.run(run())
