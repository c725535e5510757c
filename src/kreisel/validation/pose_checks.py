"""Checks of reference poses by themselves: length of quaternions, jumps, stalls, units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, Indices, Mask, apply, conjugate, log, multiply
from kreisel.recording.location import and_more, fault, rows, wrong_unit
from kreisel.recording.recording import DataWarning, ReferencePoses, angles_over
from kreisel.validation.empty_rows import POSITION, QUATERNION
from kreisel.validation.finite_values import check_finite
from kreisel.validation.masking import first_of_each
from kreisel.validation.stamp_checks import Stamped, check_duration, check_rate, check_stamps, gaps, runs

MAX_OUTLIERS = 0.1
"""Share of poses that may jump away and back; with more, the reference is an error."""

MAX_INTERPOLATED = 0.02
"""Share of poses that may have been interpolated through a change of sign."""

_SHORT = 0.01
"""By which a quaternion that was interpolated is too short. Chosen: the deviation of the length that is accepted
otherwise."""

_LONG_FREEZE = 8  # repetitions of a pose from which it is frozen; as in `masking`

_MAX_IN_A_ROW = 3
"""Poses in a row that jump away from their neighbours. Chosen: longer runs are looked for by `_tracked`, with the wider
limits of `_impossible`, because a body may really move away and back."""

_AWAY = 2.0
"""s in which poses that jumped away return. Chosen: the IMU bridges the motion meanwhile; a jump that stays longer may
be a frame that was set anew."""

_FAST = 20.0
"""Steps, in those that nine of ten do not exceed, and usual speed, m/s, that no body makes. Chosen: arms and hands move
by a few m/s (`_QUICK`), and positions in mm show a thousand times as much."""

_PLACES, _EVENLY, _MOSTLY, _OFTEN = 20, 0.9, 0.8, 0.3
"""New positions, share of them that come after equal numbers of poses, share in which more than one coordinate changes,
and share of the changing attitudes beside which the position does not, where positions are held: of two devices in one
log, the slower. Chosen: coordinates with few digits change one by one, and not evenly; an arm that turns about its tool
centre point moves it by rounding, or not at all."""

_QUICK = (5.0, 10.0)
"""m/s and rad/s; steps from pose to pose that are slower than this may be motion, however large they are."""


def stamped_poses(reference: ReferencePoses) -> Stamped:
    """Return the poses' stamps, with the rates that are usual for poses."""
    return Stamped(reference.stamps_ns, reference.source, "poses", 0.01, 20e3, reference.units.time, uneven=True)


def check_poses(reference: ReferencePoses, imu: Stamped) -> tuple[ReferencePoses, list[DataWarning]]:
    """Return the poses with unit quaternions, without repeated poses and outliers, and the warnings about them.

    Parameters
    ----------
    imu
        The IMU's stamps.

    Raises
    ------
    RecordingError
        For the first fault that would make results wrong.
    """
    source = reference.source
    check_stamps(reference, "pose")
    check_rate(stamped_poses(reference), imu)
    check_duration(stamped_poses(reference), imu)
    warnings: list[DataWarning] = []
    if reference.positions is not None:
        check_finite(reference.positions, POSITION, reference)
    if reference.quaternions is not None:
        check_finite(reference.quaternions, QUATERNION, reference)
        reference = _normalised(_without_flips(reference, warnings), warnings)
    for choose in (_new, _near, _tracked, _live, _fresh):
        keep = choose(reference, warnings)
        if not keep.all():
            reference = reference.part(keep)
    _check_jumps(reference)
    _check_metres(reference)
    long = gaps(reference.stamps_ns, 1.0)
    if long.size:
        steps = np.diff(reference.stamps_ns)[long] * 1e-9
        warnings.append(
            DataWarning("gaps", f"{source.parent.name}: {long.size} gaps of up to {steps.max():.2f} s without poses")
        )
    return reference, warnings


def _without_flips(reference: ReferencePoses, warnings: list[DataWarning]) -> ReferencePoses:
    """Return the poses without a few that somebody interpolated from q to a -q' after it: they are too short."""
    q = reference.quaternions
    assert q is not None  # noqa: S101 - for the type checker; the caller checked
    norm = np.sqrt(np.einsum("ij,ij->i", q, q))
    short = norm < 1.0 - _SHORT
    first, last = runs(short)
    if not short.any() or short[0] or short[-1] or short.sum() > MAX_INTERPOLATED * short.size:
        return reference
    if not (np.einsum("ij,ij->i", q[first - 1], q[last]) < 0.0).all() or (norm < 1e-3).any():
        return reference
    warnings.append(
        DataWarning(
            "quaternions",
            f"{int(short.sum())} of {short.size} quaternions were interpolated through a change of sign, which is no "
            "rotation; they were left out",
        )
    )
    return reference.part(~short)


