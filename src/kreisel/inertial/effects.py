"""Effects of sensors beyond offset and matrix: what each adds to the raw readings, as a function of them.

An effect is linear in its parameters. What it adds to the reading of an axis is the sum of features of the raw readings
times those of its parameters that `places` names. The filter estimates the parameters by the same description, and
`effect_formulas` writes it in other languages; nothing else in the program has to know an effect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Literal

import numpy as np

from kreisel.geometry.rotation import Array, Indices

Sensor = Literal["gyroscope", "accelerometer"]


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

    def of(self, sensor: Sensor) -> Array:
        """Return the readings of a sensor, (n, 3)."""
        return self.rates if sensor == "gyroscope" else self.accelerations

    def slopes(self, sensor: Sensor) -> Array:
        """Return the time derivative of a sensor's readings, (n, 3)."""
        if sensor not in self._slopes:
            self._slopes[sensor] = self.derivative(self.of(sensor))
        return self._slopes[sensor]

    def curvatures(self, sensor: Sensor) -> Array:
        """Return the second time derivative of a sensor's readings, (n, 3)."""
        if sensor not in self._curvatures:
            self._curvatures[sensor] = self.second_derivative(self.of(sensor))
        return self._curvatures[sensor]

    @cached_property
    def _slopes(self) -> dict[Sensor, Array]:
        return {}

    @cached_property
    def _curvatures(self) -> dict[Sensor, Array]:
        return {}


class Factor(Enum):
    """A quantity by which an effect multiplies a parameter; those of `scalar` are common to the axes."""

    READING = "the sensor's own reading"
    MAGNITUDE = "absolute value of the sensor's own reading"
    FORCE = "reading of the accelerometers"
    SLOPE = "derivative of the sensor's own reading"
    CURVATURE = "negative second derivative of the sensor's own reading"
    TEMPERATURE = "temperature difference"

    @property
    def scalar(self) -> bool:
        """Whether it is one number for all axes."""
        return self is Factor.TEMPERATURE

    def of(self, raw: RawReadings, sensor: Sensor) -> Array:
        """Return its values (3, n), or (1, n) where it is common to the axes, for an effect of a sensor."""
        values: dict[Factor, Callable[[], Array]] = {
            Factor.READING: lambda: raw.of(sensor).T,
            Factor.MAGNITUDE: lambda: np.abs(raw.of(sensor).T),
            Factor.FORCE: lambda: raw.accelerations.T,
            Factor.SLOPE: lambda: raw.slopes(sensor).T,
            Factor.CURVATURE: lambda: -raw.curvatures(sensor).T,
            Factor.TEMPERATURE: lambda: raw.temperature_difference[None],
        }
        return values[self]()


class Arrangement(Enum):
    """How the parameters of an effect belong to the axes."""

    EACH_AXIS = "one for each axis"
    ALL_AXES = "one for all axes"
    MATRIX = "a matrix, row by row"


