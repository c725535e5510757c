"""A tray of units on one robot: the mean is calibrated by the reference, each unit by the mean's motion.

The likelihood of all readings is that of the mean's given the motion, times that of the units' differences from it,
which does not depend on the reference. So one run of the estimator, with all that it finds of arm and clocks, serves
all units; each of them costs a linear fit.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from kreisel.array.left_out import COPY, in_words, reason_of
from kreisel.array.mean_imu import Aligned, BaseRows, MeanImu, align, gains_of
from kreisel.array.mount_watch import Turn
from kreisel.array.resampled import Resampled, resampled
from kreisel.array.tray_outcome import TrayOutcome, UnitOutcome
from kreisel.array.tray_places import covariance_of_units, places_of_units
from kreisel.array.tray_result import mover_of, spread_of, unit_calibration
from kreisel.array.unit_clock import BASES, clock_of
from kreisel.array.unit_fit import Common, UnitFit, fit_unit
from kreisel.array.unit_verdict import UnitFindings, unit_verdict
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.outcome import Outcome
from kreisel.calibration.result import Calibration
from kreisel.errors import KreiselError, RecordingError, SettingsError
from kreisel.geometry.rotation import Array
from kreisel.inertial.correction import Block
from kreisel.inertial.effects import EFFECTS
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.model.calibration_settings import BY_CHOICE, CalibrationSettings
from kreisel.model.parameters import PASSING_GROUPS
from kreisel.progress import Progress
from kreisel.recording.recording import DataWarning, Recording
from kreisel.synchronization.clock import Clock
from kreisel.tasks import Executor, sequential
from kreisel.units import STANDARD_GRAVITY

_ROOM = 1 << 29
"""Bytes of readings that are kept; others are read again. Chosen: sixteen units of an hour, or 50 of ten minutes."""

_TOGETHER = 4
"""Units that are read and fitted at the same time. Chosen: 0.2 GB for ten minutes."""

MIN_UNITS = 3
"""Units among which one that disagrees with the others can be named."""

_MISFIT, _ODD = 1.7, 1.4
"""Differences from the common motion over what noise explains, from which a unit may be left out of the mean, and over
those of the other units. Chosen: without a fault it is 0.9 for each unit, and one at fault in four has three times as
much as the others."""

_CLEAR = 2.3
"""The same, from which a unit with moments that are far off errs at others too. Chosen: bursts of vibration leave 2.1
at most, and a jump of an offset makes 2.6."""

_SHARE_OF_TURN = 0.03
"""Share of what does not fit, in units of its size, that a turn of the mount explains at least. Chosen: turns of 1 to
100 mrad explain 11 to 55 %; what a jump of a clock has in common with one, some tenths of a per cent."""

_WHOLE = 0.98
"""Share of the recording that the readings of a unit of the mean cover, over that of most units, and those of the base
unit over the longest. Chosen: where a unit begins or ends, the mean changes by its lever arms, which is no motion."""

_HARDLY = 1e-4
"""Share of a recording up to which readings that are far off are not worth a word."""

_NEEDED = ("gyro_cross_coupling", "gyro_offset", "accel_cross_coupling", "accel_offset", "lever_arms")


def calibrate_tray(
    read: Callable[[str], Recording],
    names: Sequence[str],
    settings: CalibrationSettings,
    progress: Progress | None = None,
    *,
    executor: Executor = sequential,
    validate: bool = False,
) -> TrayOutcome:
    """Return the calibrations of all units of a recording.

    Parameters
    ----------
    read
        Returns the recording with the readings of one IMU; see `unit_readings.unit_reader`.
    names
        Of the IMUs; the reference and what is stated of it are those of the first one's recording.
    progress
        Called with the name of the step and the share of it that is done.

    Raises
    ------
    KreiselError
        If the recording cannot be used, or no two units move together.
    """
    check_settings(settings)
    tray = _together(_Kept(read), names, progress, executor)
    run = partial(run_calibration, progress=progress, executor=executor, validate=validate, budget=True)
    turned: dict[str, Turn] = {}
    odd: dict[str, float] = {}
    try:
        mean = run(tray.mean_recording(), settings)
    except KreiselError as error:
        farthest, mean = _without_farthest(tray, partial(run, settings=settings), error)
        odd[farthest] = np.inf
    unlike: set[str] = set()
    restored: set[str] = set()
    while True:
        found = _fitted(tray, mean, progress, executor)
        apart = unlike.union(turned, odd)
        more = _with_shown(settings, [fit for name, fit in found.fits.items() if name not in apart])
        if more is not None:
            other = run(tray.mean_recording(), more)
            if other.verdict.accepted or not mean.verdict.accepted:
                settings, mean = more, other
                continue
        rough, ratio = _odd_one(tray, found.roughness), _ODD if mean.verdict.accepted else 1.0
        out = _odd_one(tray, found.misfits, ratio) or _turned_one(tray, found, turned)
        if out in found.turns:
            turned[out] = found.turns[out]
        elif out is not None and out != rough:
            odd[out] = found.misfits[out]
        else:
            out = rough or _clearest(tray, found, settings.fixed)
            if out is not None:
                unlike.add(out)
            else:
                out = _farthest_one(tray, found, restored)
                if out is not None:
                    odd[out] = found.misfits[out]
        if out is not None:
            tray.take_out(out)
        elif back := _blameless(tray, found, turned, odd) - restored:
            restored |= back
            for name in back:
                tray.put_back(name)
                turned.pop(name, None)
                odd.pop(name, None)
        else:
            break
        mean = run(tray.mean_recording(), settings)
    odd |= {name: found.misfits[name] for name in unlike if found.misfits.get(name, 0.0) > _CLEAR}
    odd = {name: found.misfits.get(name, own) for name, own in odd.items()}
    return _outcome(tray, mean, found, turned, odd, settings.fixed, executor)


def _without_farthest(tray: _Tray, run: Callable[[Recording], Outcome], error: KreiselError) -> tuple[str, Outcome]:
    """Return the unit farthest from the mean, and the mean's calibration without it; that with it cannot be used.

    Raises
    ------
    KreiselError
        That with the unit, if it cannot be used without it, either.
    """
    out = tray.farthest()
    if out is None:
        raise error
    tray.take_out(out)
    try:
        return out, run(tray.mean_recording())
    except KreiselError:
        raise error from None


def _together(read: _Kept, names: Sequence[str], progress: Progress | None, executor: Executor) -> _Tray:
    """Return the tray, brought to the readings of the first unit with which another one moves.

    Raises
    ------
    KreiselError
        That of the first unit, if none of a few does.
    """
    errors: list[KreiselError] = []
    for k in range(max(1, min(BASES, len(names) - 1))):
        try:
            tray = _Tray.of(read, [*names[k:], *names[:k]], progress, executor)
        except KreiselError as error:
            errors.append(error)
            continue
        longest = max(tray.units, key=tray.seconds)  # what the base unit did not see counts for none
        if float(tray.base.imu.seconds[-1]) >= _WHOLE * tray.seconds(longest):
            return tray
        return _Tray.of(read, [longest, *(name for name in names if name != longest)], progress, executor)
    raise errors[0]


def _with_shown(settings: CalibrationSettings, fits: Iterable[UnitFit]) -> CalibrationSettings | None:
    """Return settings that estimate the effects that units show and may have; None if there are no others."""
    shown = {group for fit in fits for group in _not_fixed(fit, settings.fixed)}
    order = max(settings.polynomial_order, 2 if any(group.endswith("polynomial") for group in shown) else 1)
    estimated = [group for group in BY_CHOICE if group in shown and group not in settings.estimated]
    if order == settings.polynomial_order and not estimated:
        return None
    return replace(settings, polynomial_order=order, estimated=(*settings.estimated, *estimated))


def _clearest(tray: _Tray, found: _Fitted, fixed: Collection[str]) -> str | None:
    """Return the unit of the mean that shows an effect most clearly; the others show what of it is in the mean."""
    weights = {
        name: max(_not_fixed(found.fits[name], fixed).values(), default=0.0)
        for name in tray.in_mean
        if name in found.fits
    }
    best = max(weights, key=lambda name: weights[name], default=None)
    return best if best is not None and len(weights) >= MIN_UNITS and weights[best] > 0.0 else None


def _not_fixed(fit: UnitFit, fixed: Collection[str]) -> dict[str, float]:
    """Return the effects that a unit shows and that may be estimated, with their weights."""
    return {group: weight for group, weight in fit.shown.items() if group not in fixed}


def _odd_one(tray: _Tray, misfits: Mapping[str, float], ratio: float = _ODD) -> str | None:
    """Return the unit that the mean is better without, by misfits: the one that fits worst.

    ratio: by how much more than the others at least.
    """
    rest = {name: misfits[name] for name in tray.in_mean if name in misfits}
    if len(rest) < MIN_UNITS:
        return None
    worst = max(rest, key=lambda name: rest[name])
    others = float(np.median([own for name, own in rest.items() if name != worst]))
    return worst if rest[worst] > max(_MISFIT, ratio * others) else None


def _farthest_one(tray: _Tray, found: _Fitted, restored: Collection[str]) -> str | None:
    """Return the unit farthest from the mean if no unit fits it, for then one of them spoils the motion of all.

    Which one it is does not show in fits to that motion. One that was put back is not taken out again.
    """
    if min((found.misfits.get(name, np.inf) for name in tray.in_mean), default=0.0) <= _MISFIT:
        return None
    out = tray.farthest()
    return None if out in restored or out not in found.misfits else out


def _blameless(tray: _Tray, found: _Fitted, turned: Mapping[str, Turn], odd: Mapping[str, float]) -> set[str]:
    """Return units that were taken out and fit the others' motion: a worse one was in the mean they were judged by."""
    usual = float(np.median([found.misfits[name] for name in tray.in_mean if name in found.misfits] or [np.inf]))
    out = {name for name in {*turned, *odd} if name in found.fits and np.isfinite(odd.get(name, 0.0))}
    return {name for name in out if name not in found.turns and found.misfits[name] <= max(_MISFIT, _ODD * usual)}


