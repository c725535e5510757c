"""A clock that was slewed: for some time it ran faster or slower, until it showed what it was to show.

Services that set a clock avoid steps; the usual one changes its rate by 500 ppm until the error is gone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.recording.recording import DataWarning, ImuSamples, JointAngles, ReferencePoses, Stamps
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.clock_jump import MIN, drift_of, explains, fitted, straight, with_best_step
from kreisel.synchronization.fits import RateFit

_USUAL, _CLEARER = 1e-3, 0.5
"""Rate of a slew up to which it is as likely as a step (services that set clocks stay below), and share of what a step
leaves that a faster one leaves at most. Chosen: samples lost one after the other look like a fast one."""

_BENT = 0.1
"""Of the size of a slew, by which shifts leave a straight line at least. Chosen: ramps between any two parts of twelve
leave it by 0.15 to 0.84."""

_SHORTEST = 1.0
"""Parts of the recording; a shorter slew is a step. Chosen: their shifts do not show its ends apart."""

_BESIDE = 2
"""Parts before and after a slew at least: by one the line goes wherever the ramp wants it."""

_GRID = (2.0, 8.0, 32.0)
"""Steps of the moments searched in a part of the recording, one search after another."""

_ENDS, _STEP = 0.5, 1e-3
"""Deviation of the moments first found, and step of derivatives by them, in parts of the recording. Chosen: parts do
not show the ends of a ramp within one part apart; the deviation keeps both where they were found."""

_SAME = 0.3
"""Deviations within which a slew is the same one."""


@dataclass(frozen=True)
class ClockSlew:
    """Reference seconds of its begin and end, by how much the offset grew in between (s), and the deviation of that."""

    begin: float
    end: float
    size: float
    size_sd: float

    def refined(self, fit: RateFit) -> ClockSlew:
        """Return the slew by what is left of it in the fit after it was taken out: begin, end and size."""
        tau, shift, sd = drift_of(fit)
        if tau.size <= 2 * _BESIDE:
            return self
        width = float(np.median(np.diff(tau)))
        ends = np.array([self.begin, self.end])
        share = _ramp(tau, width, ends)
        by_ends = [_ramp(tau, width, ends + step) - share for step in _STEP * width * np.eye(2)]
        slopes = self.size / (_STEP * width) * np.array(by_ends)
        known = np.eye(5)[3:] / (_ENDS * width)
        columns = np.vstack([np.column_stack([straight(tau), share, slopes.T]) / sd[:, None], known])
        y = np.append(shift / sd, np.zeros(2))
        covariance = np.linalg.inv(columns.T @ columns)
        change = covariance @ columns.T @ y
        left = float(np.sum((y - columns @ change) ** 2)) / tau.size
        begin, end = ends + change[3:]
        if end - begin < _SHORTEST * width or begin < tau[0] or end > tau[-1]:
            return self
        size = self.size + float(change[2]) / (1.0 + fit.clock.skew)
        return ClockSlew(float(begin), float(end), size, float(np.sqrt(covariance[2, 2] * max(left, 1.0))))

    def is_like(self, other: ClockSlew) -> bool:
        """Return whether both differ by less than the stamps of either show."""
        rate = abs(self.size) / (self.end - self.begin)
        ends = max(abs(self.begin - other.begin), abs(self.end - other.end))
        return max(abs(self.size - other.size), rate * ends) <= _SAME * other.size_sd

    def taken_out(self, reference: ReferencePoses) -> ReferencePoses:
        """Return the poses with stamps by a clock that was not slewed."""
        return replace(reference, stamps_ns=self._moved(reference.stamps_ns, int(reference.stamps_ns[0])))

    def taken_out_of_joints(self, joints: JointAngles, first_ns: int) -> JointAngles:
        """Return the joint angles, which have the clock of the poses; `first_ns` is the stamp of the first pose."""
        return replace(joints, stamps_ns=self._moved(joints.stamps_ns, first_ns))

    def taken_out_of_imu(self, imu: ImuSamples, clock: Clock) -> ImuSamples:
        """Return the readings with stamps by a clock that was not slewed. `clock` relates both as before it."""
        first = imu.stamps_ns[0]

        def moved(stamps_ns: Stamps) -> Stamps:
            return np.asarray(stamps_ns - self._shift(clock.reference_time((stamps_ns - first) * 1e-9)))

        return replace(imu, stamps_ns=moved(imu.stamps_ns), broken_ns=moved(imu.broken_ns))

    def warning(self, whose: str) -> DataWarning:
        """Return the warning about it; whose: the clock that was slewed."""
        text = (
            f"the {whose}'s clock was slewed by {1e3 * self.size:+.1f} ± {1e3 * self.size_sd:.1f} ms against the other "
            f"one, from {self.begin:.0f} to {self.end:.0f} s after the first pose; its stamps were corrected"
        )
        return DataWarning("clocks", text)

    def _moved(self, stamps_ns: Stamps, first_ns: int) -> Stamps:
        tau: Array = (stamps_ns - first_ns).astype(np.float64) * 1e-9
        moved: Stamps = stamps_ns + self._shift(tau)
        return moved

    def _shift(self, tau: Array) -> Stamps:
        """Return how far stamps have gone off by some moments, ns."""
        share = np.clip((tau - self.begin) / (self.end - self.begin), 0.0, 1.0)
        return np.asarray(np.round(1e9 * self.size * share), dtype=np.int64)


def find_clock_slew(fit: RateFit) -> ClockSlew | None:
    """Return the slew that explains why the clocks do not run evenly; None if a step does so better, or nothing.

    Notes
    -----
    The shifts of a dozen parts of the recording are fitted by a straight line and a ramp, averaged over each part.
    """
    tau, shift, sd = drift_of(fit)
    step = with_best_step(tau, shift, sd)
    if step is None:
        return None
    even, x, _ = fitted(straight(tau), shift, sd)
    if np.ptp(shift - straight(tau) @ x) < _BENT * MIN:
        return None
    width = float(np.median(np.diff(tau)))
    best = _best_ends(tau, shift, sd, width)
    left, x, deviation = _with_ramp(tau, shift, sd, width, best)
    usual = abs(x[2]) <= _USUAL * (best[1] - best[0])
    better = left <= (1.0 if usual else _CLEARER) * step.left and best[1] - best[0] >= _SHORTEST * width
    if not better or not explains(left, even, x, deviation):
        return None
    skew = fit.clock.skew + x[1]
    return ClockSlew(*best, float(x[2]) / (1.0 + skew), float(deviation[2]))


def _best_ends(tau: Array, shift: Array, sd: Array, width: float) -> tuple[float, float]:
    """Return the moments at which a ramp begins and ends that leave least, each search about the one before."""
    around, half = np.arange(tau[0], tau[-1], width / _GRID[0]), 0.0
    begins = ends = around
    for finer in (*_GRID[1:], None):
        pairs = [(begin, end) for begin in begins for end in ends if end > begin + 0.1 * width]
        best = min(pairs, key=lambda pair: _with_ramp(tau, shift, sd, width, pair)[0])
        if finer is not None:
            half = width / finer
            begins, ends = (one + half * np.arange(-4.0, 5.0) for one in best)
    return float(best[0]), float(best[1])


def _with_ramp(
    tau: Array, shift: Array, sd: Array, width: float, ends: tuple[float, float]
) -> tuple[float, Array, Array]:
    """Return the fit of a line with a ramp between two moments; nothing fits if it is not well inside."""
    if ends[0] < tau[_BESIDE - 1] + 0.5 * width or ends[1] > tau[-_BESIDE] - 0.5 * width:
        return np.inf, np.zeros(3), np.ones(3)
    return fitted(np.column_stack([straight(tau), _ramp(tau, width, np.array(ends))]), shift, sd)


def _ramp(tau: Array, width: float, ends: Array) -> Array:
    """Return the mean over each part, about tau (n,), of a ramp from 0 to 1 between two moments."""
    begin, end = ends

    def integral(t: Array) -> Array:
        inside = np.clip(t, begin, end) - begin
        return np.asarray(inside**2 / (2.0 * (end - begin)) + np.maximum(t - end, 0.0))

    return (integral(tau + 0.5 * width) - integral(tau - 0.5 * width)) / width