@dataclass(frozen=True)
class SensorEffect:
    """One effect: a sum of parameters times a product of factors.

    Attributes
    ----------
    sensor
        Whose readings it changes.
    factors
        What each parameter is multiplied by; a factor that occurs twice is squared. None: the parameter is added as it
        is.
    arrangement
        Of the parameters among the axes.
    powers
        Whether three parameters follow for each further power of the reading, from the second on.
    """

    sensor: Sensor
    factors: tuple[Factor, ...] = ()
    arrangement: Arrangement = Arrangement.EACH_AXIS
    powers: bool = False

    def products(self, count: int) -> list[tuple[Factor, ...]]:
        """Return the product of factors for each set of parameters (all, or three of each power); count: parameters."""
        if not self.powers:
            return [self.factors]
        return [self.factors * (2 + i) for i in range(count // 3)]

    @property
    def scalar(self) -> bool:
        """Whether its features are the same for all axes."""
        return all(factor.scalar for factor in self.factors)

    def features(self, raw: RawReadings, count: int) -> Array:
        """Return what the parameters are multiplied by, (E, n); count: number of parameters."""
        return np.concatenate([_product(factors, raw, self.sensor) for factors in self.products(count)])

    def places(self, count: int) -> Indices:
        """Return which parameter each feature is multiplied by in each axis, -1 for none, (E, 3); count: parameters."""
        if self.arrangement is Arrangement.MATRIX:
            return np.arange(count).reshape(3, 3).T
        if self.arrangement is Arrangement.ALL_AXES:
            return np.where(np.eye(3, dtype=bool), 0, -1)
        if self.scalar:
            return np.arange(count).reshape(1, 3)
        out = np.full((count, 3), -1)
        out[np.arange(count), np.arange(count) % 3] = np.arange(count)
        return out

    def by_parameter(self, columns: Array, count: int) -> Array:
        """Return derivatives (m, 3, count) by the parameters, from those by what each feature adds, (m, E, 3, 3).

        Those are by the readings of the three axes, in columns; count: number of parameters.
        """
        out = np.zeros((len(columns), 3, count))
        for feature, row in enumerate(self.places(count)):
            for axis in np.flatnonzero(row >= 0):
                out[:, :, row[axis]] += columns[:, feature, :, axis]
        return out


def _product(factors: tuple[Factor, ...], raw: RawReadings, sensor: Sensor) -> Array:
    """Return a product of factors, (3, n) or (1, n)."""
    out = np.ones((1, raw.stamps.size))
    values = {factor: factor.of(raw, sensor) for factor in dict.fromkeys(factors)}
    for i, factor in enumerate(factors):
        out = values[factor] if i == 0 else out * values[factor]
    return out


EFFECTS: dict[str, SensorEffect] = {
    "gyro_polynomial": SensorEffect("gyroscope", (Factor.READING,), powers=True),
    "gyro_g_sensitivity": SensorEffect("gyroscope", (Factor.FORCE,), Arrangement.MATRIX),
    "gyro_g_squared": SensorEffect("gyroscope", (Factor.FORCE, Factor.FORCE), Arrangement.MATRIX),
    "gyro_asymmetry": SensorEffect("gyroscope", (Factor.MAGNITUDE,)),
    "gyro_cubic": SensorEffect("gyroscope", (Factor.READING,) * 3),
    "gyro_axis_delay": SensorEffect("gyroscope", (Factor.SLOPE,)),
    "gyro_axis_smoothing": SensorEffect("gyroscope", (Factor.CURVATURE,)),
    "gyro_temperature": SensorEffect("gyroscope", (Factor.TEMPERATURE,)),
    "gyro_scale_temperature": SensorEffect("gyroscope", (Factor.READING, Factor.TEMPERATURE)),
    "gyro_gauss_markov": SensorEffect("gyroscope"),
    "accel_polynomial": SensorEffect("accelerometer", (Factor.READING,), powers=True),
    "accel_asymmetry": SensorEffect("accelerometer", (Factor.MAGNITUDE,)),
    "accel_cubic": SensorEffect("accelerometer", (Factor.READING,) * 3),
    "accel_delay": SensorEffect("accelerometer", (Factor.SLOPE,), Arrangement.ALL_AXES),
    "accel_smoothing": SensorEffect("accelerometer", (Factor.CURVATURE,), Arrangement.ALL_AXES),
    "accel_axis_delay": SensorEffect("accelerometer", (Factor.SLOPE,)),
    "accel_axis_smoothing": SensorEffect("accelerometer", (Factor.CURVATURE,)),
    "accel_temperature": SensorEffect("accelerometer", (Factor.TEMPERATURE,)),
    "accel_scale_temperature": SensorEffect("accelerometer", (Factor.READING, Factor.TEMPERATURE)),
    "accel_gauss_markov": SensorEffect("accelerometer"),
}
"""All effects, by the names of their groups of parameters."""


OF_TEMPERATURE = ("gyro_temperature", "gyro_scale_temperature", "accel_temperature", "accel_scale_temperature")
"""Effects of a recorded temperature."""

OF_CHANGE = ("gyro_axis_delay", "gyro_axis_smoothing")
"""Effects of the gyros by derivatives of their readings: a slope of corrected rates needs samples further away."""


def reaches_further(values: Mapping[str, Array]) -> bool:
    """Return whether any of the values of effects, by group, is one of `OF_CHANGE` other than zero."""
    return any(np.any(values.get(group, 0.0)) for group in OF_CHANGE)


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