def _turned_one(tray: _Tray, found: _Fitted, turned: Mapping[str, Turn]) -> str | None:
    """Return the unit that turned on its mount most clearly, if the others show that it was this one."""
    if sum(name in found.misfits for name in tray.in_mean) < MIN_UNITS:
        return None
    turns = {name: turn.weight for name, turn in found.turns.items() if name not in turned and name in tray.in_mean}
    return max(turns, key=lambda name: turns[name], default=None)


def check_settings(settings: CalibrationSettings) -> None:
    """Check that the units of a tray can be calibrated with settings.

    Raises
    ------
    SettingsError
        If these are for one IMU only.
    """
    if settings.size_effect is not SizeEffect.COMPLETED:
        raise SettingsError("several IMUs are calibrated with the completed size effect; leave out --size-effect")
    if settings.only is not None or settings.use is not None:
        raise SettingsError("--only and --use are for one IMU; choose it with --imu")
    fixed = [group for group in _NEEDED if group in settings.fixed]
    if fixed:
        raise SettingsError(f"--fix {fixed[0]} is for one IMU; choose it with --imu")


class _Kept:
    """Recordings of units, read again where not all have room in memory."""

    def __init__(self, read: Callable[[str], Recording]) -> None:
        self._read, self._size = read, 0
        self._kept: dict[str, Recording] = {}

    def __call__(self, name: str) -> Recording:
        if name in self._kept:
            return self._kept[name]
        recording = self._read(name)
        size = recording.imu.rates.nbytes + recording.imu.accelerations.nbytes + recording.imu.stamps_ns.nbytes
        if self._size + size <= _ROOM:
            self._kept[name] = recording
            self._size += size
        return recording


