"""The content of `calibration.yaml`: schema kreisel/calibration/1."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kreisel._version import __version__
from kreisel.calibration.data_sheet import derive
from kreisel.calibration.evidence import Consistency, Verdict
from kreisel.calibration.result import FRAMES, SCHEMA
from kreisel.filtering.estimate import Estimate
from kreisel.filtering.noise_adaptation import imu_density
from kreisel.filtering.observability import Observability
from kreisel.geometry.rotation import Array, exp, matrix, multiply
from kreisel.inertial.sensor_model import FORMULA, SensorParameters
from kreisel.model.groups import group_named
from kreisel.model.parameters import GROUPS, ROBOT_GROUPS, SENSOR_GROUPS, CellParameters, other_groups, parameter_names
from kreisel.model.problem import Problem
from kreisel.model.robot import NOT_SEPARABLE, PoseAccuracy, expected_accuracy, shift
from kreisel.preparation.preparation import Preparation
from kreisel.recording.recording import Finding, Recording
from kreisel.synchronization.clock import Clock


def document(
    recording: Recording,
    preparation: Preparation,
    found: Estimate,
    seen: Observability,
    facts: Consistency,
    verdict: Verdict,
    findings: tuple[Finding, ...],
    seconds: float,
) -> dict[str, Any]:
    """Return the document; `seconds` is what the estimation took."""
    problem = found.problem
    settings, noise = problem.settings, problem.noise.reference
    gyro_density, accel_density = imu_density(problem)
    values, deviations = _derived(found)
    imu, reference = recording.imu, preparation.reference
    return {
        "schema": SCHEMA,
        "kreisel": __version__,
        "recording": {
            "name": recording.name,
            "reference": reference.name,
            "imu_samples": int(imu.stamps_ns.size),
            "imu_rate_hz": _number(1.0 / imu.interval),
            "reference_poses": int(reference.stamps_ns.size),
            "duration_s": _number(float(imu.seconds[-1])),
            "findings": [str(finding) for finding in findings],
        },
        "estimator": {
            "name": settings.estimator,
            "sigma_points": settings.weights,
            "states": problem.layout.degrees,
            "update_interval": problem.schedule.interval,
            "updates": facts.updates,
            "passes": found.passes,
            "filter_seconds": _number(seconds),
            "polynomial_order": settings.polynomial_order,
            "size_effect": settings.size_effect.value,
            "fixed": list(settings.fixed),
            "held": list(problem.held),
            "noise": {
                "gyro_density": _number(gyro_density),
                "accel_density": _number(accel_density),
                "position_sd": _number(noise.position),
                "orientation_sd": _number(noise.orientation),
                "standstill_position_sd": _number(noise.standstill_position),
                "standstill_orientation_sd": _number(noise.standstill_orientation),
            },
        },
        "formula": dict(FORMULA),
        "frames": FRAMES,
        **_values(recording, found),
        "standard_deviation": {**_deviations(found), "derived": {name: _list(v) for name, v in deviations.items()}},
        "derived": {name: _list(value) for name, value in values.items()},
        **_robot(found),
        "consistency": {
            "nis_path": _number(facts.nis_path),
            "nis_standstill": _number(facts.nis_standstill),
            "updates": facts.updates,
            "rejected_updates": facts.rejected,
            "lag_one_correlation": _list(facts.lag_one),
            "deviation_factor": _number(facts.correlation_factor),
            "synchronisation_correlation": _number(preparation.correlation.coefficient),
        },
        "verdict": {
            "accepted": verdict.accepted,
            "summary": verdict.summary,
            "reasons": list(verdict.reasons),
            "unobservable": list(seen.unobservable),
        },
    }


def _values(recording: Recording, found: Estimate) -> dict[str, Any]:
    p = found.run.parameters
    s = p.sensors
    first = int(recording.imu.stamps_ns[0]), int(found.problem.reference.stamps_ns[0])
    tables: dict[str, dict[str, Any]] = {
        "gyroscope": {"cross_coupling": _list(s.K_omega), "offset": _list(s.k_w[0])},
        "accelerometer": {"cross_coupling": _list(s.K_a), "offset": _list(s.k_a[0])},
    }
    for name, k in (("gyroscope", s.k_w), ("accelerometer", s.k_a)):
        if k.shape[0] > 1:
            tables[name]["polynomial"] = {i + 1: _list(k[i]) for i in range(1, k.shape[0])}
    tables["accelerometer"]["lever_arms"] = _list(s.lever_arms)
    tables["timing"] = {"offset": float(Clock(p.start, p.skew).offset(*first)), "skew": float(p.skew)}
    tables["alignment"] = {"gravity": _list(gravity_r(p))}
    if "earth_down" not in found.problem.layout and "north" in found.problem.layout:
        tables["alignment"]["north"] = _list(north_r(p))
    for group in other_groups():
        if group in found.problem.layout:
            _put(tables, group_named(group).path, _list(p.stored(group)))
    if "earth_down" in found.problem.layout:
        tables["alignment"]["earth_rate"] = _list(earth_rate_r(found.problem, p))
    return tables


def _put(tree: dict[str, Any], path: str, value: Any) -> None:
    """Put a value into a tree at a path of names with points between."""
    *above, last = path.split(".")
    for name in above:
        tree = tree.setdefault(name, {})
    tree[last] = value


def _robot(found: Estimate) -> dict[str, Any]:
    """Return the robot's errors, their standard deviations, and the accuracy of its poses before and after."""
    problem, layout = found.problem, found.problem.layout
    if problem.robot is None:
        return {}
    errors = found.run.parameters.robot
    present = [g for g in ROBOT_GROUPS if g in layout]
    index = np.concatenate([np.arange(layout[g].start, layout[g].stop) for g in present])
    P = found.run.belief.covariance[np.ix_(index, index)]
    after = np.zeros((errors.vector.size,) * 2)
    before = np.zeros_like(after)
    place = np.concatenate([np.arange(errors.vector.size)[errors.part(g)] for g in present])
    after[np.ix_(place, place)] = P
    for group in present:
        part = errors.part(group)
        before[part, part] = problem.prior.covariance[group]
    deviation, prior = np.sqrt(np.diag(after)), np.sqrt(np.diag(before))
    names = [name for g in ROBOT_GROUPS for name in parameter_names(g, 1, errors.joints)]
    lost = [n for n, a, b in zip(names, deviation, prior, strict=True) if b > 0.0 and a > NOT_SEPARABLE * b]
    accuracies = {"believed_before": before, "believed_after": after}
    table: dict[str, Any] = {
        "name": problem.robot.arm.name,
        "tcp": problem.robot.arm.tcp,
        "joints": list(problem.robot.arm.joints),
        "placement": _list(errors.placement),
        "placement_standard_deviation": _list(deviation[errors.part("robot_placement")].reshape(-1, 6)),
    }
    for group, value in (("robot_gears", errors.gears), ("robot_compliance", errors.compliance)):
        if group in layout:
            name = group.removeprefix("robot_")
            table[name] = _list(value)
            table[f"{name}_standard_deviation"] = _list(deviation[errors.part(group)].reshape(value.shape))
    table["pose_error"] = {"found": _accuracy(shift(problem.robot, errors))} | {
        name: _accuracy(expected_accuracy(problem.robot, covariance)) for name, covariance in accuracies.items()
    }
    table["not_separable"] = lost
    return {"robot": table}


