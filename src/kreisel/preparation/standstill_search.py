"""Where the robot stands still, judged by the reference's motion and the IMU's readings together."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.interpolation import continuous, running_mean
from kreisel.geometry.rotation import Array, Mask, lengths
from kreisel.model.assumed_noise import ReferenceNoise
from kreisel.model.standstill import ImuStillness, OutsideStandstill, Standstill
from kreisel.recording.recording import CHUNK, ImuSamples, Recording, ReferencePoses, chunks
from kreisel.synchronization.clock import Clock
from kreisel.validation.stamp_checks import runs

MIN_SECONDS = 0.2
"""Minimum duration of a standstill without the margins, s."""

MARGIN = 0.15
"""Seconds left out at either end, where the arm still swings and its reported pose still settles."""

_CREEP = 2.0
"""Largest speed at a standstill, in errors at standstill per second; the filter assumes such an error of velocity."""

_SMOOTHED = 0.1
"""Seconds over which poses are averaged to detect slow motion."""

_WINDOW = 0.2
"""s of readings that are judged together. Chosen: equal to `MIN_SECONDS`, so that the shortest standstill fills a
window."""

_STEPS = 10
"""Windows that begin within the length of one: every 20 ms. Chosen: less than `MARGIN`, so that a standstill loses
little; one at every sample would be eight times as many at 400 Hz."""

_ALWAYS_STILL = (0.01, 0.05)
_NEVER_STILL = (0.06, 0.8)
"""rad/s and m/s^2: least and largest threshold of the scatter in a window, otherwise three times that of the quietest
tenth. Chosen: with good sensors vibration of an arm at standstill must not count as motion; the scatter of a machine
that never stands still must not count as a standstill."""


_TREMOR = 0.01
"""rad/s: scatter of rates slower than 25 Hz from which a device that may be held does not rest. Chosen: simulated
tremor of 1 mrad scatters by 0.025 to 0.05, devices that lie on a table (BROAD 05, 07, 21) by 0.0006 to 0.0009."""


def find_standstills(
    stillness: ImuStillness, reference: ReferencePoses, clock: Clock, noise: ReferenceNoise
) -> tuple[Standstill, ...]:
    """Return the intervals in which neither reference nor IMU moves.

    Notes
    -----
    The IMU's threshold lies three times above the quietest tenth of its windows, within bounds: a machine
    that never stands still has no quiet windows at that level, and the reference decides.
    """
    t, still = stillness.seconds, stillness.still
    starts, stops = runs(still & ~_reference_moving(reference, clock, t, noise))
    return tuple(
        Standstill(float(t[a]) + MARGIN, float(t[b - 1]) - MARGIN)
        for a, b in zip(starts, stops, strict=True)
        if t[b - 1] - t[a] >= MIN_SECONDS + 2.0 * MARGIN
    )


def standstill_outside(
    imu: ImuSamples, stillness: ImuStillness, reference: ReferencePoses, clock: Clock
) -> OutsideStandstill | None:
    """Return the longest standstill outside the reference's time, or None where it is shorter than two seconds."""
    t, still = stillness.seconds, stillness.still
    first, last = clock.imu_time(reference.seconds[[0, -1]])
    starts, stops = runs(still & ((t < first) | (t > last)))
    if starts.size == 0:
        return None
    longest = int(np.argmax(t[stops - 1] - t[starts]))
    start, stop = float(t[starts[longest]]), float(t[stops[longest] - 1])
    if stop - start < 2.0:
        return None
    part = slice(*np.searchsorted(imu.seconds, (start, stop)))
    return OutsideStandstill(imu.rates[part].mean(axis=0), stop - start)


def may_be_held(recording: Recording) -> bool:
    """Return whether a hand may hold the device: before cameras, without an arm's joint angles."""
    return recording.reference_kind == "mocap" and recording.joints is None