class _Tray:
    """The units of a tray that can be used, how each is brought to the first one's readings, and their mean."""

    def __init__(
        self, read: _Kept, base: Recording, units: dict[str, Aligned], left_out: dict[str, str], mean: MeanImu
    ) -> None:
        self.recording, self.base, self.units, self.left_out, self._mean = read, base, units, left_out, mean
        self.in_mean = set(units)
        usual = float(np.median([unit.share for unit in units.values()]))
        for name, unit in units.items():
            if unit.share < _WHOLE * usual and len(self.in_mean) > 1:
                self.take_out(name)

    @classmethod
    def of(cls, read: _Kept, names: Sequence[str], progress: Progress | None, executor: Executor) -> _Tray:
        """Return the tray; units that cannot be used are left out with the reason."""
        base = read(names[0])
        times = base.imu.seconds
        mean = MeanImu(times)
        units: dict[str, Aligned] = {}
        left_out: dict[str, str] = {}
        own = resampled(base.imu, Clock(0.0), times)
        rows = BaseRows.of(own, times)
        seen: dict[int, str] = {}
        for group in _groups(names):
            if progress is not None:
                progress("bring units together", names.index(group[0]) / len(names))
            for name, found in zip(
                group, executor([partial(_brought, read, names[0], (own, rows), name) for name in group]), strict=True
            ):
                if isinstance(found, str):
                    left_out[name] = found
                    continue
                of_readings = hash(read(name).imu.rates.tobytes())
                other = seen.setdefault(of_readings, name)
                if other != name:
                    left_out[name] = COPY.format(other=other)
                    continue
                units[name], readings = found
                mean.add(units[name], readings)
        if len(units) < 2:
            raise RecordingError(
                f"no other IMU moves with {names[0]}: {in_words(left_out)}; choose one with --imu", file=base.path
            )
        return cls(read, base, units, left_out, mean)

    def seconds(self, name: str) -> float:
        """Return the length of a unit's readings on the clock of the base unit, s."""
        return (1.0 + self.units[name].clock.skew) * float(self.recording(name).imu.seconds[-1])

    def readings(self, name: str) -> Resampled:
        """Return a unit's readings at the base unit's times."""
        return resampled(self.recording(name).imu, self.units[name].clock, self.base.imu.seconds, smooth=True)

    def take_out(self, name: str) -> None:
        """Take a unit out of the mean."""
        self._mean.add(self.units[name], self.readings(name), -1.0)
        self.in_mean.discard(name)

    def put_back(self, name: str) -> None:
        """Put a unit that was taken out back into the mean."""
        self._mean.add(self.units[name], self.readings(name))
        self.in_mean.add(name)

    def farthest(self) -> str | None:
        """Return the unit whose rates, brought to the mean's axes, differ most from it over their noise; None of two.

        Rates are the same wherever a unit stands on the tray, and clocks are found by them.
        """
        names = sorted(self.in_mean)
        if len(names) < MIN_UNITS:
            return None
        mean = self.mean_recording().imu
        at = np.searchsorted(self.base.imu.stamps_ns, mean.stamps_ns)

        def distance(name: str) -> float:
            unit = self.units[name]
            rates, _ = unit.brought(self.readings(name))
            return float(np.sqrt(np.mean((rates[at] - mean.rates) ** 2)) / unit.noise[0])

        return max(names, key=distance)

    def mean_recording(self) -> Recording:
        """Return the recording of the mean."""
        return self._mean.recording(self.base)

    @property
    def gain(self) -> Array:
        """See `TrayOutcome.gain`."""
        return self._mean.gain

    def shares(self) -> dict[str, Array]:
        """Return the share of each unit in the mean; those that were taken out have none."""
        names = sorted(self.in_mean)
        shares = dict(zip(names, gains_of([self.units[name] for name in names]), strict=True))
        return {name: shares.get(name, np.zeros(2)) for name in self.units}


