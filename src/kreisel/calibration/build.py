"""The filter's problem, put together from all that comes before the filter."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from kreisel.calibration.first_values import nominal_parameters, starting_point, stated_prior
from kreisel.calibration.groups import REGISTRY
from kreisel.calibration.parameters import GROUPS, ROBOT_GROUPS, CellParameters
from kreisel.calibration.problem import MIN_UPDATES, REACH, PoseError, Problem, build_layout, schedule
from kreisel.calibration.robot_errors import ANGLE_SD, LENGTH_SD
from kreisel.calibration.settings import CalibrationSettings
from kreisel.calibration.setup import Preparation, first_attitudes
from kreisel.errors import SynchronizationError
from kreisel.estimation.state import StateLayout
from kreisel.geometry.rotation import Array
from kreisel.recording import ReferencePoses
from kreisel.recording.recording import angles_over
from kreisel.synchronization import Clock

INTERVALS = {"robot": 0.48, "mocap": 0.24}
"""Seconds between updates. The paper's 0.48 s suit a robot whose errors stay alike over tenths of a
second; motion capture errs nearly independently from frame to frame, and hands move less smoothly."""

NO_ROBOT = ("vicon", "leica", "state_groundtruth", "mocap")
"""How references are called that are no robot's, as in EuRoC recordings, where their kind is not stated."""

_HALF_A_CHAIN = math.sqrt(2.0)
_POSTURE, _POSTURE_TIMES = 0.5, (1.0, 100.0)  # rad, s


def _frame_sd(preparation: Preparation) -> tuple[float, float]:
    """Return how far a robot's errors move base and tool, m and rad, where they cannot be estimated."""
    settings = preparation.recording.settings
    kind = settings.reference.kind or ("mocap" if preparation.reference.name.startswith(NO_ROBOT) else "robot")
    if preparation.robot is not None or kind == "mocap":
        return (0.0, 0.0)
    length, angle = settings.robot.length_sd, settings.robot.angle_sd
    # half of the chain's errors act like another base, half like another tool
    return (
        _HALF_A_CHAIN * (LENGTH_SD if length is None else length),
        _HALF_A_CHAIN * (ANGLE_SD if angle is None else angle),
    )


def _with_held_values(start: CellParameters, preparation: Preparation, settings: CalibrationSettings) -> CellParameters:
    """Return the first values with those the user holds groups at."""
    if not settings.held_at:
        return start
    stored = {group: start.stored(group) for group in GROUPS}
    for group in settings.fixed:
        value = settings.value_of(group)
        if value is not None:
            stored[group] = value
            if group == "time_offset":  # between stamps, as in the result; here between first IMU sample and first pose
                first = int(preparation.recording.imu.stamps_ns[0]), int(preparation.reference.stamps_ns[0])
                stored[group] = value - Clock(0.0).offset(*first)
    return CellParameters.from_stored(stored)


def _of_layout(covariance: dict[str, Array], layout: StateLayout) -> dict[str, Array]:
    """Return the covariance of every group in a layout; that of usual devices where no other is known."""
    out = {}
    for group in REGISTRY:
        if group.name not in layout:
            continue
        degrees = layout[group.name].stop - layout[group.name].start
        usual = (group.usual_sd or 1.0) ** 2 * np.eye(degrees)
        out[group.name] = covariance.get(group.name, usual)
    return out


def _pose_error(reference: ReferencePoses, frame_sd: tuple[float, float]) -> PoseError:
    """Return the error of poses that another base and another tool frame leave of a robot's geometric errors.

    It is taken to be as large as that of the frames; an angle acts on positions over `REACH`. It changes as the
    posture does: much, once the tool has turned by `_POSTURE`.
    """
    length, angle = frame_sd
    if max(frame_sd) == 0.0:
        return PoseError()
    turned = 0.0
    if reference.quaternions is not None:
        stride = max(1, round(0.2 / reference.interval))
        turned = float(np.sum(angles_over(reference.quaternions, stride)[::stride]))
    seconds = float(reference.seconds[-1])
    time = float(np.clip(_POSTURE * seconds / max(turned, 1e-9), *_POSTURE_TIMES))
    return PoseError(math.hypot(length, REACH * angle), angle, time)