def _accuracy(accuracy: PoseAccuracy) -> dict[str, float | None]:
    return {"position_rms": _number(accuracy.position), "orientation_rms": _number(accuracy.orientation)}


def gravity_r(parameters: CellParameters) -> Array:
    """Return gravity in r, (3,), m/s^2."""
    return matrix(parameters.q_rn)[:, 2] * parameters.gravity


def north_r(parameters: CellParameters) -> Array:
    """Return north in r, (3,), a level vector of about unit length (exactly so only as far as it is seen)."""
    return matrix(parameters.q_rn)[:, :2] @ parameters.north


def earth_rate_r(problem: Problem, parameters: CellParameters) -> Array:
    """Return the Earth's rotation in r, (3,), rad/s, where it is estimated."""
    level, down = problem.site.earth_rate_units
    return matrix(parameters.q_rn) @ np.array([*(level * parameters.north), down * parameters.earth_down])


def _deviations(found: Estimate) -> dict[str, Any]:
    """Return the standard deviations as the same tree; held groups with what was believed of them."""
    problem, deviation = found.problem, found.run.belief.standard_deviation
    order = problem.settings.polynomial_order

    def of(group: str, size: int) -> Array:
        if group in problem.layout:
            return deviation[problem.layout[group]]
        return np.resize(problem.prior.width[group], size) if group in problem.held else np.zeros(size)

    tree: dict[str, Any] = {
        "gyroscope": {
            "cross_coupling": _list(of("gyro_cross_coupling", 9).reshape(3, 3)),
            "offset": _list(of("gyro_offset", 3)),
        },
        "accelerometer": {
            "cross_coupling": _list(of("accel_cross_coupling", 9).reshape(3, 3)),
            "offset": _list(of("accel_offset", 3)),
        },
    }
    if order > 1:
        for name, group in (("gyroscope", "gyro_polynomial"), ("accelerometer", "accel_polynomial")):
            rows = of(group, 3 * (order - 1)).reshape(-1, 3)
            tree[name]["polynomial"] = {i + 2: _list(row) for i, row in enumerate(rows)}
    tree["accelerometer"]["lever_arms"] = _list(of("lever_arms", 9).reshape(3, 3))
    tree["timing"] = {"offset": _number(of("time_offset", 1)[0]), "skew": _number(of("time_skew", 1)[0]) or None}
    tree["alignment"] = {"gravity": _list(_gravity_deviation(found))}
    for group in other_groups():
        if group in problem.layout:
            _put(tree, group_named(group).path, _list(deviation[problem.layout[group]]))
    if "earth_down" not in problem.layout and "north" in problem.layout:
        n = problem.layout["north"]
        P = found.run.belief.covariance[n, n]
        C = matrix(found.run.parameters.q_rn)[:, :2]
        tree["alignment"]["north"] = _list(np.sqrt(np.einsum("ij,jk,ik->i", C, P, C)))
    if "earth_down" in problem.layout:
        index = np.r_[problem.layout["north"], problem.layout["earth_down"]]
        P = found.run.belief.covariance[np.ix_(index, index)]
        C = matrix(found.run.parameters.q_rn) * problem.site.earth_rate_units[0]
        tree["alignment"]["earth_rate"] = _list(np.sqrt(np.einsum("ij,jk,ik->i", C, P, C)))
    return tree


