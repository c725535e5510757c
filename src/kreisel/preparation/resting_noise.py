"""What the Allan deviation of a recording at rest shows, as an object, in words, and as a table for recording.toml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel.errors import RecordingError
from kreisel.inertial.allan import TERMS, NoiseFigures, density_and_walk, noise_figures, unrest, warms_up
from kreisel.inertial.lines import Line, without_lines
from kreisel.inertial.noise_figures import coarse_step
from kreisel.recording.recording import ImuSamples, Recording
from kreisel.units import DEG, MG
from kreisel.validation.imu_checks import check_quantities
from kreisel.validation.stamp_checks import LONG_GAP, gaps

SHORTEST = 20.0
"""Seconds at rest below which nothing is said. Chosen: a tenth of it is one octave of averaging times at 10 Hz."""

NAMES = {
    "quantisation": "quantisation",
    "density": "noise_density",
    "instability": "bias_instability",
    "walk": "random_walk",
    "ramp": "rate_ramp",
}
"""Of figures, in the JSON object."""

WORDS = {
    "quantisation": "quantisation",
    "density": "noise density",
    "instability": "bias instability",
    "walk": "random walk",
    "ramp": "rate ramp",
}

_HOUR = 3600.0
"""s."""

UNITS: dict[str, tuple[tuple[str, float], ...]] = {
    "gyroscope": (
        ("urad", 1e-6), ("deg/sqrt(h)", DEG / _HOUR**0.5), ("deg/h", DEG / _HOUR), ("deg/h/sqrt(h)", DEG / _HOUR**1.5),
        ("deg/h^2", DEG / _HOUR**2),
    ),
    "accelerometer": (
        ("um/s", 1e-6), ("ug/sqrt(Hz)", 1e-3 * MG), ("ug", 1e-3 * MG), ("ug/sqrt(s)", 1e-3 * MG), ("ug/s", 1e-3 * MG),
    ),
}  # fmt: skip
"""Of the figures as data sheets give them, in the order of `TERMS`, and in SI."""


@dataclass(frozen=True)
class AllanReport:
    """Figures of both sensors, and what to know about them.

    Attributes
    ----------
    figures
        By sensor.
    remarks
        Sentences: what the length cannot show, and axes that warm up.
    seconds
        Length of the recording.
    """

    figures: Mapping[str, NoiseFigures]
    remarks: tuple[str, ...]
    seconds: float


def allan_report(recording: Recording) -> AllanReport:
    """Return what readings at rest show.

    Raises
    ------
    RecordingError
        If they are too short, or move.
    """
    imu = recording.imu
    check_quantities(imu)
    seconds = float(imu.seconds[-1])
    if seconds < SHORTEST:
        raise RecordingError(
            f"lasts {seconds:.3g} s, expected {SHORTEST:.0f} s or more at rest, an hour if possible", file=imu.source
        )
    figures, remarks = {}, _gaps(imu)
    for sensor, values in (("gyroscope", imu.rates), ("accelerometer", imu.accelerations)):
        reason = unrest(values, imu.interval)
        if reason is not None:
            raise RecordingError(f"the readings of the {sensor} are not at rest: {reason}", file=imu.source)
        quiet, lines = without_lines(values, imu.interval)
        figures[sensor] = noise_figures(quiet, imu.interval)
        remarks += _remarks(sensor, figures[sensor], values) + _remarks_of_lines(sensor, lines)
        remarks += _remarks_of_steps(sensor, values)
    return AllanReport(figures, tuple(remarks), seconds)


def _gaps(imu: ImuSamples) -> list[str]:
    """Return the remark about readings that are missing."""
    missing = gaps(imu.stamps_ns, LONG_GAP)
    if missing.size == 0:
        return []
    lost = 1e-9 * float(np.sum(np.diff(imu.stamps_ns)[missing]))
    return [
        f"readings are missing at {missing.size} places, {lost:.3g} s in all: the parts are joined as if nothing were "
        "between them, and slow noise may come out too large"
    ]


def _remarks(sensor: str, found: NoiseFigures, values: np.ndarray) -> list[str]:
    dead = np.ptp(values, axis=0) == 0.0
    if dead.any():
        return [f"{sensor}: {_axes(dead)} never changes: it has no noise figures"] + (
            _remarks_of_noise(sensor, found, values, ~dead) if not dead.all() else []
        )
    return _remarks_of_noise(sensor, found, values, ~dead)


def _remarks_of_lines(sensor: str, lines: tuple[Line, ...]) -> list[str]:
    """Return the remark about vibrations, the largest of each axis."""
    unit = "rad/s" if sensor == "gyroscope" else "m/s^2"
    largest = {one.axis: one for one in sorted(lines, key=lambda one: one.size)}
    if not largest:
        return []
    each = [f"{'xyz'[i]} at {one.frequency:.4g} Hz ({one.size:.2g} {unit} rms)" for i, one in sorted(largest.items())]
    shown = ", ".join(each)
    return [f"{sensor}: vibration of {shown}: a line in the spectrum, not noise; the figures are those without it"]


def _remarks_of_steps(sensor: str, values: np.ndarray) -> list[str]:
    """Return the remark about readings in steps that are larger than their noise."""
    step = coarse_step(values)
    if step == 0.0:
        return []
    unit = "rad/s" if sensor == "gyroscope" else "m/s^2"
    return [
        f"{sensor}: readings are in steps of {step:.2g} {unit}, larger than their noise: the figures are those of the "
        "steps, which change with the value at rest; record with finer steps, or several rests"
    ]


def _remarks_of_noise(sensor: str, found: NoiseFigures, values: np.ndarray, alive: np.ndarray) -> list[str]:
    out = []
    if found.smoothed.any():
        used = float(found.shortest[found.smoothed].max())
        out.append(
            f"{sensor}: {_axes(found.smoothed)} has less noise in short averages than in long ones, as a filter or "
            f"interpolation leaves it: averages of {used:.2g} s and more count"
        )
    vague = alive & ~found.shown["density"]
    if vague.any():
        out.append(
            f"{sensor}: the noise density of {_axes(vague)} is hidden by other noise, as vibration, steps or slow "
            "changes are: record longer, and where nothing vibrates"
        )
    either = found.slow & ~np.logical_or.reduce([found.shown[term] for term in ("instability", "walk", "ramp")])
    if either.any():
        out.append(
            f"{sensor}: slow noise in {_axes(either)}, of a kind that {found.tau[-1]:.3g} s of averaging do not show: "
            "the random walk for a filter contains it; record longer at rest to see which it is"
        )
    fast = alive & ~either
    hidden = [WORDS[term] for term in ("instability", "walk") if not found.shown[term][fast].all()]
    if hidden:
        out.append(
            f"{sensor}: too short for {' and '.join(hidden)} of every axis: the longest averages are "
            f"{found.tau[-1]:.3g} s, and other noise is larger there; record longer at rest"
        )
    warm = warms_up(values)
    if warm.any():
        out.append(
            f"{sensor}: {_axes(warm)} changed from beginning to end, by far more than it varies at last: the unit "
            "warms up or its temperature changes; leave out the first hour, or two, and look again"
        )
    return out


def _axes(chosen: np.ndarray) -> str:
    return ", ".join(axis for axis, one in zip("xyz", chosen, strict=True) if one)


def document_of(found: AllanReport) -> dict[str, Any]:
    """Return the figures as an object; null where the length does not show one."""
    return {
        **{sensor: _table(figures) for sensor, figures in found.figures.items()},
        "filter": filter_figures(found),
        "seconds": found.seconds,
        "remarks": list(found.remarks),
    }


def _table(figures: NoiseFigures) -> dict[str, Any]:
    def numbers(values: np.ndarray, term: str) -> list[float | None]:
        return [float(v) if known else None for v, known in zip(values, figures.shown[term], strict=True)]

    return {
        **{NAMES[term]: numbers(getattr(figures, term), term) for term in TERMS},
        "standard_deviation": {NAMES[term]: numbers(figures.deviation[term], term) for term in TERMS},
        "averaging_times": figures.tau.tolist(),
        "allan_deviation": figures.curve.tolist(),
    }


def filter_figures(found: AllanReport) -> dict[str, float]:
    """Return what a filter takes, named as in [imu] of recording.toml, SI; what is not shown is left out."""
    names = {"density": "noise_density", "walk": "random_walk"}
    return {
        f"{name}_{names[what]}": value
        for sensor, name in (("gyroscope", "gyro"), ("accelerometer", "accel"))
        for what, value in density_and_walk(found.figures[sensor]).items()
    }
