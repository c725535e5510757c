"""The formats of other programs, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from kreisel.calibration.result import Calibration
from kreisel.errors import SettingsError, unknown_name
from kreisel.exchange import autopilots, kalibr, kalibr_chain, number_files, openvins, ros_frames, source_code
from kreisel.exchange.exported import ArrayRequest, Exported, ExportedArray, ExportRequest


@dataclass(frozen=True)
class Target:
    """A format: what it is, the usual suffix of its files, whether it holds noise figures, and what writes it."""

    what: str
    suffix: str
    export: Callable[[ExportRequest], Exported]
    noise: bool = False


TARGETS = {
    "kalibr": Target("Kalibr's imu.yaml (scale-misalignment-size-effect)", ".yaml", kalibr.export, noise=True),
    "openvins": Target("OpenVINS' kalibr_imu_chain.yaml", ".yaml", openvins.export, noise=True),
    "ros": Target("ROS' imu_calib (SM and bias of the accelerometers)", ".yaml", number_files.export_ros),
    "px4": Target("parameters of PX4, for QGroundControl", ".params", autopilots.export_px4),
    "ardupilot": Target("parameters of ArduPilot", ".param", autopilots.export_ardupilot),
    "imu_tk": Target("imu_tk's two files", ".calib", number_files.export_imu_tk),
    "c": Target("a header for C99 and C++", ".h", source_code.export_c),
    "rust": Target("a module for Rust", ".rs", source_code.export_rust),
    "matlab": Target("a function for MATLAB and Octave", ".m", source_code.export_matlab),
    "json": Target("the whole result file as JSON", ".json", number_files.export_json),
}


@dataclass(frozen=True)
class ArrayTarget:
    """A format of several IMUs; fields as those of `Target`."""

    what: str
    suffix: str
    export: Callable[[ArrayRequest], ExportedArray]
    noise: bool = False


ARRAY_TARGETS = {
    "kalibr": ArrayTarget("Kalibr's YAML of several IMUs", ".yaml", kalibr_chain.export, noise=True),
    "urdf": ArrayTarget("a URDF with fixed joints", ".urdf", ros_frames.export_urdf),
    "ros-tf": ArrayTarget("a launch file of static transforms for ROS 2", ".launch.xml", ros_frames.export_tf),
}
"""Of a tray; other formats are of a single IMU."""

READERS: dict[str, Callable[[Path, int], Calibration]] = {
    "kalibr": lambda path, _: kalibr.read(path),
    "openvins": lambda path, _: openvins.read(path),
    "px4": autopilots.read_px4,
}
"""Of a file and the number of a sensor in it."""


def target_named(name: str) -> Target:
    """Return a format.

    Raises
    ------
    SettingsError
        If it does not exist, or is one of several IMUs; the message lists those that do.
    """
    if name in ARRAY_TARGETS and name not in TARGETS:
        raise SettingsError(f"--to {name} is of several IMUs: give the result folder that has array.yaml")
    if name not in TARGETS:
        raise SettingsError(unknown_name("format", name, {**TARGETS, **ARRAY_TARGETS}))
    return TARGETS[name]


def array_target_named(name: str, units: Iterable[str]) -> ArrayTarget:
    """Return a format of several IMUs; units: names of those there are.

    Raises
    ------
    SettingsError
        If it does not exist, or is one of a single IMU.
    """
    if name in TARGETS and name not in ARRAY_TARGETS:
        raise SettingsError(
            f"--to {name} is of a single IMU: export the folders of the units ({', '.join(units)}) one by one; of "
            f"several IMUs are: {', '.join(sorted(ARRAY_TARGETS))}"
        )
    if name not in ARRAY_TARGETS:
        raise SettingsError(unknown_name("format", name, {**TARGETS, **ARRAY_TARGETS}))
    return ARRAY_TARGETS[name]


def read_from(name: str, path: Path, instance: int = 0) -> Calibration:
    """Return the calibration in another program's file; of an autopilot's, that of one of its sensors.

    Raises
    ------
    SettingsError
        If the format is not one of those that are read.
    RecordingError
        If the file cannot be read.
    """
    if name not in READERS:
        raise SettingsError(unknown_name("format to read", name, READERS))
    return READERS[name](path, instance)