@dataclass(frozen=True)
class _Fitted:
    """Fits of all units that can be fitted, which turned on their mounts, and how far differences exceed the noise.

    `misfits` are without rows that are far off, `roughness` with them.
    """

    fits: dict[str, UnitFit]
    turns: dict[str, Turn]
    failed: dict[str, str]
    misfits: dict[str, float]
    roughness: dict[str, float]


def _fitted(tray: _Tray, mean: Outcome, progress: Progress | None, executor: Executor) -> _Fitted:
    """Return the fits of all units by the mean's motion."""
    imu, calibration = mean.preparation.recording.imu, mean.calibration
    warmth = imu.temperature_difference
    raw = Block(imu.seconds, imu.rates, imu.accelerations, warmth)
    common = Common.of(raw, calibration.sensors, *mover_of(calibration))
    sizes = _sizes(calibration)
    # the mean's seconds may be those of the reference, or begin later
    own = tray.base.imu
    shift = 1e-9 * float(int(imu.stamps_ns[0]) - int(own.stamps_ns[0]))
    scale = float(imu.seconds[-1]) / (1e-9 * float(int(imu.stamps_ns[-1]) - int(imu.stamps_ns[0])))
    fits: dict[str, UnitFit] = {}
    failed: dict[str, str] = {}

    def fitted(name: str) -> UnitFit | str:
        unit = tray.units[name]
        clock = Clock((unit.clock.start - shift) * scale, (1.0 + unit.clock.skew) * scale - 1.0)
        try:
            start = _start(calibration.sensors, unit)
            return fit_unit(tray.recording(name).imu, clock, common, start, sizes, imu.usual_temperature)
        except KreiselError as error:
            return reason_of(error)

    names = list(tray.units)
    for group in _groups(names):
        if progress is not None:
            progress("fit units", names.index(group[0]) / len(names))
        for name, found in zip(group, executor([partial(fitted, name) for name in group]), strict=True):
            if isinstance(found, str):
                failed[name] = found
            else:
                fits[name] = found
    usual = {name: tray.units[name].noise[:, None] / np.sqrt(common.mean.row) for name in fits}
    misfits = {name: _over(fit.noise, usual[name]) * float(np.median(fit.excess)) for name, fit in fits.items()}
    least = _SHARE_OF_TURN * 6.0 * common.mean.seconds.size
    turns = {
        name: fit.turn
        for name, fit in fits.items()
        if fit.turn is not None and (misfits[name] <= _MISFIT or fit.turn.weight > least)
    }
    roughness = {name: _over(fit.rough, usual[name]) for name, fit in fits.items()}
    return _Fitted(fits, turns, failed, misfits, roughness)


