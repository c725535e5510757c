"""The raw readings of a whole recording, prepared for integration in chunks.

A sample prepared for integration takes five times the memory of its readings; of a long recording only the
chunks in use are kept in memory.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from kreisel.geometry.rotation import Array, Indices, conjugate, multiply
from kreisel.inertial.effects import RawReadings
from kreisel.inertial.strapdown import InertialSignal, Stencils, integrate_attitude, prepare, raw_readings

CHUNK = 1 << 16
"""Samples of one chunk: nearly three minutes at 400 Hz."""

_RAW_CHUNK = 1 << 13
"""Samples of a chunk that is not prepared. Chosen: forty functions of it fit into a processor's cache."""

EXCERPT = 8
"""Chunks that are enough where not all of a long recording is needed."""

_REACH = 11  # samples around an interval that enter its integral: six a curvature's, two a slope's, three a stencil's
_SHORTEST = 6  # intervals of a segment that is integrated by stencils
_HELD = 4
"""Prepared chunks that are kept: 20 MB each, 300 bytes a sample (decision 10 in docs/decisions). Chosen: tasks that run
side by side are in different chunks."""


_FAMILY = 2
"""Sets of effects for which the same readings are kept prepared: those of two passes in turn."""


class _Prepared(NamedTuple):
    """Chunks by their first samples, and signals across the ends of chunks by first and last sample."""

    chunks: dict[int, InertialSignal]
    across: dict[tuple[int, int], InertialSignal]


@dataclass(frozen=True)
class RawChunk:
    """Consecutive readings that are not prepared, with those around them.

    Attributes
    ----------
    first, last
        Samples of the recording.
    begin
        Sample of the recording with which `readings` begin.
    readings
        From some samples before the first to some after the last.
    segments
        First and last sample of every segment of them.
    """

    first: int
    last: int
    begin: int
    readings: RawReadings
    segments: tuple[tuple[int, int], ...]

    def own(self, values: Array) -> Array:
        """Return the part (k, last + 1 - first) of values (k, n) of all its readings."""
        return values[:, self.first - self.begin : self.last + 1 - self.begin]

    def integrals(self, values: Array) -> Array:
        """Return integrals (k, last - first) over each sampling interval of values (k, n), as of prepared readings."""
        whole = Stencils.of(self.readings.stamps, self.segments).integrals(np.ascontiguousarray(values))
        return whole[:, self.first - self.begin : self.last - self.begin]