def _normalised(reference: ReferencePoses, warnings: list[DataWarning]) -> ReferencePoses:
    source, q = reference.source, reference.quaternions
    assert q is not None  # noqa: S101 - for the type checker; the caller checked
    norm = np.sqrt(np.einsum("ij,ij->i", q, q))
    bad = np.flatnonzero(np.abs(norm - 1.0) > 0.01)
    if bad.size:
        k = int(bad[0])
        raise fault(
            source,
            f"the quaternion has the length {norm[k]:.4g}, expected 1 within 1 %, here"
            f"{and_more(bad.size - 1, rows(source))}; check that the columns are q_w, q_x, q_y, q_z, and normalise "
            "them",
            reference.row_of(k),
        )
    q = q / norm[:, None]
    flips = int(np.sum(np.einsum("ij,ij->i", q[1:], q[:-1]) < 0.0))
    if flips:
        warnings.append(
            DataWarning(
                "quaternions",
                f"{flips} changes of sign between neighbours; q and -q are the same rotation, so nothing is lost",
            )
        )
    return reference.with_quaternions(q)


@dataclass(frozen=True)
class _Steps:
    """Distances of poses from earlier ones: metres and radians, each (n,), zero where not recorded."""

    shift: Array
    turn: Array

    @classmethod
    def of(cls, reference: ReferencePoses, stride: int = 1) -> _Steps:
        n = reference.stamps_ns.size - stride
        shift, turn = np.zeros(n), np.zeros(n)
        if (p := reference.positions) is not None:
            way = p[stride:] - p[:-stride]
            shift = np.sqrt(np.einsum("ij,ij->i", way, way))
        if (q := reference.quaternions) is not None:
            turn = angles_over(q, stride)
        return cls(shift, turn)

    def usual(self, share: float) -> tuple[float, float]:
        """Return a percentile of the steps that are not zero."""
        return _percentile(self.shift, share), _percentile(self.turn, share)

    def above(self, shift: float, turn: float) -> Mask:
        """Return where a step is larger than a limit."""
        return np.asarray((self.shift > shift) | (self.turn > turn))

    def text(self, k: int) -> str:
        """Return the text for a step."""
        return f"{self.shift[k]:.3g} m and {np.degrees(self.turn[k]):.3g} deg"


def _percentile(values: Array, share: float) -> float:
    moving = values[values > 0.0]
    return float(np.percentile(moving, share)) if moving.size else np.inf


def _stalls(reference: ReferencePoses) -> tuple[Indices, Indices]:
    """Return first and last poses of the runs in which all numbers repeat, without a run at the end."""
    parts = [part for part in (reference.positions, reference.quaternions) if part is not None]
    same = np.all([(part[1:] == part[:-1]).all(axis=1) for part in parts], axis=0)
    starts, stops = runs(same)
    ended = stops < len(same)
    return starts[ended], stops[ended]


def _live(reference: ReferencePoses, warnings: list[DataWarning]) -> Mask:
    """Return the mask without poses that repeat for long and then jump: tracking was lost.

    Nothing starts to move that suddenly.

    Raises
    ------
    RecordingError
        If there are too many of them.
    """
    steps = _Steps.of(reference)
    shift, turn = steps.usual(90.0)
    starts, stops = _stalls(reference)
    frozen = (stops - starts >= _LONG_FREEZE) & (steps.above(4.0 * shift, 4.0 * turn) & _in_time(reference))[stops]
    keep = first_of_each(reference.stamps_ns.size, starts[frozen], stops[frozen])
    if frozen.any():
        k = int(np.flatnonzero(frozen)[0])
        what = (
            f"poses are frozen, in {_times(int(frozen.sum()))}, and then jump (here by {steps.text(int(stops[k]))}): "
            "tracking was lost"
        )
        _leave_out(reference, keep, what, int(starts[k]) + 1, warnings)
    return keep


