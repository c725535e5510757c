"""Recording folders in the EuRoC/ASL layout."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from kreisel.errors import RecordingError, unknown_name
from kreisel.files import MAX_YAML, read_bytes
from kreisel.formats.column_names import read_name
from kreisel.formats.csv_table import Column, Table, read_table
from kreisel.formats.robot_description import description_beside, is_there
from kreisel.geometry.rotation import Array
from kreisel.recording.header import UNITS, HeaderUnits
from kreisel.recording.recording import (
    Datasheet,
    DataWarning,
    ImuSamples,
    JointAngles,
    Recording,
    ReferencePoses,
    TableAngles,
)
from kreisel.recording.recording_settings import RecordingSettings, read_settings
from kreisel.tasks import Executor, sequential
from kreisel.units import ZERO_CELSIUS

_PREFERRED = ("pose0", "vicon0", "leica0", "state_groundtruth_estimate0")
_IMU_HEADER = "#timestamp [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z"
_POSE_HEADER = "#timestamp [ns],p_x [m],p_y,p_z,q_w [],q_x,q_y,q_z"


def is_folder(path: Path) -> bool:
    """Return whether a path is a recording folder, or the folder above EuRoC's `mav0`."""
    return path.is_dir() and any((path / inner / "imu0").is_dir() for inner in ("", "mav0"))


def load_folder(
    path: Path, reference: str | None = None, imu: str = "imu0", executor: Executor = sequential
) -> Recording:
    """Return the recording in a folder.

    Parameters
    ----------
    path
        The folder that holds `imu0`, or the one above `mav0`.
    reference
        Name of the reference's folder; by default `pose0`, or the most direct measurement available.
    imu
        Name of the IMU's folder.
    executor
        Reads the files.

    Raises
    ------
    RecordingError
        If a file is missing or cannot be read; the message names it and the line.
    """
    root = path if (path / "imu0").is_dir() else path / "mav0"
    settings = read_settings(path / "recording.toml") if is_there(path / "recording.toml") else RecordingSettings()
    own: list[list[DataWarning]] = [[], [], [], []]
    samples, poses, joints, turned = executor(
        [
            lambda: _read_imu(_imu_folder(root, imu), own[0]),
            lambda: _read_poses(root, reference, own[1]),
            lambda: _read_joints(root / "joint0" / "data.csv", own[2]),
            lambda: _read_turntable(root / "table0" / "data.csv", own[3]),
        ]
    )
    datasheet = _read_datasheet(root / imu / "sensor.yaml", own[0])
    warnings = [one for part in own for one in part]
    urdf = _read_urdf(path, settings, warnings, needed=joints is not None)
    settings = settings.of_imu(imu)
    return Recording(path, samples, poses, joints, settings, tuple(warnings), datasheet, urdf, table=turned)


def imus_in(path: Path) -> tuple[str, ...]:
    """Return the names of the IMUs in a recording folder, `imu0`, `imu1`, …, in the order of their numbers."""
    root = path if (path / "imu0").is_dir() else path / "mav0"
    found = [folder.name for folder in root.glob("imu*") if re.fullmatch(r"imu\d+", folder.name) and folder.is_dir()]
    return tuple(sorted(found, key=lambda name: int(name[3:])))


def load_imu(path: Path, name: str) -> tuple[ImuSamples, tuple[DataWarning, ...]]:
    """Return the readings of one IMU in a recording folder, as they were recorded, and what was found in them."""
    warnings: list[DataWarning] = []
    root = path if (path / "imu0").is_dir() else path / "mav0"
    return _read_imu(_imu_folder(root, name), warnings), tuple(warnings)


def _imu_folder(root: Path, name: str) -> Path:
    known = [folder.name for folder in root.glob("imu*") if folder.is_dir()]
    if known and name not in known:
        raise RecordingError(f"{unknown_name('IMU', name, known)}; choose with --imu", file=root)
    return root / name


def _read_imu(folder: Path, warnings: list[DataWarning]) -> ImuSamples:
    return read_imu_table(folder / "data.csv", warnings)


