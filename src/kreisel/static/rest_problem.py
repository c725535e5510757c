"""What is estimated from standstills, what is known before, and what was measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, Self

import numpy as np

from kreisel.estimation.state import Part, StateLayout
from kreisel.geometry.rotation import Array, Indices
from kreisel.inertial.effects import EFFECTS, RawReadings
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.inertial.strapdown import raw_readings
from kreisel.model.groups import group_named
from kreisel.model.layout import group_part
from kreisel.model.parameters import GROUPS, SENSOR_GROUPS, CellParameters, parameter_names
from kreisel.model.site import Site
from kreisel.recording.recording import ImuSamples
from kreisel.static.rest_chain import Equations
from kreisel.static.rests import Rests

BELOW_DIAGONAL = ("accelerometer.cross_coupling[1,0]", "accelerometer.cross_coupling[2,0]",
                  "accelerometer.cross_coupling[2,1]")  # fmt: skip
"""Zero in the frame of the accelerometers: z along their sensitive axis z, y in the plane of those of y and z."""

_ALWAYS = (
    "gyro_cross_coupling",
    "gyro_offset",
    "accel_cross_coupling",
    "accel_offset",
    "north",
    "earth_down",
    "gravity",
)

_WIDTHS = {"gyro_cross_coupling": 1.0, "gyro_offset": 1.0, "accel_cross_coupling": 1.0, "accel_offset": 10.0,
           "north": 0.7, "earth_down": 3**-0.5, "gyro_polynomial": 1e-3, "accel_polynomial": 3e-4,
           "accel_asymmetry": 2e-3, "gyro_cubic": 2e-4, "gyro_axis_smoothing": 3e-4}  # fmt: skip
"""SI: deviations before any look at the data. Chosen: of the sensors' usual parameters nothing is assumed; the Earth's
rotation is of its size, in any direction; terms of second and third degree are 0.5 % at 5 rad/s and 2 g, as data sheets
of consumer devices say, and scale factors of accelerometers that differ with the sign about as large, so that neither
stands in for the other; smoothing is that of a filter of 7 Hz."""


@dataclass(frozen=True)
class Nuisance:
    """Parameters that only some knowledge brings, zero at first, and no part of the result.

    Attributes
    ----------
    name, labels
        Of the group, and of each parameter.
    width : (n,)
        Deviations before any look at the data, SI.
    """

    name: str
    labels: tuple[str, ...]
    width: Array


class Knowledge(Protocol):
    """What is known of the attitudes besides gravity and the turns by the gyros."""

    @property
    def kind(self) -> str:
        """Name of its equations, and of the noise figure that belongs to them."""

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Parameters it brings."""

    @property
    def gives_heading(self) -> bool:
        """Whether the heading of the first standstill is no choice any more."""

    @property
    def white(self) -> Array:
        """Variances of its rows, (k, 3), that are known."""

    @property
    def share(self) -> Array:
        """What a unit of its noise figure adds to them, (k, 3)."""

    @property
    def usual(self) -> float | None:
        """Its noise figure as it usually is, by hand, within a factor of three; None where nothing is known of it."""

    def equations(self, problem: RestProblem, p: CellParameters, C: Array, /) -> Equations:
        """Return the equations about parameters and attitudes C (M, 3, 3)."""

    def part(self, keep: Indices) -> Self:
        """Return what concerns some standstills in a row."""


