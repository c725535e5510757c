"""The filter's problem: readings, poses and when they are used, the state, what is known before, and the noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kreisel.estimation.state import StateLayout
from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.inertial.readings import Readings
from kreisel.model.assumed_noise import AssumedNoise
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.groups import group_named
from kreisel.model.layout import NAVIGATION, PATH_ERROR, group_part, with_coloured_noise, without
from kreisel.model.parameters import GROUPS, PASSING_GROUPS, CellParameters, parameter_names
from kreisel.model.robot_model import RobotModel
from kreisel.model.schedule import Schedule
from kreisel.model.site import Site
from kreisel.recording.recording import ReferencePoses

_CONSIDERED_SD = {"gyro_polynomial": 5e-3, "accel_polynomial": 3e-4}
"""Deviations of polynomials that nobody asked for: less than those of a device of which they are expected."""

_WALKED = 0.5
"""Walk of a parameter over a recording, in deviations of its estimate, up to which it counts as constant: a quarter of
its variance."""

_NOTHING = 1e4
"""Factor on the noise of accelerometers with which these say nothing."""


@dataclass(frozen=True)
class Prior:
    """What is known of the parameters before the filter runs, group by group.

    Attributes
    ----------
    start, start_covariance
        Start of the first pass: least squares, with inflated deviations.
    value, covariance
        What is known before any look at the data.
    width
        Deviations before any look at the data, with which observability is judged.
    stated
        Groups whose prior the user states.
    nominal
        A faultless IMU on the mount found: values of groups that are not observable.
    expected
        Effects that a device of the stated grade has.
    likely
        Effects that the device has as likely as not: nothing is stated of it.
    """

    start: CellParameters
    start_covariance: dict[str, Array]
    value: CellParameters
    covariance: dict[str, Array]
    width: dict[str, Array]
    stated: tuple[str, ...]
    nominal: CellParameters
    expected: tuple[str, ...] = ()
    likely: tuple[str, ...] = ()


@dataclass(frozen=True)
class Sensor:
    """An IMU on the body: its name, and its readings."""

    name: str
    readings: Readings


@dataclass(frozen=True)
class Problem:
    """Everything a filter run needs; nothing in it changes during a run.

    Attributes
    ----------
    sensors, reference
        The IMUs, and what the reference recorded.
    schedule
        Which pose is used when.
    layout
        The state.
    robot
        The arm, where its errors are estimated.
    """

    sensors: tuple[Sensor, ...]
    reference: ReferencePoses
    schedule: Schedule
    settings: CalibrationSettings
    site: Site
    layout: StateLayout
    prior: Prior
    noise: AssumedNoise
    robot: RobotModel | None = None

    @property
    def sensor(self) -> Sensor:
        """The only sensor.

        Raises
        ------
        ValueError
            If there are several: what asks for the only one is made for one.
        """
        if len(self.sensors) != 1:
            names = ", ".join(sensor.name for sensor in self.sensors)
            raise ValueError(f"the problem has {len(self.sensors)} sensors ({names}); this step is made for one")
        return self.sensors[0]

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups that are estimated, in the order of the state."""
        return tuple(part.name for part in self.layout if part.name in GROUPS)

    @property
    def changing(self) -> int:
        """Degrees of freedom that change between updates."""
        return sum(part.degrees for part in (*PATH_ERROR, *NAVIGATION) if part.name in self.layout)

    @property
    def sensor_degrees(self) -> int:
        """Degrees of freedom of the sensor parameters, first in the state."""
        return self._degrees_of("gyroscope", "accelerometer")

    @property
    def gyro_degrees(self) -> int:
        """Degrees of freedom of the gyros' parameters, before all others."""
        return self._degrees_of("gyroscope")

    def _degrees_of(self, *owners: str) -> int:
        return sum(self.layout[g].stop - self.layout[g].start for g in self.groups if group_named(g).owner in owners)

    @property
    def joints(self) -> int:
        """Joints of the robot whose errors are estimated; 0 without one."""
        return 0 if self.robot is None else self.robot.joints

    @property
    def lasting(self) -> Indices:
        """Degrees of freedom of all parameters that last longer than seconds."""
        passing = [np.r_[self.layout[group]] for group in PASSING_GROUPS if group in self.layout]
        return np.setdiff1d(np.arange(len(self.parameter_names)), np.concatenate([np.zeros(0, dtype=int), *passing]))

    def constant(self, deviation: Array) -> Indices:
        """Return the degrees of freedom of the lasting parameters that hardly walk during the recording.

        deviation: of their estimates, (degrees,).
        """
        walked = np.sqrt(self.walked_variance)
        return np.setdiff1d(self.lasting, np.flatnonzero(walked > _WALKED * deviation[: walked.size]))

    @property
    def walked_variance(self) -> Array:
        """Variance of the offsets' random walk from the first update to the last, one for each parameter, (n,)."""
        out = np.zeros(len(self.parameter_names))
        for group in self.noise.offset_walk:
            if group in self.layout:
                out[self.layout[group]] = walked_variance(self, group)
        return out

    @property
    def known_places(self) -> Mask:
        """Which degrees of freedom of the parameters have a prior or a value that the user states, (n,)."""
        return np.isin(self.parameter_names, [name for name, _, _ in self.settings.priors])

    def stored(self, parameters: CellParameters, group: str) -> Array:
        """Return the numbers of a group that are in the state, as they are stored."""
        value = parameters.stored(group)
        return value if group_named(group).rotation else value[self.layout.present(group)]

    def columns(self, group: str, whole: Array) -> Array:
        """Return those columns (k, degrees) of a matrix (k, whole), one for each parameter, that are in the state."""
        return np.asarray(whole[..., self.layout.present(group)])

    def whole(self, group: str, own: Array) -> Array:
        """Return changes of all parameters of a group (whole,) from those in the state; of others they are zero."""
        out = np.zeros(self.layout.whole(group))
        out[self.layout.present(group)] = own
        return out

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Name of every estimated parameter, one for each of its degrees of freedom."""
        names: list[str] = []
        for group in self.groups:
            own = parameter_names(group, self.settings.polynomial_order, self.joints)
            names.extend(own[i] for i in self.layout.present(group))
        return tuple(names)


def with_readings(problem: Problem, readings: Readings) -> Problem:
    """Return the problem with other readings of its only sensor."""
    return replace(problem, sensors=(replace(problem.sensor, readings=readings),))


def walked_variance(problem: Problem, group: str) -> float:
    """Return the variance of a group's random walk from the first update to the last."""
    updates, stamps = problem.schedule.updates, problem.sensor.readings.stamps
    return problem.noise.offset_walk.get(group, 0.0) ** 2 * float(stamps[updates[-1].last] - stamps[updates[0].first])