def read_imu_table(path: Path, warnings: list[DataWarning]) -> ImuSamples:
    """Return the readings in the table of an IMU, as they were recorded, and add what was found in them.

    Raises
    ------
    RecordingError
        If the table cannot be read, with its line.
    """
    table = read_table(path, "IMU readings")
    warnings.extend(table.warnings)
    if len(table.columns) < 7:
        raise RecordingError(
            f"{len(table.columns)} columns, expected 7 or more: {_IMU_HEADER}; correct the header, or record again",
            file=table.source,
            line=1,
        )
    gyro, accel = imu_columns(table)
    rates = table.take(gyro, "rate")
    accelerations = table.take(accel, "acceleration")
    units = _header_units(table, rate=gyro, acceleration=accel)
    _note_conversion(table, {"rate": gyro, "acceleration": accel}, warnings)
    return ImuSamples(
        table.stamps_ns, rates, accelerations, table.source, units, temperature=temperature_of(table, warnings)
    )


def temperature_of(table: Table, warnings: list[DataWarning]) -> Array | None:
    """Return the sensor's temperature in degrees Celsius, (n,), from a column named after it; None without one."""
    found = [c for c in table.columns[7:] if re.match(r"(imu_?|sensor_?|gyro_?)?temp", c.name.lower())]
    if not found:
        return None
    values = table.take(found[:1], "temperature")[:, 0]
    if found[0].unit == "K":
        values = values - ZERO_CELSIUS
    warnings.append(DataWarning(_short_name(table), f"column '{found[0].name}' is read as the sensor's temperature"))
    return values


def _header_units(table: Table, **groups: list[Column]) -> HeaderUnits:
    """Return the units that a header states of a stream's stamps, and of groups of columns by their quantity."""
    stated = {quantity: table.with_units(columns)[0].unit for quantity, columns in groups.items() if columns}
    return HeaderUnits(table.columns[0].unit, **stated)


def imu_columns(table: Table) -> tuple[list[Column], list[Column]]:
    """Return the columns of rates and of accelerations: two to seven, unless their names say otherwise.

    Raises
    ------
    RecordingError
        If the name of a column contradicts its place.
    """
    triads = list(table.columns[1:4]), list(table.columns[4:7])
    for triad, meant, wanted in zip(triads, ("rate", "acceleration"), (("w_x", "w_y", "w_z"), ("a_x", "a_y", "a_z")),
                                    strict=True):  # fmt: skip
        for column, axis, usual in zip(triad, "xyz", wanted, strict=True):
            quantity, named = _meaning(column.name)
            if quantity not in (meant, "") or named not in (axis, ""):
                raise RecordingError(
                    f"column {column.index + 1} is '{column.name}' where {usual} ({meant}) is expected, as in "
                    f"{_IMU_HEADER}; put the columns into this order, or correct the header",
                    file=table.source,
                    line=1,
                )
    return triads


def _meaning(name: str) -> tuple[str, str]:
    """Return the quantity and the axis that a column's name states, each empty where it states none."""
    plain = name.lower().replace(" ", "_")
    axis = plain[-1:] if re.fullmatch(r"(.*[_.\[])?[a-z]{1,5}[xyz]|.*[_.][xyz]", plain) else ""
    if re.match(r"(w|omega|gyr|g)_?[xyz]?(_|$)|gyro|omega|ang", plain):
        return "rate", axis
    if re.match(r"(a|acc|f)_?[xyz]?(_|$)|acc|lin|force", plain):
        return "acceleration", axis
    return ("another quantity", "") if re.match(r"temp|mag|m_?[xyz]$|press|baro|time|q_|p_", plain) else ("", "")


def _note_conversion(table: Table, groups: dict[str, list[Column]], warnings: list[DataWarning]) -> None:
    found = {
        str(column.unit)
        for quantity, columns in groups.items()
        for column in table.with_units(columns)
        if column.unit is not None and UNITS[quantity][column.unit] != 1.0
    }
    if found:
        units = ", ".join(f"[{unit}]" for unit in sorted(found))
        warnings.append(DataWarning(_short_name(table), f"converted from {units} to SI"))


def _short_name(table: Table) -> str:
    return f"{table.source.parent.name}/{table.source.name}"