def _over(noise: Array, usual: Array) -> float:
    """Return by how much differences from the common motion (2, 3) exceed what a unit's noise explains."""
    return float(np.sqrt(np.mean((noise / usual) ** 2)))


def _groups(names: Sequence[str]) -> Iterator[Sequence[str]]:
    """Return names in groups whose readings have room at the same time."""
    return (names[k : k + _TOGETHER] for k in range(0, len(names), _TOGETHER))


def _brought(
    read: _Kept, first: str, of_base: tuple[Resampled, BaseRows], name: str
) -> tuple[Aligned, Resampled] | str:
    """Return how a unit is brought to the base unit's readings, and those that are; or why it cannot be.

    Raises
    ------
    KreiselError
        For the base unit itself.
    """
    base, alone = read(first).imu, name == first
    try:
        imu = base if alone else read(name).imu
        clock = Clock(0.0) if alone else clock_of(imu, base, first)
        readings = of_base[0] if alone else resampled(imu, clock, base.seconds, smooth=True)
        return align(name, imu, clock, readings, of_base[1]), readings
    except KreiselError as error:
        if alone:
            raise
        return reason_of(error)


def _sizes(calibration: Calibration) -> dict[str, int]:
    """Return the effects that were estimated of the mean, and their numbers of parameters."""
    values = calibration.sensors.effects
    return {
        group: np.asarray(values[group]).size
        for group in EFFECTS
        if group in values and group not in PASSING_GROUPS and np.any(values[group])
    }


