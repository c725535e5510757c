"""Assembly of the calibration from the estimate and the checks of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from kreisel.calibration.data_sheet import derive
from kreisel.calibration.device_axes import device_triads
from kreisel.calibration.recording_facts import recording_facts
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import (
    Alignment,
    CalibrationParts,
    Consistency,
    EstimatorFacts,
    FinalNoise,
    Measured,
    RobotErrors,
    Timing,
    Verdict,
)
from kreisel.estimation.sigma_points import USUAL
from kreisel.estimation.uncertainty_budget import Budget
from kreisel.geometry.rotation import Array, exp, matrix, multiply
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.groups import group_named
from kreisel.model.parameters import (
    GROUPS,
    ROBOT_GROUPS,
    SENSOR_GROUPS,
    CellParameters,
    RobotParameters,
    other_groups,
    parameter_names,
    sensor_fields,
)
from kreisel.model.problem import Problem
from kreisel.model.robot_model import NOT_SEPARABLE, RobotModel, expected_accuracy, shift
from kreisel.model.site import earth_rate_r, gravity_r, north_r
from kreisel.recording.recording import DataWarning, Recording
from kreisel.refinement.estimate import Estimate
from kreisel.refinement.noise_adaptation import imu_density
from kreisel.refinement.observability import Observability
from kreisel.robot.urdf import calibrated_urdf
from kreisel.synchronization.clock import Clock

_STEP = 1e-6
"""rad; step of the difference quotient of gravity by the tilt. Chosen: half of it is the error by curvature, 5e-7, and
1e-16 over it that by rounding, 1e-10."""


@dataclass(frozen=True)
class Assessment:
    """Results of the checks of an estimate, the seconds the estimation took, and the budget of its uncertainty."""

    observability: Observability
    consistency: Consistency
    verdict: Verdict
    seconds: float
    budget: Budget | None = None


def assemble(
    recording: Recording, found: Estimate, judged: Assessment, warnings: tuple[DataWarning, ...]
) -> Calibration:
    """Return the calibration of a recording."""
    problem, run = found.problem, found.run
    reference = problem.reference
    poses, kind = int(reference.stamps_ns.size), recording.settings.reference.kind or ""
    parts = CalibrationParts(
        sensors=run.parameters.sensors,
        sensor_sd=_sensor_deviations(found),
        size_effect=problem.settings.size_effect,
        timing=_timing(recording, found),
        alignment=_alignment(found),
        derived=_derived(found),
        consistency=judged.consistency,
        verdict=judged.verdict,
        recording=recording_facts(recording, warnings, reference.name, poses, kind),
        estimator=_estimator_facts(found, judged),
        robot=None if problem.robot is None else _robot_errors(found, problem.robot),
        others=_others(found),
        considered=found.considered,
        budget=judged.budget,
    )
    n = len(judged.observability.names)
    names, covariance = judged.observability.names, _covariance(found, n)
    parts = replace(parts, triads=device_triads(parts.sensors, parts.sensor_sd, names, covariance))
    robot = problem.robot
    return Calibration(
        **vars(parts),
        names=names,
        covariance=covariance,
        prior_deviation=judged.observability.prior,
        estimates=_estimates(recording, found, n),
        robot_urdf=None
        if robot is None
        else calibrated_urdf(robot.arm, run.parameters.robot.placement, run.parameters.robot.zeros),
    )


def _estimator_facts(found: Estimate, judged: Assessment) -> EstimatorFacts:
    problem = found.problem
    settings, noise = problem.settings, problem.noise.reference
    gyro_density, accel_density = imu_density(problem)
    return EstimatorFacts(
        name=found.estimator.name,
        sigma_points=found.estimator.points or settings.sigma_points or USUAL,
        states=problem.layout.degrees,
        update_interval=problem.schedule.interval,
        updates=judged.consistency.updates,
        passes=found.passes,
        filter_seconds=judged.seconds,
        polynomial_order=settings.polynomial_order,
        fixed=(*settings.fixed, *settings.fixed_parameters),
        noise=FinalNoise(
            gyro_density,
            accel_density,
            noise.position,
            noise.orientation,
            noise.standstill_position,
            noise.standstill_orientation,
        ),
    )


def _covariance(found: Estimate, n: int) -> Array:
    """Return the covariance of the first n parameters."""
    return np.asarray(found.belief.covariance[:n, :n])


def _deviation_of(found: Estimate, group: str) -> Array:
    """Return the standard deviations of a whole group, zero for what is not estimated."""
    problem = found.problem
    if group in problem.layout:
        return problem.whole(group, found.deviation[problem.layout[group]])
    return np.zeros(group_named(group).degrees(problem.settings.polynomial_order, problem.joints))


def _sensor_deviations(found: Estimate) -> SensorParameters:
    return sensor_fields({group: _deviation_of(found, group) for group in SENSOR_GROUPS})


def _timing(recording: Recording, found: Estimate) -> Timing:
    p = found.run.parameters
    offset, skew = (float(_deviation_of(found, group)[0]) for group in ("time_offset", "time_skew"))
    first = int(recording.imu.stamps_ns[0]), int(found.problem.reference.stamps_ns[0])
    stretch = recording.imu.stretch  # seconds by the stamps as recorded
    start, own = Clock((1.0 + stretch) * p.start), 1.0 + stretch
    return Timing(start.offset(*first), float(p.skew) + stretch * (1.0 + p.skew), own * offset, own * skew or None)


def _alignment(found: Estimate) -> Alignment:
    problem, p = found.problem, found.run.parameters
    gravity = Measured(gravity_r(p), _gravity_deviation(found))
    if "north" not in problem.layout:
        return Alignment(gravity)
    C = matrix(p.q_rn)
    if "earth_down" in problem.layout:
        J = C * problem.site.earth_rate_units[0]
        return Alignment(
            gravity, earth_rate=Measured(earth_rate_r(problem.site, p), _propagated(found, J, "north", "earth_down"))
        )
    return Alignment(gravity, north=Measured(north_r(p), _propagated(found, C[:, :2], "north")))


def _propagated(found: Estimate, J: Array, *groups: str) -> Array:
    """Return the standard deviations of J (k, n) times all the groups' parameters (n,)."""
    layout = found.problem.layout
    index = np.concatenate([np.r_[layout[group]] for group in groups])
    begin = np.cumsum([0, *(layout.whole(group) for group in groups)])
    J = J[:, np.concatenate([first + layout.present(group) for first, group in zip(begin, groups, strict=False)])]
    P = found.belief.covariance[np.ix_(index, index)]
    return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", J, P, J)))


