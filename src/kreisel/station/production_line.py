"""What is the same for all units of a station."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from kreisel.calibration.limits import Limits
from kreisel.calibration.result import Calibration
from kreisel.devices.address import Address
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording_settings import RecordingSettings


@dataclass(frozen=True)
class Golden:
    """The unit that checks the station: its serial number, what is known of it, and for how long a check holds, h."""

    serial: str
    reference: Calibration
    hours: float


@dataclass(frozen=True)
class Line:
    """What is the same for all units of a station.

    Attributes
    ----------
    seconds
        Length of a recording.
    settings
        recording.toml of every unit; its serial number is that of the unit.
    name
        Of the station; stands in the file of results.
    retests
        How often a unit may be tested again.
    golden
        None where no unit checks the station.
    language
        Of certificates.
    """

    imu: Address
    robot: Address
    output: Path
    seconds: float
    limits: Limits | None
    settings: RecordingSettings = field(default_factory=RecordingSettings)
    urdf: str | None = None
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    name: str = ""
    retests: int = 1
    golden: Golden | None = None
    language: str = "en"
