"""Checks of the stamps of a stream: order, duplicates, unit, bursts and gaps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Indices
from kreisel.recording.header import UNITS
from kreisel.recording.location import ARRAYS, and_more, at, fault, header_fault, is_mapped, is_table, rows
from kreisel.recording.recording import DataWarning, ImuSamples, Stamps

MIN_SECONDS = 5.0
"""Seconds of recording needed for a calibration."""

LONG_GAP = 0.05
"""Longest gap in s between IMU samples across which the motion is bridged, at least five sampling intervals."""

_MIN_DURATION, _MAX_DURATION = 1.0, 1e7  # s; a unit is proposed only if the recording lasts as long as this in it

_IN_ORDER = 0.8
"""Squares of second differences of rates in the order of rows, over those once sorted, below which rows are in their
order. Chosen: of two recordings with packets that overlap they were 0.41 and 0.54, of the same with rows displaced 1.8
and more; at rest both are the same."""

_FEW = 3
"""Steps back up to which somebody set a clock."""

_BITS, _NEAR = 32, 10.0
"""Of counters that overflow; and usual steps by which the step back may differ from all that such a counter counts."""


def runs(mask: NDArray[np.bool_]) -> tuple[Indices, Indices]:
    """Return the first index of each run of true values, and the index after its last."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    return edges[::2], edges[1::2]


def gaps(stamps_ns: Stamps, longest: float) -> NDArray[np.int64]:
    """Return the indices k after which more than `longest` seconds (and five intervals) pass to k + 1."""
    steps = np.diff(stamps_ns)
    return np.flatnonzero(steps > max(longest * 1e9, 5.0 * float(np.median(steps))))


class Rows(Protocol):
    """Rows of a stream, each with its stamp, and its place in the source."""

    @property
    def stamps_ns(self) -> Stamps:
        """Stamps, (n,)."""

    @property
    def source(self) -> Path:
        """File, or bag and topic."""

    def row_of(self, place: int) -> int:
        """Return the row of the source."""


def check_stamps(stream: Rows, what: str) -> None:
    """Raise an error unless stamps ascend without duplicates and without a jump.

    Parameters
    ----------
    what
        What is stamped, for messages.

    Raises
    ------
    RecordingError
        With the first place where they do not.
    """
    stamps, source = stream.stamps_ns, stream.source
    if stamps.size < 10:
        raise RecordingError(
            f"holds {stamps.size} {what} {rows(source)}; expected 10 or more: record longer", file=source
        )
    distance = np.abs(stamps - np.median(stamps))
    if distance.max() > 4e18:  # differences of 64 bit integers would overflow
        k = int(np.argmax(distance))
        raise fault(source, f"the stamp {stamps[k]} ns is far from all others; repair or delete the row",
                    stream.row_of(k))  # fmt: skip
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0)
    if back.size:
        k = int(back[0])
        raise fault(
            source,
            f"stamps run backwards by {-steps[k] * 1e-9:.6g} s here{and_more(back.size - 1, 'places')}; "
            + (_overflow(steps, k) or _in_their_order(stream, back.size) or _sort(source)),
            stream.row_of(k + 1),
        )
    same = np.flatnonzero(steps == 0)
    if same.size > 0.2 * steps.size:
        raise fault(
            source,
            f"{same.size} of {stamps.size} stamps repeat the one before: they have lost their last digits, as when "
            "seconds or milliseconds were rounded (write them with all digits), or rows of several sensors or bodies "
            "stand in one file (write those of each into its own)",
            stream.row_of(int(same[0]) + 1),
        )
    if same.size:
        raise fault(
            source,
            f"the stamp {stamps[same[0]]} occurs twice{and_more(same.size - 1, rows(source))}; delete the duplicates",
            stream.row_of(int(same[0]) + 1),
        )
    usual = float(np.median(steps))
    far = np.flatnonzero(steps > max(600e9, 1e4 * usual))
    if far.size:
        k = int(far[0])
        raise fault(
            source,
            f"stamps jump by {steps[k] * 1e-9:.6g} s here (usual step {usual * 1e-9:.4g} s): "
            "the clock was set during the recording; split the recording here",
            stream.row_of(k + 1),
        )