@dataclass(frozen=True)
class Readings:
    """Raw readings on the IMU's clock.

    Attributes
    ----------
    stamps : (n,)
        Seconds since the first sample.
    rates, accelerations : (n, 3)
        rad/s and m/s^2.
    segments
        First and last sample (inclusive) of every segment.
    noise : (4, 3)
        See `strapdown.Samples`.
    temperature_difference : (n,) or None
        Temperature above its mean, K, where it was recorded.
    estimated, applied
        Effects whose features are prepared too, and values of effects by which the readings are corrected; see
        `strapdown.prepare`.
    """

    stamps: Array
    rates: Array
    accelerations: Array
    segments: tuple[tuple[int, int], ...]
    noise: Array = field(default_factory=lambda: np.zeros((4, 3)))
    temperature_difference: Array | None = None
    estimated: Mapping[str, int] = field(default_factory=dict)
    applied: Mapping[str, Array] = field(default_factory=dict)
    _family: dict[Hashable, _Prepared] = field(default_factory=dict, repr=False, compare=False)

    def with_noise(self, gyro: float, accel: float) -> Readings:
        """Return the readings with their noise's standard deviations multiplied by factors."""
        return replace(self, noise=self.noise * np.array([gyro**2, accel**2, gyro, accel])[:, None])

    def with_effects(self, estimated: Mapping[str, int], applied: Mapping[str, Array]) -> Readings:
        """Return the readings prepared for effects: those that are estimated, and the values of all."""
        applied = {group: value for group, value in applied.items() if np.any(value)}
        same = applied.keys() == self.applied.keys() and all(
            np.array_equal(applied[g], self.applied[g]) for g in applied
        )
        if same and dict(estimated) == dict(self.estimated):
            return self
        return replace(self, estimated=dict(estimated), applied=applied)

    def with_values(self, *, rates: Array | None = None, accelerations: Array | None = None) -> Readings:
        """Return other readings (n, 3) of the same samples."""
        rates = self.rates if rates is None else rates
        accelerations = self.accelerations if accelerations is None else accelerations
        return replace(self, rates=rates, accelerations=accelerations, _family={})

    @cached_property
    def _prepared(self) -> _Prepared:
        """What is prepared of these readings with these effects; of others, that of the last ones is kept."""
        applied = tuple((group, np.asarray(self.applied[group]).tobytes()) for group in sorted(self.applied))
        key = (tuple(sorted(self.estimated.items())), applied)
        found = self._family.pop(key, None) or _Prepared({}, {})
        self._family[key] = found
        for oldest in list(self._family)[:-_FAMILY]:
            self._family.pop(oldest, None)
        return found

    def segment_of(self, sample: int) -> int | None:
        """Return the index of the segment a sample lies in, or None."""
        for i, (start, stop) in enumerate(self.segments):
            if start <= sample <= stop:
                return i
        return None

    @property
    def count(self) -> int:
        """The number of chunks."""
        return int(self._starts().size)

    def chunks(self) -> Iterator[InertialSignal]:
        """Yield consecutive chunks, prepared for integration."""
        for start in self._starts():
            yield self._usual(int(start))

    def raw_chunks(self) -> Iterator[RawChunk]:
        """Yield consecutive chunks as they were read; the last sample of each is the first of the next."""
        last = self.stamps.size - 1
        for start in range(0, last, _RAW_CHUNK):
            stop = min(start + _RAW_CHUNK, last)
            low, high = max(start - _REACH, 0), min(stop + _REACH, last)
            stamps, rates, accelerations, segments, temperature_difference = self._part(low, high)
            raw = raw_readings(stamps, rates, accelerations, segments, temperature_difference)
            yield RawChunk(start, stop, low, raw, segments)

    def excerpt(self, begin: float, end: float) -> Iterator[InertialSignal]:
        """Yield at most `EXCERPT` chunks, spread evenly over those between two times, s."""
        starts = self._starts()
        until = np.append(self.stamps[starts[1:]], self.stamps[-1])
        starts = starts[(until > begin) & (self.stamps[starts] < end)]
        if starts.size > EXCERPT:
            starts = starts[np.round(np.linspace(0, starts.size - 1, EXCERPT)).astype(int)]
        for start in starts:
            yield self._usual(int(start))

    def holding(self, first: int, last: int) -> tuple[InertialSignal, int]:
        """Return a chunk to integrate the motion from sample `first` to `last` in, and its last valid sample."""
        signal = self._usual(min(first // CHUNK * CHUNK, int(self._starts()[-1])))
        if last > self._good_until(signal):
            signal = self._across(first, last)
        return signal, self._good_until(signal)

    def _across(self, first: int, last: int) -> InertialSignal:
        """Return the signal around a motion from one chunk to the next; the last few are kept."""
        kept = self._prepared.across
        signal = kept.get((first, last))
        if signal is None:
            signal = kept[first, last] = self._between(first - _REACH, last + _REACH)
            for oldest in list(kept)[:-_HELD]:
                kept.pop(oldest, None)
        return replace(signal, samples=signal.samples._replace(noise=self.noise))

    def _good_until(self, signal: InertialSignal) -> int:
        """Return the last sample whose stencils are those of the whole recording."""
        end = signal.begin + signal.stamps.size - 1
        return end if end == self.stamps.size - 1 else end - _REACH

    def _starts(self) -> Indices:
        """Return the first samples of the chunks; a short remainder at the end is added to the last."""
        return np.arange(0, max(self.stamps.size - CHUNK // 4, 1), CHUNK)

    def _usual(self, start: int) -> InertialSignal:
        """Return the chunk that begins at one of the `_starts`; it is kept in memory for the next call."""
        kept = self._prepared.chunks
        signal = kept.get(start)
        if signal is None:
            last = start == self._starts()[-1]
            signal = self._between(start - _REACH, self.stamps.size - 1 if last else start + CHUNK + _REACH)
        # The most recent one is deleted last. Other threads may do the same: no step here depends on the one before.
        kept.pop(start, None)
        kept[start] = signal
        for oldest in list(kept)[:-_HELD]:
            kept.pop(oldest, None)
        return replace(signal, samples=signal.samples._replace(noise=self.noise))

    def _between(self, low: int, high: int) -> InertialSignal:
        low, high = max(low, 0), min(high, self.stamps.size - 1)
        stamps, rates, accelerations, segments, temperature_difference = self._part(low, high)
        signal = prepare(
            stamps, rates, accelerations, noise=self.noise, estimated=self.estimated, applied=self.applied,
            temperature_difference=temperature_difference, segments=segments,
        )  # fmt: skip
        return replace(signal, begin=low)

    def _part(self, low: int, high: int) -> tuple[Array, Array, Array, tuple[tuple[int, int], ...], Array | None]:
        """Return stamps, rates, accelerations, segments and temperature difference from one sample to another.

        Segments are numbered from the first of these samples on.
        """
        part = slice(low, high + 1)
        inside = [(max(a, low) - low, min(b, high) - low) for a, b in self.segments]
        segments = tuple((a, b) for a, b in inside if b - a >= _SHORTEST)
        temperature_difference = None if self.temperature_difference is None else self.temperature_difference[part]
        return self.stamps[part], self.rates[part], self.accelerations[part], segments, temperature_difference


def attitudes_at(readings: Readings, rate: Array, samples: Indices) -> Array:
    """Return attitudes (k, 4) at ascending samples, seen from the first of all; see `strapdown.integrate_attitude`."""
    out = np.empty((samples.size, 4))
    before, joint = np.array([1.0, 0.0, 0.0, 0.0]), 0
    for signal in readings.chunks():
        free = integrate_attitude(signal, rate)
        carried = multiply(before, conjugate(free[joint - signal.begin]))
        end = signal.begin + signal.stamps.size
        inside = (samples >= joint) & (samples < end)
        out[inside] = multiply(carried, free[samples[inside] - signal.begin])
        # on both sides of it the stencils are those of the whole recording
        joint = max(end - 1 - _REACH, 0)
        before = multiply(carried, free[joint - signal.begin])
    return out