def _tracked(reference: ReferencePoses, warnings: list[DataWarning]) -> Mask:
    """Return the mask without poses that jump away for up to two seconds and return to where the body moves on.

    Raises
    ------
    RecordingError
        If there are too many of them.
    """
    steps = _Steps.of(reference)
    jumps = np.flatnonzero(steps.above(*_impossible(reference, steps)) & _in_time(reference))
    keep, places, last, here = np.ones(reference.stamps_ns.size, dtype=bool), 0, -1, -1
    for i, first in enumerate(jumps.tolist()):
        if first <= last:
            continue
        for second in jumps[i + 1 :].tolist():
            if reference.stamps_ns[second + 1] - reference.stamps_ns[first] > 1e9 * _AWAY:
                break
            if _returns(reference, steps, first, second):
                keep[first + 1 : second + 1] = False
                places, last, here = places + 1, second, first if here < 0 else here
                break
    if places:
        what = (
            f"poses jump away and return within {_AWAY:g} s, in {_times(places)} (here by {steps.text(here)}): "
            "tracking was lost, or markers were taken for each other"
        )
        _leave_out(reference, keep, what, here + 1, warnings)
    return keep


def _returns(reference: ReferencePoses, steps: _Steps, first: int, second: int) -> bool:
    """Return whether the second of two jumps undoes the first.

    The pose after it is about where it was before, or the body moved on and both are the same change of the body's
    axes and point, as by markers that are taken for each other.
    """
    across = _Steps.of(reference.part(np.array([first, second + 1])))
    over = np.array([across.shift[0], across.turn[0]])
    back = np.minimum([steps.shift[first], steps.turn[first]], [steps.shift[second], steps.turn[second]])
    jumped = back > _impossible(reference, steps)
    near = np.minimum(over, _left_of_jumps(reference, first, second))
    return bool(jumped.any() and np.all(near[jumped] < 0.5 * back[jumped]))


def _left_of_jumps(reference: ReferencePoses, first: int, second: int) -> Array:
    """Return how far two jumps, seen from the body, are from being each other's inverse: m and rad, (2,)."""
    p, q = reference.positions, reference.quaternions
    if q is None:
        return np.full(2, np.inf)
    both = [multiply(conjugate(q[k]), q[k + 1]) for k in (first, second)]
    turn = float(np.linalg.norm(log(multiply(both[0], both[1]))))
    if p is None:
        return np.array([np.inf, turn])
    ways = [apply(conjugate(q[at]), p[k + 1] - p[k]) for at, k in ((first + 1, first), (second, second))]
    return np.array([float(np.linalg.norm(ways[0] + ways[1])), turn])


def _times(count: int) -> str:
    return "one place" if count == 1 else f"{count} places"


def _leave_out(reference: ReferencePoses, keep: Mask, what: str, first: int, warnings: list[DataWarning]) -> None:
    """Add the warning about poses that are left out.

    Raises
    ------
    RecordingError
        If there are too many of them.
    """
    gone = int(np.sum(~keep))
    if gone > MAX_OUTLIERS * keep.size:
        raise fault(
            reference.source, f"{what}; {gone} of {keep.size} poses, expected {MAX_OUTLIERS:.0%} at the most",
            reference.row_of(first),
        )  # fmt: skip
    warnings.append(
        DataWarning("outliers", f"{reference.source.parent.name}: {what}; {gone} of {keep.size} poses were left out")
    )


def _impossible(reference: ReferencePoses, steps: _Steps) -> tuple[float, float]:
    """Return steps from pose to pose, m and rad, that are no motion."""
    (shift, turn), dt = steps.usual(90.0), reference.interval
    return max(0.25, _QUICK[0] * dt, _FAST * shift), max(0.7, _QUICK[1] * dt, _FAST * turn)


def _in_time(reference: ReferencePoses) -> Mask:
    """Return which poses are followed by the next without a gap."""
    dt = np.diff(reference.stamps_ns)
    return np.asarray(dt < 3.0 * float(np.median(dt)))


def _fresh(reference: ReferencePoses, warnings: list[DataWarning]) -> Mask:
    """Return the mask of the poses that do not only repeat the one before while the body moves."""
    steps = _Steps.of(reference)
    starts, stops = _stalls(reference)
    stale = (stops - starts < _LONG_FREEZE) & steps.above(*steps.usual(50.0))[stops]
    keep = first_of_each(reference.stamps_ns.size, starts[stale], stops[stale])
    if np.sum(~keep) > 0.1 * keep.size:
        # standstills are logged as often as motion: thin both alike, so that the rate is the same everywhere
        every = round(float(np.mean(stops[stale] - starts[stale]))) + 1
        for start, stop in zip(starts[~stale], stops[~stale], strict=True):
            keep[start : stop + 1] &= np.arange(stop + 1 - start) % every == 0
    if not keep.all():
        warnings.append(
            DataWarning(
                "repeats",
                f"{reference.source.parent.name}: {int(np.sum(~keep))} of {keep.size} poses only repeat the one before "
                "and were left out",
            )
        )
    return keep


