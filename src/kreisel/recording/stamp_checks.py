"""What can be wrong with the stamps of a stream: order, doubles, unit, bursts and gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Indices
from kreisel.recording.place import and_more, at, fault, is_table, rows
from kreisel.recording.recording import Finding, Stamps

SHORTEST = 5.0
"""Seconds of recording below which nothing is tried."""

LONG_GAP = 0.05
"""Seconds without IMU samples up to which the motion is bridged, at least five sampling intervals."""

_UNITS = (("us", 1e3), ("ms", 1e6), ("s", 1e9))


def runs(mask: NDArray[np.bool_]) -> tuple[Indices, Indices]:
    """Return where the stretches of true values begin, and where they have ended."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def gaps(stamps_ns: Stamps, longest: float) -> NDArray[np.int64]:
    """Return the indices k after which more than `longest` seconds (and five intervals) pass to k + 1."""
    steps = np.diff(stamps_ns)
    return np.flatnonzero(steps > max(longest * 1e9, 5.0 * float(np.median(steps))))


def check_stamps(stamps: Stamps, source: Path, what: str) -> None:
    """Raise an error unless stamps ascend, each alone, without a leap.

    Parameters
    ----------
    what
        What is stamped, for messages.

    Raises
    ------
    RecordingError
        With the first place where they do not.
    """
    if stamps.size < 10:
        raise RecordingError(
            f"holds {stamps.size} {what} {rows(source)}; too few for anything: record longer", file=source
        )
    distance = np.abs(stamps - np.median(stamps))
    if distance.max() > 4e18:  # differences of 64 bit integers would run over
        k = int(np.argmax(distance))
        raise fault(source, f"the stamp {stamps[k]} ns is out of all proportion; repair or delete the row", k)
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0)
    if back.size:
        k = int(back[0])
        raise fault(
            source,
            f"stamps run backwards by {-steps[k] * 1e-9:.6g} s here{and_more(back.size - 1, 'places')}; "
            f"sort the {rows(source)}, or split the recording where the clock was reset",
            k + 1,
        )
    same = np.flatnonzero(steps == 0)
    if same.size > 0.2 * steps.size:
        raise fault(
            source,
            f"{same.size} of {stamps.size} stamps repeat the one before: they have lost their last digits, as where "
            "seconds or milliseconds were rounded; write them with all digits",
            int(same[0]) + 1,
        )
    if same.size:
        raise fault(
            source,
            f"the stamp {stamps[same[0]]} stands twice{and_more(same.size - 1, rows(source))}; delete the duplicates",
            int(same[0]) + 1,
        )
    usual = float(np.median(steps))
    far = np.flatnonzero(steps > max(600e9, 1e4 * usual))
    if far.size:
        k = int(far[0])
        raise fault(
            source,
            f"stamps leap by {steps[k] * 1e-9:.6g} s here (usual step {usual * 1e-9:.4g} s): "
            "the clock was set during the recording; split the recording here",
            k + 1,
        )


def check_rate(stamps: Stamps, source: Path, what: str, slowest: float, fastest: float) -> None:
    """Raise an error if stamps come at a rate that no such device has.

    Parameters
    ----------
    slowest, fastest
        Hz.

    Raises
    ------
    RecordingError
        With the unit the stamps seem to be in, or that they come in bursts.
    """
    steps = np.diff(stamps)
    usual = float(np.median(steps))
    short = (steps > 1.6 * usual) & (steps < 100.0 * float(np.mean(steps)))
    lost = float(np.sum(steps[short] / usual - 1.0))
    if lost > 0.5 * stamps.size and np.count_nonzero(short) > 0.02 * stamps.size:
        raise RecordingError(
            f"stamps come in bursts: the usual step is {usual * 1e-6:.4g} ms, the mean {np.mean(steps) * 1e-6:.4g} ms. "
            "They seem to be times of arrival; record the sensor's own stamps, or look for lost samples",
            file=source,
        )
    rate = 1e9 / usual
    if not slowest <= rate <= fastest:
        raise RecordingError(
            f"stamps say {rate:.6g} {what} a second, expected {slowest:g} to {fastest:g}"
            f"{_unit_guess(usual, 1e9 / fastest, 1e9 / slowest, source) or '; record at such a rate'}",
            file=source,
            line=1 if is_table(source) else None,
        )


def _unit_guess(value: float, low: float, high: float, source: Path) -> str:
    """Return the unit in which a number of nanoseconds would be between two others, as a remedy."""
    fitting = [unit for unit, factor in _UNITS if low <= value * factor <= high]
    if fitting and not is_table(source):
        return f"; they look like [{fitting[0]}]: write seconds and nanoseconds into the messages' headers"
    if fitting:
        return f"; they look like [{fitting[0]}]: write '#timestamp [{fitting[0]}]' into the header"
    smaller = [factor for _, factor in _UNITS if low <= value / factor <= high]
    if smaller and is_table(source):
        return f"; they look {smaller[0]:,.0f} times too long: write the unit they are in, such as '#timestamp [ns]'"
    return ""


def check_duration(stamps: Stamps, source: Path, other: tuple[str, float] | None = None) -> None:
    """Raise an error if a stream is too short to be used.

    Parameters
    ----------
    other
        Name and seconds of the stream recorded beside it, which may betray a wrong unit.

    Raises
    ------
    RecordingError
        With the unit the stamps seem to be in.
    """
    seconds = float(stamps[-1] - stamps[0]) * 1e-9
    if other is not None and not 1e-2 < seconds / other[1] < 1e2:
        guess = _unit_guess(seconds, 0.2 * other[1], 5.0 * other[1], source)
        if guess:
            line = 1 if is_table(source) else None
            raise RecordingError(f"lasts {seconds:.4g} s, {other[0]} {other[1]:.4g} s{guess}", file=source, line=line)
    if seconds < SHORTEST:
        raise RecordingError(
            f"lasts {seconds:.2f} s; a calibration needs {SHORTEST:g} s and more of motion: record longer", file=source
        )


def gap_findings(stamps: Stamps, source: Path, longest: float) -> list[Finding]:
    """Return what to say of missing samples: those bridged in one sentence, each long gap in one."""
    steps = np.diff(stamps) * 1e-9
    usual = float(np.median(steps))
    long = gaps(stamps, longest)
    short = np.setdiff1d(np.flatnonzero(steps > 1.6 * usual), long)
    findings, name = [], source.parent.name
    if short.size:
        lost = float(np.sum(steps[short] / usual - 1.0))
        findings.append(
            Finding(
                "gaps",
                f"{name}: about {lost:.0f} samples missing in {short.size} short gaps "
                f"(longest {steps[short].max() * 1e3:.1f} ms), bridged",
            )
        )
    for k in long:
        where = at(source, int(k))
        findings.append(
            Finding("gaps", f"{name}: {steps[k]:.3f} s without samples after {where}; the recording is split there")
        )
    return findings
