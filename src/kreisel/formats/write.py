"""Write a recording: as a folder that any tool can read, or as one MCAP file."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kreisel.errors import RecordingError
from kreisel.formats.input_formats import SUFFIXES
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import ImuSamples, JointAngles, Recording, ReferencePoses, Stamps
from kreisel.recording.recording_settings import RecordingSettings

_IMU_HEADER = "#timestamp [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z"
_POSITION_HEADER = ",p_x [m],p_y,p_z"
_ROWS = 20_000  # rows written at once; chosen: 2 MB of text, and few calls for each row
_QUATERNION_HEADER = ",q_w [],q_x,q_y,q_z"


def write(recording: Recording, path: str | Path, further: Mapping[str, ImuSamples] | None = None) -> None:
    """Write a recording as an MCAP file where the path ends in .mcap, otherwise as a folder.

    Parameters
    ----------
    further
        Readings of further units of a tray by their names, imu1, imu2, …; the settings are then those of all.

    Raises
    ------
    RecordingError
        If the path exists already, or cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in SUFFIXES and suffix not in WRITERS:
        raise RecordingError(f"{suffix} files are only read; name a folder or an .mcap file", file=path)
    _check_kept(recording, path, (recording.imu, *(further or {}).values()))
    if further:
        recording = replace(recording, settings=recording.settings.of_all_imus())
    WRITERS.get(suffix, write_folder)(recording, path, further or {})


def _check_kept(recording: Recording, path: Path, imus: Sequence[ImuSamples]) -> None:
    """Raise an error if a file would lose or misname what a recording holds."""
    if any(imu.units.counted(kind) for imu in imus for kind in ("rate", "acceleration")):
        raise RecordingError("raw counts cannot be written: copy the recording's folder", file=path)
    if path.suffix.lower() != ".mcap":
        return
    lost = ["temperatures"] if any(imu.temperature is not None for imu in imus) else []
    lost += ["a turntable's angles"] if recording.table is not None else []
    if lost:
        raise RecordingError(f"MCAP files of kreisel do not hold {' and '.join(lost)}: name a folder", file=path)


def _write_mcap(recording: Recording, path: Path, further: Mapping[str, ImuSamples]) -> None:
    from kreisel.formats.mcap_file import write_mcap  # here, because rosbags is slow to import

    write_mcap(recording, path, further)


def write_tum(recording: Recording, path: Path, further: Mapping[str, ImuSamples] | None = None) -> None:
    """Write the reference as a TUM trajectory: s, position, quaternion with its scalar last; IMUs are left out.

    Raises
    ------
    RecordingError
        If the file exists or cannot be written, or there are no positions with orientations.
    """
    del further
    reference = recording.reference
    if reference is None or reference.positions is None or reference.quaternions is None:
        raise RecordingError(
            "has no poses with positions and orientations, which a trajectory needs", file=recording.path
        )
    if path.exists():
        raise RecordingError("exists already; delete it, or give another name", file=path)
    rows = np.column_stack([reference.positions, np.roll(reference.quaternions, -1, axis=1)])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", encoding="utf-8", newline="\n") as file:
            for stamp, row in zip(reference.stamps_ns.tolist(), rows.tolist(), strict=True):
                # in whole numbers, because a double of seconds since 1970 does not resolve nanoseconds
                sign, (seconds, nanoseconds) = "-" if stamp < 0 else "", divmod(abs(stamp), 10**9)
                file.write(f"{sign}{seconds}.{nanoseconds:09d} {' '.join(map(repr, row))}\n")
    except OSError as error:
        raise RecordingError(f"cannot be written: {error.strerror}", file=path) from error


WRITERS: dict[str, Callable[[Recording, Path, Mapping[str, ImuSamples]], None]] = {
    ".mcap": _write_mcap,
    ".tum": write_tum,
}
"""By the suffix of the file; without one of these a folder is written."""


def write_folder(recording: Recording, path: Path, further: Mapping[str, ImuSamples] | None = None) -> None:
    """Write a recording as a folder in the EuRoC/ASL layout; every float64 is read back as it was. See `write`.

    The reference's folder has the reference's name; a ROS topic gives its own name without slashes, and
    kreisel's own topics give `pose0`.

    Raises
    ------
    RecordingError
        If the folder exists and is not empty, or cannot be written.
    """
    if path.is_file() or (path.is_dir() and any(path.iterdir())):
        kind = "file" if path.is_file() else "folder that is not empty"
        raise RecordingError(f"is a {kind} already; delete it, or give another name", file=path)
    try:
        _write_streams(recording, path)
        for name, imu in (further or {}).items():
            write_imu(imu, path / name)
        write_settings(recording, path)
    except OSError as error:
        raise RecordingError(f"cannot be written: {error.strerror}", file=path) from error