def _new(reference: ReferencePoses, warnings: list[DataWarning]) -> Mask:
    """Return the mask of the poses of which both parts are new, where one is held while the other changes.

    Where neither changes the body rests, and as many are kept.
    """
    keep, (p, q) = np.ones(reference.stamps_ns.size, dtype=bool), (reference.positions, reference.quaternions)
    if p is None or q is None:
        return keep
    for slow, fast, name in ((p, q, "positions"), (q, p, "attitudes")):
        changes, moves = slow[1:] != slow[:-1], (fast[1:] != fast[:-1]).any(axis=1)
        new = changes.any(axis=1)
        at = np.flatnonzero(new) + 1
        if at.size < _PLACES or np.count_nonzero(moves & ~new) < _OFTEN * np.count_nonzero(moves):
            continue
        between = np.diff(at)
        every = int(np.median(between))
        even = np.mean(np.abs(between - every) <= 1) > _EVENLY
        if every < 2 or not even or np.mean(changes[at - 1].sum(axis=1) > 1) < _MOSTLY:
            continue
        keep[:] = False
        keep[at] = True
        begin, end = runs(~(moves | new))
        for first, last in zip(begin, end, strict=True):
            if last - first > every:
                keep[first : last + 1 : every] = True
        text = (
            f"{reference.source.parent.name}: {name} are held over {every} poses, of which the others are new; only "
            f"the {np.count_nonzero(keep)} of {keep.size} poses with new ones are used"
        )
        warnings.append(DataWarning("repeats", text))
        break
    return keep


def _near(reference: ReferencePoses, warnings: list[DataWarning]) -> Mask:
    """Return the mask without up to three poses in a row that jump away from their neighbours, which agree.

    Raises
    ------
    RecordingError
        If there are too many of them.
    """
    steps = _Steps.of(reference)
    shift, turn = steps.usual(25.0)
    dt = reference.interval
    keep = np.ones(reference.stamps_ns.size, dtype=bool)
    for length in range(1, 1 + min(_MAX_IN_A_ROW, keep.size - 2)):
        over = _Steps.of(reference, length + 1)
        for step, across, limit in (
            (steps.shift, over.shift, max(0.05, _QUICK[0] * dt, 10.0 * shift)),
            (steps.turn, over.turn, max(0.1, _QUICK[1] * dt, 10.0 * turn)),
        ):
            away, back = step[:-length], step[length:]
            out = np.minimum(away, back)
            for first in np.flatnonzero((out > limit) & (across < 0.5 * out)) + 1:
                keep[first : first + length] = False
    out = np.flatnonzero(~keep)
    if not out.size:
        return keep
    if out.size > MAX_OUTLIERS * keep.size:
        raise fault(
            reference.source,
            f"{out.size} of {keep.size} poses jump away from their neighbours (here by {steps.text(int(out[0]) - 1)}): "
            "markers were lost or swapped, or poses of another body are among them; record the reference again",
            reference.row_of(int(out[0])),
        )
    warnings.append(
        DataWarning(
            "outliers",
            f"{reference.source.parent.name}: {out.size} of {keep.size} poses jump away and back, by up to "
            f"{steps.shift[out - 1].max():.3g} m and {np.degrees(steps.turn[out - 1].max()):.3g} deg; they were left "
            "out",
        )
    )
    return keep


def _check_jumps(reference: ReferencePoses) -> None:
    """Raise an error where the pose jumps and stays there: another run, swapped markers, a frame set anew."""
    steps = _Steps.of(reference)
    jumps = steps.above(*_impossible(reference, steps)) & _in_time(reference)
    where = np.flatnonzero(jumps)
    if where.size:
        k = int(where[0])
        raise fault(
            reference.source,
            f"the pose jumps by {steps.text(k)} from one to the next{and_more(where.size - 1, 'places')}: poses of "
            "another run, swapped markers, or a frame set anew; split the recording here",
            reference.row_of(k + 1),
        )


def _check_metres(reference: ReferencePoses) -> None:
    speed = _Steps.of(reference).shift / (np.diff(reference.stamps_ns) * 1e-9)
    usual = _percentile(speed, 50.0)
    if np.isfinite(usual) and usual > _FAST:
        raise wrong_unit(reference, f"the body would move at {usual:.4g} m/s", "length", 1e-3)
