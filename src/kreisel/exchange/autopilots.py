"""Parameters of PX4 and ArduPilot: offset and scale of each axis, and of gyros the offset alone.

Both subtract the offset in the sensor's own axes and multiply by the scale. Sources: Accelerometer.hpp and
Gyroscope.hpp of PX4-Autopilot; AP_InertialSensor_Backend.cpp of ardupilot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from kreisel.calibration.result import Calibration
from kreisel.errors import RecordingError, SettingsError
from kreisel.exchange.exported import Exported, ExportRequest
from kreisel.exchange.imported import imported
from kreisel.exchange.losses import losses, without_effects_of
from kreisel.files import read_text
from kreisel.geometry.rotation import Array, lengths
from kreisel.inertial.sensor_model import SensorParameters

_FLOAT = 9
"""Type of a parameter in a file of QGroundControl: a float of 32 bits."""

ARDUPILOT_SCALES, ARDUPILOT_OFFSET = (0.8, 1.2), 3.5
"""Ranges of INS_ACCSCAL and INS_ACCOFFS."""

PX4_SCALES = (0.1, 3.0)
"""Range of CAL_ACC_XSCALE."""


def _held(full: SensorParameters) -> SensorParameters:
    """Return offset and scale along each sensitive axis, for the axes of the sensor itself."""
    scale = 1.0 / lengths(np.linalg.inv(full.K_a)) * np.sign(np.diag(full.K_a))
    plain = without_effects_of(full)
    return replace(plain, K_omega=np.eye(3), K_a=np.diag(scale), lever_arms=np.zeros((3, 3)))


def _check(request: ExportRequest, held: SensorParameters) -> tuple[Array, Array]:
    """Return scale and offset (3,) of the accelerometers.

    Raises
    ------
    SettingsError
        In the tool's axes, or if an axis counts downward.
    """
    if request.calibration.axes == "tool":
        raise SettingsError(
            "--axes tool: an autopilot keeps an offset and a scale for each axis of the sensor; use --axes imu, and "
            "give the mounting to the autopilot as its board's rotation"
        )
    scale = np.diag(held.K_a)
    if np.any(scale <= 0.0):
        raise SettingsError(
            "the accelerometers are a left-handed triad, which the autopilot's driver turns; export after it"
        )
    return scale, -held.k_a[0]


_AXES = "XYZ"

_COMMON_NOTES = (
    "The axes are those of the sensor as the driver gives them; readings and results are specific force, +g upward at "
    "rest (in the autopilot's frame, whose z points down, z reads -g).",
)


def export_px4(request: ExportRequest) -> Exported:
    """Return a parameter file of QGroundControl.

    Raises
    ------
    SettingsError
        If a scale is out of PX4's range, or in the tool's axes.
    """
    full, i = request.calibration.sensors, request.instance
    held = _held(full)
    scale, offset = _check(request, held)
    _check_range(f"CAL_ACC{i}_XSCALE", scale, PX4_SCALES)
    values = {f"CAL_ACC{i}_{axis}OFF": x for axis, x in zip(_AXES, offset, strict=True)}
    values |= {f"CAL_ACC{i}_{axis}SCALE": x for axis, x in zip(_AXES, scale, strict=True)}
    values |= {f"CAL_GYRO{i}_{axis}OFF": x for axis, x in zip(_AXES, -held.k_w[0], strict=True)}
    notes = (
        *_COMMON_NOTES,
        f"PX4 uses CAL_ACC{i} and CAL_GYRO{i} for the sensor whose identifier is in CAL_ACC{i}_ID and CAL_GYRO{i}_ID; "
        "this file leaves these as they are.",
        "Some versions ignore changes of offset or scale whose norm is below 0.01: compare after loading.",
    )
    return _exported(request, held, notes, "#", lambda name, x: f"1\t1\t{name}\t{x:.9g}\t{_FLOAT}", values,
                     ("Onboard parameters for Vehicle 1", "", "Vehicle-Id Component-Id Name Value Type"))  # fmt: skip


def export_ardupilot(request: ExportRequest) -> Exported:
    """Return a parameter file of Mission Planner, MAVProxy and QGroundControl for ArduPilot.

    Raises
    ------
    SettingsError
        If an offset or scale is out of ArduPilot's range, or in the tool's axes.
    """
    full, i = request.calibration.sensors, request.instance
    if not 0 <= i <= 2:
        raise SettingsError(f"--instance {i}: ArduPilot has these names for 0, 1 and 2")
    held = _held(full)
    scale, offset = _check(request, held)
    number = "" if i == 0 else str(i + 1)
    accel, gyro = f"INS_ACC{number}", f"INS_GYR{number}"
    _check_range(f"{accel}SCAL_X", scale, ARDUPILOT_SCALES)
    _check_range(f"{accel}OFFS_X", offset, (-ARDUPILOT_OFFSET, ARDUPILOT_OFFSET))
    values = {f"{accel}OFFS_{axis}": x for axis, x in zip(_AXES, offset, strict=True)}
    values |= {f"{accel}SCAL_{axis}": x for axis, x in zip(_AXES, scale, strict=True)}
    values |= {f"{gyro}OFFS_{axis}": x for axis, x in zip(_AXES, -held.k_w[0], strict=True)}
    notes = (
        *_COMMON_NOTES,
        "ArduPilot finds the gyros' offsets anew at every start unless INS_GYR_CAL is 0.",
        f"The accelerometers count as calibrated only if {accel}_ID is that of the sensor.",
    )
    return _exported(request, held, notes, "#", lambda name, x: f"{name},{x:.9g}", values, ())


def _exported(request, held, notes, mark, line, values: Mapping[str, float], head) -> Exported:  # type: ignore[no-untyped-def]
    lost = losses(request.calibration.sensors, held)
    comments = [*head, *request.caveats, *notes, *(f"Not held: {text}" for text in lost)]
    lines = [*(f"{mark} {text}".rstrip() for text in comments), *(line(n, float(x)) for n, x in values.items())]
    return Exported({"": "\n".join(lines) + "\n"}, held, lost, notes)


def _check_range(name: str, values: Array, limits: tuple[float, float]) -> None:
    for axis, x in zip(_AXES, values, strict=True):
        if not limits[0] <= x <= limits[1]:
            raise SettingsError(
                f"{name[:-1] if name.endswith('X') else name}: axis {axis} needs {x:.4g}, and the autopilot takes "
                f"{limits[0]:g} to {limits[1]:g}"
            )


def read_px4(path: Path, instance: int = 0) -> Calibration:
    """Return the calibration of one sensor in a parameter file of QGroundControl, in the sensor's axes.

    Raises
    ------
    RecordingError
        If it is no such file, or has no offsets of this sensor.
    """
    values: dict[str, float] = {}
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"cannot be read as text: {error}", file=path) from error
    for number, row in enumerate(text.splitlines(), 1):
        if row.startswith("#") or not row.strip():
            continue
        cells = row.split()
        if len(cells) != 5:
            raise RecordingError(
                f"{len(cells)} values, expected vehicle, component, name, value and type", file=path, line=number
            )
        if cells[2] in values:
            raise RecordingError(f"{cells[2]} is there twice", file=path, line=number)
        try:
            values[cells[2]] = float(cells[3])
        except ValueError as error:
            raise RecordingError(f"'{cells[3]}' is not a number", file=path, line=number) from error

    def triple(name: str, otherwise: float | None) -> Array:
        found = [values.get(name.format(axis=axis)) for axis in _AXES]
        if otherwise is not None and all(name.format(axis=axis) not in values for axis in _AXES):
            return np.full(3, otherwise)
        if None in found:
            missing = name.format(axis=_AXES[found.index(None)])
            raise RecordingError(f"has no {missing}; got {len(values)} other parameters", file=path)
        return np.array(found, dtype=float)

    i, still = instance, np.zeros((3, 3))
    sensors = SensorParameters(
        K_omega=np.eye(3),
        k_w=-triple(f"CAL_GYRO{i}_{{axis}}OFF", 0.0)[None],
        K_a=np.diag(triple(f"CAL_ACC{i}_{{axis}}SCALE", 1.0)),
        k_a=-triple(f"CAL_ACC{i}_{{axis}}OFF", None)[None],
        lever_arms=still,
    )
    gyros = "" if f"CAL_GYRO{i}_XOFF" in values else "; without offsets of the gyros"
    return imported(path, sensors, 0.0, f"PX4{gyros}")
