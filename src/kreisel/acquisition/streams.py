"""The recorder's state of one stream: its clock, lost readings, and rate."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from itertools import pairwise

from kreisel.devices.events import Arrival

LEAP_NS = 1_000_000_000
"""ns; a device's clock has leapt if it advances by this much more or less than the host's clock."""

AGREEING = 4
"""Number of consecutive readings that must agree on another clock to begin a new part; fewer are dropped."""

_WRAPS_NS = (2**32, 2**24 * 1_000, 2**32 * 1_000, 2**16 * 1_000_000, 2**24 * 1_000_000, 2**32 * 1_000_000)
"""Periods of counters of 16, 24 or 32 bits that count ns, us or ms, without those shorter than `LEAP_NS`."""

_RECENT = 512
"""Steps between stamps of which rate and usual interval are taken. Chosen: one to five seconds at 500 to 100 Hz: enough
for a median, and short enough to follow a device whose rate is changed."""


@dataclass
class Stream:
    """The state of one stream while it is recorded.

    Attributes
    ----------
    epoch
        Number of the device's clock that readings are on; increases by one with every jump.
    count, late, missing, odd
        Number of readings taken; of those that came after newer ones, or twice; of those missing according to the
        stamps; of those dropped because their stamps were on another clock and those of the next readings were not.
    """

    epoch: int = 1
    count: int = 0
    late: int = 0
    missing: int = 0
    odd: int = 0
    _stamp_ns: int | None = None
    _host_ns: int = 0
    _first: tuple[int, int] | None = None
    _steps: deque[int] = field(default_factory=lambda: deque(maxlen=_RECENT))
    _interval_ns: int = 0
    _held: list[Arrival] = field(default_factory=list)
    _wrapped_ns: int = 0

    def take(self, reading: Arrival) -> tuple[list[Arrival], list[str]]:
        """Take a reading; return the readings to keep now, and notes.

        A reading that is late or came twice is counted and not kept. One on another clock is held until `AGREEING` of
        them in a row agree: they begin a new part. Where a counter begins again at zero, its stamps go on.
        """
        reading = self._unwrapped(reading)
        stamp_ns, host_ns = reading.sample.stamp_ns, reading.host_ns
        if self._stamp_ns is None:
            self._start(stamp_ns, host_ns)
            return [reading], []
        step, passed = stamp_ns - self._stamp_ns, host_ns - self._host_ns
        if step < -LEAP_NS or step - passed > LEAP_NS:
            return self._hold(reading, step - passed)
        notes = self._drop_held()
        if step <= 0:
            self.late += 1
            return [], notes
        notes += self._gap(step)
        self._steps.append(step)
        self._stamp_ns, self._host_ns = stamp_ns, host_ns
        self.count += 1
        return [reading], notes

    def _unwrapped(self, reading: Arrival) -> Arrival:
        """Return a reading with the stamp that it has if the device's counter never began again.

        It did, if the step is then what the host saw pass, and if the counter was at its end and is at its beginning: a
        restart does not come at that moment.
        """
        own = reading.sample.stamp_ns
        if self._stamp_ns is not None and own + self._wrapped_ns - self._stamp_ns < -LEAP_NS:
            passed, before = reading.host_ns - self._host_ns, self._stamp_ns - self._wrapped_ns
            for wrap in _WRAPS_NS:
                step = own + wrap - before
                if 0 < step < LEAP_NS and abs(step - passed) < LEAP_NS and 0 <= own < step and before < wrap:
                    self._wrapped_ns += wrap
                    break
        if not self._wrapped_ns:
            return reading
        return replace(reading, sample=replace(reading.sample, stamp_ns=own + self._wrapped_ns))

    def _hold(self, reading: Arrival, leap_ns: int) -> tuple[list[Arrival], list[str]]:
        """Hold a reading on another clock; return the held readings when enough of them agree."""
        notes: list[str] = []
        if self._held:
            last = self._held[-1]
            step = reading.sample.stamp_ns - last.sample.stamp_ns
            if -LEAP_NS <= step <= 0:  # late or twice, on the new clock
                self.late += 1
                return [], notes
            if not 0 < step <= reading.host_ns - last.host_ns + LEAP_NS:
                notes = self._drop_held()
        self._held.append(reading)
        if len(self._held) < AGREEING:
            return [], notes
        held, self._held = self._held, []
        self.epoch += 1
        self._start(held[0].sample.stamp_ns, held[0].host_ns)
        for one, next_one in pairwise(held):
            self._steps.append(next_one.sample.stamp_ns - one.sample.stamp_ns)
        self._stamp_ns, self._host_ns = reading.sample.stamp_ns, reading.host_ns
        self.count += len(held) - 1
        notes.append(
            f"the device's clock leapt by {leap_ns * 1e-9:+.3f} s, for example after a restart: "
            f"the readings that follow are on a new clock, and on a new topic that ends in _{self.epoch}"
        )
        return held, notes

    def _drop_held(self) -> list[str]:
        """Drop the held readings; return a note for the first, the tenth, the hundredth, … of them."""
        if not self._held:
            return []
        before = self.odd
        self.odd += len(self._held)
        self._held = []
        if len(str(self.odd)) == len(str(before)) and before:
            return []
        return [f"readings dropped: stamps on another clock than those before and after; {self.odd} so far"]

    @property
    def rate(self) -> float:
        """Readings a second, on the device's clock."""
        return 1e9 * len(self._steps) / max(1, sum(self._steps)) if self._steps else 0.0

    @property
    def drift_ppm(self) -> float | None:
        """How much faster the device's clock runs than the host's, ppm; None in the first ten seconds."""
        if self._first is None or self._stamp_ns is None or self._host_ns - self._first[1] < 10 * 10**9:
            return None
        return 1e6 * ((self._stamp_ns - self._first[0]) / (self._host_ns - self._first[1]) - 1.0)

    def _start(self, stamp_ns: int, host_ns: int) -> None:
        self._first = (stamp_ns, host_ns)
        self._stamp_ns, self._host_ns = stamp_ns, host_ns
        self._steps.clear()
        self._interval_ns = 0
        self.count += 1

    def _gap(self, step: int) -> list[str]:
        """Count the readings missing before a reading; return a note if the gap is longer than 0.25 s."""
        if len(self._steps) >= 16 and (not self._interval_ns or len(self._steps) % 64 == 0):
            self._interval_ns = sorted(self._steps)[len(self._steps) // 2]
        if not self._interval_ns or step < 1.6 * self._interval_ns:
            return []
        lost = round(step / self._interval_ns) - 1
        self.missing += lost
        return [f"gap of {step * 1e-9:.3f} s, about {lost} readings"] if step > 250_000_000 else []