def write_settings(recording: Recording, folder: Path) -> None:
    """Write the settings of a recording into an existing folder: recording.toml and the robot's description."""
    text = settings_toml(recording.settings)
    if text:
        (folder / "recording.toml").write_text(text, encoding="utf-8")
    if recording.urdf is not None:
        (folder / (recording.settings.robot.urdf or "robot.urdf")).write_text(recording.urdf, encoding="utf-8")


def add_reference(path: Path, reference: ReferencePoses | None, joints: JointAngles | None) -> None:
    """Write poses and joint angles into a new or existing folder; its other contents are kept.

    Raises
    ------
    RecordingError
        If the folder has poses or joint angles of these names, or cannot be written.
    """
    names = ["joint0"] if joints is not None else []
    names += [] if reference is None else [_folder_name(reference.name)]
    for name in names:
        if (path / name).exists():
            raise RecordingError("is there already; delete it, or give another folder", file=path / name)
    if path.exists() and not path.is_dir():
        raise RecordingError("is a file; give a folder", file=path)
    try:
        _write_reference(path, reference, joints)
    except OSError as error:
        raise RecordingError(f"cannot be written: {error.strerror}", file=path) from error


def _write_streams(recording: Recording, path: Path) -> None:
    write_imu(recording.imu, path / "imu0")
    _write_reference(path, recording.reference, recording.joints)
    if recording.table is not None:
        table = recording.table
        _write_table(path / "table0", "#timestamp [ns],angle [rad]", table.stamps_ns, table.angles[:, None])


def _write_reference(path: Path, reference: ReferencePoses | None, joints: JointAngles | None) -> None:
    if reference is not None:
        header, poses = _pose_table(reference)
        _write_table(path / _folder_name(reference.name), header, reference.stamps_ns, poses)
    if joints is not None:
        columns = ",".join(f"q_{k} [rad]" for k in range(1, joints.angles.shape[1] + 1))
        _write_table(path / "joint0", f"#timestamp [ns],{columns}", joints.stamps_ns, joints.angles)


def _pose_table(reference: ReferencePoses) -> tuple[str, Array]:
    header, parts = "#timestamp [ns]", []
    if reference.positions is not None:
        header += _POSITION_HEADER
        parts.append(reference.positions)
    if reference.quaternions is not None:
        header += _QUATERNION_HEADER
        parts.append(reference.quaternions)
    return header, np.hstack(parts)


def _folder_name(name: str) -> str:
    """Return a name that is valid for folders on every system, and that a reader recognises as a reference."""
    if name in ("/robot/pose", "/robot/position", "/robot/orientation"):
        return "pose0"
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", name.strip("/")) or "pose0"
    return f"pose_{name}" if name.startswith(("imu", "cam", "joint", "table")) else name


def write_imu(imu: ImuSamples, folder: Path) -> None:
    """Write an IMU's readings as the table of a new folder, with its temperature where it was recorded."""
    header, parts = _IMU_HEADER, [imu.rates, imu.accelerations]
    if imu.temperature is not None:
        header += ",temperature [degC]"
        parts.append(imu.temperature[:, None])
    _write_table(folder, header, imu.stamps_ns, np.hstack(parts))


def write_imu_table(path: Path, stamps: Stamps, rates: Array, accelerations: Array) -> None:
    """Write readings (n, 3) each, rad/s and m/s^2, as a table in a file of its own."""
    _write_rows(path, _IMU_HEADER, stamps, np.hstack([rates, accelerations]))


def _write_table(folder: Path, header: str, stamps: Stamps, values: Array) -> None:
    folder.mkdir(parents=True)
    _write_rows(folder / "data.csv", header, stamps, values)


def _write_rows(path: Path, header: str, stamps: Stamps, values: Array) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"{header}\n")
        # repr gives the fewest digits that are read back as the same number; of a whole list at once it is fast
        for start in range(0, stamps.size, _ROWS):
            part = slice(start, start + _ROWS)
            rows = [[stamp, *row] for stamp, row in zip(stamps[part].tolist(), values[part].tolist(), strict=True)]
            file.write(repr(rows)[2:-2].replace("], [", "\n").replace(" ", "") + "\n")


def settings_toml(settings: RecordingSettings) -> str:
    """Return the settings that are set as TOML, empty where none is."""
    return "\n".join(toml_table(name, table) for name, table in settings.tables.items() if table)


def toml_table(name: str, table: Mapping[str, float | str]) -> str:
    """Return a table of TOML."""
    lines = [f"{_toml_key(key)} = {_toml_value(value)}\n" for key, value in table.items()]
    return f"[{name}]\n{''.join(lines)}"


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml_value(key)


def _toml_value(value: float | str) -> str:
    if isinstance(value, str):
        # JSON's escapes are TOML's; only DEL must be escaped in TOML alone
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)