def _gravity_deviation(found: Estimate) -> Array:
    """Return the standard deviation of gravity's components in r, (3,)."""
    layout, p = found.problem.layout, found.run.parameters
    present = [name for name in ("alignment", "gravity") if name in layout]
    if not present:
        return np.zeros(3)
    columns = []
    if "alignment" in layout:
        for i in range(layout["alignment"].stop - layout["alignment"].start):
            turned = multiply(p.q_rn, exp(_STEP * np.eye(3)[i]))
            columns.append((gravity_r(replace(p, q_rn=turned)) - gravity_r(p)) / _STEP)
    if "gravity" in layout:
        columns.append(matrix(p.q_rn)[:, 2])
    return _propagated(found, np.column_stack(columns), *present)


def _derived(found: Estimate) -> Mapping[str, Measured]:
    problem, p = found.problem, found.run.parameters
    layout = problem.layout
    estimated = [group for group in SENSOR_GROUPS if group in layout]
    n = problem.sensor_degrees
    stored = {group: p.stored(group) for group in GROUPS}

    def moved(change: Array) -> SensorParameters:
        values = dict(stored)
        for group in estimated:
            values[group] = stored[group] + problem.whole(group, change[layout[group]])
        return CellParameters.from_stored(values).sensors

    return derive(p.sensors, _covariance(found, n), moved, _not_determined(problem))


