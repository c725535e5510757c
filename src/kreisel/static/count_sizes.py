"""Nominal sensitivities of raw converter readings, by gravity: its length, and how it turns with the device."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, lengths, nearest_rotation, skew
from kreisel.inertial.counts import Counts
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.inertial.strapdown import raw_readings
from kreisel.recording.header import NO_UNITS
from kreisel.recording.recording import ImuSamples
from kreisel.static.first_values import vertical_misfits
from kreisel.static.rest_search import find_rests
from kreisel.static.turns import turns_between

_BLOCK = 0.05
"""Seconds of readings whose mean is taken: noise matters less, and a hand turns by a few degrees."""

_FAR, _ROUNDS = 0.1, 8
"""Difference of a force from gravity in length, over gravity, with which a block counts as moved; rounds of fits."""

_UNSIGNED = 1.2
"""Offset of the accelerometers, over gravity, from which on the converter is taken to know no sign. Chosen: no offset
is as large, and half of a converter's range is larger."""

_STEPS = 1.04 ** np.arange(-12.0, 13.0)
"""Factors on the first sensitivity of the gyros that are compared. Chosen: moving by hand makes it wrong by 30 %."""

_DIGITS = 3
"""Of a nominal sensitivity."""


def in_quantities(imu: ImuSamples, gravity: float) -> tuple[ImuSamples, Counts | None]:
    """Return readings in SI, and what a count is; None if they are in SI already.

    Raises
    ------
    RecordingError
        If the device is not turned over, so that gravity shows nothing.
    """
    of_rate, of_force = imu.units.counted("rate"), imu.units.counted("acceleration")
    if not of_rate and not of_force:
        return imu, None
    step = max(1, round(_BLOCK / imu.interval))
    blocks = len(imu.stamps_ns) // step
    means = [v[: blocks * step].reshape(blocks, step, 3).mean(axis=1) for v in (imu.rates, imu.accelerations)]
    size, zero = _sphere(means[1], gravity, imu) if of_force else (1.0, np.zeros(3))
    force = (means[1] - zero) * size
    one = Counts(1.0, size, np.zeros(3), zero)
    if of_rate:
        rate, mount, rate_zero = _first_rate(means[0], force, gravity, step * imu.interval, imu)
        one = replace(one, rate=rate, rate_zero=rate_zero)
        one = replace(one, rate=_rounded(rate * _best_factor(_in_si(imu, one), mount)))
    return _in_si(imu, one), one


def _in_si(imu: ImuSamples, counts: Counts) -> ImuSamples:
    rates, accelerations = counts.in_si(imu.rates, imu.accelerations)
    return replace(imu, rates=rates, accelerations=accelerations, units=NO_UNITS)


def _sphere(means: Array, gravity: float, imu: ImuSamples) -> tuple[float, Array]:
    """Return size and zero of the accelerometers' counts: the sphere that most means lie on."""
    weight = np.ones(len(means))
    centre, radius = np.zeros(3), 1.0
    for _ in range(_ROUNDS):
        A = np.column_stack([2.0 * means, np.ones(len(means))]) * weight[:, None]
        x, *_, singular = np.linalg.lstsq(A, np.sum(means**2, axis=1) * weight, rcond=None)
        centre = x[:3]
        radius = float(np.sqrt(max(x[3] + centre @ centre, 0.0)))
        away = lengths(means - centre) / max(radius, 1e-9) - 1.0
        weight = 1.0 / (1.0 + (away / _FAR) ** 2)
    if not radius > 0.0 or not np.isfinite(singular).all():
        raise RecordingError("all accelerations are alike: turn the device over", file=imu.source)
    seen = (means - centre) / radius
    if float(np.linalg.eigvalsh(seen[np.abs(away) < _FAR].T @ seen[np.abs(away) < _FAR]).min()) < 0.02 * len(means):
        raise RecordingError(
            "raw counts need more attitudes: lay the device on each of its faces, so that gravity shows their size",
            file=imu.source,
        )
    unsigned = bool((np.abs(centre) > _UNSIGNED * radius).any())
    return _rounded(gravity / radius), np.round(centre) if unsigned else np.zeros(3)


def _first_rate(w: Array, f: Array, gravity: float, h: float, imu: ImuSamples) -> tuple[float, Array, Array]:
    """Return size of the gyros' counts, how the gyros are mounted (3, 3), and their zero.

    Gravity's direction u, seen in the device, changes by u x omega.
    """
    length = lengths(f)
    u = f / length[:, None]
    change = (u[2:] - u[:-2]) / (2.0 * h)
    still = lengths(change)
    quiet = still <= np.quantile(still, 0.2)
    zero = np.median(w[1:-1][quiet], axis=0)
    good = np.abs(length[1:-1] / gravity - 1.0) < _FAR
    y = (w[1:-1] - zero)[good]
    # change = [u x] K y, linear in the nine entries of K
    A = np.einsum("kij,kl->kijl", skew(u[1:-1][good]), y).reshape(-1, 9)
    K = np.linalg.lstsq(A, change[good].ravel(), rcond=None)[0].reshape(3, 3)
    size = float(np.abs(np.linalg.det(K)) ** (1.0 / 3.0))
    if not size > 0.0:
        raise RecordingError("all rates are alike: turn the device about all axes", file=imu.source)
    unsigned = bool((np.abs(zero) > 0.25 * np.ptp(w, axis=0).max()).any())
    sign = np.sign(np.linalg.det(K))
    return size, sign * nearest_rotation(sign * K), np.round(zero) if unsigned else np.zeros(3)


def _best_factor(imu: ImuSamples, mount: Array) -> float:
    """Return the factor on all rates by which turns between standstills lead from one vertical to the next."""
    try:
        rests = find_rests(imu)
    except RecordingError:
        return 1.0
    if rests.count < 3:
        return 1.0
    up = rests.forces / np.linalg.norm(rests.forces, axis=1, keepdims=True)
    raw = raw_readings(imu.seconds, imu.rates, imu.accelerations)
    offset = -np.median(rests.rates, axis=0)[None]
    misfits = []
    for factor in _STEPS:
        sensors = SensorParameters(factor * mount, offset, np.eye(3), np.zeros((1, 3)), np.zeros((3, 3)))
        turns = turns_between(imu, raw, rests, sensors)
        misfits.append(float(vertical_misfits(turns.rotations, up[:-1], up[1:]).mean()))
    return float(_STEPS[int(np.argmin(misfits))])


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