@dataclass(frozen=True)
class Stamped:
    """Stamps of a stream, with their source, unit and usual rates.

    Attributes
    ----------
    what
        What is stamped, for messages.
    slowest, fastest
        Hz; rates at which such a stream comes.
    unit
        Unit of the stamps that the header states, None where it states none.
    uneven
        Whether such a stream may come at several rates: poses at rest and in motion.
    """

    stamps: Stamps
    source: Path
    what: str
    slowest: float
    fastest: float
    unit: str | None = None
    uneven: bool = False

    @property
    def name(self) -> str:
        """Name of the stream's folder, or of its topic."""
        return self.source.parent.name if is_table(self.source) else self.source.name

    @property
    def seconds(self) -> float:
        """Seconds from the first to the last stamp, as read."""
        return float(self.stamps[-1] - self.stamps[0]) * 1e-9

    @property
    def step(self) -> float:
        """Usual step between stamps as read, ns."""
        return float(np.median(np.diff(self.stamps)))

    def comes_at_such_a_rate(self, factor: float = 1.0) -> bool:
        """Return whether the rate is possible once stamps are multiplied by a factor."""
        return self.slowest <= 1e9 / max(self.step * factor, 1e-300) <= self.fastest

    def error(self, message: str) -> RecordingError:
        """Return the error for the stream's header."""
        return header_fault(self.source, message)


def check_rate(stream: Stamped, other: Stamped | None = None) -> None:
    """Raise an error if stamps have a rate that no such device has.

    Parameters
    ----------
    other
        The stream recorded with it, as evidence of the unit.

    Raises
    ------
    RecordingError
        With the unit the stamps seem to be in, or that they come in bursts.
    """
    steps = np.diff(stream.stamps)
    usual = stream.step
    short = (steps > 1.6 * usual) & (steps < 100.0 * float(np.mean(steps)))
    lost = float(np.sum(steps[short] / usual - 1.0))
    possible = stream.comes_at_such_a_rate()
    if not (stream.uneven and possible) and lost > 0.5 * steps.size and np.count_nonzero(short) > 0.02 * steps.size:
        raise RecordingError(
            f"stamps come in bursts: the usual step is {usual * 1e-6:.4g} ms, the mean {np.mean(steps) * 1e-6:.4g} ms. "
            "They seem to be times of arrival; record the sensor's own stamps, or check for lost samples",
            file=stream.source,
        )
    if not possible:
        raise stream.error(
            f"stamps say {1e9 / usual:.6g} {stream.what} a second, expected {stream.slowest:g} to {stream.fastest:g}"
            f"{_unit_remedy(stream, other)}"
        )


def check_duration(stream: Stamped, other: Stamped | None = None) -> None:
    """Raise an error if a stream is too short to be used, or far shorter or longer than the one recorded with it.

    Raises
    ------
    RecordingError
        With the unit the stamps seem to be in.
    """
    if other is not None and not 1e-2 < stream.seconds / other.seconds < 1e2 and _fitting_units(stream, other):
        raise stream.error(
            f"lasts {stream.seconds:.4g} s, {other.name} {other.seconds:.4g} s{_unit_remedy(stream, other)}"
        )
    if stream.seconds < MIN_SECONDS:
        raise RecordingError(
            f"lasts {stream.seconds:.2f} s; a calibration needs {MIN_SECONDS:g} s and more of motion: record longer",
            file=stream.source,
        )


def _fitting_units(stream: Stamped, other: Stamped | None) -> list[str]:
    """Return the units in which a stream's rate, its duration, and that of the other stream are all possible."""
    if other is not None and (other.stamps.size < 10 or other.seconds <= 0.0 or not other.comes_at_such_a_rate()):
        other = None  # its own unit is in question
    fitting = []
    for unit, size in UNITS["time"].items():
        factor = size / UNITS["time"][stream.unit or "ns"]
        seconds = stream.seconds * factor
        alike = other is None or 0.2 <= seconds / other.seconds <= 5.0
        if (
            factor != 1.0
            and stream.comes_at_such_a_rate(factor)
            and _MIN_DURATION <= seconds <= _MAX_DURATION
            and alike
        ):
            fitting.append(unit)
    return fitting


