"""Assembly of the filter's problem from the preparation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from kreisel.errors import SettingsError, SynchronizationError
from kreisel.estimation.state import StateLayout
from kreisel.geometry.rotation import Array, conjugate, log, multiply
from kreisel.inertial.effects import OF_TEMPERATURE
from kreisel.inertial.noise_figures import GAUSS_MARKOV_TIME
from kreisel.model.assumed_noise import REACH, AssumedNoise, GaussMarkov, PoseError, stamps_of
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.groups import REGISTRY
from kreisel.model.parameters import GROUPS, PASSING_GROUPS, ROBOT_GROUPS, CellParameters
from kreisel.model.problem import Prior, Problem, Sensor
from kreisel.model.schedule import MIN_UPDATES, Schedule
from kreisel.preparation.attitude import start_attitudes
from kreisel.preparation.preparation import Preparation
from kreisel.preparation.robot_errors import ANGLE_SD, LENGTH_SD
from kreisel.preparation.scheduling import schedule_updates
from kreisel.preparation.start_values import (
    expected_effects,
    gauss_markov_sizes,
    likely_effects,
    nominal_parameters,
    starting_point,
    stated_prior,
)
from kreisel.preparation.state_layout import build_layout
from kreisel.preparation.stated_priors import apart, with_known
from kreisel.preparation.turning_axes import turning_axes
from kreisel.recording.recording import ReferencePoses, angles_over
from kreisel.synchronization.clock import Clock

INTERVALS = {"robot": 0.48, "mocap": 0.24}
"""Seconds between updates. The paper's 0.48 s suit a robot, whose errors are correlated over tenths of a
second; errors of motion capture are nearly independent from frame to frame, and motion by hand is less smooth."""

_FEW_UPDATES = 100
"""Updates below which they are nearer to each other, as near as poses are. Chosen: in a run of twelve seconds an update
every half a second leaves 23 for some 40 unknowns, and neither noise nor effects are found from so few."""

_SENSOR = "imu0"
"""Name of the only sensor of a recording."""

_MIN_NOISE = 0.1
"""Share of the reference's assumed noise that passes may find at least. Chosen: errors that last make small
differences, which must not be taken for a reference without noise."""

_HALF_A_CHAIN = math.sqrt(2.0)
"""Errors of the base frame, and of the tool frame, over those of one placement: as of two that are independent. Chosen;
see docs/explanation/robot-errors.md."""

_VOLUME_SD = 1e-3
"""Relative error of the scale of cameras' positions. Chosen: wands are measured, or printed, to some tenths of a
millimetre of half a metre."""

_FEW_STANDSTILLS = 6
"""Standstills below which they do not show by themselves how large a reference's errors are there. Those of cameras,
which depend on where the markers are, are then as large as in motion. Chosen: six scatter by a third."""

_AXIS_SD = 0.02
"""rad; how far an arm of which nothing is stated may turn about another axis than it reports."""

_POSTURES = 150
"""Attitudes of a tool, half a radian apart, that moves of an arm reach: as many independent errors there are."""

_POSTURE, _POSTURE_TIMES = 0.5, (1.0, 100.0)  # rad, s

_ALL_ATTITUDES = 2.1
"""rad; rms angle from the mean attitude, above which errors of poses do not grow further. Of four simulated arms with
errors of each joint's placement, in moves of 10 to 100 % of their ranges, they are 0.85 of it, in mrad per mrad, and
1.6 to 1.8 at most."""


def frame_sd_of(preparation: Preparation) -> tuple[float, float]:
    """Return the deviations of base and tool frame by a robot's errors, m and rad, if they cannot be estimated."""
    settings = preparation.recording.settings
    if preparation.robot is not None or preparation.recording.reference_kind == "mocap":
        return (0.0, 0.0)
    length, angle = settings.robot.length_sd, settings.robot.angle_sd
    # half of the chain's errors act like an error of the base frame, half like one of the tool frame
    return (
        _HALF_A_CHAIN * (LENGTH_SD if length is None else length),
        _HALF_A_CHAIN * (ANGLE_SD if angle is None else angle),
    )


def _nothing_stated(preparation: Preparation) -> bool:
    """Return whether the user states nothing of a robot's errors."""
    stated = preparation.recording.settings.robot
    return stated.length_sd is None and stated.angle_sd is None


