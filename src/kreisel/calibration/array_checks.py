"""Checks of what a user passes; every message names the argument."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, lengths
from kreisel.inertial.effects import follows_temperature
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.recording.header import COLDEST, HOTTEST
from kreisel.recording.recording import Recording
from kreisel.recording.user_arrays import check_kind

_MIN_SAMPLES = 6
"""Minimum number of samples; rates are differentiated and integrated over them."""

_MAX_STEP = 1.0
"""Seconds between samples; above it, floats cannot be stamps of an IMU in seconds."""

_MIN_STEP = 2e-5
"""Seconds between samples; below it, integers cannot be stamps of an IMU in nanoseconds."""

_RESOLVED = 0.01
"""Of the usual step, that stamps must resolve. Chosen: derivatives of the rates err by as much."""

_MANY, _FASTEST, _IN_G = 100, 40.0, (0.5, 2.0)
"""Readings from which their units are looked at; rad/s that gyros do not reach (2000 deg/s are 35), but for spikes; and
usual length of accelerations in multiples of gravity. Chosen: no device falls freely for half of a recording."""


def check_recording(recording: object) -> None:
    """Raise an error for what is no recording.

    Raises
    ------
    RecordingError
        Of a path it says how to load it.
    """
    if not isinstance(recording, Recording):
        remedy = "load it: kreisel.load(path)" if isinstance(recording, str | Path) else "take one of kreisel.load"
        raise RecordingError(f"recording: got {type(recording).__name__}, expected a Recording; {remedy}")


def triads(values: ArrayLike, name: str, least: int = _MIN_SAMPLES) -> Array:
    """Return readings of three axes (n, 3) as float64.

    Parameters
    ----------
    name
        Name of the argument, for messages.
    least
        Least number of samples.

    Raises
    ------
    RecordingError
        If they have another shape, are not numbers, or are not finite.
    """
    check_kind(values, name)
    try:
        out = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise RecordingError(f"{name}: not an array of numbers ({error}); expected the shape (n, 3)") from error
    if out.ndim != 2 or out.shape[1] != 3 or len(out) < least:
        raise RecordingError(f"{name}: got the shape {out.shape}, expected (n, 3) with n = {least} or more")
    _check_finite(out, name)
    return out


def _check_finite(values: Array, name: str) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        place = ", ".join(map(str, bad[0]))
        raise RecordingError(f"{name}[{place}] is {values[tuple(bad[0])]}; expected finite numbers; remove this sample")


def elapsed_seconds(timestamps: ArrayLike, size: int, name: str) -> Array:
    """Return the seconds since the first timestamp, (n,).

    Parameters
    ----------
    timestamps : (n,)
        Integers are nanoseconds and are used exactly; floats are seconds.
    size
        Expected number of timestamps.
    name
        Name of the argument, for messages.

    Raises
    ------
    RecordingError
        If they have another shape, are not numbers, do not ascend, or are clearly in another unit.
    """
    stamps = np.asarray(timestamps)
    if stamps.dtype.kind == "M" and not np.isnat(stamps).any():
        stamps = stamps.astype("datetime64[ns]").astype(np.int64)
    if stamps.shape != (size,):
        raise RecordingError(f"{name}: got the shape {stamps.shape}, expected ({size},), one for each reading")
    if stamps.dtype.kind not in "iuf":
        raise RecordingError(
            f"{name}: got values of type {stamps.dtype}, expected seconds as floats, nanoseconds as integers, or dates"
        )
    whole = stamps.dtype.kind in "iu"
    given = stamps.dtype
    if not whole:
        stamps = stamps.astype(float)
        _check_finite(stamps, name)
    check_ascending(stamps, name)
    seconds = (stamps - stamps[0]) * 1e-9 if whole else stamps - stamps[0]
    step = float(np.median(np.diff(seconds)))
    if whole:
        check_nanoseconds(stamps, name)
    if not whole and step > _MAX_STEP:
        guess = "they look like nanoseconds: give those as integers" if step > 1e3 else "give seconds"
        raise RecordingError(f"{name}: floats are seconds, but the usual step is {step:.4g} s; {guess}")
    if given.kind == "f" and np.spacing(given.type(np.abs(stamps).max())) > _RESOLVED * step:
        raise RecordingError(f"{name}: {given} does not resolve steps of {step:.4g} s; give float64, or nanoseconds")
    return np.asarray(seconds)


def check_nanoseconds(stamps: NDArray[Any], name: str) -> None:
    """Raise an error for integers that are nanoseconds of no IMU.

    Raises
    ------
    RecordingError
        With their usual step.
    """
    step = float(np.median(np.diff(stamps.astype(np.int64)))) if stamps.size > 1 else np.inf
    if step < 1e9 * _MIN_STEP:
        raise RecordingError(
            f"{name}: integers are nanoseconds, but the usual step is {step:.4g} ns; give seconds as floats"
        )


def check_si(rates: Array, accelerations: Array) -> None:
    """Raise an error for many readings (n, 3) that are in degrees, or in multiples of gravity.

    Raises
    ------
    RecordingError
        With the unit that they seem to be in.
    """
    if len(rates) < _MANY:
        return
    if float(np.quantile(lengths(rates), 0.99)) > _FASTEST:
        raise RecordingError(f"rates: more than one of a hundred is above {_FASTEST:g} rad/s; are they in deg/s?")
    usual = float(np.median(lengths(accelerations)))
    if _IN_G[0] < usual < _IN_G[1]:
        raise RecordingError(f"accelerations: their usual length is {usual:.3g} m/s^2; are they in g? Give m/s^2")


def check_ascending(stamps: NDArray[Any], name: str) -> None:
    """Raise an error unless stamps ascend.

    Raises
    ------
    RecordingError
        With the first pair that does not.
    """
    back = np.flatnonzero(stamps[1:] <= stamps[:-1])  # a difference of unsigned integers would overflow
    if back.size:
        k = int(back[0])
        raise RecordingError(
            f"{name}[{k + 1}] = {stamps[k + 1]} does not follow {name}[{k}] = {stamps[k]}; expected ascending stamps"
        )


def temperature_difference_of(
    temperatures: ArrayLike | None, count: int, sensors: SensorParameters, temperature_c: float | None
) -> Array | None:
    """Return temperatures (count,) above that of the parameters, K; None where the calibration has none.

    Raises
    ------
    RecordingError
        If it needs them and they are missing, of another shape or not finite.
    """
    if not follows_temperature(sensors.effects):
        return None
    if temperatures is None or temperature_c is None:
        raise RecordingError("temperatures: this calibration has temperature coefficients; give the sensor's, degC")
    try:
        found = np.asarray(temperatures, dtype=float)
    except (TypeError, ValueError) as error:
        raise RecordingError(f"temperatures: not an array of numbers ({error}); expected ({count},)") from error
    if found.shape != (count,):
        raise RecordingError(f"temperatures: got the shape {found.shape}, expected ({count},)")
    if not np.isfinite(found).all():
        bad = int(np.flatnonzero(~np.isfinite(found))[0])
        raise RecordingError(f"temperatures[{bad}] is {found[bad]}; expected finite numbers")
    if count and not COLDEST < float(np.median(found)) < HOTTEST:
        raise RecordingError(f"temperatures: {float(np.median(found)):.4g} degC is that of no sensor; give degC")
    return found - temperature_c
