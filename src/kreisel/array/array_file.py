"""The result folder of a tray, read: `array.yaml`, and the calibration of each unit in a folder of its own."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from kreisel.array.relative_pose import SCHEMA
from kreisel.calibration.result import Calibration
from kreisel.errors import RecordingError
from kreisel.files import MAX_YAML, check_entries, read_text
from kreisel.geometry.rotation import Array

FILE = "array.yaml"

_ORTHOGONAL = 1e-9
"""Largest deviation of a rotation times its transpose from the identity; files have all digits."""


@dataclass(frozen=True)
class ArrayUnit:
    """A unit of a tray: its calibration, and where it lies against the reference unit.

    Attributes
    ----------
    calibration
        In axes of the tool, which all units have in common.
    position : (3,)
        Of the middle of its accelerometers in the frame of the reference unit, m; see `device_axes.AXES`, imu.
    rotation : (3, 3)
        Turns a vector from its axes to those of the reference unit.
    position_sd, rotation_sd : (3,)
        m, and rad of a rotation vector in axes of the reference unit.
    offset, skew
        t_reference = t + offset + skew (t - first t), s and 1.
    offset_sd, skew_sd
        Their standard deviations.
    """

    name: str
    calibration: Calibration
    position: Array
    rotation: Array
    position_sd: Array
    rotation_sd: Array
    offset: float = 0.0
    skew: float = 0.0
    offset_sd: float = 0.0
    skew_sd: float = 0.0


@dataclass(frozen=True)
class ArrayResult:
    """The units of a tray, the reference unit first, and those that could not be used, with the reasons."""

    folder: Path
    units: tuple[ArrayUnit, ...]
    left_out: Mapping[str, str]

    @property
    def reference(self) -> ArrayUnit:
        """The unit against which the others are placed."""
        return self.units[0]


def is_array(path: Path) -> bool:
    """Return whether a path is the result folder of a tray, or its `array.yaml`."""
    return path.name == FILE or ((path / FILE).is_file() and not (path / "calibration.yaml").exists())


def load_array(path: Path) -> ArrayResult:
    """Return the units in the result folder of a tray.

    Raises
    ------
    RecordingError
        If `array.yaml` or the calibration of a unit is missing, or they are not what `kreisel calibrate` writes.
    """
    folder = path.parent if path.name == FILE else path
    file = folder / FILE
    document = _document(file)
    try:
        check_entries(document)
        reference, placed = _name(document["reference"]), dict(document["imus"])
        found = [_unit(folder, reference, None), *(_unit(folder, _name(name), own) for name, own in placed.items())]
        left_out = {str(name): str(reason) for name, reason in dict(document.get("left_out") or {}).items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RecordingError(
            f"incomplete or changed: {error}; write it again with `kreisel calibrate`", file=file
        ) from error
    return ArrayResult(folder, tuple(found), left_out)


def _document(file: Path) -> dict[str, Any]:
    try:
        document = YAML(typ="safe").load(read_text(file, MAX_YAML))
    except OSError as error:
        raise RecordingError(
            f"cannot be read ({error.strerror}); give the result folder of `kreisel calibrate` of several IMUs",
            file=file,
        ) from error
    except (YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise RecordingError(f"not valid YAML: {str(error).splitlines()[0]}", file=file) from error
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema != SCHEMA:
        raise RecordingError(f"schema is '{str(schema)[:60]}', expected '{SCHEMA}'", file=file)
    return dict(document)


def _name(name: Any) -> str:
    if not re.fullmatch(r"imu\d+", str(name)):
        raise ValueError(f"a unit is named '{str(name)[:60]}', expected imu0, imu1 and so on")
    return str(name)


def _unit(folder: Path, name: str, placed: Mapping[str, Any] | None) -> ArrayUnit:
    """Return a unit; the reference unit is placed by nothing."""
    calibration = Calibration.load(folder / name)
    if calibration.axes != "tool":
        raise RecordingError(
            f"in axes '{calibration.axes}', expected those of the tool, which the units have in common",
            file=folder / name,
        )
    if placed is None:
        return ArrayUnit(name, calibration, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3))
    deviation, clock = placed["standard_deviation"], placed["clock"]
    rotation = _numbers(placed["rotation"], (3, 3))
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > _ORTHOGONAL or np.linalg.det(rotation) < 0.0:
        raise ValueError(f"the rotation of {name} is none")
    position, position_sd, rotation_sd = (
        _numbers(row, (3,)) for row in (placed["position"], deviation["position"], deviation["rotation"])
    )
    offset, skew, offset_sd, skew_sd = _numbers(
        [clock[key] for key in ("offset", "skew", "offset_sd", "skew_sd")], (4,)
    ).tolist()
    return ArrayUnit(name, calibration, position, rotation, position_sd, rotation_sd, offset, skew, offset_sd, skew_sd)


def _numbers(values: Any, shape: tuple[int, ...]) -> Array:
    out = np.array(values, dtype=float)
    if out.shape != shape or not np.isfinite(out).all():
        raise ValueError(f"got {str(values)[:60]}, expected finite numbers of the shape {shape}")
    return out