def _with_held_values(start: CellParameters, preparation: Preparation, settings: CalibrationSettings) -> CellParameters:
    """Return the start values, with the values the user gave for fixed groups."""
    if not settings.fixed_values:
        return start
    stored = {group: start.stored(group) for group in GROUPS}
    for group in settings.fixed:
        value = settings.value_of(group)
        if value is not None:
            stored[group] = value
            if group == "time_offset":
                stored[group] = value - apart(preparation)
    return CellParameters.from_stored(stored)


def _of_layout(covariance: dict[str, Array], layout: StateLayout) -> dict[str, Array]:
    """Return all covariances that are known, and those of usual devices for other groups in a layout."""
    out = {group: P for group, P in covariance.items() if P.size}
    for group in REGISTRY:
        if group.name in layout:
            out.setdefault(group.name, group.usual_covariance(layout.present(group.name).size))
    return out


def _pose_error(reference: ReferencePoses, frame_sd: tuple[float, float], *, assumed: bool = False) -> PoseError:
    """Return the part of a robot's pose error that errors of the base and tool frames cannot represent.

    It is assumed to be as large as that of the frames; an angle acts on positions over `REACH`. It changes with the
    posture: it counts as changed once the tool has turned by `_POSTURE`. It is a function of the posture, and comes
    back with it: a long recording averages over `_POSTURES` errors at most, and each of more counts as larger.
    """
    length, angle = frame_sd
    if max(frame_sd) == 0.0:
        return PoseError()
    turned, reached = 0.0, 1.0
    if reference.quaternions is not None:
        stride = max(1, round(0.2 / reference.interval))
        turned = float(np.sum(angles_over(reference.quaternions, stride)[::stride]))
        reached = min(_spread(reference.quaternions[::stride]) / _ALL_ATTITUDES, 1.0)
    seconds = float(reference.seconds[-1])
    time = float(np.clip(_POSTURE * seconds / max(turned, 1e-9), *_POSTURE_TIMES))
    repeated = math.sqrt(max(1.0, turned / (_POSTURE * _POSTURES)))
    counted = (repeated * math.hypot(length, REACH * angle), repeated * angle)
    return PoseError(*counted, time, assumed, repeated, max(reached, 1e-3))


def _spread(q: Array) -> float:
    """Return the rms angle of attitudes (n, 4) from their mean, rad."""
    mean = np.linalg.eigh(q.T @ q)[1][:, -1]
    return float(np.sqrt(np.mean(np.sum(log(multiply(conjugate(mean), q)) ** 2, axis=1))))


def build_problem(preparation: Preparation, settings: CalibrationSettings) -> Problem:
    """Return the problem for the filter.

    Raises
    ------
    SynchronizationError
        If too little of the reference lies within the IMU's recording.
    SettingsError
        If temperature coefficients are asked for, but no temperature was recorded.
    """
    if preparation.readings.temperature_difference is None and (
        wanted := [g for g in settings.estimated if g in OF_TEMPERATURE]
    ):
        raise SettingsError(
            f"{', '.join(wanted)} cannot be estimated: the recording has no temperature (a column of imu0/data.csv "
            "whose name begins with temp)"
        )
    fit, site, reference = preparation.rate_fit, preparation.site, preparation.reference
    skewed = fit.skewed if settings.skew is None else settings.skew
    start, start_covariance = starting_point(preparation, settings.polynomial_order)
    if not skewed:
        start = replace(start, skew=0.0)
    start = _with_held_values(start, preparation, settings)
    schedule = _schedule(preparation, settings, start.clock)
    noise = _assumed_noise(preparation)
    # with and without single parameters that are fixed
    whole, layout = (
        build_layout(
            one,
            latitude=site.earth_rate_n is not None,
            skew=skewed,
            standstill_error=any(update.standstill is not None for update in schedule.updates),
            path_error=(
                noise.pose_error.position > 0.0 and reference.positions is not None,
                noise.pose_error.orientation > 0.0 and reference.quaternions is not None,
            ),
            joints=preparation.joints,
            gauss_markov=tuple(noise.gauss_markov),
        )
        for one in (replace(settings, priors=()), settings)
    )
    prior = _prior(preparation, settings.polynomial_order, whole, start, start_covariance)
    return Problem(
        sensors=(Sensor(_SENSOR, preparation.readings),),
        reference=reference,
        schedule=schedule,
        settings=settings,
        site=site,
        layout=layout,
        prior=with_known(prior, preparation, settings, whole),
        noise=noise,
        robot=preparation.robot,
    )