def _gravity_deviation(found: Estimate) -> Array:
    """Return the standard deviation of gravity's components in r, (3,)."""
    problem, p = found.problem, found.run.parameters
    layout = problem.layout
    rows = [layout[name] for name in ("alignment", "gravity") if name in layout]
    if not rows:
        return np.zeros(3)
    columns = []
    if "alignment" in layout:
        for i in range(layout["alignment"].stop - layout["alignment"].start):
            turned = multiply(p.q_rn, exp(1e-6 * np.eye(3)[i]))
            columns.append((gravity_r(replace(p, q_rn=turned)) - gravity_r(p)) / 1e-6)
    if "gravity" in layout:
        columns.append(matrix(p.q_rn)[:, 2])
    J = np.column_stack(columns)
    index = np.concatenate([np.arange(r.start, r.stop) for r in rows])
    P = found.run.belief.covariance[np.ix_(index, index)]
    return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", J, P, J)))


def _derived(found: Estimate) -> tuple[dict[str, Array], dict[str, Array]]:
    problem, p = found.problem, found.run.parameters
    layout = problem.layout
    estimated = [g for g in SENSOR_GROUPS if g in layout]
    n = problem.sensor_degrees
    stored = {group: p.stored(group) for group in GROUPS}

    def moved(change: Array) -> SensorParameters:
        values = dict(stored)
        for group in estimated:
            values[group] = stored[group] + change[layout[group]]
        return CellParameters.from_stored(values).sensors

    return derive(p.sensors, found.run.belief.covariance[:n, :n], moved)


def _number(value: float) -> float | None:
    value = float(value)
    return float(f"{value:.6g}") if np.isfinite(value) else None


def _list(values: Array) -> list[Any]:
    return [_list(v) if isinstance(v, np.ndarray) else _plain(float(v)) for v in np.asarray(values)]


def _plain(value: float) -> float | None:
    return value if np.isfinite(value) else None
