"""Stages that repair the clocks: losses, a slew, a jump, the time base. Each takes a comparison and returns one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import Mask
from kreisel.preparation.comparison import Comparison
from kreisel.preparation.imu_noise import readings_of
from kreisel.preparation.time_base import on_reference_clock
from kreisel.recording.recording import ImuSamples, ReferencePoses
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.clock_jump import ClockJump, corrected, find_clock_jump
from kreisel.synchronization.clock_slew import ClockSlew, find_clock_slew
from kreisel.synchronization.even_losses import evenly_lost
from kreisel.synchronization.lost_samples import LostSamples, find_lost_poses, find_lost_samples

_ROUNDS_OF_LOSSES = 3
"""Searches for lost samples: with the first ones restored the clocks' line is a better one, and may show others.
Chosen: searches end as soon as nothing is found; each costs a further fit of the rates."""

_FAR_LESS = 0.8
"""Share of the residual up to which losses at even intervals are taken. Chosen: in four recordings of such sensors it
was 0.36 to 0.55, and places at random leave it as it is."""

_MIN_SURE_SHARE = 0.3
"""Share of the poses that must not depend on where samples were lost."""

_BURST, _MAX_IN_BURST = 0.5, 6
"""s, and samples lost in that time: of more of them it is not known how they lie."""

_MAX_LOST_SHARE = 0.007
"""Share of the samples that may be restored: more of them explain a clock of any rate."""

_ROUNDS_OF_SIZE, _SETTLED = 5, 0.3
"""Corrections of a jump or a slew at most, and deviations of a jump below which it is found. Chosen: each leaves a
tenth."""

_NO_WORSE = 1.25
"""Share of the residual that lost samples leave at most. Chosen: a unit of a tray with a cubic term "lost" three, by
which it rose to 1.6. Restored ones leave less, but where a ratio of the clocks has hidden them: 1.06 before an arm."""

_WHOLE, _AT_ONCE = 0.93, 0.97
"""Factors on the residuals that losses, and a jump, leave, by which they are preferred to a slew: whole intervals of
counted stamps are no chance, and a jump leaves out the poses beside it, which are a little worse. Chosen: two samples
that were lost looked like a slew of 20 s that left 0.983 of what a jump did, and a turn was lost with them."""

_EQUAL_RATES = 3e-4
"""Difference of two clocks that a crystal may have."""


def without_losses(before: Comparison) -> Comparison | None:
    """Return the comparison with later stamps after samples that were lost without a gap; None if there are none.

    If the clocks do not run at equal rates afterwards, something else is wrong with them.
    """
    recording, reference, found = before.recording, before.reference, before
    certain = np.ones(reference.stamps_ns.size, dtype=bool)
    for round_number in range(_ROUNDS_OF_LOSSES):
        imu = found.recording.imu
        missing = find_lost_samples(imu, found.readings, reference, found.fit)
        if missing is None:
            break
        if (even := _evenly_lost(found, missing)) is not None:
            missing = even
        if missing.max_within(_BURST) > _MAX_IN_BURST:
            return None
        if round_number == 0:
            found = found.with_warning(missing.warning(imu))
        certain &= missing.sure_poses(reference)
        found = found.of(replace(recording, imu=missing.restored(imu)))
    if found is before or abs(found.fit.clock.skew) > _EQUAL_RATES + 3.0 * found.fit.clock.skew_sd:
        return None
    # the ratio of the clocks has hidden losses by which the rates fit worse: without them it is nearer to one
    nearer = abs(found.fit.clock.skew) < abs(before.fit.clock.skew)
    if found.fit.residual_sd > (_NO_WORSE if nearer else 1.0) * before.fit.residual_sd:
        return None
    imu = found.recording.imu
    share = 1.0 - recording.imu.stamps_ns.size / (1.0 + float(imu.seconds[-1]) / imu.interval)
    if np.mean(certain) < _MIN_SURE_SHARE or share > _MAX_LOST_SHARE:
        return None
    broken = replace(recording, imu=_broken_after(imu, reference, found.fit.clock, ~certain))
    return replace(
        found,
        recording=broken,
        reference=replace(reference, doubtful=~certain),
        readings=readings_of(broken, found.imu_noise),
    )


def _evenly_lost(before: Comparison, missing: LostSamples) -> LostSamples | None:
    """Return losses at even intervals, if those found lie so and if they leave far less of the differences."""
    imu = before.recording.imu
    left = {
        before.of(replace(before.recording, imu=even.restored(imu))).fit.residual_sd: even
        for even in evenly_lost(missing, imu.stamps_ns, before.fit.clock)
    }
    least = min(left, default=np.inf)
    return left[least] if least < _FAR_LESS * before.fit.residual_sd else None


def without_lost_poses(before: Comparison) -> Comparison | None:
    """Return the comparison with later stamps of poses after some that were lost without a gap; None if none were."""
    if before.recording.joints is not None:
        return None  # a robot's own stamps
    found, fit = None, before.fit
    for _ in range(_ROUNDS_OF_LOSSES):
        skew = 0.0 if found is None else found.fit.clock.skew
        missing = find_lost_poses(before.readings, before.reference, fit, skew)
        if missing is None or missing.counts.sum() > _MAX_LOST_SHARE * before.reference.stamps_ns.size:
            break
        other = before.of(before.recording, missing.restored(before.reference))
        if found is not None and other.fit.residual_sd >= found.fit.residual_sd:
            break
        found = other.with_warning(missing.warning(before.reference))
        fit = replace(found.fit, clock=before.fit.clock)  # with a matrix that losses no longer disturb
    return found


def without_slew(before: Comparison) -> Comparison | None:
    """Return the comparison without a slew of a clock; None if there is none.

    Whose clock it was is seen by the rates: they are wrong while it was slewed if it was the IMU's.
    """
    slew = find_clock_slew(before.fit)
    if slew is None:
        return None
    found = []
    for whose, without in (("reference", _in_reference), ("IMU", _in_imu)):
        own, after = slew, without(before, slew)
        for _ in range(_ROUNDS_OF_SIZE):
            last, own = own, own.refined(after.fit)
            after = without(before, own)
            if own.is_like(last):
                break
        found.append(after.with_warning(own.warning(whose)))
    return min(found, key=lambda one: one.fit.residual_sd)


def _in_reference(before: Comparison, slew: ClockSlew) -> Comparison:
    joints, first = before.recording.joints, int(before.reference.stamps_ns[0])
    moved = None if joints is None else slew.taken_out_of_joints(joints, first)
    return before.of(replace(before.recording, joints=moved), slew.taken_out(before.reference))


def _in_imu(before: Comparison, slew: ClockSlew) -> Comparison:
    return before.of(replace(before.recording, imu=slew.taken_out_of_imu(before.recording.imu, before.fit.clock)))


def without_jump(before: Comparison) -> Comparison:
    """Return the comparison without a jump of the clocks; the same one if there is none."""
    jump = find_clock_jump(before.readings, before.reference, before.fit)
    if jump is None:
        return before
    for _ in range(_ROUNDS_OF_SIZE):
        found = _taken_out(before, jump)
        last, jump = jump, corrected(jump, found.fit)
        if abs(jump.size - last.size) <= _SETTLED * jump.size_sd:
            break
    return _taken_out(before, jump).with_warning(jump.warning())


def in_stated_seconds(before: Comparison) -> Comparison:
    """Return the comparison with the IMU's stamps in seconds of the reference, if those are stated to be true."""
    if before.recording.settings.imu.time_base != "reference" or not before.fit.skewed:
        return before
    return before.of(on_reference_clock(before.recording, before.fit.clock))


