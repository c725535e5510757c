"""Checks of an IMU's readings by themselves.

They find what makes a recording useless: numbers that are no readings, wrong units, dead and copied channels.
Single samples that show no motion are left out by `masking`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import combinations

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, Mask, lengths
from kreisel.recording.header import COLDEST, HOTTEST, UNITS
from kreisel.recording.location import at, header_fault, wrong_unit
from kreisel.recording.recording import DataWarning, ImuSamples, excerpt
from kreisel.units import STANDARD_GRAVITY
from kreisel.validation.finite_values import check_finite
from kreisel.validation.masking import CHANNELS, part_of, without_faults, without_repeats
from kreisel.validation.stamp_checks import runs

_SPIKED = 1e-3
"""Share of readings of a dead channel that may be spikes of the line. Chosen: one that works changes more often."""

_LOOKED_AT = 1000
"""Readings that show which one is usual. Chosen: spikes are one in a thousand at most."""


_SILENCED, _STEPS = 0.01, 3.0
"""Share of samples whose rates are all zero, and steps of the readings that others are larger than at least, where a
device sets them so. Chosen: rounding makes zeros of less than half a step."""

_NOISY = 0.5
"""Share of such samples in which the accelerations change, as by noise."""


def check_imu(imu: ImuSamples, *, moved: bool) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples without those that show no motion or repeat the one before, and the warnings about them.

    Parameters
    ----------
    moved
        Whether a reference was recorded with them. Without one the sensor may stand still, and a dead
        channel or a shock gives only a warning.

    Raises
    ------
    RecordingError
        For the first fault that would make results wrong.
    """
    check_temperature(imu)
    _check_filled(imu)
    check_gravity(imu)
    imu, warnings = _without_silenced(imu) if moved else (imu, [])
    with _as_warnings(warnings, moved=moved):
        check_dead(imu, moved=moved)
    with _as_warnings(warnings, moved=moved):
        _check_copies(imu)
    imu, masked = without_faults(imu, moved=moved)
    imu, repeated = without_repeats(imu)
    return imu, [*warnings, *masked, *repeated]


def silenced_samples(rates: Array) -> Mask:
    """Return which samples (n, 3) are rates that a device set to zero while they were small, (n,).

    Those that are zero by rounding have others beside them that are one step.
    """
    zero = (rates == 0.0).all(axis=1)
    if zero.all() or zero.mean() < _SILENCED:
        return np.zeros(zero.size, dtype=bool)
    sizes = np.unique(np.abs(rates[~zero]))
    step = np.diff(sizes).min(initial=np.inf)
    least = float(np.abs(rates[~zero]).max(axis=1).min())
    return zero if least > _STEPS * step else np.zeros(zero.size, dtype=bool)


