"""What can be wrong with a stream by itself; each fault has its message, with file and line.

What shows only when reference and IMU are compared (units, conventions, another run's poses) is judged
in `calibration.plausibility`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import Finding, ImuSamples, Recording, ReferencePoses, Stamps
from kreisel.units import STANDARD_GRAVITY

SHORTEST = 5.0
"""Seconds of recording below which nothing is tried."""

LONG_GAP = 0.05
"""Seconds without IMU samples up to which the motion is bridged, at least five sampling intervals."""

_SHORTEST_FREEZE = 8
"""Samples in a row that must be the same in all six channels to be called frozen."""


def check_streams(recording: Recording) -> Recording:
    """Return the recording with findings added and quaternions made unit length.

    Raises
    ------
    RecordingError
        For the first fault that would make results wrong.
    """
    findings: list[Finding] = []
    imu = recording.imu
    _check_stamps(imu.stamps_ns, imu.source, "IMU")
    _check_finite(np.hstack([imu.rates, imu.accelerations]), imu.source)
    _check_imu_rate(imu)
    _check_gravity_unit(imu)
    _check_saturation(imu)
    _check_frozen(imu)
    findings.extend(_gap_findings(imu.stamps_ns, imu.source.parent.name, LONG_GAP))
    reference = recording.reference
    if reference is not None:
        reference = _check_reference(reference, findings)
    if recording.joints is not None:
        _check_stamps(recording.joints.stamps_ns, recording.joints.source, "joint angle")
        _check_finite(recording.joints.angles, recording.joints.source)
    return replace(recording, reference=reference).with_findings(*findings)


def gaps(stamps_ns: Stamps, longest: float) -> NDArray[np.int64]:
    """Return the indices k after which more than `longest` seconds (and five intervals) pass to k + 1."""
    steps = np.diff(stamps_ns)
    return np.flatnonzero(steps > max(longest * 1e9, 5.0 * float(np.median(steps))))


def _check_stamps(stamps: Stamps, source: Path, what: str) -> None:
    if stamps.size < 10:
        raise RecordingError(f"holds {stamps.size} {what} rows; too few for anything", file=source)
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0)
    if back.size:
        k = int(back[0])
        raise RecordingError(
            f"stamps run backwards by {-steps[k] * 1e-9:.6g} s here and in {back.size - 1} more places; "
            "sort the rows, or split the file where the clock was reset",
            file=source,
            line=k + 3,
        )
    same = np.flatnonzero(steps == 0)
    if same.size:
        raise RecordingError(
            f"the stamp {stamps[same[0]]} stands twice, and {same.size - 1} more stamps do too; delete the duplicates",
            file=source,
            line=int(same[0]) + 3,
        )
    usual = float(np.median(steps))
    far = np.flatnonzero(steps > max(600e9, 1e4 * usual))
    if far.size:
        k = int(far[0])
        raise RecordingError(
            f"stamps jump by {steps[k] * 1e-9:.6g} s here (usual step {usual * 1e-9:.4g} s); "
            "the clock was set during the recording: split the file here",
            file=source,
            line=k + 3,
        )


def _check_finite(values: Array, source: Path) -> None:
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        raise RecordingError(
            f"not a finite number here, and in {bad.size - 1} more rows; delete these rows (a gap is bridged)",
            file=source,
            line=int(bad[0]) + 2,
        )


def _check_imu_rate(imu: ImuSamples) -> None:
    rate = 1.0 / imu.interval
    if not 20.0 <= rate <= 20e3:
        guess = ""
        for unit, factor in (("us", 1e3), ("ms", 1e6), ("s", 1e9)):
            if 20.0 <= rate / factor <= 20e3:
                guess = f"; they look like [{unit}]: write '#timestamp [{unit}]' in the header"
        raise RecordingError(
            f"stamps say {rate:.6g} samples a second; expected 20 to 20000{guess}", file=imu.source, line=1
        )
    duration = float(imu.seconds[-1])
    if duration < SHORTEST:
        raise RecordingError(f"lasts {duration:.2f} s; a calibration needs {SHORTEST:g} s and more of motion", file=imu.source)


def _check_gravity_unit(imu: ImuSamples) -> None:
    length = float(np.median(np.linalg.norm(imu.accelerations, axis=1)))
    if 4.0 < length < 25.0:
        return
    for unit, size in (("g", 1.0), ("mg", 1e3), ("cm s^-2", 100.0 * STANDARD_GRAVITY)):
        if 0.6 * size < length < 1.6 * size:
            raise RecordingError(
                f"accelerations have a median length of {length:.4g}, where gravity alone makes {STANDARD_GRAVITY:.4g} m/s^2: "
                f"they look like [{unit}]. Write the unit into the header, or convert",
                file=imu.source,
                line=1,
            )
    raise RecordingError(
        f"accelerations have a median length of {length:.4g} m/s^2, where gravity alone makes {STANDARD_GRAVITY:.4g}; "
        "check unit, scale and whether gravity was removed (raw readings are needed)",
        file=imu.source,
        line=1,
    )


def _check_saturation(imu: ImuSamples) -> None:
    names = ("w_x", "w_y", "w_z", "a_x", "a_y", "a_z")
    values = np.hstack([imu.rates, imu.accelerations])
    for channel, name in enumerate(names):
        x = values[:, channel]
        for extreme in (x.max(), x.min()):
            at = x == extreme
            if int(at.sum()) < 5 or extreme == 0.0:
                continue
            starts = np.flatnonzero(at[1:] & ~at[:-1]) + 1
            lengths = _run_lengths(at)
            if lengths.max() < 3:
                continue
            # A clipped signal arrives at its end steeply and stays; a quantised peak is approached gently.
            usual = np.median(np.abs(np.diff(np.unique(x))))
            step = np.median(np.abs(x[starts] - x[starts - 1])) if starts.size else 0.0
            spread = float(np.std(x))
            if abs(extreme - np.median(x)) > 2.0 * spread and step > max(8.0 * usual, 0.02 * spread):
                line = int(np.flatnonzero(at)[0]) + 2
                raise RecordingError(
                    f"{name} stays at its {'largest' if extreme > 0 else 'smallest'} value {extreme:.6g} for up to "
                    f"{lengths.max()} samples, {int(at.sum())} in all: the sensor is saturated. Move more gently, or choose a larger range",
                    file=imu.source,
                    line=line,
                )


def _check_frozen(imu: ImuSamples) -> None:
    values = np.hstack([imu.rates, imu.accelerations])
    same = (np.diff(values, axis=0) == 0.0).all(axis=1)
    lengths = _run_lengths(same)
    if lengths.size == 0 or lengths.max() < _SHORTEST_FREEZE:
        return
    edges = np.diff(np.concatenate([[0], same.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    usual = np.percentile(np.abs(np.diff(values, axis=0)), 90, axis=0) + 1e-12
    for start, stop in zip(starts, stops, strict=True):
        if stop - start < _SHORTEST_FREEZE or stop + 1 >= len(values):
            continue
        jump = np.abs(values[stop + 1] - values[stop]) / usual
        if jump.max() > 4.0:
            raise RecordingError(
                f"all six readings are frozen for {stop - start + 1} samples, then jump; "
                "delete these rows (a gap is bridged), and look for a stalled driver",
                file=imu.source,
                line=int(start) + 2,
            )


def _run_lengths(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    return np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)


def _gap_findings(stamps: Stamps, name: str, longest: float) -> list[Finding]:
    steps = np.diff(stamps) * 1e-9
    usual = float(np.median(steps))
    long = gaps(stamps, longest)
    short = np.flatnonzero(steps > 1.6 * usual)
    short = np.setdiff1d(short, long)
    findings = []
    if short.size:
        lost = float(np.sum(steps[short] / usual - 1.0))
        findings.append(
            Finding("gaps", f"{name}: about {lost:.0f} samples missing in {short.size} short gaps (longest {steps[short].max() * 1e3:.1f} ms), bridged")
        )
    findings.extend(
        Finding("gaps", f"{name}: {steps[k]:.3f} s without samples after line {k + 2}; the recording is split there") for k in long
    )
    return findings


def _check_reference(reference: ReferencePoses, findings: list[Finding]) -> ReferencePoses:
    source = reference.source
    _check_stamps(reference.stamps_ns, source, "pose")
    rate = 1.0 / reference.interval
    if not 0.5 <= rate <= 20e3:
        raise RecordingError(f"stamps say {rate:.6g} poses a second; expected 0.5 to 20000; check the unit of the stamps", file=source, line=1)
    duration = float(reference.seconds[-1])
    if duration < SHORTEST:
        raise RecordingError(f"lasts {duration:.2f} s; a calibration needs {SHORTEST:g} s and more of motion", file=source)
    long = gaps(reference.stamps_ns, 1.0)
    if long.size:
        steps = np.diff(reference.stamps_ns)[long] * 1e-9
        findings.append(Finding("gaps", f"{source.parent.name}: {long.size} gaps of up to {steps.max():.2f} s without poses"))
    if reference.positions is not None:
        _check_finite(reference.positions, source)
        _check_positions(reference)
    if reference.quaternions is None:
        return reference
    _check_finite(reference.quaternions, source)
    norm = np.linalg.norm(reference.quaternions, axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > 0.01)
    if bad.size:
        raise RecordingError(
            f"the quaternion has length {norm[bad[0]]:.4g} (and {bad.size - 1} more are off by over 1 %); expected 1. "
            "Check that the columns are q_w, q_x, q_y, q_z, and normalise them",
            file=source,
            line=int(bad[0]) + 2,
        )
    q = reference.quaternions / norm[:, None]
    flips = int(np.sum(np.sum(q[1:] * q[:-1], axis=1) < 0.0))
    if flips:
        findings.append(Finding("quaternions", f"{flips} changes of sign between neighbours; q and -q are the same turn, so nothing is lost"))
    return replace(reference, quaternions=q)


def _check_positions(reference: ReferencePoses) -> None:
    assert reference.positions is not None  # noqa: S101 - for the type checker; the caller looked
    step = np.linalg.norm(np.diff(reference.positions, axis=0), axis=1)
    speed = step / (np.diff(reference.stamps_ns) * 1e-9)
    moving = speed[speed > 0.0]
    usual = float(np.percentile(moving, 90)) if moving.size else 0.0
    if usual > 30.0:
        raise RecordingError(
            f"the body would move at {usual:.4g} m/s; positions look like millimetres: write [mm] into the header",
            file=reference.source,
            line=1,
        )
