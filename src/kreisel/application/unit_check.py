"""Whether readings are in the units that they are taken for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import lengths
from kreisel.inertial.counts import Counts
from kreisel.recording.header import NO_UNITS
from kreisel.recording.recording import ImuSamples
from kreisel.units import STANDARD_GRAVITY
from kreisel.validation.as_sampled import usual_step
from kreisel.validation.imu_checks import check_gravity, check_temperature

FASTEST = 40.0
"""rad/s; rates above it in a hundredth of the samples are in another unit, for gyros end at 35 (2000 deg/s)."""


SLOWEST_RATE, FASTEST_RATE = 1.0, 20e3
"""Samples a second of IMUs; stamps that say otherwise are in another unit."""

REMEDY = "; --force corrects them as they are"


def check_units(samples: ImuSamples, *, stated: bool, warm: bool = False, counts: Counts | None = None) -> None:
    """Raise an error for readings that are in other units than they are taken for.

    Parameters
    ----------
    counts
        What a count is, of a calibration of raw counts.
    stated
        Whether units must be stated: those of a table of another shape.
    warm
        Whether temperatures are used, and must be plausible.

    Raises
    ------
    RecordingError
        It says which unit fits, or is missing.
    """
    if stated:
        for quantity, entry, example in (
            ("rate", "imu.rate", "[deg/s] or [rad/s]"),
            ("acceleration", "imu.acceleration", "[g] or [m/s^2]"),
        ):
            if getattr(samples.units, quantity) is None:
                raise RecordingError(
                    f"the unit of {entry} is not stated: write it after the columns, {example}", file=samples.source
                )
    if counts is None:
        samples = replace(samples, units=NO_UNITS) if samples.units.counted("acceleration") else samples
    else:
        rates, accelerations = counts.in_si(samples.rates, samples.accelerations)
        length = float(np.median(lengths(accelerations)))
        if not 0.4 < length / STANDARD_GRAVITY < 2.5:
            raise RecordingError(
                f"the calibration is one of raw counts, by which these accelerations are {length:.3g} m/s^2: give the "
                f"counts{REMEDY}", file=samples.source,
            )  # fmt: skip
        samples = replace(samples, rates=rates, accelerations=accelerations, units=NO_UNITS)
    try:
        check_gravity(samples)
        if warm:
            check_temperature(samples)
    except RecordingError as error:
        raise RecordingError(error.message + REMEDY, file=error.file, line=error.line) from error
    if len(samples.stamps_ns) > 1:
        step = usual_step(samples.stamps_ns)
        rate = 1e9 / step if step > 0.0 else np.inf
        if not SLOWEST_RATE <= rate <= FASTEST_RATE:
            raise RecordingError(
                f"{rate:.4g} samples a second, expected {SLOWEST_RATE:g} to {FASTEST_RATE:g}: are the stamps in "
                f"nanoseconds? State their unit, as in #timestamp [us]{REMEDY}",
                file=samples.source,
            )
    check_rates(float(np.percentile(lengths(samples.rates), 99.0)), samples.source)


def check_rates(usual: float, source: Path) -> None:
    """Raise an error for rates, rad/s, that are usual and faster than a device turns.

    Raises
    ------
    RecordingError
        It says what else they may be.
    """
    if usual > FASTEST:
        raise RecordingError(
            f"rates of {usual:.4g} rad/s: are they in deg/s? State the unit in the header, or after the columns"
            + REMEDY,
            file=source,
        )