def _without_silenced(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples without those whose rates the device set to zero: the offsets are not those of its motion."""
    zero = silenced_samples(imu.rates)
    changes = (np.diff(imu.accelerations, axis=0) != 0.0).any(axis=1)
    if not zero.any() or np.mean(changes[zero[1:]]) < _NOISY:  # readings without noise repeat at rest
        return imu, []
    begin, end = runs(zero)
    longest = 1e-9 * float(np.max(imu.stamps_ns[end - 1] - imu.stamps_ns[begin]))
    text = (
        f"{imu.source.parent.name}: all gyros read exactly 0 in {zero.mean():.0%} of the samples, for up to "
        f"{longest:.2g} s, first at {at(imu.source, imu.row_of(int(begin[0])))}: the device silences them at rest, "
        "which hides their offsets; these samples are not used"
    )
    return part_of(imu, ~zero), [DataWarning("silenced", text)]


def check_readings(imu: ImuSamples) -> None:
    """Raise an error for readings that are no numbers, or that no sensor gives."""
    for columns, names in ((imu.rates, CHANNELS[:3]), (imu.accelerations, CHANNELS[3:])):
        check_finite(columns, names, imu)


def check_temperature(imu: ImuSamples) -> None:
    """Raise an error for temperatures that no working sensor has; without a column there is nothing to check."""
    if imu.temperature is None:
        return
    check_finite(imu.temperature[:, None], ("temperature",), imu)
    low, high = float(imu.temperature.min()), float(imu.temperature.max())
    if not (low > COLDEST and high < HOTTEST):
        raise RecordingError(
            f"temperature from {low:.4g} to {high:.4g} degrees Celsius; name its unit in the header, "
            "[degC] or [K], or leave the column out",
            file=imu.source,
        )


@contextmanager
def _as_warnings(warnings: list[DataWarning], *, moved: bool) -> Iterator[None]:
    """Turn the error of a check into a warning where nothing was moved."""
    try:
        yield
    except RecordingError as error:
        if moved:
            raise
        warnings.append(DataWarning("imu", error.message))


def _check_filled(imu: ImuSamples) -> None:
    """Raise an error if all accelerations are zero: gravity is always measured."""
    if not imu.accelerations.any():
        raise RecordingError("all accelerations are zero: record the accelerometers too", file=imu.source)


def check_quantities(imu: ImuSamples) -> None:
    """Raise an error for raw converter readings, which say nothing in rad/s and m/s^2."""
    if imu.units.counted("rate") or imu.units.counted("acceleration"):
        raise header_fault(
            imu.source,
            "the readings are raw counts: `kreisel static` finds what a count is; convert them to rad/s and m/s^2 for "
            "anything else",
        )


_SHAKEN, _GENTLE = 150.0, 10.0
"""m/s^2; median length up to which accelerations may be those of a device that is shaken, and the percentile that is
much smaller then. Chosen: raw counts of a device at rest, or moved as usual, hardly vary."""


def check_gravity(imu: ImuSamples) -> None:
    """Raise an error if the accelerometers do not read about one g; it names the unit that would fit.

    Of raw counts nothing is known.
    """
    if imu.units.counted("acceleration"):
        return
    length = _usual_length(imu.accelerations)
    if 4.0 < length < 25.0:
        return
    if length < _SHAKEN and 4.0 < _usual_length(imu.accelerations, _GENTLE) < min(30.0, length / 1.5):
        return
    got = f"accelerations have a median length of {length:.4g}, expected {STANDARD_GRAVITY:.4g} m/s^2 or a little more"
    for unit in ("g", "mg", "m s^-2"):
        factor = UNITS["acceleration"][unit] / imu.units.size("acceleration")
        if factor != 1.0 and 0.6 * STANDARD_GRAVITY < length * factor < 1.6 * STANDARD_GRAVITY:
            raise wrong_unit(imu, got, "acceleration", factor)
    if length < 4.0 < _usual_length(imu.rates) < 25.0:
        advice = "the rates seem to be in their columns: put rates first, accelerations after them"
    elif length < 4.0:
        advice = "was gravity removed, or are the columns in another order? Raw readings are needed"
    else:
        advice = "are they raw counts? Convert them to m/s^2, or write [counts] for `kreisel static`"
    raise header_fault(imu.source, f"{got}; {advice}")


def _usual_length(vectors: Array, share: float = 50.0) -> float:
    """Return a percentile of the lengths."""
    return float(np.percentile(np.concatenate([lengths(part) for part in excerpt(vectors)]), share))


def _channels(imu: ImuSamples) -> list[Array]:
    return [*imu.rates.T, *imu.accelerations.T]


def check_dead(imu: ImuSamples, names: Sequence[str] = CHANNELS, *, moved: bool = True) -> None:
    """Raise an error if one of some channels never changes; of a sensor that was moved, apart from a few spikes."""
    spikes = _SPIKED * imu.stamps_ns.size if moved else 0.0
    columns = zip(CHANNELS, _channels(imu), strict=True)
    others = [(name, *_others(x)) for name, x in columns if name in names]
    dead = [(name, value, count) for name, value, count in others if count <= spikes]
    if dead:
        but = {0: "", 1: " but for one reading"}
        names = ", ".join(
            f"{name} (always {value:.4g}{but.get(count, f' but for {count} readings')})" for name, value, count in dead
        )
        raise RecordingError(
            f"dead channel: {names} never changes; check the sensor and the columns, and record again",
            file=imu.source,
        )


def _others(readings: Array) -> tuple[float, int]:
    """Return the usual reading of a channel, and how many are other than that."""
    some = readings[:: max(len(readings) // _LOOKED_AT, 1)]
    usual = float(np.partition(some, len(some) // 2)[len(some) // 2])
    return usual, int(np.count_nonzero(readings != usual))


def _check_copies(imu: ImuSamples) -> None:
    for (a, x), (b, y) in combinations(zip(CHANNELS, _channels(imu), strict=True), 2):
        if x[0] == y[0] and np.array_equal(x, y):
            raise header_fault(
                imu.source,
                f"{a} and {b} hold the same numbers in all rows; one column was written twice: "
                "check how the file was made, and record again",
            )