def _not_determined(problem: Problem) -> tuple[str, ...]:
    """Return the groups whose values nobody measured or stated: those that are fixed without a value."""
    settings = problem.settings
    return tuple(group for group in settings.fixed if settings.value_of(group) is None)


def _others(found: Estimate) -> dict[str, Measured]:
    """Return the estimated groups that have no field of their own, by their path in the result file."""
    p = found.run.parameters
    present = [
        g for g in other_groups() if g in found.problem.layout or (p.stored(g) != group_named(g).nominal(1)).any()
    ]
    return {group_named(g).path: Measured(p.stored(g), _deviation_of(found, g)) for g in present}


def _robot_errors(found: Estimate, robot: RobotModel) -> RobotErrors:
    """Return the robot's errors, and the accuracy of its poses before and after."""
    layout = found.problem.layout
    errors = found.run.parameters.robot
    after, before = arm_covariances(found.problem, errors, found.belief.covariance)
    deviation, prior = np.sqrt(np.diag(after)), np.sqrt(np.diag(before))
    names = [name for group in ROBOT_GROUPS for name in parameter_names(group, 1, errors.joints)]
    lost = [n for n, a, b in zip(names, deviation, prior, strict=True) if b > 0.0 and a > NOT_SEPARABLE * b]

    def measured(group: str, value: Array) -> Measured:
        return Measured(value, deviation[errors.part(group)].reshape(value.shape))

    return RobotErrors(
        name=robot.arm.name,
        tcp=robot.arm.tcp,
        joints=tuple(robot.arm.joints),
        placement=measured("robot_placement", errors.placement),
        gears=measured("robot_gears", errors.gears) if "robot_gears" in layout else None,
        compliance=measured("robot_compliance", errors.compliance) if "robot_compliance" in layout else None,
        zeros=measured("robot_zeros", errors.zeros) if "robot_zeros" in layout else None,
        before=expected_accuracy(robot, before),
        found=shift(robot, errors),
        after=expected_accuracy(robot, after),
        not_separable=tuple(lost),
    )


def arm_covariances(problem: Problem, errors: RobotParameters, covariance: Array) -> tuple[Array, Array]:
    """Return the covariance of an arm's errors by that of a state, and before any look at the data, (10 n + 4) each."""
    layout = problem.layout
    present = [group for group in ROBOT_GROUPS if group in layout]
    after = np.zeros((errors.vector.size,) * 2)
    before = np.zeros_like(after)
    index = np.concatenate([np.r_[layout[group]] for group in present])
    place = np.concatenate([np.r_[errors.part(group)][layout.present(group)] for group in present])
    after[np.ix_(place, place)] = covariance[np.ix_(index, index)]
    for group in present:
        own = np.r_[errors.part(group)][layout.present(group)]
        before[np.ix_(own, own)] = problem.prior.covariance[group]
    return after, before


def _estimates(recording: Recording, found: Estimate, n: int) -> Array:
    """Return IMU seconds, estimates and deviations at every update; the last row is the result itself."""
    history, run, layout = found.run.history, found.run, found.problem.layout
    table = np.column_stack([history.seconds, history.parameters, history.deviations * found.correlation_factor])
    for group in found.problem.groups:
        if group != "alignment":
            d = layout[group]
            table[-1, 1 + d.start : 1 + d.stop] = found.problem.stored(run.parameters, group)
    if "time_offset" in layout:
        # from the first pose's IMU time to the offset between stamps, as in the result
        first = int(recording.imu.stamps_ns[0]), int(found.problem.reference.stamps_ns[0])
        column, own = 1 + layout["time_offset"].start, 1.0 + recording.imu.stretch
        table[:, column] = own * table[:, column] + Clock(0.0).offset(*first)
    table[-1, 1 + n :] = found.deviation[:n]
    return table