def _reference_folders(root: Path) -> dict[str, Path]:
    taken = ("imu", "cam", "joint", "table")
    folders = [f for f in sorted(root.iterdir()) if is_there(f / "data.csv") and not f.name.startswith(taken)]
    return {folder.name: folder for folder in folders}


def _read_poses(root: Path, name: str | None, warnings: list[DataWarning]) -> ReferencePoses | None:
    folders = _reference_folders(root)
    if name is not None and name not in folders:
        raise RecordingError(unknown_name("reference", name, folders or ["none: this folder has no poses"]), file=root)
    if not folders:
        return None
    if name is None:
        name = next((n for n in _PREFERRED if n in folders), next(iter(folders)))
        if len(folders) > 1:
            warnings.append(
                DataWarning("reference", f"took {name} of {', '.join(folders)}; --reference chooses another")
            )
    table = read_table(folders[name] / "data.csv", "reference poses")
    warnings.extend(table.warnings)
    return _poses(table, name, warnings)


def _poses(table: Table, name: str, warnings: list[DataWarning]) -> ReferencePoses:
    positions, quaternions = _pose_columns(table)
    if not positions and not quaternions:
        raise _not_poses(table, "; --reference chooses another folder")
    if not quaternions and any(_ANGLE.match(column.name.lower()) for column in table.columns[1:]):
        raise _not_poses(table, "; angles are not read: convert them to quaternions")
    if [c.index for c in quaternions] != sorted(c.index for c in quaternions):
        order = ", ".join(c.name for c in sorted(quaternions, key=lambda c: c.index))
        warnings.append(
            DataWarning(_short_name(table), f"quaternion columns are in the order {order}; read by these names")
        )
    p = table.take(positions, "length") if positions else None
    q = table.take(quaternions, "quaternion") if quaternions else None
    _note_conversion(table, {"length": positions}, warnings)
    return ReferencePoses(name, table.stamps_ns, p, q, table.source, _header_units(table, length=positions))


def _not_poses(table: Table, remedy: str) -> RecordingError:
    names = ", ".join(column.name for column in table.columns[1:9]) or "only stamps"
    return RecordingError(
        f"columns are {names}; expected {_POSE_HEADER}, or only its p or its q columns{remedy}",
        file=table.source,
        line=1,
    )


_POSITION = re.compile(r"p.*[xyz]|(t|trans.*)?_?[xyz]")
_ANGLE = re.compile(r"roll|pitch|yaw|heading|euler|rot|[abc]$|r_?[xyz]$|angle")


def _pose_columns(table: Table) -> tuple[list[Column], list[Column]]:
    """Return the columns of p (x, y, z) and of q (w, x, y, z), whatever order the header gives them in."""
    columns = [(column, column.name.lower()) for column in table.columns[1:]]
    p = [(name[-1], column) for column, name in columns if _POSITION.fullmatch(name)][:3]
    q = [(name[-1], column) for column, name in columns if name.startswith("q") and name[-1:] in "wxyz"][:4]
    said = [(column, read_name(column.name)) for column, _ in columns]
    p = p or [(name.axis, column) for column, name in said if name.quantity == "position"][:3]
    q = q or [(name.axis, column) for column, name in said if name.quantity in ("quaternion", "orientation")][:4]
    return _by_axes(p, "xyz", table), _by_axes(q, "wxyz", table)


def _by_axes(found: list[tuple[str, Column]], axes: str, table: Table) -> list[Column]:
    """Return columns, each with its axis, in the order of axes; none where there are none."""
    if found and sorted(axis for axis, _ in found) != sorted(axes):
        raise _not_poses(table, "; name each column by its axis, as p_x, p_y, p_z, q_w, q_x, q_y, q_z")
    return [column for _, column in sorted(found, key=lambda one: axes.index(one[0]))]


def _read_joints(path: Path, warnings: list[DataWarning]) -> JointAngles | None:
    if not is_there(path):
        return None
    table = read_table(path, "joint angles")
    warnings.extend(table.warnings)
    if len(table.columns) < 2:
        raise RecordingError(
            "no joint columns; expected #timestamp [ns],q_1 [rad],…; without joint angles, remove the folder",
            file=path,
            line=1,
        )
    columns = [c for c in table.columns[1:] if c.words is None or c.unit is not None or c.name[-1:].isdigit()]
    angles = table.take(columns, "angle")
    _note_conversion(table, {"angle": columns}, warnings)
    return JointAngles(table.stamps_ns, angles, path, _header_units(table, angle=columns))


