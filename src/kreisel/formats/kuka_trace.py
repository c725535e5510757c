"""Traces of KUKA's controllers ($TRACE): their poses and joint angles, and how these are added to a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kreisel.errors import RecordingError, RobotError
from kreisel.files import read_bytes
from kreisel.formats.diadem import BEGIN, read_diadem
from kreisel.formats.kuka_channels import JOINTS, ORIENTATION, POSITION, Channel, choose, factor, meaning
from kreisel.formats.kuka_trace_text import read_text
from kreisel.formats.robot_description import description_beside
from kreisel.formats.write import add_reference
from kreisel.geometry.interpolation import continuous
from kreisel.geometry.kuka import from_abc
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import DataWarning, JointAngles, ReferencePoses, Stamps
from kreisel.recording.recording_settings import RecordingSettings, read_settings
from kreisel.robot.description import parse_arm
from kreisel.robot.kinematics import poses
from kreisel.units import DEG

SUFFIXES = (".dat", ".r64", ".trc", ".asc", ".txt")
"""Endings of the files of a trace; only headers and texts are read by name."""

_NO_VALUE = 1e30
"""DIAdem writes 9.9e34 for missing values."""

_MAX_TRACE = 1 << 28
"""Largest size in bytes of a trace as text, 256 MiB: several hours."""

_TURNED = 2.0 * np.pi
"""If all angles of a robot are within so many degrees, they are radians."""

_FAR = {"angle": 720.0 * DEG, "length": 100.0}
"""rad and m that no axis and no tool reaches, but angles of motors before the gear do."""

_NEAR = 10.0
"""If all positions of a tool are within so many millimetres, they are metres."""


_QUANTITY = {JOINTS: "angle", POSITION: "length", ORIENTATION: "angle"}


@dataclass(frozen=True)
class Trace:
    """The robot's motion in a trace, on the controller's clock from its first sample on."""

    joints: JointAngles | None
    reference: ReferencePoses | None
    warnings: tuple[DataWarning, ...]


def is_trace(path: Path) -> bool:
    """Return whether a file's name is that of a trace, not of a recording."""
    return path.suffix.lower() in SUFFIXES and not path.is_dir()


def read_trace(path: Path) -> Trace:
    """Return the measured joint angles A1 to A6 and the measured pose X to C of a trace, each if present.

    Parameters
    ----------
    path
        The header (.dat) of a KR C4's trace, with its .r64 in the same folder; or a trace as text.

    Raises
    ------
    RecordingError
        If it cannot be read, holds none of these, or has impossible values; the message says where.
    """
    text = _text(path)
    diadem = BEGIN in text or text.startswith("DIA")
    channels, warnings = (read_diadem if diadem else read_text)(path, text)
    stamps = _stamps(channels, path)
    taken = {wanted: chosen for wanted in _QUANTITY if (chosen := choose(channels, wanted, path)) is not None}
    if not taken:
        raise _nothing(channels, path)
    _check_numbers([channel for chosen in taken.values() for channel in chosen], stamps.size, path)
    warnings += [DataWarning("trace", f"took {_named(chosen)}{_assumptions(chosen)}") for chosen in taken.values()]
    values = {wanted: _values(chosen, _QUANTITY[wanted], path) for wanted, chosen in taken.items()}
    joints, p, abc = (values.get(wanted) for wanted in _QUANTITY)
    q = None if abc is None else continuous(np.array([from_abc(*angles) for angles in abc.tolist()]))
    return Trace(
        None if joints is None else JointAngles(stamps, joints, path),
        None if p is None and q is None else ReferencePoses("pose0", stamps, p, q, path),
        tuple(warnings),
    )


