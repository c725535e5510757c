"""What a recorder knows of one stream: its clock, what was lost of it, how fast it comes."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

LEAP_NS = 1_000_000_000
"""A device's clock that moves by so much more or less than the host's has leapt."""

_RECENT = 512


@dataclass
class Stream:
    """The state of one stream while it is recorded.

    Attributes
    ----------
    epoch
        Which of the device's clocks readings are on: one more for every leap.
    count, late, missing
        Readings taken; those that came after newer ones, or twice; those the stamps show to be missing.
    """

    epoch: int = 1
    count: int = 0
    late: int = 0
    missing: int = 0
    _stamp_ns: int | None = None
    _host_ns: int = 0
    _first: tuple[int, int] | None = None
    _steps: deque[int] = field(default_factory=lambda: deque(maxlen=_RECENT))
    _interval_ns: int = 0

    def take(self, stamp_ns: int, host_ns: int) -> str | None:
        """Take a reading's stamps; return what is to be noted, or None.

        A reading that is late or came twice is counted and not to be kept: see `fresh`.
        """
        self._fresh = True
        if self._stamp_ns is None:
            self._start(stamp_ns, host_ns)
            return None
        step, passed = stamp_ns - self._stamp_ns, host_ns - self._host_ns
        if step < -LEAP_NS or step - passed > LEAP_NS:
            self.epoch += 1
            self._start(stamp_ns, host_ns)
            return (
                f"the device's clock leapt by {(step - passed) * 1e-9:+.3f} s, as where it was started anew: what "
                f"follows is on a clock of its own, and on a topic of its own ending in _{self.epoch}"
            )
        if step <= 0:
            self.late += 1
            self._fresh = False
            return None
        note = self._gap(step)
        self._steps.append(step)
        self._stamp_ns, self._host_ns = stamp_ns, host_ns
        self.count += 1
        return note

    @property
    def fresh(self) -> bool:
        """Whether the last reading is to be kept."""
        return self._fresh

    @property
    def rate(self) -> float:
        """Readings a second, on the device's clock."""
        return 1e9 * len(self._steps) / max(1, sum(self._steps)) if self._steps else 0.0

    @property
    def drift_ppm(self) -> float | None:
        """How much faster the device's clock runs than the host's, after ten seconds."""
        if self._first is None or self._stamp_ns is None or self._host_ns - self._first[1] < 10 * 10**9:
            return None
        return 1e6 * ((self._stamp_ns - self._first[0]) / (self._host_ns - self._first[1]) - 1.0)

    def _start(self, stamp_ns: int, host_ns: int) -> None:
        self._first = (stamp_ns, host_ns)
        self._stamp_ns, self._host_ns = stamp_ns, host_ns
        self._steps.clear()
        self._interval_ns = 0
        self.count += 1

    def _gap(self, step: int) -> str | None:
        """Count what is missing before a reading; return a note where it is more than a quarter of a second."""
        if len(self._steps) >= 16 and (not self._interval_ns or len(self._steps) % 64 == 0):
            self._interval_ns = sorted(self._steps)[len(self._steps) // 2]
        if not self._interval_ns or step < 1.6 * self._interval_ns:
            return None
        lost = round(step / self._interval_ns) - 1
        self.missing += lost
        return f"gap of {step * 1e-9:.3f} s, about {lost} readings" if step > 250_000_000 else None