def with_groups(problem: Problem, groups: tuple[str, ...], known: Mapping[str, Array] | None = None) -> Problem:
    """Return the problem with further groups of parameters in the state; polynomials are of the second order.

    known: covariances of their priors; the usual ones by default.
    """
    order = problem.settings.polynomial_order
    if order == 1 and any(group.endswith("polynomial") for group in groups):
        problem, order = _with_order(problem, 2), 2
    parts = {part.name: part for part in problem.layout} | {g: group_part(g, order, problem.joints) for g in groups}
    others = [part for part in problem.layout if part.name not in GROUPS]
    prior = problem.prior
    covariance = {g: prior.covariance.get(g, usual_covariance(g, problem)) for g in groups} | dict(known or {})
    return replace(
        problem,
        layout=StateLayout([*(parts[g] for g in GROUPS if g in parts), *others]),
        prior=replace(
            prior,
            covariance=prior.covariance | covariance,
            start_covariance=prior.start_covariance | covariance,
            width=prior.width | {g: np.sqrt(np.diag(P)) for g, P in covariance.items()},
        ),
    )


def without_groups(problem: Problem, groups: tuple[str, ...]) -> Problem:
    """Return the problem without groups of parameters, which have their nominal values in its start and prior."""
    prior = problem.prior
    return replace(
        problem,
        layout=without(problem.layout, groups),
        prior=replace(
            prior,
            start=with_nominal(problem, prior.start, groups),
            value=with_nominal(problem, prior.value, groups),
            start_covariance={g: P for g, P in prior.start_covariance.items() if g not in groups},
            covariance={g: P for g, P in prior.covariance.items() if g not in groups},
        ),
    )


def without_forces(problem: Problem) -> Problem:
    """Return the problem with accelerometers so noisy that they say nothing, for the gyros alone."""
    gyro, accel = problem.noise.imu_bounds
    bounds = (gyro, (_NOTHING * accel[0], _NOTHING * accel[1]))
    noise = replace(problem.noise, imu_bounds=bounds)
    return with_readings(replace(problem, noise=noise), problem.sensor.readings.with_noise(1.0, _NOTHING))


def with_nominal(problem: Problem, values: CellParameters, groups: tuple[str, ...]) -> CellParameters:
    """Return parameters with groups at their nominal values."""
    stored = {group: (problem.prior.nominal if group in groups else values).stored(group) for group in GROUPS}
    return CellParameters.from_stored(stored)


def usual_covariance(group: str, problem: Problem) -> Array:
    """Return the covariance of a group's prior for devices of which nothing is known; polynomials of second order."""
    degrees = group_part(group, max(problem.settings.polynomial_order, 2), problem.joints).degrees
    return group_named(group).usual_covariance(degrees, _CONSIDERED_SD.get(group))


def _with_order(problem: Problem, order: int) -> Problem:
    """Return the problem with room for sensor polynomials of an order, all zero beyond the present one."""
    prior = problem.prior
    start, value, nominal = (values.with_order(order) for values in (prior.start, prior.value, prior.nominal))
    return replace(
        problem,
        settings=replace(problem.settings, polynomial_order=order),
        prior=replace(prior, start=start, value=value, nominal=nominal),
    )


def with_correlation_time(problem: Problem, time: float) -> Problem:
    """Return the problem with coloured noise of the reference on the path, of a time constant in s."""
    present = (problem.reference.positions is not None, problem.reference.quaternions is not None)
    layout = with_coloured_noise(problem.layout, present)
    return replace(problem, layout=layout, noise=replace(problem.noise, correlation_time=time))


def part_of(problem: Problem, part: slice) -> Problem:
    """Return the problem of a part of the updates."""
    updates = list(problem.schedule.updates[part])
    updates[0] = updates[0].begun_anew()
    schedule = replace(problem.schedule, updates=tuple(updates), attitude=problem.schedule.attitude[part])
    return replace(problem, schedule=schedule)


def with_rarer_updates(problem: Problem) -> Problem:
    """Return the problem with about half the updates: every second one on the path is left out.

    Standstills and beginnings of navigation keep theirs.
    """
    updates, kept, begun = problem.schedule.updates, [], None
    places = []
    for i, update in enumerate(updates):
        one = update if begun is None else replace(update, first=begun)
        following = updates[i + 1] if i + 1 < len(updates) else None
        plain = update.standstill is None and not update.new_segment
        joined = following is not None and following.standstill is None and not following.new_segment
        if plain and joined and begun is None:
            begun = one.first
            continue
        kept.append(one)
        places.append(i)
        begun = None
    schedule = problem.schedule
    thinned = replace(
        schedule, updates=tuple(kept), attitude=schedule.attitude[places], interval=2.0 * schedule.interval
    )
    return replace(problem, schedule=thinned)
