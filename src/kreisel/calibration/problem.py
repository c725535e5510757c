"""A recording turned into a problem for the filter: signal, layout, first values, priors, updates."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from kreisel.calibration.parameters import (
    GROUPS,
    ROBOT_GROUPS,
    SENSOR_GROUPS,
    CellParameters,
    group_part,
    parameter_names,
)
from kreisel.calibration.reference_noise import ReferenceNoise
from kreisel.calibration.rests import Rest, Standstill, find_rests
from kreisel.calibration.robot_errors import RobotModel
from kreisel.calibration.settings import BY_CHOICE, CalibrationSettings
from kreisel.estimation.state import Part, StateLayout
from kreisel.geometry.rotation import Array, Indices
from kreisel.inertial.earth import EARTH_RATE
from kreisel.inertial.readings import Readings
from kreisel.recording import ReferencePoses
from kreisel.synchronization import Clock

NAVIGATION = (Part("velocity", 3), Part("position", 3), Part("attitude", 3, rotation=True))
"""What changes between updates; last in the state."""

REST_ERROR = (Part("rest_position", 3), Part("rest_orientation", 3))
"""The reference's error at the present rest: one draw for each stop."""


PATH_ERROR = (Part("path_position", 3), Part("path_orientation", 3))
"""The part of the reference's error on the path that lasts from one update to the next."""

REACH = 1.0
"""m; over which angles of a robot's chain act on positions, and its lengths on the scale of these."""

MIN_UPDATES = 20
"""Updates without which nothing is estimated."""

LASTING = 0.9
"""Its share of the variance, where there is such a part."""


@dataclass(frozen=True)
class Site:
    """Where the cell stands: gravity (m/s^2) and its standard deviation, and the Earth's rotation.

    Attributes
    ----------
    earth_rate_n : (3,) or None
        In north, east, down, rad/s; None where no latitude is given: it is then estimated.
    """

    gravity: float
    gravity_sd: float
    earth_rate_n: Array | None

    @property
    def earth_rate_units(self) -> tuple[float, float]:
        """Earth rate, rad/s, that a unit of the parameters `north` and `earth_down` stands for."""
        if self.earth_rate_n is None:
            return EARTH_RATE, EARTH_RATE
        return float(self.earth_rate_n[0]), float(self.earth_rate_n[2])

    @property
    def known_share(self) -> float:
        """Value of `earth_down` before any look at the data: 1 by the latitude, 0 without one."""
        return 0.0 if self.earth_rate_n is None else 1.0


@dataclass(frozen=True)
class Update:
    """One use of the reference.

    Attributes
    ----------
    first, last
        Samples the motion is integrated over since the update before.
    pose, tau
        Index of the pose and its reference seconds.
    rest
        Index of the rest it lies in, or None on the path.
    new_rest, new_segment
        Whether it is the first in its rest, and whether navigation starts anew here.
    """

    first: int
    last: int
    pose: int
    tau: float
    rest: int | None
    new_rest: bool
    new_segment: bool


@dataclass(frozen=True)
class PoseError:
    """Error of reported poses that is a function of the arm's posture: as large at each pose, and lasting.

    Attributes
    ----------
    position, orientation
        Standard deviations, m and rad; zero where there is no arm, or its errors are estimated.
    time
        How long the arm, as it moves here, keeps much the same posture, s.
    """

    position: float = 0.0
    orientation: float = 0.0
    time: float = 0.0


@dataclass(frozen=True)
class Lasting:
    """Error of the reference on the path that lasts: how long (s), how large (m, rad), and the share that is new.

    The deviations of the path's noise are multiplied by `fresh` for what is drawn anew at every update.
    """

    time: float
    position: float
    orientation: float
    fresh: float


