"""Results of the units of a tray: each one's parameters with the uncertainty of the mean and its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from kreisel.array.unit_fit import UnitFit
from kreisel.calibration.data_sheet import derive
from kreisel.calibration.device_axes import NAMES, device_triads
from kreisel.calibration.recording_facts import recording_facts
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import Measured, Timing, Verdict
from kreisel.estimation.uncertainty_budget import Budget, Source
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.groups import group_named
from kreisel.model.parameters import SENSOR_GROUPS, CellParameters, parameter_names, sensor_fields
from kreisel.recording.recording import DataWarning, Recording
from kreisel.synchronization.clock import Clock

OWN = "the unit's own noise"
"""Cause of what a budget of a unit has beyond that of the mean."""

_CLOCK = {"timing.offset": ("clock.shift", "clock.stretch"), "timing.skew": ("clock.stretch",)}


@dataclass(frozen=True)
class Spread:
    """How uncertain a unit's parameters are.

    Attributes
    ----------
    by_mean : (n, n)
        What the parameters of the mean do to those of the unit, both as in the names of the result.
    own : (n, n)
        Covariance of what is the unit's own.
    """

    by_mean: Array
    own: Array


def spread_of(fit: UnitFit, mean: Calibration, seconds: float) -> Spread:
    """Return how uncertain a unit's parameters are; seconds: length of the recording."""
    place = {name: k for k, name in enumerate(fit.names)}
    n = len(mean.names)
    sensors = [k for k, name in enumerate(mean.names) if name in place]
    T, E = np.eye(n), np.zeros((n, len(fit.names)))
    for k in sensors:
        T[k] = 0.0
        T[k, sensors] = fit.by_motion[place[mean.names[k]]]
        E[k, place[mean.names[k]]] = 1.0
    half = 0.5 * seconds
    # the unit's seconds of a pose are those of the mean less what its clock gained
    gained = {"clock.shift": (-1.0, 0.0), "clock.stretch": (1.0, -1.0 / half)}
    for name, parts in _CLOCK.items():
        if name in mean.names:
            row = mean.names.index(name)
            for part in parts:
                share = gained[part][0 if name == "timing.offset" else 1]
                E[row, place[part]] = share
                T[row, sensors] += share * fit.by_motion[place[part]]
    return Spread(T, E @ fit.covariance @ E.T)


def unit_calibration(
    fit: UnitFit, mean: Calibration, own: Recording, spread: Spread, verdict: Verdict,
    warnings: tuple[DataWarning, ...], prepared_clock: Clock,
) -> Calibration:  # fmt: skip
    """Return the calibration of a unit.

    Parameters
    ----------
    mean
        The calibration of the mean of the tray.
    own
        The unit's recording.
    prepared_clock
        The reference's clock against the one the mean was calibrated on.
    """
    of_mean = spread.by_mean @ mean.covariance @ spread.by_mean.T
    covariance = of_mean + spread.own
    if "timing.offset" in mean.names:  # the mean's stamps are those of no unit
        row = mean.names.index("timing.offset")
        covariance[row, row] += own.imu.lateness**2
    deviation = dict(zip(mean.names, np.sqrt(np.maximum(np.diag(covariance), 0.0)), strict=True))
    sensors = fit.sensors
    sd = _sensor_deviations(sensors, deviation)
    estimated = [name for name in mean.names if group_is_sensor(name)]
    n = len(estimated)
    others = dict(mean.others)
    for group, value in sensors.others.items():
        path = group_named(group).path
        if path in others:
            others[path] = Measured(np.asarray(value), np.asarray(sd.others[group]))
    facts = recording_facts(own, warnings, "", 0)
    base = mean.recording
    if base is not None:
        facts = replace(
            facts, reference=base.reference, reference_poses=base.reference_poses, reference_kind=base.reference_kind,
            temperature_c=base.temperature_c if facts.temperature_c is not None else None,
        )  # fmt: skip
    return replace(
        mean,
        sensors=sensors,
        sensor_sd=sd,
        timing=_timing(fit, own, prepared_clock, deviation),
        derived=derive(sensors, covariance[:n, :n], _mover(sensors, mean.names[:n])),
        verdict=verdict,
        recording=facts,
        others=others,
        triads=device_triads(sensors, sd, mean.names, covariance),
        budget=_budget(mean, of_mean, spread.own),
        covariance=covariance,
        estimates=np.zeros((0, 1 + 2 * len(mean.names))),
        updates=None,
    )


