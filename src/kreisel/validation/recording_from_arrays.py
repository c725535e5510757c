"""A recording from arrays: NumPy's, or frames of pandas and polars through the array interface."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array
from kreisel.recording.header import HeaderUnits
from kreisel.recording.location import ARRAYS
from kreisel.recording.nanoseconds import in_nanoseconds
from kreisel.recording.recording import NO_STAMP, ImuSamples, JointAngles, Recording, ReferencePoses, Stamps
from kreisel.recording.recording_settings import RecordingSettings, what_is_wrong
from kreisel.recording.user_arrays import check_kind
from kreisel.validation.checks import check_streams

_SLOWEST_IMU, _SLOWEST_POSES, _FASTEST = 2.5, 100.0, 4e4
"""Longest steps between stamps, s, and the shortest, ns, that devices have."""

_MAX_SECONDS = 9e9  # s; a little below the largest ns in 64 bits, 9.2e18


def from_arrays(
    imu_stamps: ArrayLike,
    rates: ArrayLike,
    accelerations: ArrayLike,
    pose_stamps: ArrayLike | None = None,
    positions: ArrayLike | None = None,
    quaternions: ArrayLike | None = None,
    *,
    joint_stamps: ArrayLike | None = None,
    joint_angles: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    settings: RecordingSettings | Mapping[str, Any] | None = None,
    urdf: str | None = None,
    name: str = "arrays",
) -> Recording:
    """Return a recording from arrays, or from columns of pandas or polars, checked as one from files.

    Parameters
    ----------
    imu_stamps, pose_stamps : (n,), (m,)
        Each on its own clock: integers are nanoseconds, floats are seconds; or dates.
    rates, accelerations : (n, 3)
        Raw readings, rad/s and m/s^2.
    positions : (m, 3)
        m; may be left out if there are quaternions.
    quaternions : (m, 4)
        q_rb, scalar first; may be left out if there are positions.
    joint_stamps, joint_angles : (k,), (k, joints)
        The arm's, rad; the stamps are those of the poses by default.
    temperature : (n,)
        Of the sensor, degrees Celsius.
    settings
        Tables as in recording.toml, such as ``{"imu": {"grade": "fog-mems"}, "reference": {"kind": "mocap"}}``. The
        robot's description is given by `urdf`.
    urdf
        Text of the robot's description.
    name
        Of the recording.

    Raises
    ------
    RecordingError
        For an argument of another shape or type (the message begins with its name), and for all that is refused in
        files. Rows that are not finite are left out, with a warning.
    """
    stamps = _stamps(imu_stamps, "imu_stamps", _SLOWEST_IMU)
    n = stamps.size
    warm = None if temperature is None else _numbers(temperature, "temperature", n, None)
    imu = ImuSamples(
        stamps,
        _numbers(rates, "rates", n, 3),
        _numbers(accelerations, "accelerations", n, 3),
        ARRAYS / "imu",
        HeaderUnits(_time_unit(imu_stamps), rate="rad s^-1", acceleration="m s^-2"),
        temperature=warm,
    )
    reference = None
    if positions is not None or quaternions is not None:
        if pose_stamps is None:
            raise RecordingError("pose_stamps: are missing; give the stamps of the poses")
        tau = _stamps(pose_stamps, "pose_stamps")
        reference = ReferencePoses(
            "pose0",
            tau,
            None if positions is None else _numbers(positions, "positions", tau.size, 3),
            None if quaternions is None else _numbers(quaternions, "quaternions", tau.size, 4),
            ARRAYS / "reference",
            HeaderUnits(_time_unit(pose_stamps), length="m"),
        )
    elif pose_stamps is not None:
        raise RecordingError("positions, quaternions: are missing; pose_stamps belong to them")
    joints = None
    if joint_angles is None and joint_stamps is not None:
        raise RecordingError("joint_angles: are missing; joint_stamps belong to them")
    if joint_angles is not None:
        given = pose_stamps if joint_stamps is None else joint_stamps
        if given is None:
            raise RecordingError("joint_stamps: are missing; give the stamps of the joint angles")
        at = _stamps(given, "joint_stamps")
        joints = JointAngles(at, _numbers(joint_angles, "joint_angles", at.size, -1), ARRAYS / "joints",
                             HeaderUnits(angle="rad"))  # fmt: skip
    return check_streams(Recording(Path(str(name)), imu, reference, joints, _settings(settings), urdf=urdf))


def _settings(given: RecordingSettings | Mapping[str, Any] | None) -> RecordingSettings:
    try:
        known = given if isinstance(given, RecordingSettings) else RecordingSettings.model_validate(dict(given or {}))
        return known.model_copy(update={"columns": None})
    except ValidationError as error:
        raise RecordingError(f"settings: {what_is_wrong(error)}") from error
    except (TypeError, ValueError) as error:
        raise RecordingError(f"settings: expected tables as in recording.toml ({error})") from error


def _numbers(values: ArrayLike, name: str, size: int, width: int | None) -> Array:
    """Return an argument as float64, (size,) or (size, width); any width if that is -1."""
    check_kind(values, name)
    try:
        out = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RecordingError(f"{name}: not an array of numbers ({error})") from error
    shape = (size,) if width is None else (size, "k" if width == -1 else width)
    fits = (
        out.size > 0
        and out.ndim == len(shape)
        and out.shape[0] == size
        and (width in (None, -1) or out.shape[1] == width)
    )
    if not fits:
        hint = "; transpose it" if out.ndim == 2 and out.shape[1] == size else ""
        raise RecordingError(f"{name}: got the shape {out.shape}, expected ({', '.join(map(str, shape))}){hint}")
    return out


def _stamps(values: ArrayLike, name: str, slowest: float = _SLOWEST_POSES) -> Stamps:
    """Return stamps in ns: of integers in ns, floats in s (steps up to `slowest`), or dates; NO_STAMP where none is."""
    check_kind(values, name)
    stamps = np.asarray(values)
    if stamps.ndim != 1 or stamps.size < 2:
        raise RecordingError(f"{name}: got the shape {stamps.shape}, expected (n,)")
    kind = stamps.dtype.kind
    if kind == "M":
        return np.where(np.isnat(stamps), NO_STAMP, stamps.astype("datetime64[ns]").astype(np.int64))
    if kind == "O":
        try:
            return _stamps(stamps.astype("datetime64[ns]"), name, slowest)  # dates with a time zone are objects
        except (TypeError, ValueError):
            pass
    if kind not in "iuf":
        raise RecordingError(
            f"{name}: got values of type {stamps.dtype}, expected seconds as floats, nanoseconds as integers, or dates"
        )
    if kind == "f":
        known = np.isfinite(stamps)
        if known.sum() < 2:
            raise RecordingError(f"{name}: {int(known.sum())} of {stamps.size} are finite numbers")
        largest = float(np.abs(stamps[known]).max())
        step = float(np.median(np.abs(np.diff(stamps[known]))))
        if step > slowest or largest > _MAX_SECONDS:
            raise RecordingError(
                f"{name}: floats are seconds, but the usual step is {step:.4g} s; give nanoseconds as integers"
            )
        resolved = float(np.spacing(stamps.dtype.type(largest)))
        if resolved > 0.01 * step:
            raise RecordingError(
                f"{name}: {stamps.dtype} resolves {resolved:.2g} s only, and the usual step is {step:.4g} s; give "
                "float64, or nanoseconds as integers"
            )
        return np.where(known, in_nanoseconds(np.where(known, stamps, 0.0).astype(np.float64), 1e9), NO_STAMP)
    if stamps.max() > 9e18 or stamps.min() < -9e18:
        raise RecordingError(f"{name}: integers are nanoseconds; {stamps.max()} does not fit 64 bits")
    whole = stamps.astype(np.int64)
    step = float(np.median(np.abs(np.diff(whole))))
    if step < _FASTEST:
        raise RecordingError(
            f"{name}: integers are nanoseconds, but the usual step is {step:.4g} ns; give seconds as floats"
        )
    return whole


def _time_unit(stamps: ArrayLike) -> str:
    """Return the unit in which stamps were given."""
    return "s" if np.asarray(stamps).dtype.kind == "f" else "ns"