def _unit_remedy(stream: Stamped, other: Stamped | None) -> str:
    """Return the remedy for stamps of a wrong unit: the end of a sentence."""
    fitting = _fitting_units(stream, other)
    units = " or ".join(f"[{unit}]" for unit in fitting)
    if not fitting:
        also = "" if other is None else f" and {other.name}"
        return f"; no unit of stamps fits their rate, their duration{also}: check how the stamps are made"
    if stream.source.parent == ARRAYS:
        return f"; they look like {units}: give seconds as floats, or nanoseconds as integers"
    if is_mapped(stream.source):
        named = f"they are read in [{stream.unit}], but " if stream.unit else ""
        return f"; {named}they look like {units}: write that unit after their column in the mapping"
    if not is_table(stream.source):
        return f"; they look like {units}: write seconds and nanoseconds into the messages' headers"
    stated = "" if stream.unit is None else f"the header says [{stream.unit}], but "
    return f"; {stated}they look like {units}: write '#timestamp [{fitting[0]}]' into the header"


def gap_warnings(imu: ImuSamples, longest: float) -> list[DataWarning]:
    """Return the warnings about missing samples: one for all bridged gaps, one for each long gap, none for restarts.

    Bridged gaps in which rows of the file were left out have a warning already.
    """
    stamps, source = imu.stamps_ns, imu.source
    steps = np.diff(stamps) * 1e-9
    usual = float(np.median(steps))
    long = gaps(stamps, longest)
    short = np.setdiff1d(np.flatnonzero(steps > 1.6 * usual), long)
    if imu.rows is not None:
        short = short[np.diff(imu.rows)[short] < np.round(steps[short] / usual)]
    warnings, name = [], source.parent.name
    if short.size:
        lost = float(np.sum(steps[short] / usual - 1.0))
        warnings.append(
            DataWarning(
                "gaps",
                f"{name}: about {lost:.0f} samples missing in {short.size} short gaps "
                f"(longest {steps[short].max() * 1e3:.1f} ms), bridged",
            )
        )
    for k in long:
        if stamps[k + 1] in imu.restarts_ns:
            continue
        where = at(source, imu.row_of(int(k)))
        warnings.append(
            DataWarning("gaps", f"{name}: {steps[k]:.3f} s without samples after {where}; the recording is split there")
        )
    return warnings


def _sort(source: Path) -> str:
    return f"sort the {rows(source)}, or split the recording where the clock was reset"


def _in_their_order(stream: Rows, places: int) -> str:
    """Return what is said of readings that are in their order, though their stamps are not; empty for others.

    Where rows were displaced, neighbours differ by more than once they are sorted.

    places: number of steps back.
    """
    if not isinstance(stream, ImuSamples):
        return ""
    order = np.argsort(stream.stamps_ns, kind="stable")
    moved = np.convolve(order != np.arange(order.size), np.ones(3), "valid") > 0.0
    as_they_are, in_order = (
        float(np.sum(np.diff(rates, n=2, axis=0)[moved] ** 2)) for rates in (stream.rates, stream.rates[order])
    )
    if as_they_are >= _IN_ORDER * in_order:
        return ""
    said = f"the readings show that the {rows(stream.source)} are in their order, so do not sort"
    if places <= _FEW:
        return f"{said}: split the recording where the clock was reset"
    return f"{said}: stamps of packets overlap, as those of arrival do. Write the device's own stamps, or even ones"


def _overflow(steps: Stamps, k: int) -> str:
    """Return what is said of a step that is that of a counter which begins anew; empty for others."""
    usual = float(np.median(steps))
    for unit, nanoseconds in (("ns", 1.0), ("us", 1e3), ("ms", 1e6)):
        whole = 2.0**_BITS * nanoseconds
        if abs(whole + steps[k] - usual) < _NEAR * usual:
            return (
                f"a counter of {_BITS} bits begins anew: add {2**_BITS} {unit} to all stamps from here on, or let the "
                "device count with 64"
            )
    return ""