def group_is_sensor(name: str) -> bool:
    """Return whether a parameter of this name is one of a sensor."""
    return name.startswith(("gyroscope.", "accelerometer."))


def _names_of(group: str, sensors: SensorParameters) -> tuple[str, ...]:
    order = len(sensors.k_w if group.startswith("gyro") else sensors.k_a)
    return parameter_names(group, order)


def _stored(sensors: SensorParameters) -> dict[str, Array]:
    cell = CellParameters(sensors, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(2), 0.0, 0.0, 0.0)
    return {group: cell.stored(group) for group in SENSOR_GROUPS}


def _as_sensors(stored: Mapping[str, Array], like: SensorParameters) -> SensorParameters:
    return replace(sensor_fields(stored), others={group: stored[group] for group in like.others})


def _sensor_deviations(sensors: SensorParameters, deviation: Mapping[str, float]) -> SensorParameters:
    """Return deviations in the fields of the parameters; zero for what was not estimated."""
    stored = {
        group: np.array([deviation.get(name, 0.0) for name in _names_of(group, sensors)]) for group in SENSOR_GROUPS
    }
    return _as_sensors(stored, sensors)


def _mover(sensors: SensorParameters, names: tuple[str, ...]) -> Callable[[Array], SensorParameters]:
    """Return a function that returns parameters moved by changes of the named ones."""
    stored = _stored(sensors)
    place = {name: k for k, name in enumerate(names)}
    groups = {
        group: np.array([place.get(name, len(names)) for name in _names_of(group, sensors)], dtype=np.int64)
        for group in SENSOR_GROUPS
    }

    def moved(change: Array) -> SensorParameters:
        padded = np.append(change, 0.0)
        return _as_sensors({group: stored[group] + padded[own] for group, own in groups.items()}, sensors)

    return moved


def mover_of(calibration: Calibration) -> tuple[Callable[[Array], SensorParameters], int]:
    """Return what moves a calibration's sensors by changes of its first parameters, and how many these are."""
    names = tuple(name for name in calibration.names if group_is_sensor(name))
    return _mover(calibration.sensors, names), len(names)


def _timing(fit: UnitFit, own: Recording, prepared: Clock, deviation: Mapping[str, float]) -> Timing:
    """Return how the unit's clock relates to the reference's."""
    start = (prepared.start - fit.clock.start) / (1.0 + fit.clock.skew)
    skew = (1.0 + prepared.skew) / (1.0 + fit.clock.skew) - 1.0
    reference = own.reference
    first = 0 if reference is None else int(reference.stamps_ns[0])
    offset = Clock(start).offset(int(own.imu.stamps_ns[0]), first)
    return Timing(offset, skew, deviation.get("timing.offset"), deviation.get("timing.skew") or fit.clock.skew_sd)


def _budget(mean: Calibration, of_mean: Array, own: Array) -> Budget | None:
    """Return the mean's budget of uncertainty with the unit's own noise."""
    whole = mean.budget
    if whole is None:
        return None
    variance = np.column_stack([whole.shares * np.diag(of_mean)[:, None], np.diag(own)])
    return Budget.of(mean.names, {**whole.causes, OWN: Source.SENSOR}, np.maximum(variance, 0.0))


def own_covariance(fit: UnitFit) -> tuple[Array, Array]:
    """Return covariance (33, 33) of `NAMES` that is the unit's own, and what the mean's parameters do to them."""
    place = {name: k for k, name in enumerate(fit.names)}
    rows = [place[name] for name in NAMES]
    return fit.covariance[np.ix_(rows, rows)], fit.by_motion[rows]