def add_trace(path: Path, folder: Path) -> tuple[DataWarning, ...]:
    """Write the poses and joint angles of a trace into a new or existing recording folder.

    Where the trace holds only joint angles, poses are computed from them with the folder's robot.urdf.

    Returns
    -------
    warnings
        Warnings about the channels used, and about files still missing in the folder.

    Raises
    ------
    RecordingError
        If the trace cannot be read, the folder has poses or joint angles already, or robot.urdf is needed and missing.
    RobotError
        If the folder's robot.urdf is not an arm of six joints.
    """
    trace = read_trace(path)
    root = folder / "mav0" if (folder / "mav0" / "imu0").is_dir() else folder
    reference, warnings = trace.reference, list(trace.warnings)
    if reference is None and trace.joints is not None:
        reference, warning = _by_kinematics(trace.joints, folder)
        warnings.append(warning)
    add_reference(root, reference, trace.joints)
    if not (root / "imu0").is_dir():
        warnings.append(
            DataWarning("imu0", f"is not there yet: put the IMU's readings into {root / 'imu0' / 'data.csv'}")
        )
    return tuple(warnings)


def _by_kinematics(joints: JointAngles, folder: Path) -> tuple[ReferencePoses, DataWarning]:
    toml = folder / "recording.toml"
    settings = read_settings(toml) if toml.exists() else RecordingSettings()
    urdf, name = description_beside(folder, settings), settings.robot.urdf or "robot.urdf"
    if urdf is None:
        raise RecordingError(
            f"holds only joint angles, and there is no {name} in {folder} to compute poses from them; put the robot's "
            "description there and convert again, or trace X, Y, Z, A, B, C of the tool as well",
            file=joints.source,
        )
    arm = parse_arm(urdf, settings.robot.tcp, str(folder / name))
    if len(arm.joints) != len(JOINTS):
        raise RobotError(
            f"{folder / name}: {len(arm.joints)} joints move '{arm.tcp}' ({', '.join(arm.joints)}), expected the six "
            "of the trace; correct it, or robot.tcp in recording.toml"
        )
    p, q = poses(arm, joints.angles)
    reference = ReferencePoses("pose0", joints.stamps_ns, p, q, joints.source)
    return reference, DataWarning(
        "pose0", f"poses of '{arm.tcp}' were computed from these angles with {name}: the trace holds none"
    )


def _text(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix == ".r64":
        raise RecordingError("holds only the values; give the .dat next to it, which names them", file=path)
    try:
        data = read_bytes(path, _MAX_TRACE)
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}; give a trace's .dat or text", file=path) from error
    if b"\0" in data:
        remedy = "export it as text" if suffix == ".trc" else "give a trace's .dat (KR C4) or its text (KR C2)"
        raise RecordingError(f"is binary (byte {data.index(0)} is zero); {remedy}", file=path)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # the encoding of the controllers: ° is one byte
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _stamps(channels: Sequence[Channel], path: Path) -> Stamps:
    times = [channel for channel in channels if channel.time]
    if len(times) != 1:
        raise RecordingError(
            f"{len(times)} channels hold the time{f': {_named(times)}' if times else ''}; expected one, 'Zeit', with "
            "the step between samples: trace again",
            file=path,
        )
    time = times[0]
    if meaning(time.name) is not None:
        raise RecordingError(
            f"the first column is '{time.name}', expected the time; export the trace with its time",
            file=path,
            line=time.line,
        )
    seconds = time.values * factor(time, "time", "s", path)
    if not np.all(np.abs(seconds) < 4e9):
        k = int(np.argmin(np.abs(seconds) < 4e9))
        raise _fault(path, time, f"{time.values[k]:g} at sample {k + 1} is not a possible time; trace again")
    stamps = np.round(seconds * 1e9).astype(np.int64)
    steps = np.diff(stamps)
    back = np.flatnonzero(steps <= 0)
    if back.size:
        k = int(back[0])
        raise _fault(
            path,
            time,
            f"time goes from {time.values[k]:g} to {time.values[k + 1]:g} at sample {k + 2}, and so in {back.size} "
            "places; expected it to grow: split the trace there, or export all digits",
        )
    rate = 1e9 / float(np.median(steps)) if steps.size else 0.0
    if not 0.5 <= rate <= 20e3:
        raise _fault(
            path,
            time,
            f"{stamps.size} samples, {rate:g} a second in [{time.unit}]; expected 0.5 to "
            "20000: write the unit after the name, as in 'Zeit [s]'",
        )
    return stamps - stamps[0]  # time before the trigger is negative, which not every format can store