@dataclass(frozen=True)
class RestProblem:
    """A problem of standstills and the turns between them.

    Attributes
    ----------
    imu, raw
        Readings, and what effects of sensors are made of.
    rests
        Standstills.
    site
        Gravity and the Earth's rotation.
    effects
        Effects of sensors that are estimated. That of gravity on the gyros always is: where the device is tilted
        little, nothing distinguishes it from their offsets, however small it is.
    constant_offsets
        Whether offsets are taken to be constant; otherwise they may walk.
    known
        What is known of the attitudes besides.
    unused
        Turns, by the standstill before each, that are not used: nothing counts them, or gyros were cut off.
    own_frame
        Whether b is the accelerometers' own frame; otherwise it is given by what is known of the attitudes.
    """

    imu: ImuSamples
    raw: RawReadings
    rests: Rests
    site: Site
    effects: tuple[str, ...] = ("gyro_g_sensitivity",)
    constant_offsets: bool = False
    known: tuple[Knowledge, ...] = ()
    unused: tuple[int, ...] = ()
    own_frame: bool = True

    @property
    def order(self) -> int:
        """Order of the sensor polynomials."""
        return 2 if {"gyro_polynomial", "accel_polynomial"} & set(self.effects) else 1

    @cached_property
    def layout(self) -> StateLayout:
        """Parameters that are estimated."""
        groups = [g for g in (*SENSOR_GROUPS, "north", "earth_down", "gravity") if g in (*_ALWAYS, *self.effects)]
        if self.site.earth_rate_n is not None:
            groups.remove("earth_down")
        fixed = BELOW_DIAGONAL if self.own_frame else ()
        own = [group_part(g, self.order, 0, fixed) for g in groups]
        return StateLayout([*own, *(Part(one.name, one.width.size) for one in self.nuisances)])

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Parameters that are estimated beside, last in the layout."""
        return tuple(one for known in self.known for one in known.nuisances)

    @property
    def reported(self) -> int:
        """Number of estimated parameters that are no nuisances."""
        return self.layout.degrees - sum(one.width.size for one in self.nuisances)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated."""
        layout, beside = self.layout, {one.name: one.labels for one in self.nuisances}
        return tuple(
            (beside.get(part.name) or parameter_names(part.name, self.order))[i]
            for part in layout
            for i in layout.present(part.name).tolist()
        )

    @cached_property
    def width(self) -> Array:
        """Deviation of every parameter before any look at the data, (P,)."""
        own = {**_WIDTHS, "gravity": self.site.gravity_sd}
        beside = {one.name: one.width for one in self.nuisances}

        def of(part: Part) -> Array:
            if part.name in beside:
                return beside[part.name]
            return np.full(part.degrees, own.get(part.name) or group_named(part.name).usual_sd or 1.0)

        return np.concatenate([of(part) for part in self.layout])

    def values(self, parameters: CellParameters) -> Array:
        """Return the estimated ones of parameters, (P,)."""
        layout, beside = self.layout, {one.name for one in self.nuisances}
        return np.concatenate([
            nuisance(parameters, part.name, part.degrees)
            if part.name in beside
            else parameters.stored(part.name)[layout.present(part.name)]
            for part in layout
        ])  # fmt: skip

    def with_effects(self, effects: tuple[str, ...]) -> RestProblem:
        """Return the problem with other effects."""
        return replace(self, effects=effects)

    def additions(self, group: str) -> Array:
        """Return what an effect adds to the mean readings at standstills, by its parameters, (M, 3, size)."""
        if group not in self._additions:
            effect, size = EFFECTS[group], group_named(group).degrees(self.order)
            means = self.rests.means_of(effect.features(self.raw, size))
            self._additions[group] = effect.by_parameter(means[:, :, None, None] * np.eye(3), size)
        return self._additions[group]

    @cached_property
    def _additions(self) -> dict[str, Array]:
        return {}

    def columns(self, by_group: dict[str, Array], count: int) -> Array:
        """Return derivatives by all parameters, (count, 3, P), from those by groups."""
        layout = self.layout
        J = np.zeros((count, 3, layout.degrees))
        for group, columns in by_group.items():
            if group in layout:
                J[:, :, layout[group]] = columns[:, :, layout.present(group)]
        return J

    def part(self, keep: Indices) -> RestProblem:
        """Return the problem of some standstills in a row."""
        known, first = tuple(one.part(keep) for one in self.known), int(keep[0])
        return replace(self, rests=self.rests.part(keep), known=known, unused=tuple(m - first for m in self.unused))

    def changed(self, parameters: CellParameters, change: Array) -> CellParameters:
        """Return parameters moved by changes (P,) of the estimated ones."""
        layout = self.layout
        values = {group: parameters.stored(group) for group in GROUPS}
        values |= {one.name: nuisance(parameters, one.name, one.width.size) for one in self.nuisances}
        for part in layout:
            whole = values[part.name].copy()
            whole[layout.present(part.name)] += change[layout[part.name]]
            values[part.name] = whole
        return self.room(CellParameters.from_stored(values))

    def room(self, parameters: CellParameters) -> CellParameters:
        """Return parameters with room for the effects that are estimated, and nothing of others."""
        sensors = parameters.sensors
        others = {
            g: sensors.others.get(g, np.zeros(group_named(g).degrees(self.order)))
            for g in self.effects
            if not g.endswith("_polynomial")
        }
        k_w, k_a = (k[: self.order] for k in (sensors.k_w, sensors.k_a))
        return replace(parameters, sensors=replace(sensors, k_w=k_w, k_a=k_a, others=others)).with_order(self.order)


def nuisance(parameters: CellParameters, name: str, size: int) -> Array:
    """Return the values of nuisances, (size,)."""
    return np.asarray(parameters.others.get(name, np.zeros(size)), dtype=float)


def begun(sensors: SensorParameters, site: Site) -> CellParameters:
    """Return the first values, for the sensors' parameters and a site."""
    return CellParameters(sensors, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(2), site.gravity, 0.0, 0.0,
                          earth_down=site.known_earth_down)  # fmt: skip


def raw_of(imu: ImuSamples) -> RawReadings:
    """Return what effects are made of."""
    return raw_readings(imu.seconds, imu.rates, imu.accelerations, temperature_difference=imu.temperature_difference)
