"""The content of the result file of a calibration from standstills."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kreisel.calibration.data_sheet import derive
from kreisel.calibration.device_axes import device_triads
from kreisel.calibration.recording_facts import recording_facts
from kreisel.calibration.result_sections import (
    Alignment,
    CalibrationParts,
    Consistency,
    DeviceTriad,
    EstimatorFacts,
    FinalNoise,
    Measured,
    RecordingFacts,
    Timing,
    Verdict,
)
from kreisel.estimation.uncertainty import Contribution
from kreisel.estimation.uncertainty_budget import Budget, Source
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.model.groups import group_named
from kreisel.model.parameters import SENSOR_GROUPS, other_groups, sensor_fields
from kreisel.recording.recording import DataWarning, Recording
from kreisel.static.multi_position import KINDS, StaticEstimate
from kreisel.static.pose_attitudes import PoseAttitudes
from kreisel.static.rest_problem import RestProblem
from kreisel.static.static_methods import Chosen

_ANYWHERE = 1.0
"""m; deviation of lever arms, of which standstills show nothing. Chosen: no tool is larger."""


@dataclass(frozen=True)
class Judged:
    """What is known of a result besides the estimate: method, covariance, budget, verdict, seconds and warnings."""

    chosen: Chosen
    covariance: Array
    budget: Budget
    verdict: Verdict
    seconds: float
    warnings: tuple[DataWarning, ...]


def parts_of(recording: Recording, found: StaticEstimate, judged: Judged) -> CalibrationParts:
    """Return the content of the result file."""
    problem, p, covariance = found.problem, found.parameters, judged.covariance
    deviation = np.sqrt(np.diag(covariance))
    layout, order = problem.layout, problem.order
    n = sum(part.degrees for part in layout if part.name in SENSOR_GROUPS)

    def moved(change: Array) -> SensorParameters:
        return problem.changed(p, np.pad(change, (0, layout.degrees - n))).sensors

    def whole(group: str) -> Array:
        out = np.zeros(group_named(group).degrees(order))
        if group in layout:
            out[layout.present(group)] = deviation[layout[group]]
        return out

    others = {group_named(g).path: Measured(p.stored(g), whole(g)) for g in other_groups() if g in layout}
    size = float(whole("gravity")[0])
    gravity = Measured(np.array([0.0, 0.0, p.gravity]), np.array([0.0, 0.0, size]))
    if not problem.own_frame:
        gravity = _gravity(found, size)
    sensor_sd = sensor_fields({group: whole(group) for group in SENSOR_GROUPS})
    return CalibrationParts(
        sensors=p.sensors,
        sensor_sd=sensor_sd,
        size_effect=SizeEffect.COMPLETED,
        timing=Timing(),
        alignment=Alignment(gravity),
        derived=derive(p.sensors, covariance[:n, :n], moved, ("lever_arms",)),
        consistency=_consistency(found),
        verdict=judged.verdict,
        recording=_facts(recording, found.problem, judged),
        estimator=_estimator_facts(found, judged),
        others=others,
        considered=found.considered,
        budget=judged.budget,
        axes="imu" if problem.own_frame else "tool",
        triads={} if problem.own_frame else _triads(found, judged, sensor_sd),
    )


def _gravity(found: StaticEstimate, size: float) -> Measured:
    """Return gravity in the reference frame. size: deviation of its magnitude, m/s^2."""
    problem, g = found.problem, found.parameters.gravity
    known = next(one for one in problem.known if isinstance(one, PoseAttitudes))
    frame, tilt = known.frame(found.parameters), problem.layout["reference"]
    index = np.r_[problem.layout["gravity"], tilt]
    J = np.column_stack([frame[:, 2], g * frame[:, 1], -g * frame[:, 0]])
    P = found.covariance[np.ix_(index, index)].copy()
    P[0, 0] = size**2
    return Measured(g * frame[:, 2], np.sqrt(np.einsum("ij,jk,ik->i", J, P, J)))


def _facts(recording: Recording, problem: RestProblem, judged: Judged) -> RecordingFacts:
    reference, warnings = recording.reference, judged.warnings
    if problem.own_frame or reference is None:
        return replace(recording_facts(recording, warnings, "gravity", 0), counts=judged.chosen.counts)
    kind = recording.settings.reference.kind or ""
    return recording_facts(recording, warnings, reference.name, reference.stamps_ns.size, kind)


def _triads(found: StaticEstimate, judged: Judged, sensor_sd: SensorParameters) -> dict[str, DeviceTriad]:
    """Return the device's own part, with the mounting on the tool split off."""
    names = found.problem.names[: judged.covariance.shape[0]]
    anywhere = replace(sensor_sd, lever_arms=np.full((3, 3), _ANYWHERE))
    return device_triads(found.parameters.sensors, anywhere, names, judged.covariance)


def budget_of(found: StaticEstimate, more: Sequence[Contribution]) -> Budget:
    """Return what comes from gravity's uncertainty, from noise and errors of standstills, and from contributions."""
    layout, n = found.problem.layout, found.problem.reported
    own = np.diag(found.covariance)[:n]
    gravity = found.covariance[:n, layout["gravity"].start] ** 2 / found.problem.site.gravity_sd**2
    gravity = np.minimum(gravity, own)
    rows: list[tuple[str, Source, Array]] = [
        ("noise and errors of standstills and turns", Source.SENSOR, own - gravity),
        ("gravity", Source.PRIOR, gravity),
        *((one.cause, one.source, one.variance) for one in more),
    ]
    causes = {cause: source for cause, source, _ in rows}
    return Budget.of(found.problem.names[:n], causes, np.column_stack([variance for _, _, variance in rows]))


def _consistency(found: StaticEstimate) -> Consistency:
    force, rate, turn = (found.residuals[kind] for kind in KINDS)
    updates = len(force) + len(turn)
    return Consistency(
        nis_path=float(np.sum(turn**2) / max(2 * len(turn), 1)),  # their heading is free
        nis_standstill=float((np.sum(force**2) + np.sum(rate**2)) / (force.size / 3 + rate.size)),
        updates=updates,
        rejected=len(found.left_out),
        lag_one=np.full(6, np.nan),
        correlation_factor=1.0,
        synchronisation=float("nan"),
    )


def _estimator_facts(found: StaticEstimate, judged: Judged) -> EstimatorFacts:
    rests = found.problem.rests
    nothing = float("nan")
    return EstimatorFacts(
        name=judged.chosen.name,
        sigma_points="linear",
        states=found.problem.layout.degrees,
        update_interval=0.0,
        updates=rests.count + found.linear.turn.node.size,
        passes=1,
        filter_seconds=judged.seconds,
        polynomial_order=found.problem.order,
        fixed=("lever_arms", "time_offset"),
        noise=FinalNoise(*(float(np.sqrt(np.mean(d**2))) for d in (rests.density_w, rests.density_a)), *[nothing] * 4),
    )
