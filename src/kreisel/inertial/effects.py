"""Effects of sensors beyond offset and matrix: what each adds to the raw readings, as a function of them.

An effect is linear in its parameters. What it adds to the reading of an axis is the sum of features of the raw readings
times those of its parameters that `places` names. The filter estimates the parameters by the same description; nothing
else in the program has to know an effect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from kreisel.geometry.rotation import Array, Indices


@dataclass(frozen=True)
class RawReadings:
    """Raw readings and their derivatives.

    Attributes
    ----------
    stamps : (n,)
        Seconds, ascending.
    rates, accelerations : (n, 3)
        rad/s and m/s^2.
    derivative, second_derivative
        Return time derivatives of values (n, 3).
    temperature_difference : (n,)
        Temperature above that of the parameters, K; zero where it was not recorded.
    """

    stamps: Array
    rates: Array
    accelerations: Array
    derivative: Callable[[Array], Array]
    second_derivative: Callable[[Array], Array]
    temperature_difference: Array

    @cached_property
    def accel_slopes(self) -> Array:
        """Time derivative of the accelerometers' readings, (n, 3)."""
        return self.derivative(self.accelerations)

    @cached_property
    def accel_curvatures(self) -> Array:
        """Second time derivative of the accelerometers' readings, (n, 3)."""
        return self.second_derivative(self.accelerations)


@dataclass(frozen=True)
class SensorEffect:
    """One effect.

    Attributes
    ----------
    sensor
        Whose readings it changes.
    features
        Returns the features (E, n) of raw readings, for so many parameters.
    places
        Returns, for so many parameters, which of them each feature is multiplied by in each axis, -1 for none, (E, 3).
    """

    sensor: Literal["gyroscope", "accelerometer"]
    features: Callable[[RawReadings, int], Array]
    places: Callable[[int], Indices]


def _of_each_axis(count: int) -> Indices:
    """Return the places of features of one axis each, with parameters of their own: power by power, axis by axis."""
    out = np.full((count, 3), -1)
    out[np.arange(count), np.arange(count) % 3] = np.arange(count)
    return out


def _common(_count: int) -> Indices:
    """Return the places of three features, one for each axis, with a parameter that is common to all."""
    return np.where(np.eye(3, dtype=bool), 0, -1)


def _offset(count: int) -> Indices:
    """Return the places of one feature that enters each axis with a parameter of its own."""
    return np.arange(count).reshape(1, 3)


def _matrix(count: int) -> Indices:
    """Return the places of three features that enter all axes, through a matrix, row by row."""
    return np.arange(count).reshape(3, 3).T


def _powers(values: Array, count: int) -> Array:
    return np.concatenate([values.T ** (2 + i) for i in range(count // 3)])


def _one(raw: RawReadings, _count: int) -> Array:
    return np.ones((1, raw.stamps.size))


def _temperature_difference(raw: RawReadings, _count: int) -> Array:
    return raw.temperature_difference[None]


EFFECTS: dict[str, SensorEffect] = {
    "gyro_polynomial": SensorEffect("gyroscope", lambda raw, count: _powers(raw.rates, count), _of_each_axis),
    "gyro_g_sensitivity": SensorEffect("gyroscope", lambda raw, _: raw.accelerations.T, _matrix),
    "gyro_g_squared": SensorEffect("gyroscope", lambda raw, _: raw.accelerations.T**2, _matrix),
    "gyro_asymmetry": SensorEffect("gyroscope", lambda raw, _: np.abs(raw.rates.T), _of_each_axis),
    "gyro_temperature": SensorEffect("gyroscope", _temperature_difference, _offset),
    "gyro_scale_temperature": SensorEffect(
        "gyroscope", lambda raw, _: raw.rates.T * raw.temperature_difference, _of_each_axis
    ),
    "gyro_drift": SensorEffect("gyroscope", _one, _offset),
    "accel_polynomial": SensorEffect(
        "accelerometer", lambda raw, count: _powers(raw.accelerations, count), _of_each_axis
    ),
    "accel_asymmetry": SensorEffect("accelerometer", lambda raw, _: np.abs(raw.accelerations.T), _of_each_axis),
    "accel_delay": SensorEffect("accelerometer", lambda raw, _: raw.accel_slopes.T, _common),
    "accel_smoothing": SensorEffect("accelerometer", lambda raw, _: -raw.accel_curvatures.T, _common),
    "accel_temperature": SensorEffect("accelerometer", _temperature_difference, _offset),
    "accel_scale_temperature": SensorEffect(
        "accelerometer", lambda raw, _: raw.accelerations.T * raw.temperature_difference, _of_each_axis
    ),
    "accel_drift": SensorEffect("accelerometer", _one, _offset),
}
"""All effects, by the names of their groups of parameters."""


OF_TEMPERATURE = ("gyro_temperature", "gyro_scale_temperature", "accel_temperature", "accel_scale_temperature")
"""Effects of a recorded temperature."""


def follows_temperature(values: Mapping[str, Array]) -> bool:
    """Return whether any of the values of effects, by group, is a temperature coefficient other than zero."""
    return any(np.any(values.get(group, 0.0)) for group in OF_TEMPERATURE)


def groups_of(sizes: Mapping[str, int], sensor: str) -> Sequence[str]:
    """Return those of some groups that are effects of a sensor, in the order of `EFFECTS`."""
    return [g for g, effect in EFFECTS.items() if g in sizes and effect.sensor == sensor]


def features_of(raw: RawReadings, sizes: Mapping[str, int], sensor: str) -> Array:
    """Return the features (E, n) of a sensor's effects, group by group; sizes: numbers of parameters by group."""
    own = [EFFECTS[group].features(raw, sizes[group]) for group in groups_of(sizes, sensor)]
    return np.concatenate([np.zeros((0, raw.stamps.size)), *own])


def places_of(sizes: Mapping[str, int], sensor: str) -> Indices:
    """Return the places (E, 3) of a sensor's effects among all parameters of these, group by group."""
    out, before = [np.zeros((0, 3), dtype=np.int64)], 0
    for group in groups_of(sizes, sensor):
        places = EFFECTS[group].places(sizes[group])
        out.append(np.where(places < 0, -1, places + before))
        before += sizes[group]
    return np.ascontiguousarray(np.concatenate(out), dtype=np.int64)


def added(raw: RawReadings, values: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return what effects add to the raw rates and accelerations (n, 3) each, by the values of their groups.

    Notes
    -----
    The sums of equation (23).
    """
    out = {"gyroscope": np.zeros_like(raw.rates), "accelerometer": np.zeros_like(raw.accelerations)}
    for group, value in values.items():
        flat = np.asarray(value, dtype=float).ravel()
        if np.any(flat):
            effect = EFFECTS[group]
            places = effect.places(flat.size)
            out[effect.sensor] += effect.features(raw, flat.size).T @ np.where(places < 0, 0.0, flat[places])
    return out["gyroscope"], out["accelerometer"]