def imu_stillness(imu: ImuSamples, *, held: bool = False) -> ImuStillness:
    """Return when the IMU stands still.

    held: whether a hand may hold it, whose tremor is slow: it is motion, and no vibration of a device at rest.
    """
    step = max(1, round(_WINDOW / _STEPS / imu.interval))
    rate, force = (_spread(values, step) for values in (imu.rates, imu.accelerations))
    limit_rate = np.clip(3.0 * np.percentile(rate, 10), _ALWAYS_STILL[0], _NEVER_STILL[0])
    limit_force = np.clip(3.0 * np.percentile(force, 10), _ALWAYS_STILL[1], _NEVER_STILL[1])
    still = np.asarray((rate < limit_rate) & (force < limit_force))
    if held:
        still &= _sway(imu.rates, step) < _TREMOR
    # the ends of the recording are as still as the first and the last whole window
    t = imu.seconds[_STEPS * step // 2 :: step][: still.size]
    return ImuStillness(np.concatenate([imu.seconds[:1], t, imu.seconds[-1:]]), np.pad(still, 1, mode="edge"))


def _spread(values: Array, step: int) -> Array:
    """Return the standard deviation within windows of `_STEPS` steps, one step apart, all axes together."""
    usual = values[: min(len(values), CHUNK)].mean(axis=0)  # squares of values far from zero would lose digits
    steps = len(values) // step
    sums = np.zeros((steps + 1, 4))
    for part in chunks(steps):
        x = (values[part.start * step : part.stop * step] - usual).reshape(-1, step, 3)
        sums[1:][part, :3] = x.sum(axis=1)
        sums[1:][part, 3] = np.einsum("kij,kij->k", x, x)
    np.cumsum(sums, axis=0, out=sums)
    mean = (sums[_STEPS:] - sums[:-_STEPS]) / (_STEPS * step)
    return np.asarray(np.sqrt(np.maximum(mean[:, 3] - (mean[:, :3] ** 2).sum(axis=1), 0.0)))


def _sway(rates: Array, step: int) -> Array:
    """Return the standard deviation of what is slower than two steps, within windows of `_STEPS` steps, one apart."""
    steps = len(rates) // step
    mean = rates[: steps * step].reshape(-1, step, 3).mean(axis=1)
    smooth = 0.5 * (mean[1:] + mean[:-1])
    windows = np.lib.stride_tricks.sliding_window_view(smooth, _STEPS - 1, axis=0)
    return np.asarray(np.sqrt(windows.var(axis=2).sum(axis=1)))


def _reference_moving(reference: ReferencePoses, clock: Clock, t: Array, noise: ReferenceNoise) -> Mask:
    """Return for IMU times whether the reference moves, by its displacement over a third of a second.

    Both ends are means over `_SMOOTHED` seconds, because a slow move begins and ends with speeds that single poses do
    not show. Taken as a standstill, it would enter the filter with a velocity of zero.
    """
    tau = reference.seconds
    stride = max(1, round(0.3 / reference.interval))
    width = max(1, round(_SMOOTHED / reference.interval))
    span = tau[stride:] - tau[:-stride]
    moving = np.zeros(span.size, dtype=bool)
    if reference.positions is not None:
        limit = (noise.standstill_position, 0.004 + 4.0 * noise.position)
        moving |= _faster(reference.positions, stride, width, span, limit)
    if reference.quaternions is not None:
        limit = (noise.standstill_orientation, 0.004 + 8.0 * noise.orientation)
        # half the angle is the distance of unit quaternions
        moving |= _faster(2.0 * continuous(reference.quaternions), stride, width, span, limit)
    middle = clock.imu_time(0.5 * (tau[stride:] + tau[:-stride]))
    nearest = np.clip(np.searchsorted(middle, t), 0, middle.size - 1)
    result = moving[nearest]
    result |= (t < clock.imu_time(tau[0])) | (t > clock.imu_time(tau[-1]))
    return np.asarray(result)


def _faster(x: Array, stride: int, width: int, span: Array, limit: tuple[float, float]) -> Mask:
    """Return whether values (m, k) move faster than their noise allows, (m - stride,).

    Parameters
    ----------
    limit
        Error at standstill, and the speed that always counts as motion, whatever the noise of the values.
    """
    smooth = running_mean(x, width)
    left = lengths(x - smooth)
    quiet = float(np.percentile(running_mean(left[:, None] ** 2, stride), 10)) ** 0.5
    allowed = _CREEP * limit[0] + 4.0 * quiet * (2.0 / width) ** 0.5 / float(np.median(span))
    speed = lengths(smooth[stride:] - smooth[:-stride]) / span
    return np.asarray(speed > min(allowed, limit[1]))