def _start(mean: SensorParameters, aligned: Aligned) -> SensorParameters:
    """Return start values of a unit's parameters, by those of the mean and how it is brought to it."""
    C_w, C_a = aligned.gyro, aligned.accel
    k_w, k_a = mean.k_w.copy(), mean.k_a.copy()
    k_w[0] = np.linalg.solve(C_w[:, :3], mean.k_w[0] + C_w[:, 3])
    k_a[0] = np.linalg.solve(C_a[:, :3], mean.k_a[0] + C_a[:, 3])
    others = {group: value for group, value in mean.others.items() if group not in PASSING_GROUPS}
    return SensorParameters(mean.K_omega @ C_w[:, :3], k_w, mean.K_a @ C_a[:, :3], k_a, mean.lever_arms.copy(), others)


def _outcome(
    tray: _Tray,
    mean: Outcome,
    found: _Fitted,
    turned: dict[str, Turn],
    odd: dict[str, float],
    fixed: Collection[str],
    executor: Executor,
) -> TrayOutcome:
    """Return calibrations and relative poses of all units.

    Raises
    ------
    RecordingError
        If the parameters of no unit can be estimated.
    """
    if not found.fits:
        raise RecordingError(f"no unit can be calibrated: {in_words(found.failed)}", file=tray.base.path)
    prepared = mean.preparation.recording.imu
    seconds = float(prepared.seconds[-1])
    clock, shares = mean.estimate.run.parameters.clock, tray.shares()
    turns = turned | found.turns  # those of the last fit are against a mean without them

    def concluded(name: str) -> UnitOutcome:
        fit, own, turn = found.fits[name], tray.recording(name), turns.get(name)
        spread = spread_of(fit, mean.calibration, seconds)
        share = fit.far / seconds
        shown = _not_fixed(fit, fixed)
        of_unit = UnitFindings(turn, name in turned, odd.get(name), share, shown, fit.sensors)
        verdict = unit_verdict(mean.verdict, of_unit)
        far = (*_far(fit, seconds), *_bent(fit))
        calibration = unit_calibration(fit, mean.calibration, own, spread, verdict, (*own.warnings, *far), clock)
        return UnitOutcome(name, calibration, fit, shares[name], turn, far)

    groups = _groups(list(found.fits))
    units = [unit for group in groups for unit in executor([partial(concluded, name) for name in group])]
    left_out = tuple((tray.left_out | found.failed).items())
    joint = covariance_of_units(mean.calibration, units)
    poses, covariance = places_of_units(units, joint)
    return TrayOutcome(tray.base, mean, tuple(units), left_out, poses, covariance, tray.gain, joint)


def _far(fit: UnitFit, seconds: float) -> tuple[DataWarning, ...]:
    """Return the warning about readings that differ from the motion of the other units for some time."""
    if fit.far <= _HARDLY * seconds:
        return ()
    said = f"its readings differ grossly from the motion of the other units for {fit.far:.2g} s; these are not used"
    return (DataWarning("unit", said),)


def _bent(fit: UnitFit) -> tuple[DataWarning, ...]:
    """Return the warning about a mount that bends."""
    if not fit.bending.any():
        return ()
    most = np.unravel_index(int(np.argmax(np.abs(fit.bending))), fit.bending.shape)
    size, sd = (1e3 * STANDARD_GRAVITY * values[most] for values in (np.abs(fit.bending), fit.bending_sd))
    said = (
        f"its mount bends by up to {size:.2g} ± {sd:.1g} mrad/g against the mean of the units; its parameters are "
        "those at the mean force"
    )
    return (DataWarning("unit", said),)