def repaired(comparison: Comparison) -> Comparison:
    """Return the comparison after all stages; of losses, a jump and a slew that by which the rates fit best."""
    complete, poses, slewed = without_losses(comparison), without_lost_poses(comparison), without_slew(comparison)
    jumped = without_jump(comparison)
    explained = [one for one in (complete, poses, slewed, jumped) if one is not None and one is not comparison]

    def left(one: Comparison) -> float:
        share = _WHOLE if one is complete or one is poses else _AT_ONCE if one is jumped else 1.0
        return one.fit.residual_sd * share

    found = min(explained, key=left, default=comparison)
    return in_stated_seconds(without_jump(found) if found is slewed and complete is None else found)


def _taken_out(found: Comparison, jump: ClockJump) -> Comparison:
    """Return the comparison of recording and reference without a jump of the clocks."""
    reference, joints = found.reference, found.recording.joints
    moved = jump.taken_out(reference)
    imu = _broken_after(found.recording.imu, moved, found.fit.clock, jump.is_beside(moved))
    recording = replace(
        found.recording,
        imu=replace(imu, placed_sd=jump.size_sd),
        joints=None if joints is None else jump.taken_out_of_joints(joints, int(reference.stamps_ns[0])),
    )
    return found.of(recording, moved)


def _broken_after(imu: ImuSamples, reference: ReferencePoses, clock: Clock, doubtful: Mask) -> ImuSamples:
    """Return the readings with a new start of navigation after doubtful poses.

    The rotation in between depends on when samples were lost, or a clock jumped: it must not be compared with the
    reference's.
    """
    ends = np.flatnonzero(doubtful & ~np.append(doubtful[1:], False))
    after = imu.stamps_ns[0] + np.round(1e9 * clock.imu_time(reference.seconds[ends])).astype(np.int64)
    return replace(imu, broken_ns=np.unique(np.concatenate([imu.broken_ns, after])))