def _check_numbers(chosen: Sequence[Channel], size: int, path: Path) -> None:
    """Raise an error unless each channel has as many numbers as there are stamps, and these move."""
    for channel in chosen:
        if channel.values.size != size:
            raise _fault(
                path, channel, f"{channel.values.size} values, but the time has {size}; expected as many: trace again"
            )
        missing = np.flatnonzero(~(np.abs(channel.values) < _NO_VALUE))
        if missing.size:
            k = int(missing[0])
            raise _fault(
                path,
                channel,
                f"{channel.values[k]:g} at sample {k + 1} of {size}, and {missing.size - 1} more such, are not values; "
                "expected only numbers: trace again",
            )
    # the last digit of a measured value always changes
    still = [channel for channel in chosen if np.all(channel.values == channel.values[0])]
    if still:
        which = "as are all others" if len(still) == len(chosen) else f"but not all of {_named(chosen)} are constant"
        raise _fault(
            path,
            still[0],
            f"{still[0].values[0]:g} in all samples, {which}; a measured value is never constant: it was not recorded, "
            "or the robot did not move. Trace again",
        )


def _values(chosen: Sequence[Channel], quantity: str, path: Path) -> Array:
    """Return channels (n, k) in SI, unless their numbers look like another unit's."""
    usual = "°" if quantity == "angle" else "mm"
    factors = np.array([factor(channel, quantity, usual, path) for channel in chosen])
    values = np.column_stack([channel.values for channel in chosen]) * factors
    largest = np.abs(values).max(axis=0)
    k = int(np.argmax(largest))
    seen = f"up to {largest[k] / factors[k]:.6g} [{chosen[k].unit or usual}]"
    if largest[k] > _FAR[quantity]:
        raise _fault(
            path,
            chosen[k],
            f"{seen}, larger than for any robot; expected angles of axes (not of motors, before the gear) and "
            "positions of the tool: correct the unit, or trace those",
        )
    small, si = (_TURNED, "rad") if quantity == "angle" else (_NEAR, "m")
    if largest[k] < small * factors[k] and factors[k] < 1.0:
        raise _fault(
            path, chosen[k], f"{seen}, and no more in {_named(chosen)}: they look like [{si}]; correct the unit"
        )
    return values


def _nothing(channels: Sequence[Channel], path: Path) -> RecordingError:
    """Return the error for a trace without what is needed: what it holds, and what to trace."""
    others = [channel for channel in channels if not channel.time]
    commanded = [c for c in others if (known := meaning(c.name)) is not None and known[0] == "commanded"]
    note = f" ({_named(commanded)}: commanded, not measured)" if commanded else ""
    if any(channel.name.lower() in ("istposition", "sollposition") for channel in others):
        note += " (a drive's own position is that of its motor, before the gear)"
    return RecordingError(
        "no measured motion: expected AxisPos_Act1 to AxisPos_Act6, or X, Y, Z or A, B, C with Act in their names; the "
        f"channels are {_named(others)}{note}. Add those to the trace's configuration (module KRCIpo) and trace again",
        file=path,
    )


def _named(channels: Sequence[Channel]) -> str:
    names = [channel.name or "(no name)" for channel in channels[:40]]
    return ", ".join(names) + (f" and {len(channels) - 40} more" if len(channels) > 40 else "")


def _assumptions(chosen: Sequence[Channel]) -> str:
    """Return the text of what is assumed about channels whose names or units leave it open."""
    text = ""
    if any((known := meaning(channel.name)) is not None and known[0] == "bare" for channel in chosen):
        text += "; their names do not say whether they are measured or commanded"
    if any(channel.unit is None for channel in chosen):
        text += "; without unit, so assumed in ° and mm"
    return text


def _fault(path: Path, channel: Channel, message: str) -> RecordingError:
    return RecordingError(f"channel '{channel.name}': {message}", file=path, line=channel.line)