def build_problem(preparation: Preparation, settings: CalibrationSettings) -> Problem:
    """Return the problem for the filter.

    Raises
    ------
    SynchronizationError
        If too little of the reference lies within the IMU's recording.
    """
    fit, site, reference = preparation.rate_fit, preparation.site, preparation.reference
    start, start_covariance = starting_point(preparation, settings.polynomial_order)
    prior, prior_covariance = stated_prior(preparation, settings.polynomial_order)
    skewed = fit.skewed if settings.skew is None else settings.skew
    if not skewed:
        start = replace(start, skew=0.0)
    start = _with_held_values(start, preparation, settings)
    kind = preparation.recording.settings.reference.kind or "robot"
    interval = settings.update_interval or INTERVALS[kind]
    tau = reference.seconds
    clock = Clock(start.start, start.skew)
    updates = schedule(preparation.readings, clock.imu_time(tau), tau, preparation.rests, interval)
    if len(updates) < MIN_UPDATES:
        raise SynchronizationError(
            f"{reference.source}: only {len(updates)} updates of {interval:g} s lie within the IMU's recording; "
            f"expected {MIN_UPDATES} or more: record longer, or use a shorter --update-interval"
        )
    noise = preparation.imu_noise
    given = {}
    if noise.gyro_offset_sd is not None:
        given["gyro_offset"] = np.full(3, noise.gyro_offset_sd)
    if noise.accel_offset_sd is not None:
        given["accel_offset"] = np.full(3, noise.accel_offset_sd)
    frame_sd = _frame_sd(preparation)
    pose_error = _pose_error(reference, frame_sd)
    layout = build_layout(
        settings,
        latitude=site.earth_rate_n is not None,
        skew=skewed,
        rest_error=any(u.rest is not None for u in updates),
        path_error=(
            pose_error.position > 0.0 and reference.positions is not None,
            pose_error.orientation > 0.0 and reference.quaternions is not None,
        ),
        joints=0 if preparation.robot is None else preparation.robot.joints,
    )
    return Problem(
        readings=preparation.readings,
        reference=reference,
        attitude=first_attitudes(preparation, np.array([update.last for update in updates])),
        tau=tau,
        clock=clock,
        settings=settings,
        site=site,
        noise=preparation.noise,
        least_noise=(0.1 * preparation.noise.position, 0.1 * preparation.noise.orientation),
        imu_bounds=(preparation.imu_noise.gyro_bounds, preparation.imu_noise.accel_bounds),
        offset_walk={"gyro_offset": preparation.imu_noise.gyro_walk, "accel_offset": preparation.imu_noise.accel_walk},
        layout=layout,
        start=start,
        start_covariance=_of_layout(start_covariance, layout),
        prior=prior,
        prior_covariance=_of_layout(prior_covariance, layout),
        prior_width={
            **{g.name: np.array([g.usual_sd]) for g in REGISTRY if g.usual_sd is not None},
            **given,
            "gravity": np.array([site.gravity_sd]),
            **{g: np.sqrt(np.diag(prior_covariance[g])) for g in ROBOT_GROUPS if g in prior_covariance},
        },
        given_priors=tuple(given),
        nominal=nominal_parameters(preparation, settings.polynomial_order),
        rests=preparation.rests,
        updates=updates,
        update_interval=interval,
        robot=preparation.robot,
        frame_sd=frame_sd,
        pose_error=pose_error,
        standstill=preparation.standstill,
        lateness=math.hypot(preparation.recording.imu.lateness, preparation.reference.lateness),
        rate_scatter=preparation.imu_noise.gyro_scatter,
    )
