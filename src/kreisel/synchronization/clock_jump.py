"""A jump of a clock during the recording, found by the rotations and taken out of the reference's stamps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kreisel.geometry.rotation import Array, Mask
from kreisel.inertial.readings import Readings
from kreisel.recording.recording import DataWarning, JointAngles, ReferencePoses, Stamps
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.fits import RateFit
from kreisel.synchronization.rate_fit import turn_errors

MIN = 4e-3
"""s; smaller jumps are found by the filter, as a clock that walks."""

_MIN_PARTS, _BETTER = 3, 0.15
"""Parts of the recording on either side of a jump, and share of the sum of squares that it leaves at most."""

_BESIDE = 0.5
"""s; poses so near to the jump are not used: to which side they belong is not known well enough."""


@dataclass(frozen=True)
class ClockJump:
    """A jump: reference seconds when it was, by how much the offset grew (s), and the deviation of that."""

    tau: float
    size: float
    size_sd: float

    def taken_out(self, reference: ReferencePoses) -> ReferencePoses:
        """Return the poses, those after the jump with stamps by the clock before it; poses near it are doubtful."""
        kept, stamps = self._moved(reference.stamps_ns, reference.stamps_ns[0])
        known = reference.doubtful
        moved = replace(
            reference,
            stamps_ns=stamps,
            positions=None if reference.positions is None else reference.positions[kept],
            quaternions=None if reference.quaternions is None else reference.quaternions[kept],
        )
        return replace(moved, doubtful=self.is_beside(moved) if known is None else self.is_beside(moved) | known[kept])

    def is_beside(self, reference: ReferencePoses) -> Mask:
        """Return which poses are so near to the jump that it is not known to which side they belong."""
        return np.abs(reference.seconds - self.tau) < _BESIDE

    def taken_out_of_joints(self, joints: JointAngles, first_ns: int) -> JointAngles:
        """Return the joint angles, which have the clock of the poses; `first_ns` is the stamp of the first pose."""
        kept, stamps = self._moved(joints.stamps_ns, first_ns)
        return replace(joints, stamps_ns=stamps, angles=joints.angles[kept])

    def _moved(self, stamps_ns: Stamps, first_ns: int) -> tuple[Mask, Stamps]:
        """Return which stamps are kept, and these by the clock before the jump: they must ascend."""
        after = (stamps_ns - first_ns) * 1e-9 > self.tau
        moved = stamps_ns + np.where(after, round(1e9 * self.size), 0)
        last = moved[~after].max(initial=np.iinfo(np.int64).min)
        kept = ~after | (moved > last)
        return kept, moved[kept]

    def warning(self) -> DataWarning:
        """Return the warning about it."""
        text = (
            f"the clocks jumped by {1e3 * self.size:+.1f} ± {1e3 * self.size_sd:.1f} ms, {self.tau:.1f} s after the "
            "first pose (a clock was set, or samples were lost); the stamps of the poses after it were corrected"
        )
        return DataWarning("clocks", text)


def find_clock_jump(readings: Readings, reference: ReferencePoses, fit: RateFit) -> ClockJump | None:
    """Return the one jump that explains why the clocks do not run evenly; None if there is none.

    Notes
    -----
    The shifts of a dozen parts of the recording are fitted by a straight line and a step. The moment of the step is
    that at which the rotations change from one clock to the other.
    """
    tau, shift, sd = drift_of(fit)
    step = with_best_step(tau, shift, sd)
    if reference.quaternions is None or step is None:
        return None
    even, *_ = fitted(straight(tau), shift, sd)
    best, x, deviation = step.before, step.coefficients, step.deviations
    if not explains(step.left, even, x, deviation):
        return None
    before = Clock(fit.clock.start + x[0], fit.clock.skew + x[1])
    after = replace(before, start=before.start + x[2])
    # the part in which it jumped shows a mixture of both: look at its neighbours too
    low, high = tau[max(best - 2, 0)], tau[min(best + 1, tau.size - 1)]
    middle, by_first, by_second = turn_errors(readings, reference.seconds, reference.quaternions, fit, (before, after))
    inside = (middle > low) & (middle < high)
    order = np.argsort(middle[inside])
    gain = np.cumsum((by_second - by_first)[inside][order])
    at = float(middle[inside][order][int(np.argmax(gain))])
    return ClockJump(at, float(x[2]) / (1.0 + before.skew), float(deviation[2]))


def corrected(jump: ClockJump, fit: RateFit) -> ClockJump:
    """Return a jump with the size that the shifts of parts still show where it was taken out, beside a straight line.

    The first estimate has the parts of both clocks fitted by one, which takes a tenth of the jump for a ratio of the
    clocks and for the scatter of the parts.
    """
    tau, shift, sd = drift_of(fit)
    after = 1 + int(np.argmin(np.abs(tau - jump.tau))) if tau.size else 0
    if not _MIN_PARTS <= after <= tau.size - _MIN_PARTS:
        return jump
    left, x, deviation = _with_step(tau, shift, sd, after)
    more = float(x[2]) / (1.0 + fit.clock.skew)
    return replace(jump, size=jump.size + more, size_sd=float(deviation[2] * np.sqrt(max(left, 1.0))))


def drift_of(fit: RateFit) -> tuple[Array, Array, Array]:
    """Return the middles of parts of a recording, and their shifts with deviations, of those that have one, s."""
    tau, shift, sd = fit.clock_drift.T
    known = np.isfinite(shift) & np.isfinite(sd)
    return tau[known], shift[known], np.maximum(sd[known], 1e-5)


def straight(tau: Array) -> Array:
    """Return the columns (n, 2) of a straight line."""
    return np.column_stack([np.ones(tau.size), tau])


def explains(left: float, even: float, x: Array, deviation: Array) -> bool:
    """Return whether a third column beside a line explains shifts that the line alone does not, and is large enough.

    Parameters
    ----------
    left, even
        Mean squares of what is left with it, and without.
    x, deviation : (3,)
        Coefficients.
    """
    return left <= _BETTER * even and abs(x[2]) >= max(MIN, 10.0 * deviation[2])


@dataclass(frozen=True)
class Step:
    """A line with a step, fitted to shifts of parts.

    Attributes
    ----------
    before
        The step is before this part.
    left
        Mean square of what is left.
    coefficients, deviations : (3,)
        Of the line and the step.
    """

    before: int
    left: float
    coefficients: Array
    deviations: Array


def with_best_step(tau: Array, shift: Array, sd: Array) -> Step | None:
    """Return the line with a step that leaves least; None for too few parts."""
    if tau.size < 2 * _MIN_PARTS:
        return None
    steps = (Step(k, *_with_step(tau, shift, sd, k)) for k in range(_MIN_PARTS, tau.size - _MIN_PARTS + 1))
    return min(steps, key=lambda one: one.left)


def _with_step(tau: Array, shift: Array, sd: Array, k: int) -> tuple[float, Array, Array]:
    """Return the fit of a line with a step before part k, which itself may be a mixture and does not count."""
    columns = np.column_stack([straight(tau), np.arange(tau.size) >= k])
    counts = np.arange(tau.size) != k - 1
    return fitted(columns[counts], shift[counts], sd[counts])


def fitted(columns: Array, shift: Array, sd: Array) -> tuple[float, Array, Array]:
    """Return the mean square of what is left, the coefficients and their standard deviations."""
    A, y = columns / sd[:, None], shift / sd
    x, *_ = np.linalg.lstsq(A, y, rcond=None)
    rest = y - A @ x
    deviation = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    return float(rest @ rest) / y.size, np.asarray(x), np.asarray(deviation)
