"""Whether columns can be what a mapping says: rates held against orientations, both thinned to be quick."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from kreisel.errors import KreiselError
from kreisel.formats.mapped import stamps_of
from kreisel.formats.mapping import parse_time
from kreisel.formats.rotation_forms import quaternions_of
from kreisel.formats.sheet import Sheet
from kreisel.geometry.rotation import Array, apply, lengths, nearest_rotation
from kreisel.inertial.readings import Readings
from kreisel.recording.recording import ImuSamples, ReferencePoses, Stamps
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.correlation import correlate
from kreisel.synchronization.rate_fit import fit_linear_rates

_IMU_STEP, _POSE_STEP = 0.01, 0.03
"""Seconds; more densely nothing more is learned of a mapping."""

_MAX_SAMPLES, _MAX_POSES = 40_000, 15_000
"""Rows after thinning. Chosen: 400 and 450 s with the steps above, more than `_LONG`; longer tables are thinned
further, so that a proposal takes seconds."""

_LONG = 300.0
"""Seconds of poses that are compared."""

_HOPELESS = 0.3
"""Share of the rotation that a right mapping explains without any search for the time offset."""

_FALL_STEP, _BEND = 0.1, 0.25
"""s over which the turn of gravity is compared, and half of a second difference of positions. Chosen: gravity turns by
more than the noise, and by a small angle; the second as `synchronization.windows.HALF_WINDOW`."""


@dataclass(frozen=True)
class Fit:
    """How well readings and orientations agree.

    Attributes
    ----------
    explained
        Share of the rotation that the rates explain; -1 where nothing could be compared.
    size
        Of the matrix between rates and rotation: the unit of the rates.
    handed
        1, or -1 where the matrix mirrors.
    steady
        Length of the mean acceleration in the reference's axes, over the mean length: 1 where gravity stands still.
    upright
        Share of that mean along the reference's third axis.
    moved, length
        Correlation of the accelerations with those of the positions, and the size of a unit of the positions in m; 0
        and 1 where there are no positions.
    """

    explained: float = -1.0
    size: float = 1.0
    handed: float = 1.0
    steady: float = 0.0
    upright: float = 0.0
    moved: float = 0.0
    length: float = 1.0


NO_FIT = Fit()
"""Of what could not be compared."""


def thinned_imu(sheet: Sheet, time: str, rate: tuple[int, ...], force: tuple[int, ...]) -> ImuSamples | None:
    """Return means of readings over blocks, as they stand in the table; None where too few rows are complete."""
    values = np.column_stack([sheet.columns[k] for k in (*rate, *force)]).astype(np.float64)
    found = _complete(sheet, time, values)
    if found is None:
        return None
    stamps, values = found
    step = float(np.median(np.diff(stamps))) * 1e-9
    size = max(1, int(_IMU_STEP / step), -(-stamps.size // _MAX_SAMPLES))
    n = stamps.size // size * size
    mean = values[:n].reshape(-1, size, 6).mean(axis=1)
    middle = stamps[:n].reshape(-1, size)
    middle = middle[:, 0] + np.round((middle - middle[:, :1]).mean(axis=1)).astype(np.int64)
    return ImuSamples(middle, mean[:, :3], mean[:, 3:], sheet.source)


def thinned_poses(
    sheet: Sheet, time: str, orientation: tuple[str, Array] | None, position: Array | None
) -> ReferencePoses | None:
    """Return some of the poses; `orientation` is a form and its numbers (n, k), angles in rad, `position` is (n, 3)."""
    parts = [part for part in (None if orientation is None else orientation[1], position) if part is not None]
    found = _complete(sheet, time, np.hstack(parts))
    if found is None:
        return None
    stamps, values = found
    changed = np.append(True, (np.diff(values, axis=0) != 0.0).any(axis=1))
    if np.mean(~changed) > 0.3:  # each is repeated until the next
        stamps, values = stamps[changed], values[changed]
    if stamps.size < 20:
        return None
    step = float(np.median(np.diff(stamps))) * 1e-9
    some = slice(None, None, max(1, int(_POSE_STEP / step), -(-stamps.size // _MAX_POSES)))
    stamps, values = stamps[some], values[some]
    width = 0 if orientation is None else orientation[1].shape[1]
    q = None
    if orientation is not None:
        try:
            q = quaternions_of(orientation[0], values[:, :width])
        except KreiselError:  # no rotations
            return None
        length = lengths(q)
        good = (length > 0.5) & (length < 2.0)
        stamps, values, q = stamps[good], values[good], (q / np.maximum(length, 1e-9)[:, None])[good]
    if stamps.size < 20:
        return None
    lively = _liveliest(stamps, values if q is None else q)
    stamps, values, q = stamps[lively], values[lively], None if q is None else q[lively]
    return ReferencePoses("pose0", stamps, None if position is None else values[:, width:], q, sheet.source)


def _liveliest(stamps: Stamps, values: Array) -> slice:
    """Return the part of a long series in which values change most: a search over hours would take minutes."""
    t = (stamps - stamps[0]) * 1e-9
    if t[-1] < 1.5 * _LONG:
        return slice(None)
    way = np.append(0.0, np.cumsum(np.minimum(lengths(np.diff(values, axis=0)), 0.1)))
    ends = np.searchsorted(t, t + _LONG)
    inside = ends < t.size
    first = int(np.argmax(way[ends[inside]] - way[: ends.size][inside]))
    return slice(first, int(ends[first]))


def _complete(sheet: Sheet, time: str, values: Array) -> tuple[Stamps, Array] | None:
    """Return stamps in order, each once, and the rows of values that belong to them and hold numbers throughout."""
    try:
        stamps, known, _ = stamps_of(sheet, parse_time(time))
    except KreiselError:
        return None
    rows = np.flatnonzero(np.isfinite(values).all(axis=1) & known)
    stamps = stamps[rows] if parse_time(time).terms else stamps[: rows.size]
    order = np.argsort(stamps, kind="stable")
    stamps, values = stamps[order], values[rows[order]]
    new = np.append(True, np.diff(stamps) > 0)
    return (stamps[new], values[new]) if new.sum() > 20 else None


def compare(imu: ImuSamples, poses: ReferencePoses, *, one_clock: bool) -> Fit:
    """Return how well readings and orientations agree.

    Parameters
    ----------
    one_clock
        Whether both have the same stamps: then what does not agree at all without a search is not searched for.
    """
    tau, q = poses.seconds, poses.quaternions
    assert q is not None  # noqa: S101 - for the type checker; the caller gave some
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # most readings make no sense
        try:
            readings = Readings(imu.seconds, imu.rates, imu.accelerations, ((0, imu.stamps_ns.size - 1),))
            if one_clock:
                clock = Clock(1e-9 * float(poses.stamps_ns[0] - imu.stamps_ns[0]), 0.0)
                _, explained = fit_linear_rates(readings, tau, q, clock)
                if explained < _HOPELESS:
                    return Fit(explained)
            clock = correlate(imu, poses).clock
            K, explained = fit_linear_rates(readings, tau, q, clock)
            k = np.clip(np.searchsorted(readings.stamps, clock.imu_time(tau)), 0, readings.stamps.size - 1)
            determinant = float(np.linalg.det(K))
            C = nearest_rotation(K if determinant > 0.0 else -K)
            forces = apply(q, imu.accelerations[k] @ C.T)
        except (KreiselError, ValueError, IndexError, ArithmeticError, np.linalg.LinAlgError):
            return NO_FIT
    mean = forces.mean(axis=0)
    length = float(np.linalg.norm(mean))
    usual = float(lengths(forces).mean())
    if not np.isfinite([explained, determinant, length, usual]).all() or length == 0.0:
        return NO_FIT
    size = float(np.cbrt(abs(determinant)))
    moved = (0.0, 1.0) if poses.positions is None else _by_positions(tau, poses.positions, forces)
    return Fit(explained, size, float(np.sign(determinant)), length / usual, float(abs(mean[2]) / length), *moved)


def _by_positions(tau: Array, p: Array, forces: Array) -> tuple[float, float]:
    """Return the correlation of forces (m, 3) in the reference's axes with its accelerations, and their ratio.

    A second difference over a time h is the mean of the acceleration with the weights of a triangle from -h to h.
    """
    step = float(np.median(np.diff(tau)))
    h = max(1, round(_BEND / step))
    if tau.size < 4 * h + 20:
        return 0.0, 1.0
    bent = (p[2 * h :] - 2.0 * p[h:-h] + p[: -2 * h]) / (h * step) ** 2
    weights = np.bartlett(2 * h + 1)
    weights /= weights.sum()
    meant = np.column_stack([np.convolve(f, weights, mode="valid") for f in forces.T])
    even = np.abs(tau[2 * h :] - tau[: -2 * h] - 2.0 * h * step) < 0.5 * step
    if even.sum() < 20:
        return 0.0, 1.0
    bent, meant = bent[even], meant[even]
    bent, meant = bent - np.median(bent, axis=0), meant - np.median(meant, axis=0)
    product, own, other = float(np.sum(bent * meant)), float(np.sum(bent**2)), float(np.sum(meant**2))
    if not own > 0.0 or not other > 0.0 or product == 0.0:
        return 0.0, 1.0
    # the reference's noise makes its accelerations too large, so the ratio of the sizes is used, not the slope
    return product / (own * other) ** 0.5, (other / own) ** 0.5


def by_gravity(imu: ImuSamples) -> tuple[float, float]:
    """Return size and correlation of the turn of gravity that the rates say: of the IMU alone.

    The accelerometers' vector turns against the body: its change over a short time is minus rate times vector. What
    accelerates the body besides is noise in that.
    """
    step = imu.interval
    size = max(1, round(_FALL_STEP / step))
    n = imu.stamps_ns.size // size * size
    if n < 20 * size:
        return 1.0, 0.0
    w, f = (part[:n].reshape(-1, size, 3).mean(axis=1) for part in (imu.rates, imu.accelerations))
    said = -np.cross(0.5 * (w[1:] + w[:-1]) * size * step, 0.5 * (f[1:] + f[:-1]))
    seen = np.diff(f, axis=0)
    product, own, other = (float(np.sum(a * b)) for a, b in ((said, seen), (said, said), (seen, seen)))
    if own <= 0.0 or other <= 0.0:
        return 1.0, 0.0
    return product / own, product / (own * other) ** 0.5


def scaled(imu: ImuSamples, rate: float) -> ImuSamples:
    """Return the samples with rates in another unit."""
    return replace(imu, rates=rate * imu.rates)
