"""What an export writes, and what it is given besides the calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from kreisel.array.array_file import ArrayUnit
from kreisel.calibration.result import Calibration
from kreisel.exchange.exported_noise import ExportNoise
from kreisel.inertial.sensor_model import SensorParameters


@dataclass(frozen=True)
class ExportRequest:
    """What is exported.

    Attributes
    ----------
    calibration
        In the axes it is exported in.
    noise
        The IMU's noise; formats that hold it raise an error where figures are missing.
    name
        Of functions and constants in source code.
    rate_hz, topic
        Of the readings in use; for formats that name them.
    instance
        Number of the sensor in an autopilot, from 0.
    """

    calibration: Calibration
    noise: ExportNoise = field(default_factory=ExportNoise)
    name: str = "imu"
    rate_hz: float | None = None
    topic: str = "/imu/data_raw"
    instance: int = 0

    @property
    def caveats(self) -> tuple[str, ...]:
        """What whoever uses a file must know, whatever its format: written into each that has comments."""
        verdict, counts = self.calibration.verdict, self.calibration.counts
        out = []
        if not verdict.accepted:
            out.append(f"REJECTED, do not use: {'; '.join(verdict.reasons) or 'no reason is in the file'}")
        if counts is not None:
            zeros = (", ".join(f"{x:.9g}" for x in zero) for zero in (counts.rate_zero, counts.acceleration_zero))
            rate_zero, acceleration_zero = zeros
            out.append(
                f"Of counts, first: rates (count - [{rate_zero}]) * {counts.rate:.9g} rad/s, accelerations "
                f"(count - [{acceleration_zero}]) * {counts.acceleration:.9g} m/s^2"
            )
        return tuple(out)


@dataclass(frozen=True)
class Exported:
    """The result of an export.

    Attributes
    ----------
    files
        Texts by what is put between the stem and the suffix of the file's name; "" for a single file.
    held
        The model that a reader of the files applies, in axes of the export.
    lost
        What the format does not hold, with its size.
    notes
        What must be known to use them.
    """

    files: dict[str, str]
    held: SensorParameters
    lost: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlacedUnit:
    """A unit of a tray as it is exported: where it is, and the request of its own export, in axes `imu`."""

    unit: ArrayUnit
    request: ExportRequest


@dataclass(frozen=True)
class ArrayRequest:
    """What is exported of a tray.

    Attributes
    ----------
    title
        What the files are said to be of.
    units
        The reference unit first.
    left_out
        Units that are not exported, with the reasons.
    """

    title: str
    units: tuple[PlacedUnit, ...]
    left_out: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ExportedArray:
    """The result of an export of a tray; fields as those of `Exported`."""

    files: dict[str, str]
    lost: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
