"""`kreisel station`: calibrate one unit after another, by an operator at a page."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kreisel.cli import completion
from kreisel.cli.watch import PORT

if TYPE_CHECKING:
    from kreisel.station.production_line import Golden


def station(
    imu: str = typer.Option(
        ..., "--imu", help="Address of the IMU, as for `kreisel record`.", autocompletion=completion.imus
    ),
    robot: str = typer.Option(
        ..., "--robot", help="Address of the robot, as for `kreisel record`.", autocompletion=completion.robots
    ),
    output: Path = typer.Option(..., "-o", "--output", help="Folder for everything; one in use is continued."),
    seconds: float = typer.Option(120.0, "--seconds", min=5.0, help="Length of each recording, s."),
    limits: str | None = typer.Option(
        None, help="Limits: a TOML file with [limits], or a grade.", autocompletion=completion.grades
    ),
    settings: Path | None = typer.Option(None, help="recording.toml for every unit."),
    urdf: Path | None = typer.Option(None, help="The robot's description; needed to use joint angles."),
    fix: list[str] = typer.Option(
        [], help="Group or parameter not to estimate; may be repeated.", autocompletion=completion.parameters
    ),
    retests: int = typer.Option(1, min=0, help="How often a unit may be tested again."),
    golden: Path | None = typer.Option(None, help="Result of the known unit that checks the station."),
    golden_hours: float = typer.Option(12.0, min=0.1, help="For how many hours such a check holds."),
    name: str = typer.Option("", "--name", help="The station's name, for the file of results."),
    language: str = typer.Option(
        "en",
        "--language",
        help="Language of certificates, en or de.",
        autocompletion=completion.one_of(completion.LANGUAGES),
    ),
    host: str = typer.Option(
        "127.0.0.1", help="Address to serve the page on; any other than this machine's needs a token."
    ),
    port: int = PORT,
) -> None:
    """Serve a page on which an operator scans a serial number, and sees whether the unit passes.

    Each unit is recorded while the robot moves it by its own program, calibrated, judged by the limits, and gets a
    certificate. Nothing that moves the robot is sent. Everything is kept in OUT/results.db; a killed station goes on.
    """
    from kreisel.batch.result_store import Store
    from kreisel.calibration.limits import limits_named
    from kreisel.certificate.words import LANGUAGES
    from kreisel.cli.output import alone_in, check_output
    from kreisel.cli.record import description
    from kreisel.devices.address import IMUS, ROBOTS, parse_address
    from kreisel.errors import SettingsError, unknown_name
    from kreisel.model.calibration_settings import CalibrationSettings
    from kreisel.model.stated_parameters import parse_fixed
    from kreisel.recording.recording_settings import RecordingSettings, read_settings
    from kreisel.station.production_line import Line

    try:
        from kreisel.dashboard.serving import address_of, listening, server_of
        from kreisel.station.server import station_app
        from kreisel.station.station import Station
    except ImportError as error:
        raise SettingsError(f"the page needs an extra ({error.name}): pip install 'kreisel[serve]'") from error
    if language not in LANGUAGES:
        raise SettingsError(unknown_name("language", language, LANGUAGES))
    line = Line(
        parse_address(imu, IMUS), parse_address(robot, ROBOTS), output, seconds,
        None if limits is None else limits_named(limits),
        RecordingSettings() if settings is None else read_settings(settings),
        None if urdf is None else description(urdf),
        CalibrationSettings(fixed=parse_fixed(fix)), name, retests, _golden(golden, golden_hours), language,
    )  # fmt: skip
    check_output(output)
    output.mkdir(parents=True, exist_ok=True)
    with alone_in(output, "station"), Store(output / "results.db") as store, closing(listening(host, port)) as listener:
        station = Station(line, store)
        station.announce()
        app, token = station_app(station, host)
        typer.echo(address_of(listener, host, token))
        server_of(app).run(sockets=[listener])


def _golden(result: Path | None, hours: float) -> Golden | None:
    from kreisel.calibration.result import Calibration
    from kreisel.errors import SettingsError
    from kreisel.station.production_line import Golden

    if result is None:
        return None
    found = Calibration.load(result)
    if not found.accepted:
        raise SettingsError(f"--golden {result}: was rejected; give an accepted result of the known unit")
    facts = found.recording
    serial = "" if facts is None else facts.device.get("serial_number", "")
    if not serial:
        raise SettingsError(f"--golden {result}: states no serial number; set it in [device] of its recording.toml")
    return Golden(serial, found, hours)