_ONE_TURN = 2.01 * np.pi
"""rad: range of angles that begin anew after a turn; those of a larger range count turns."""

_TURNTABLE_HEADER = "#timestamp [ns],angle [rad], or rate [rad s^-1]"


def _read_turntable(path: Path, warnings: list[DataWarning]) -> TableAngles | None:
    if not is_there(path):
        return None
    table = read_table(path, "angles of the turntable")
    warnings.extend(table.warnings)
    own = [c for c in table.columns[1:] if re.match(r"angle|position|rate|speed", c.name.lower())]
    if len(own) != 1:
        names = ", ".join(column.name for column in table.columns[1:]) or "only stamps"
        raise RecordingError(f"columns are {names}; expected {_TURNTABLE_HEADER}", file=path, line=1)
    by_rate = own[0].name.lower().startswith(("rate", "speed"))
    quantity = "rate" if by_rate else "angle"
    values = table.take(own, quantity)[:, 0]
    _note_conversion(table, {quantity: own}, warnings)
    kept = np.isfinite(values)
    stamps, values = table.stamps_ns[kept], values[kept]
    if stamps.size < 2 or np.any(np.diff(stamps) <= 0):
        what = "fewer than two rows" if stamps.size < 2 else "stamps do not increase"
        raise RecordingError(f"{what}; expected the table's angle or rate from beginning to end", file=path)
    if by_rate:
        steps = 0.5 * (values[1:] + values[:-1]) * np.diff(stamps) * 1e-9
        values = np.concatenate([np.zeros(1), np.cumsum(steps)])
    elif np.ptp(values) < _ONE_TURN:
        values = np.unwrap(values)
    return TableAngles(stamps, values, path, by_rate)


def _read_urdf(path: Path, settings: RecordingSettings, warnings: list[DataWarning], *, needed: bool) -> str | None:
    """Return the text of the robot's description; a missing file is an error only where it is needed."""
    name = settings.robot.urdf
    if name is not None and not is_there(path / name):
        if needed:
            raise RecordingError(
                "no such file; robot.urdf in recording.toml names it: copy it there, or delete that entry",
                file=path / name,
            )
        warnings.append(DataWarning("robot", f"recording.toml names {name}, which is missing; no joint angles need it"))
    return description_beside(path, settings)


def _read_datasheet(path: Path, warnings: list[DataWarning]) -> Datasheet | None:
    """Return the noise figures of EuRoC's sensor.yaml, or None where there are none."""
    if not is_there(path):
        return None
    sheet = _parse_datasheet(path)
    if sheet is None:
        warnings.append(DataWarning("noise", f"{path.name} holds no noise densities that can be read; it was left out"))
        return None
    warnings.append(
        DataWarning(
            "noise",
            f"densities and random walks taken from {path.name}: gyro {sheet.gyro_noise_density:.4g} rad/s/sqrt(Hz), "
            f"accelerometer {sheet.accel_noise_density:.4g} m/s^2/sqrt(Hz)",
        )
    )
    return sheet


def _parse_datasheet(path: Path) -> Datasheet | None:
    try:
        lines = read_bytes(path, MAX_YAML).decode("utf-8", errors="replace").splitlines()
        text = "\n".join(line for line in lines if not line.startswith("%"))  # OpenCV's first line is not YAML
        content: dict[str, Any] = YAML(typ="safe").load(text) or {}
        densities = [float(content[f"{name}_noise_density"]) for name in ("gyroscope", "accelerometer")]
        walks = [float(content.get(f"{name}_random_walk", 0.0)) for name in ("gyroscope", "accelerometer")]
    except (OSError, YAMLError, AttributeError, KeyError, TypeError, ValueError, RecursionError):
        return None
    figures = np.array([*densities, *walks])
    if not np.isfinite(figures).all() or (figures < 0.0).any() or (figures[:2] == 0.0).any():
        return None
    return Datasheet(*densities, *walks)
