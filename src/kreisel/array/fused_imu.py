"""Calibrated IMUs on one body fused to a virtual one: the mean of their rates and forces with the best weights.

Each unit's calibration gives angular rate and specific force of the common body b, so that only clocks have to be
brought together. The noise of units is independent: inverse variances are the best weights. What the accelerometers
read by their distances from the origin of b follows from the fused angular rate, whose derivative has the least noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kreisel.array.clock_refinement import refined_clock
from kreisel.array.left_out import in_words, reason_of
from kreisel.array.lower_rate import smoothed, window_for
from kreisel.array.mean_imu import MIN_EXPLAINED
from kreisel.array.odd_unit import OddUnit, odd_unit
from kreisel.array.resampled import Resampled, clipped_samples, resampled, white_noise
from kreisel.array.rest_density import Standstills, standstills
from kreisel.array.sudden_change import SuddenChange, sudden_change
from kreisel.array.unit_clock import clock_of
from kreisel.array.unsteady_clock import UnsteadyClock, unsteady_clock
from kreisel.calibration.result import Calibration
from kreisel.errors import KreiselError, RecordingError, SynchronizationError
from kreisel.geometry.rotation import Array, Mask
from kreisel.inertial.sensor_model import correct_specific_force
from kreisel.inertial.slopes import LONGEST_GAP, REACH, local_cubics, usual_interval
from kreisel.progress import StepProgress
from kreisel.recording.recording import ImuSamples, Stamps
from kreisel.synchronization.clock import Clock
from kreisel.validation.imu_checks import silenced_samples
from kreisel.validation.masking import without_spikes

MAX_TURNED = 0.02
"""Share of the rates by which a unit may differ from the base in proportion to them. Chosen: scale factors of the
cheapest gyros change by less after a calibration, and a mount is turned by more before it is seen, 1.1 degrees."""

_LEAST = 0.2
"""Noise at standstills over that by third differences, at least. Chosen: noise with memory has a third."""

_ENOUGH = 100
"""Samples by which noise is known to a tenth."""

SENSORS = ("gyro", "accel")


@dataclass(frozen=True)
class UnitReadings:
    """A unit's readings, corrected.

    Attributes
    ----------
    imu
        At the unit's stamps: angular rates of b, and specific forces where each accelerometer is, in axes of b.
    calibration
        By which they were corrected.
    doubtful : (n,)
        Samples that are clipped or spikes, or near such ones.
    silenced : (n,)
        Samples whose rates the device set to zero because they were small, or near such ones.
    noise : (2,)
        Noise density of gyros and accelerometers by third differences, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz), rms.
    """

    name: str
    imu: ImuSamples
    calibration: Calibration
    doubtful: Mask
    silenced: Mask
    noise: Array

    @classmethod
    def of(cls, name: str, raw: ImuSamples, calibration: Calibration) -> UnitReadings:
        """Return a unit's readings, corrected by its calibration.

        Raises
        ------
        RecordingError
            If the calibration cannot be applied to them.
        """
        there = replace(calibration, sensors=replace(calibration.sensors, lever_arms=np.zeros((3, 3))))
        readings = (raw.rates, raw.accelerations, raw.stamps_ns, raw.temperature)
        omega, f = there.correct(*readings, check=calibration.accepted)
        left, _ = without_spikes(raw)
        clipped = clipped_samples(raw.rates) | clipped_samples(raw.accelerations)
        clipped |= ~np.isin(raw.stamps_ns, left.stamps_ns)
        # derivatives for delays reach so far
        doubtful, silenced = (
            np.convolve(mask, np.ones(2 * REACH + 1), "same") > 0.5 for mask in (clipped, silenced_samples(raw.rates))
        )
        read, counts = (raw.rates, raw.accelerations), calibration.counts
        read = read if counts is None else counts.in_si(*read)
        matrices = (calibration.sensors.K_omega, calibration.sensors.K_a)
        shown = ~silenced if np.count_nonzero(~silenced) >= _ENOUGH else slice(None)
        noise = [
            np.sqrt(raw.interval * np.mean(K**2 @ white_noise(part[shown]) ** 2))
            for K, part in zip(matrices, read, strict=True)
        ]
        imu = ImuSamples(raw.stamps_ns, omega, f, raw.source)
        return cls(name, imu, calibration, doubtful, silenced, np.array(noise))

    def at(self, clock: Clock, times: Array) -> Resampled:
        """Return the readings at times (n,) of the base unit; see `resampled`."""
        seen = resampled(self.imu, clock, times)
        last = np.clip(np.searchsorted(self.imu.seconds, clock.reference_time(times)), 2, self.imu.seconds.size - 2)
        clipped = self.doubtful[last[:, None] + np.arange(-2, 2)].any(axis=1)
        return Resampled(seen.rates, seen.forces, None, seen.known & ~clipped)

    def for_rate(self, interval: float) -> UnitReadings:
        """Return the readings smoothed for one sample each `interval`, s, where they have more."""
        window = window_for(self.imu, interval)
        if window == 1:
            return self
        imu, _ = smoothed(self.imu, window)
        return replace(self, imu=imu, doubtful=np.convolve(self.doubtful, np.ones(window), "same") > 0.5)

    def to_origin(self, rates: Array, slopes: Array) -> Array:
        """Return what brings its forces to the origin of b, (n, 3), by the rate of b and its derivative."""
        sensors, form = self.calibration.sensors, self.calibration.size_effect
        return correct_specific_force(-sensors.k_a[0], rates, slopes, sensors, form)


@dataclass(frozen=True)
class FusedUnit:
    """A unit's part in the fused IMU.

    Attributes
    ----------
    clock
        Against the base unit's, each counting from its first sample.
    offset
        t_base = t + offset + skew (t - first t), s.
    weight, density : (2,)
        Share in the mean, and noise density (rad/s/sqrt(Hz), m/s^2/sqrt(Hz), rms over the axes), of gyros and
        accelerometers.
    share
        Of the samples, that it has a part in.
    """

    name: str
    clock: Clock
    offset: float
    weight: Array
    density: Array
    share: float


@dataclass(frozen=True)
class FusedImu:
    """Angular rate and specific force of b by several units.

    Attributes
    ----------
    stamps_ns : (n,)
        Of the base unit, and even ones in its gaps.
    rates, forces : (n, 3)
        rad/s, m/s^2.
    units
        The base unit first.
    left_out
        Units that are not used, with the reasons.
    predicted, measured : (2,)
        Noise density of gyros and accelerometers by the weights, and as the fused readings at rest show it, before
        forces are brought to the origin of b; None without standstills.
    at_rest
        Whether the densities of the units are those at standstills; they are by third differences otherwise.
    lost
        Samples that no unit has.
    """

    stamps_ns: Stamps
    rates: Array
    forces: Array
    units: tuple[FusedUnit, ...]
    left_out: Mapping[str, str]
    predicted: Array
    measured: Array | None
    at_rest: bool
    lost: int

    @property
    def document(self) -> dict[str, Any]:
        """What is said of the weights and the noise, in SI."""
        return {
            "reference": self.units[0].name,
            "samples": int(self.stamps_ns.size),
            "samples_lost": self.lost,
            "noise_by": "standstills" if self.at_rest else "third differences",
            "imus": {
                unit.name: {
                    "weight": _pair(unit.weight),
                    "noise_density": _pair(unit.density),
                    "share_of_samples": unit.share,
                    "clock": {
                        "offset": unit.offset, "offset_sd": unit.clock.start_sd,
                        "skew": unit.clock.skew, "skew_sd": unit.clock.skew_sd,
                    },
                }
                for unit in self.units
            },
            "fused": {
                "noise_density": None if self.measured is None else _pair(self.measured),
                "predicted": _pair(self.predicted),
            },
            "left_out": dict(self.left_out),
        }  # fmt: skip


def _pair(values: Array) -> dict[str, float]:
    return dict(zip(SENSORS, map(float, values), strict=True))


def fuse(units: Sequence[UnitReadings], progress: StepProgress | None = None) -> FusedImu:
    """Return the fused IMU.

    The first unit with which half of the units move is the base, on whose clock the others are brought.

    Raises
    ------
    RecordingError
        If no two units move together all the time.
    """
    if not all(unit.silenced.any() for unit in units):  # else there are no others
        units = [replace(unit, doubtful=unit.doubtful | unit.silenced) for unit in units]
    group = _steady(units, progress)
    base = group.units[0]
    stamps = _filled(base.imu.stamps_ns)
    times = (stamps - stamps[0]) * 1e-9
    noise = np.array([unit.noise for unit in group.units])
    rates, there, known = _mean(group, times, noise)
    still = standstills(times, (rates, there), known)
    found = _densities(group, times, still)
    density = noise if found is None else found
    rates, there, known = _mean(group, times, density)
    forces = _at_origin(group, times, density[:, 1], (rates, there), known)
    own = [still.density(values, known) for values in (rates, there)]
    measured = None if found is None or None in own else np.array(own, dtype=float)
    weights = density**-2.0 / np.sum(density**-2.0, axis=0)
    first = int(base.imu.stamps_ns[0])
    fused = tuple(
        FusedUnit(
            unit.name, clock, clock.offset(first, int(unit.imu.stamps_ns[0])), weights[k], density[k],
            float(np.mean(unit.at(clock, times[known]).known)),
        )
        for k, (unit, clock) in enumerate(zip(group.units, group.clocks, strict=True))
    )  # fmt: skip
    predicted = np.sum(density**-2.0, axis=0) ** -0.5
    return FusedImu(
        stamps[known], rates[known], forces[known], fused, group.left_out, predicted, measured,
        found is not None, int(np.sum(~known)),
    )  # fmt: skip


@dataclass(frozen=True)
class _Group:
    """Units that move together, the base first and at its rate, with their clocks against it."""

    units: tuple[UnitReadings, ...]
    clocks: tuple[Clock, ...]
    left_out: Mapping[str, str]


def _steady(units: Sequence[UnitReadings], progress: StepProgress | None) -> _Group:
    """Return the units that move together without one that turns on the body, or whose clock jumps.

    Raises
    ------
    RecordingError
        If fewer than two are left.
    """
    left_out: dict[str, str] = {}
    while True:
        group = _moving_together(units, progress)
        left_out |= group.left_out
        change = _change(group)
        if change is None:
            return replace(group, left_out=left_out)
        name = group.units[change.number].name
        if len(group.units) == 2:
            raise RecordingError(f"no two units move together all the time: {name}: {change.text}")
        left_out[name] = change.text
        units = [unit for unit in group.units if unit.name != name]


def _change(group: _Group) -> SuddenChange | UnsteadyClock | OddUnit | None:
    """Return the clearest change of a unit against the others, or the unit that differs from them, if there is one.

    Many jumps of one clock may look like one of another unit.
    """
    times = group.units[0].imu.seconds
    seen = [unit.at(clock, times) for unit, clock in zip(group.units, group.clocks, strict=True)]
    known = np.all([one.known for one in seen], axis=0)
    rates, t = np.stack([one.rates[known] for one in seen]), times[known]
    slope = local_cubics(t, usual_interval(t)).slopes(rates.mean(axis=0))
    unsteady, change = unsteady_clock(t, rates, slope), sudden_change(t, rates, slope)
    if unsteady is not None and (change is None or change.number != unsteady.number):
        return unsteady
    if change is not None:
        return change
    turning = rates.mean(axis=0)
    forces = [one.forces[known] + unit.to_origin(turning, slope) for one, unit in zip(seen, group.units, strict=True)]
    return odd_unit(rates, np.stack(forces), usual_interval(t))


def _moving_together(units: Sequence[UnitReadings], progress: StepProgress | None) -> _Group:
    best: _Group | None = None
    for base in units:
        group = _group(base, units, progress)
        if best is None or len(group.units) > len(best.units):
            best = group
        if 2 * len(group.units) > len(units):
            break
    if best is None or len(best.units) < 2:
        reasons = "there is one unit only"
        if best is not None and best.left_out:
            reasons = in_words(best.left_out)
        raise RecordingError(f"no two units move together: {reasons}")
    return best


def _group(base: UnitReadings, units: Sequence[UnitReadings], progress: StepProgress | None) -> _Group:
    """Return the units that move with a base."""
    found, clocks, left_out = [base], [Clock(0.0)], {}
    for k, unit in enumerate(units):
        if progress is not None:
            progress(k / len(units))
        if unit is base:
            continue
        try:
            clock = _clock(unit, base)
        except KreiselError as error:
            left_out[unit.name] = reason_of(error)
            continue
        found.append(unit)
        clocks.append(clock)
    found = [unit.for_rate(base.imu.interval) for unit in found]
    return _Group(tuple(found), tuple(clocks), left_out)


def _clock(unit: UnitReadings, base: UnitReadings) -> Clock:
    """Return the clock of a unit that moves as the base does.

    Raises
    ------
    SynchronizationError
        If it does not.
    """
    found = refined_clock(unit.imu, clock_of(unit.imu, base.imu, base.name), base.imu)
    if not found.explained >= MIN_EXPLAINED:
        raise SynchronizationError(
            f"its rates explain {100.0 * max(found.explained, 0.0):.0f} % of the changes of those of {base.name}, "
            f"expected {100.0 * MIN_EXPLAINED:.0f} % or more: it did not move with it, or its readings are wrong"
        )
    if not found.turned <= MAX_TURNED:
        raise SynchronizationError(
            f"its rates differ from those of {base.name} by {100.0 * found.turned:.1f} %, expected "
            f"{100.0 * MAX_TURNED:.0f} % or less: it is another unit than was calibrated there, or turned on its mount"
        )
    return found.clock


def _filled(stamps: Stamps) -> Stamps:
    """Return ascending stamps with even ones in their gaps."""
    usual = usual_interval(stamps.astype(np.float64))
    gaps = np.flatnonzero(np.diff(stamps) > max(1e9 * LONGEST_GAP, 5.0 * usual))
    more = []
    for gap in gaps:
        low, high = int(stamps[gap]), int(stamps[gap + 1])
        steps = round((high - low) / usual)
        more.append(low + np.round(np.arange(1, steps) * ((high - low) / steps)).astype(np.int64))
    return np.sort(np.concatenate([stamps, *more]))


def _mean(group: _Group, times: Array, density: Array) -> tuple[Array, Array, Mask]:
    """Return means of rates, and of forces where the units are, (n, 3), weighted by densities (units, 2).

    The last value says where there are any; they are zero elsewhere.
    """
    sums, weights = np.zeros((2, times.size, 3)), np.zeros((2, times.size, 1))
    for unit, clock, own in zip(group.units, group.clocks, density, strict=True):
        seen = unit.at(clock, times)
        weight = own[:, None, None] ** -2.0 * seen.known[:, None]
        sums += weight * np.stack([seen.rates, seen.forces])
        weights += weight
    known = weights[0, :, 0] > 0.0
    rates, forces = sums / np.where(weights > 0.0, weights, 1.0)
    return rates, forces, known


def _at_origin(group: _Group, times: Array, density: Array, mean: tuple[Array, Array], known: Mask) -> Array:
    """Return mean forces at the origin of b (n, 3) by mean rates and forces where the units are; density: (units,)."""
    t, w = times[known], mean[0][known]
    slopes = local_cubics(t, usual_interval(t)).slopes(w)
    sums, weights = np.zeros((t.size, 3)), np.zeros((t.size, 1))
    for unit, clock, own in zip(group.units, group.clocks, density, strict=True):
        weight = unit.at(clock, t).known[:, None] * own**-2.0
        sums += weight * unit.to_origin(w, slopes)
        weights += weight
    forces = mean[1].copy()
    forces[known] += sums / weights
    return forces


def _densities(group: _Group, times: Array, still: Standstills) -> Array | None:
    """Return noise densities at standstills, (units, 2); None where one of the units has too few.

    Of a device that sets its rates to zero at rest, or rounds coarsely, they are those in motion.
    """
    out = []
    for unit, clock in zip(group.units, group.clocks, strict=True):
        seen = unit.at(clock, times)
        own = [still.density(values, seen.known) for values in (seen.rates, seen.forces)]
        if None in own:
            return None
        out.append(np.maximum(np.array(own, dtype=float), _LEAST * unit.noise))
    return np.maximum(np.array(out), 1e-12)