def _schedule(preparation: Preparation, settings: CalibrationSettings, clock: Clock) -> Schedule:
    """Return the updates, at the requested interval or that for the kind of reference, shorter where it leaves few."""
    reference, readings = preparation.reference, preparation.readings
    tau = reference.seconds
    interval = settings.update_interval
    if interval is None:
        usual = INTERVALS[preparation.recording.reference_kind]
        interval = min(usual, max(float(tau[-1] - tau[0]) / _FEW_UPDATES, reference.interval))
    updates = schedule_updates(readings, clock.imu_time(tau), reference, preparation.standstills, interval)
    if len(updates) < MIN_UPDATES:
        raise SynchronizationError(
            f"{reference.source}: only {len(updates)} updates of {interval:g} s lie within the IMU's recording; "
            f"expected {MIN_UPDATES} or more: record longer, or use a shorter --update-interval"
        )
    attitude = start_attitudes(preparation, np.array([update.last for update in updates]))
    return Schedule(updates, interval, clock, preparation.standstills, attitude, stillness=preparation.stillness)


def _assumed_noise(preparation: Preparation) -> AssumedNoise:
    imu, reference = preparation.imu_noise, preparation.noise
    frame_sd = frame_sd_of(preparation)
    return AssumedNoise(
        reference=reference,
        min_reference=(_MIN_NOISE * reference.position, _MIN_NOISE * reference.orientation),
        imu_bounds=(imu.gyro_bounds, imu.accel_bounds),
        offset_walk={"gyro_offset": imu.gyro_walk, "accel_offset": imu.accel_walk, **_placed(preparation)},
        gauss_markov={
            group: GaussMarkov(size, GAUSS_MARKOV_TIME) for group, size in gauss_markov_sizes(imu).items() if size > 0.0
        },
        rate_scatter=imu.gyro_scatter,
        observed=imu.observed,
        misstated=imu.misstated,
        frame_sd=frame_sd,
        volume_sd=_volume_sd(preparation),
        pose_error=_pose_error(preparation.reference, frame_sd, assumed=_nothing_stated(preparation)),
        time_base_sd=preparation.time_base_sd,
        axes=turning_axes(preparation.reference) if max(frame_sd) > 0.0 else np.zeros((0, 3)),
        axis_sd=_AXIS_SD if preparation.recording.settings.robot.angle_sd is None else frame_sd[1],
        lateness=math.hypot(preparation.recording.imu.lateness, preparation.reference.lateness),
        stamps=stamps_of(reference.stamp, preparation.wrong_stamps, preparation.reference.interval),
        persists=preparation.recording.reference_kind == "mocap" and len(preparation.standstills) < _FEW_STANDSTILLS,
    )


def _volume_sd(preparation: Preparation) -> float:
    """Return the relative deviation of the scale of cameras' positions, as stated or as is usual; 0 for an arm."""
    stated = preparation.recording.settings.reference.scale_sd
    if preparation.recording.reference_kind != "mocap":
        return 0.0
    return _VOLUME_SD if stated is None else stated


def _placed(preparation: Preparation) -> dict[str, float]:
    """Return the walk of the clocks' offset that stands for parts of the recording that are not quite in place."""
    imu = preparation.recording.imu
    return {} if imu.placed_sd == 0.0 else {"time_offset": 2.0 * imu.placed_sd * float(imu.seconds[-1]) ** -0.5}


def _prior(
    preparation: Preparation,
    order: int,
    layout: StateLayout,
    start: CellParameters,
    start_covariance: dict[str, Array],
) -> Prior:
    """Return what is known before the filter runs; `start` and its covariance are those of the least squares fits."""
    noise = preparation.imu_noise
    value, covariance = stated_prior(preparation, order)
    offsets = {"gyro_offset": noise.gyro_offset_sd, "accel_offset": noise.accel_offset_sd}
    stated = {group: np.full(3, sd) for group, sd in offsets.items() if sd is not None}
    return Prior(
        start=start,
        start_covariance=_of_layout(start_covariance, layout),
        value=value,
        covariance=_of_layout(covariance, layout),
        width={
            **{g.name: np.array([g.usual_sd]) for g in REGISTRY if g.usual_sd is not None},
            **stated,
            "gravity": np.array([preparation.site.gravity_sd]),
            **{g: np.sqrt(np.diag(covariance[g])) for g in (*PASSING_GROUPS, *ROBOT_GROUPS) if g in covariance},
        },
        stated=tuple(stated),
        nominal=nominal_parameters(preparation, order),
        expected=expected_effects(preparation),
        likely=likely_effects(preparation),
    )