@dataclass(frozen=True)
class Problem:
    """Everything a filter run needs; nothing in it changes during a run.

    Attributes
    ----------
    attitude : (updates, 4)
        q_rb at every update, roughly: for navigation to begin with if the reference shows no attitude. Good to
        `attitude_sd`, rad.
    start, start_covariance
        What the first pass begins with, group by group: least squares, with wide deviations.
    prior, prior_covariance
        What is known before any look at the data, group by group.
    prior_width
        Deviations before any look at the data, against which observability is judged.
    given_priors
        Groups whose prior is the user's word.
    nominal, held
        Values for groups the motion does not show, and the groups held there for that reason.
    robot
        The arm, where its errors are estimated.
    frame_sd
        How far base and tool lie from where the reference has them, m and rad, if nothing else stands for it.
    correlation_time
        How long the reference's errors on the path last, s; 0 where each update's are new.
    clock
        The clocks by which poses were assigned to samples, and rests found.
    standstill
        When the IMU stands still, for rests by other clocks.
    pose_error
        What an arm's geometric errors do to its reported poses, where they are not estimated.
    rate_scatter
        Standard deviation of the noise in a single reading of a gyro, rad/s.
    lateness
        How far the stamps, of the IMU or the reference, may all be late, s.
    """

    readings: Readings
    reference: ReferencePoses
    attitude: Array
    tau: Array
    clock: Clock
    settings: CalibrationSettings
    site: Site
    noise: ReferenceNoise
    least_noise: tuple[float, float]
    imu_bounds: tuple[tuple[float, float], tuple[float, float]]
    offset_walk: dict[str, float]
    layout: StateLayout
    start: CellParameters
    start_covariance: dict[str, Array]
    prior: CellParameters
    prior_covariance: dict[str, Array]
    prior_width: dict[str, Array]
    given_priors: tuple[str, ...]
    nominal: CellParameters
    rests: tuple[Rest, ...]
    updates: tuple[Update, ...]
    update_interval: float
    held: tuple[str, ...] = ()
    robot: RobotModel | None = None
    frame_sd: tuple[float, float] = (0.0, 0.0)
    attitude_sd: float = 0.2
    correlation_time: float = 0.0
    standstill: Standstill | None = None
    pose_error: PoseError = PoseError()
    rate_scatter: float = 0.0
    lateness: float = 0.0

    @property
    def lasting(self) -> Lasting:
        """The reference's lasting errors: those found by likelihood, and those of an arm's geometry."""
        noise, own = self.noise, self.pose_error
        if self.correlation_time == 0.0:
            return Lasting(own.time, own.position, own.orientation, 1.0)
        found = (LASTING**0.5 * noise.position, LASTING**0.5 * noise.orientation)
        size = (math.hypot(found[0], own.position), math.hypot(found[1], own.orientation))
        return Lasting(self.correlation_time, *size, (1.0 - LASTING) ** 0.5)

    @property
    def rest_error(self) -> tuple[float, float]:
        """Error of the pose at a rest, drawn once for each, m and rad."""
        noise, own = self.noise, self.pose_error
        return (
            math.hypot(noise.standstill_position, own.position),
            math.hypot(noise.standstill_orientation, own.orientation),
        )

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
        return sum(part.degrees for part in self.layout if part.name in SENSOR_GROUPS)

    @property
    def joints(self) -> int:
        """Joints of the robot whose errors are estimated; 0 without one."""
        return 0 if self.robot is None else self.robot.joints

    @property
    def gyro_degrees(self) -> int:
        """Degrees of freedom of the gyros' parameters, before all others."""
        return sum(part.degrees for part in self.layout if part.name.startswith("gyro"))

    @property
    def walked_variance(self) -> Array:
        """Variance the walk of the offsets gathers from the first update to the last, one for each parameter, (n,)."""
        out = np.zeros(len(self.parameter_names))
        seconds = float(self.readings.stamps[self.updates[-1].last] - self.readings.stamps[self.updates[0].first])
        for group, density in self.offset_walk.items():
            if group in self.layout:
                out[self.layout[group]] = density**2 * seconds
        return out

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Name of every estimated parameter, one for each of its degrees of freedom."""
        names: list[str] = []
        for group in self.groups:
            own = parameter_names(group, self.settings.polynomial_order, self.joints)
            names.extend(own[: self.layout[group].stop - self.layout[group].start])
        return tuple(names)


def hold(problem: Problem, groups: tuple[str, ...]) -> Problem:
    """Return the problem with groups taken out of the state and held at their nominal values."""

    def with_nominal(values: CellParameters) -> CellParameters:
        stored = {group: (problem.nominal if group in groups else values).stored(group) for group in GROUPS}
        return CellParameters.from_stored(stored)

    return replace(
        problem,
        layout=StateLayout([part for part in problem.layout if part.name not in groups]),
        start=with_nominal(problem.start),
        prior=with_nominal(problem.prior),
        start_covariance={g: P for g, P in problem.start_covariance.items() if g not in groups},
        prior_covariance={g: P for g, P in problem.prior_covariance.items() if g not in groups},
        held=(*problem.held, *groups),
    )


def with_lasting_errors(problem: Problem, correlation_time: float) -> Problem:
    """Return the problem with the reference's errors on the path as a process that lasts so long, s."""
    given = (problem.reference.positions is not None, problem.reference.quaternions is not None)
    kept = [part for part in problem.layout if part not in (*PATH_ERROR, *NAVIGATION)]
    lasting = [part for part, there in zip(PATH_ERROR, given, strict=True) if there]
    return replace(problem, layout=StateLayout([*kept, *lasting, *NAVIGATION]), correlation_time=correlation_time)


