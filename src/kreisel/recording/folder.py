"""Recording folders in the EuRoC/ASL layout."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML, YAMLError

from kreisel.errors import RecordingError, unknown_name
from kreisel.recording.recording import Datasheet, Finding, ImuSamples, JointAngles, Recording, ReferencePoses
from kreisel.recording.settings import RecordingSettings, read_settings
from kreisel.recording.table import Column, Table, read_table

_PREFERRED = ("pose0", "vicon0", "leica0", "state_groundtruth_estimate0")
_IMU_HEADER = "#timestamp [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z"
_POSE_HEADER = "#timestamp [ns],p_x [m],p_y,p_z,q_w [],q_x,q_y,q_z"


def is_folder(path: Path) -> bool:
    """Return whether a path is a recording folder, or the folder above EuRoC's `mav0`."""
    return path.is_dir() and any((path / inner / "imu0").is_dir() for inner in ("", "mav0"))


def load_folder(path: Path, reference: str | None = None, imu: str = "imu0") -> Recording:
    """Return the recording in a folder.

    Parameters
    ----------
    path
        The folder that holds `imu0`, or the one above `mav0`.
    reference
        Name of the reference's folder; by default `pose0`, or the most direct measurement there is.
    imu
        Name of the IMU's folder.

    Raises
    ------
    RecordingError
        If a file is missing or cannot be read; the message names it and the line.
    """
    root = path if (path / "imu0").is_dir() else path / "mav0"
    findings: list[Finding] = []
    settings = read_settings(path / "recording.toml") if (path / "recording.toml").is_file() else RecordingSettings()
    samples = _read_imu(_imu_folder(root, imu), findings)
    datasheet = _read_datasheet(root / imu / "sensor.yaml", findings)
    poses = _read_poses(root, reference, findings)
    joints = _read_joints(root / "joint0" / "data.csv", findings)
    return Recording(path, samples, poses, joints, settings, tuple(findings), datasheet)


def _imu_folder(root: Path, name: str) -> Path:
    known = [folder.name for folder in root.glob("imu*") if folder.is_dir()]
    if known and name not in known:
        raise RecordingError(unknown_name("IMU", name, known), file=root)
    return root / name


def _read_imu(folder: Path, findings: list[Finding]) -> ImuSamples:
    table = read_table(folder / "data.csv", "IMU readings")
    findings.extend(table.findings)
    if len(table.columns) < 7:
        raise RecordingError(
            f"{len(table.columns)} columns, expected 7 or more: {_IMU_HEADER}", file=table.source, line=1
        )
    rates = table.take(list(table.columns[1:4]), "rate")
    accelerations = table.take(list(table.columns[4:7]), "acceleration")
    _note_conversion(table, table.columns[1:7], ("rad s^-1", "rad/s", "m s^-2", "m/s^2"), findings)
    return ImuSamples(table.stamps_ns, rates, accelerations, table.source)


def _note_conversion(table: Table, columns: tuple[Column, ...], usual: tuple[str, ...], findings: list[Finding]) -> None:
    units = {column.unit for column in columns if column.unit not in (*usual, None)}
    if units:
        findings.append(Finding(table.source.name, f"converted from {', '.join(f'[{u}]' for u in sorted(map(str, units)))} to SI"))


def _reference_folders(root: Path) -> dict[str, Path]:
    taken = ("imu", "cam", "joint")
    folders = [f for f in sorted(root.iterdir()) if (f / "data.csv").is_file() and not f.name.startswith(taken)]
    return {folder.name: folder for folder in folders}


def _read_poses(root: Path, name: str | None, findings: list[Finding]) -> ReferencePoses | None:
    folders = _reference_folders(root)
    if name is not None and name not in folders:
        raise RecordingError(unknown_name("reference", name, folders or ["none: this folder has no poses"]), file=root)
    if not folders:
        return None
    if name is None:
        name = next((n for n in _PREFERRED if n in folders), next(iter(folders)))
        if len(folders) > 1:
            findings.append(Finding("reference", f"took {name} of {', '.join(folders)}; --reference picks another"))
    table = read_table(folders[name] / "data.csv", "reference poses")
    findings.extend(table.findings)
    return _poses(table, name, findings)


def _poses(table: Table, name: str, findings: list[Finding]) -> ReferencePoses:
    positions, quaternions = _pose_columns(table)
    if not positions and not quaternions:
        raise RecordingError(f"neither three position nor four quaternion columns; expected {_POSE_HEADER}", file=table.source, line=1)
    _note_conversion(table, tuple(positions), ("m",), findings)
    p = table.take(positions, "length") if positions else None
    q = table.take(quaternions, "quaternion") if quaternions else None
    return ReferencePoses(name, table.stamps_ns, p, q, table.source)


def _pose_columns(table: Table) -> tuple[list[Column], list[Column]]:
    """Return the columns of p (x, y, z) and of q (w, x, y, z), whatever order the header gives them in."""
    columns = table.columns[1:]
    p = [c for c in columns if c.name.lower().startswith("p") and c.name.lower()[-1:] in "xyz"][:3]
    q = [c for c in columns if c.name.lower().startswith("q") and c.name.lower()[-1:] in "wxyz"][:4]
    p.sort(key=lambda c: "xyz".index(c.name.lower()[-1]))
    q.sort(key=lambda c: "wxyz".index(c.name.lower()[-1]))
    if len({c.name.lower()[-1] for c in p}) not in (0, 3) or len({c.name.lower()[-1] for c in q}) not in (0, 4):
        names = ", ".join(c.name for c in columns[:8])
        raise RecordingError(f"columns are {names}; expected {_POSE_HEADER}, or only its p or its q columns", file=table.source, line=1)
    return p, q


def _read_joints(path: Path, findings: list[Finding]) -> JointAngles | None:
    if not path.is_file():
        return None
    table = read_table(path, "joint angles")
    findings.extend(table.findings)
    if len(table.columns) < 2:
        raise RecordingError("no joint columns; expected #timestamp [ns],q_1 [rad],…", file=path, line=1)
    return JointAngles(table.stamps_ns, table.take(list(table.columns[1:]), "angle"), path)


def _read_datasheet(path: Path, findings: list[Finding]) -> Datasheet | None:
    """Return the noise figures of EuRoC's sensor.yaml, or None where there are none."""
    if not path.is_file():
        return None
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    try:
        content: dict[str, Any] = YAML(typ="safe").load("\n".join(line for line in lines if not line.startswith("%"))) or {}
        sheet = Datasheet(
            float(content["gyroscope_noise_density"]),
            float(content["accelerometer_noise_density"]),
            float(content.get("gyroscope_random_walk", 0.0)),
            float(content.get("accelerometer_random_walk", 0.0)),
        )
    except (YAMLError, KeyError, TypeError, ValueError):
        return None
    figures = np.array([sheet.gyro_noise_density, sheet.accel_noise_density, sheet.gyro_random_walk, sheet.accel_random_walk])
    if not np.isfinite(figures).all() or (figures < 0.0).any() or (figures[:2] == 0.0).any():
        return None
    findings.append(
        Finding(
            "noise",
            f"densities and random walks taken from {path.name}: gyro {figures[0]:.4g} rad/s/sqrt(Hz), "
            f"accelerometer {figures[1]:.4g} m/s^2/sqrt(Hz)",
        )
    )
    return sheet