def build_layout(
    settings: CalibrationSettings,
    *,
    latitude: bool,
    skew: bool,
    rest_error: bool,
    path_error: tuple[bool, bool] = (False, False),
    joints: int = 0,
) -> StateLayout:
    """Return the layout: sensor parameters, cell parameters, the robot's errors, rest error, navigation."""
    absent = set(settings.fixed) | (set(BY_CHOICE) - set(settings.estimated))
    if joints == 0:
        absent |= set(ROBOT_GROUPS)
    if settings.polynomial_order == 1:
        absent |= {"gyro_polynomial", "accel_polynomial"}
    if latitude or "north" in absent:
        absent.add("earth_down")
    if not skew:
        absent.add("time_skew")
    parts = [group_part(g, settings.polynomial_order, joints) for g in GROUPS if g not in absent]
    if rest_error:
        parts += REST_ERROR
    parts += [part for part, there in zip(PATH_ERROR, path_error, strict=True) if there]
    return StateLayout([*parts, *NAVIGATION])


def assigns_otherwise(problem: Problem, clock: Clock) -> bool:
    """Return whether another clock assigns poses to other samples."""
    step = float(np.median(np.diff(problem.readings.stamps[:1000])))
    return problem.clock.distance(clock, problem.tau) > 0.5 * step


def rescheduled(problem: Problem, clock: Clock) -> Problem:
    """Return the problem with updates and rests by other clocks, where these differ by a sample or so."""
    if problem.reference.quaternions is None or not assigns_otherwise(problem, clock):
        return problem
    rests = problem.rests
    if problem.standstill is not None:
        rests = find_rests(problem.standstill, problem.reference, clock, problem.noise)
    updates = schedule(problem.readings, clock.imu_time(problem.tau), problem.tau, rests, problem.update_interval)
    if len(updates) < MIN_UPDATES:
        return problem
    attitude = np.tile([1.0, 0.0, 0.0, 0.0], (len(updates), 1))
    return replace(problem, clock=clock, rests=rests, updates=updates, attitude=attitude)


def schedule(
    readings: Readings,
    t_pose: Array,
    tau: Array,
    rests: tuple[Rest, ...],
    interval: float,
) -> tuple[Update, ...]:
    """Return the updates: one every `interval`, each with the pose nearest to it.

    Parameters
    ----------
    t_pose
        IMU seconds of every pose, as far as known.
    tau
        Reference seconds of every pose.
    """
    updates: list[Update] = []
    last_rest: int | None = None
    starts = np.array([rest.start for rest in rests])
    stops = np.array([rest.stop for rest in rests])
    for begin, end in readings.segments:
        low, high = readings.stamps[begin + 1], readings.stamps[end - 1]
        inside = np.flatnonzero((t_pose > low) & (t_pose < high))
        if inside.size < 2:
            continue
        previous: int | None = None
        for pose in _spread(t_pose, inside, interval):
            sample = _nearest(readings.stamps, float(t_pose[pose]), begin + 1, end - 1)
            if previous is not None and sample <= previous:
                continue
            rest = _containing(starts, stops, float(t_pose[pose]))
            updates.append(
                Update(
                    first=sample if previous is None else previous,
                    last=sample,
                    pose=int(pose),
                    tau=float(tau[pose]),
                    rest=rest,
                    new_rest=rest is not None and rest != last_rest,
                    new_segment=previous is None,
                )
            )
            last_rest = rest if rest is not None else last_rest
            previous = sample
    return tuple(updates)


def _spread(t_pose: Array, inside: Indices, interval: float) -> Indices:
    """Return the poses nearest to a grid of the given interval, each once."""
    times = t_pose[inside]
    grid = np.arange(times[0], times[-1] + 0.5 * interval, interval)
    right = np.clip(np.searchsorted(times, grid), 1, times.size - 1)
    nearest = np.where(grid - times[right - 1] < times[right] - grid, right - 1, right)
    close = np.abs(times[nearest] - grid) <= 0.5 * interval
    return np.asarray(inside[np.unique(nearest[close])])


def _nearest(stamps: Array, t: float, low: int, high: int) -> int:
    k = int(np.searchsorted(stamps, t))
    if k > 0 and (k == stamps.size or t - stamps[k - 1] < stamps[k] - t):
        k -= 1
    return min(max(k, low), high)


def _containing(starts: Array, stops: Array, t: float) -> int | None:
    if starts.size == 0:
        return None
    k = int(np.searchsorted(starts, t, side="right")) - 1
    return k if k >= 0 and t <= stops[k] else None
