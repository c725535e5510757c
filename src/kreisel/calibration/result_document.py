"""The content of `calibration.yaml`, schema kreisel/calibration/2, to and from the parts of a calibration.

Schema 1 is read too: it has other names for some derived quantities. `result-schema.json` describes schema 2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kreisel._version import __version__
from kreisel.calibration.data_sheet import OF_SCHEMA_1
from kreisel.calibration.device_axes import AXES
from kreisel.calibration.result_sections import (
    Alignment,
    CalibrationParts,
    Cause,
    Consistency,
    DeviceTriad,
    EstimatorFacts,
    FinalNoise,
    JointFacts,
    JointRecording,
    Measured,
    RecordingFacts,
    RobotErrors,
    StatedNoise,
    Timing,
    Verdict,
)
from kreisel.estimation.uncertainty_budget import Budget, Source
from kreisel.geometry.rotation import Array, nearest_rotation
from kreisel.inertial.counts import Counts
from kreisel.inertial.sensor_model import FORMULA, SensorParameters, SizeEffect, check_parameters
from kreisel.model.considered_terms import Considered
from kreisel.model.groups import group_named
from kreisel.model.parameters import SENSOR_GROUPS, other_groups
from kreisel.robot.pose_accuracy import PoseAccuracy

SCHEMA = "kreisel/calibration/2"

READ = ("kreisel/calibration/1", SCHEMA)
"""Schemas that can be read."""

FRAMES = (
    "b: body whose pose the reference gives (robot tool centre point, marker body). r: reference frame. "
    "i: inertial. Raw readings (primed) are corrected to true values: omega_ib_b, angular rate of b against i, "
    "and f_b, specific force at the origin of b (at standstill +g, upward), both along the axes of b. Row j of "
    "lever_arms is the position of accelerometer j in b; rows of the inverse of cross_coupling are the "
    "sensitive axes in b. gyroscope and accelerometer hold corrections (offset is added to a reading); derived holds "
    "the sensors' errors (a bias is what a sensor reads too much). SI and radians throughout, except where a name in "
    "derived ends with another unit."
)


def to_document(parts: CalibrationParts) -> dict[str, Any]:
    """Return the document of a calibration, schema 2: mappings, lists, texts, numbers, in the order of the file."""
    document: dict[str, Any] = {"schema": SCHEMA, "kreisel": __version__}
    if parts.recording is not None:
        document["recording"] = _recording_table(parts.recording)
    if parts.estimator is not None:
        document["estimator"] = _estimator_table(parts.estimator, parts.size_effect)
    values = {**_sensor_tables(parts.sensors), "timing": _timing_table(parts.timing)}
    deviations = {**_sensor_tables(parts.sensor_sd), "timing": _timing_sd_table(parts.timing)}
    for tables, of in ((values, "value"), (deviations, "deviation")):
        directions = {name: getattr(parts.alignment, name) for name in ("gravity", "north", "earth_rate")}
        tables["alignment"] = {name: _plain(getattr(d, of)) for name, d in directions.items() if d is not None}
        for path, other in parts.others.items():
            _put(tables, path, _plain(getattr(other, of)))
    derived = {name: _plain(quantity.value) for name, quantity in parts.derived.items()}
    deviations["derived"] = {name: _plain(quantity.deviation) for name, quantity in parts.derived.items()}
    document |= {"formula": dict(FORMULA), "frames": _frames(parts), **values}
    document |= {"standard_deviation": deviations, "derived": derived}
    if parts.robot is not None:
        document["robot"] = _robot_table(parts.robot)
    document |= {"consistency": _consistency_table(parts.consistency), "verdict": _verdict_table(parts.verdict)}
    document["considered"] = [_effect_table(effect) for effect in parts.considered]
    if parts.budget is not None:
        document["budget"] = _budget_table(parts.budget)
    document["axes"] = parts.axes
    if parts.triads:
        document["device_axes"] = {axes: _triad_table(triad) for axes, triad in parts.triads.items()}
    return document if parts.joint is None else document | {"joint": _joint_table(parts.joint)}


def _frames(parts: CalibrationParts) -> str:
    """Return what the frames are; without a reference there is no body but the sensors' own."""
    if parts.recording is None or parts.recording.reference_poses:
        return FRAMES
    return f"b: the accelerometers' own frame, {AXES[parts.axes]}. {FRAMES.partition('marker body). ')[2]}"


def from_document(document: Mapping[str, Any]) -> CalibrationParts:
    """Return the parts in a document of schema 1 or 2.

    Raises
    ------
    KeyError, TypeError, ValueError
        If an entry is missing or has another type; the message names it.
    """
    sd = _table(document, "standard_deviation")
    others = _others(document, sd)
    own = {g: others[path].value.ravel() for g in SENSOR_GROUPS if (path := group_named(g).path) in others}
    values, deviations = replace(_sensors(document), others=own), _sensors(sd) if sd else None
    check_parameters(values)
    estimator = document.get("estimator")
    derived = _derived(_table(document, "derived"), _table(sd, "derived"))
    if "axes" not in document:
        derived |= _along_own_axes(derived, values)
    return CalibrationParts(
        sensors=values,
        sensor_sd=_no_deviations(values) if deviations is None else deviations,
        size_effect=SizeEffect((estimator or {}).get("size_effect", SizeEffect.COMPLETED.value)),
        timing=_timing(_table(document, "timing"), _table(sd, "timing")),
        alignment=_alignment(_table(document, "alignment"), _table(sd, "alignment")),
        derived=derived,
        consistency=_consistency(_table(document, "consistency")),
        verdict=_verdict(document["verdict"]),
        recording=_recording(document["recording"]) if "recording" in document else None,
        estimator=None if estimator is None else _estimator(estimator),
        robot=_robot(document["robot"]) if "robot" in document else None,
        others=others,
        considered=tuple(_effect(table) for table in document.get("considered", ())),
        joint=_joint(document["joint"]) if "joint" in document else None,
        budget=_budget(_table(document, "budget")) if "budget" in document else None,
        axes=str(document.get("axes", "tool")),
        triads={axes: _triad(table) for axes, table in _table(document, "device_axes").items()},
    )


def _along_own_axes(derived: Mapping[str, Measured], sensors: SensorParameters) -> dict[str, Measured]:
    """Return the rotation between the triads along the device's axes: files without `axes` have it along b."""
    name = "gyro_to_accel_rotation_mrad"
    if name not in derived:
        return {}
    C = nearest_rotation(sensors.K_a).T
    along_b = derived[name]
    return {name: Measured(C @ along_b.value, np.sqrt(C**2 @ along_b.deviation**2))}


# Sensors, clocks and directions


def _sensor_tables(p: SensorParameters) -> dict[str, dict[str, Any]]:
    tables: dict[str, dict[str, Any]] = {}
    for name, K, k in (("gyroscope", p.K_omega, p.k_w), ("accelerometer", p.K_a, p.k_a)):
        tables[name] = {"cross_coupling": _plain(K), "offset": _plain(k[0])}
        if k.shape[0] > 1:
            tables[name]["polynomial"] = {i + 1: _plain(k[i]) for i in range(1, k.shape[0])}
    tables["accelerometer"]["lever_arms"] = _plain(p.lever_arms)
    return tables


def _sensors(document: Mapping[str, Any]) -> SensorParameters:
    def coefficients(table: Mapping[str, Any]) -> Array:
        polynomial = table.get("polynomial") or {}
        order = max([1, *(int(power) for power in polynomial)])
        rows = [polynomial.get(i, polynomial.get(str(i), [0.0, 0.0, 0.0])) for i in range(2, order + 1)]
        return _array([table["offset"], *rows], (order, 3))

    gyro, accel = document["gyroscope"], document["accelerometer"]
    k_w, k_a = coefficients(gyro), coefficients(accel)
    order = max(len(k_w), len(k_a))
    k_w, k_a = (np.vstack([k, np.zeros((order - len(k), 3))]) for k in (k_w, k_a))
    return SensorParameters(
        K_omega=_array(gyro["cross_coupling"], (3, 3)),
        k_w=k_w,
        K_a=_array(accel["cross_coupling"], (3, 3)),
        k_a=k_a,
        lever_arms=_array(accel["lever_arms"], (3, 3)),
    )


def _no_deviations(p: SensorParameters) -> SensorParameters:
    K_omega, k_w, K_a, k_a, arms = (np.full(x.shape, np.nan) for x in (p.K_omega, p.k_w, p.K_a, p.k_a, p.lever_arms))
    return SensorParameters(K_omega, k_w, K_a, k_a, arms)


def _timing_table(timing: Timing) -> dict[str, Any]:
    return {"offset": float(timing.offset), "skew": float(timing.skew)}


def _timing_sd_table(timing: Timing) -> dict[str, Any]:
    return {"offset": _rounded(timing.offset_sd), "skew": _rounded(timing.skew_sd)}


def _timing(values: Mapping[str, Any], deviations: Mapping[str, Any]) -> Timing:
    return Timing(
        _number(values.get("offset", 0.0)),
        _number(values.get("skew", 0.0)),
        _optional(deviations.get("offset")),
        _optional(deviations.get("skew")),
    )


def _alignment(values: Mapping[str, Any], deviations: Mapping[str, Any]) -> Alignment:
    def direction(name: str) -> Measured | None:
        if name not in values:
            return None
        return Measured(_array(values[name], (3,)), _array(deviations.get(name, [np.nan] * 3), (3,)))

    gravity = direction("gravity") or Measured(np.full(3, np.nan), np.full(3, np.nan))
    return Alignment(gravity, direction("north"), direction("earth_rate"))


def _derived(values: Mapping[str, Any], deviations: Mapping[str, Any]) -> dict[str, Measured]:
    out = {}
    for name, value in values.items():
        new, sign = OF_SCHEMA_1.get(name, (name, 1.0))
        out[new] = Measured(sign * _array(value, (3,)), _array(deviations.get(name, [np.nan] * 3), (3,)))
    return out


def _others(document: Mapping[str, Any], sd: Mapping[str, Any]) -> dict[str, Measured]:
    """Return the groups of parameters without a field of their own."""
    out = {}
    for path in (group_named(group).path for group in other_groups()):
        value, deviation = _get(document, path), _get(sd, path)
        if value is not None:
            value = np.asarray(value, dtype=float)
            nothing = np.full(value.shape, np.nan)
            out[path] = Measured(value, nothing if deviation is None else np.asarray(deviation, dtype=float))
    return out


# The device's own part


def _triad_table(triad: DeviceTriad) -> dict[str, Any]:
    def tables(of: str) -> dict[str, Any]:
        return {
            "gyroscope": {"cross_coupling": _plain(getattr(triad.gyro_matrix, of))},
            "accelerometer": {
                "cross_coupling": _plain(getattr(triad.accel_matrix, of)),
                "lever_arms": _plain(getattr(triad.lever_arms, of)),
            },
            "mounting": {
                "rotation_vector": _plain(getattr(triad.rotation_vector, of)),
                "position": _plain(getattr(triad.position, of)),
            },
        }

    table = tables("value")
    table["mounting"] = {"rotation": _plain(triad.rotation), **table["mounting"]}
    return table | {"standard_deviation": tables("deviation")}


def _triad(table: Mapping[str, Any]) -> DeviceTriad:
    def measured(part: str, name: str, shape: tuple[int, ...]) -> Measured:
        return Measured(_array(table[part][name], shape), _array(table["standard_deviation"][part][name], shape))

    return DeviceTriad(
        gyro_matrix=measured("gyroscope", "cross_coupling", (3, 3)),
        accel_matrix=measured("accelerometer", "cross_coupling", (3, 3)),
        lever_arms=measured("accelerometer", "lever_arms", (3, 3)),
        rotation=_array(table["mounting"]["rotation"], (3, 3)),
        rotation_vector=measured("mounting", "rotation_vector", (3,)),
        position=measured("mounting", "position", (3,)),
    )


# Recording and estimator


def _recording_table(facts: RecordingFacts) -> dict[str, Any]:
    temperature = {} if facts.temperature_c is None else {"temperature_c": _rounded(facts.temperature_c)}
    return {
        "name": facts.name,
        "reference": facts.reference,
        "imu_samples": facts.imu_samples,
        "imu_rate_hz": _rounded(facts.imu_rate_hz),
        "reference_poses": facts.reference_poses,
        "duration_s": _rounded(facts.duration_s),
        **temperature,
        **({} if facts.noise is None else {"noise": _noise_table(facts.noise)}),
        **{name: dict(table) for name, table in _texts_of(facts).items() if table},
        **({"reference_kind": facts.reference_kind} if facts.reference_kind else {}),
        **({} if facts.counts is None else {"counts": _counts_table(facts.counts)}),
        **({} if facts.digest is None else {"sha256": facts.digest, "begin_ns": facts.begin_ns}),
        "findings": list(facts.warnings),
    }


def _recording(table: Mapping[str, Any]) -> RecordingFacts:
    return RecordingFacts(
        str(table["name"]),
        str(table["reference"]),
        int(table["imu_samples"]),
        _number(table["imu_rate_hz"]),
        int(table["reference_poses"]),
        _number(table["duration_s"]),
        tuple(str(warning) for warning in table.get("findings", ())),
        None if table.get("temperature_c") is None else _number(table["temperature_c"]),
        None if table.get("noise") is None else _stated_noise(table["noise"]),
        **{name: _texts(_table(table, name)) for name in ("device", "certificate")},
        digest=None if table.get("sha256") is None else str(table["sha256"]),
        begin_ns=None if table.get("begin_ns") is None else int(table["begin_ns"]),
        reference_kind=str(table.get("reference_kind", "")),
        counts=None if table.get("counts") is None else _counts(table["counts"]),
    )


def _counts_table(counts: Counts) -> dict[str, Any]:
    return {
        "formula": "quantity = (count - zero) * size; the calibration is applied to quantities, rad/s and m/s^2",
        "rate": {"size": counts.rate, "zero": _plain(counts.rate_zero)},
        "acceleration": {"size": counts.acceleration, "zero": _plain(counts.acceleration_zero)},
    }


def _counts(table: Mapping[str, Any]) -> Counts:
    sizes, zeros = zip(
        *((_number(table[name]["size"]), _array(table[name]["zero"], (3,))) for name in ("rate", "acceleration")),
        strict=True,
    )
    return Counts(*sizes, *zeros)


def _texts_of(facts: RecordingFacts) -> dict[str, Mapping[str, str]]:
    return {"device": facts.device, "certificate": facts.certificate}


def _texts(table: Mapping[str, Any]) -> dict[str, str]:
    return {str(key): str(value) for key, value in table.items()}


_STATED = ("gyro_density", "accel_density", "gyro_walk", "accel_walk")


def _noise_table(noise: StatedNoise) -> dict[str, Any]:
    return {"source": noise.source, **{name: _rounded(getattr(noise, name)) for name in _STATED}}


def _stated_noise(table: Mapping[str, Any]) -> StatedNoise:
    return StatedNoise(str(table["source"]), *(_optional(table.get(name)) for name in _STATED))


_NOISE = (
    *("gyro_density", "accel_density", "position_sd", "orientation_sd"),
    *("standstill_position_sd", "standstill_orientation_sd"),
)


def _estimator_table(facts: EstimatorFacts, form: SizeEffect) -> dict[str, Any]:
    return {
        "name": facts.name,
        "sigma_points": facts.sigma_points,
        "states": facts.states,
        "update_interval": facts.update_interval,
        "updates": facts.updates,
        "passes": facts.passes,
        "filter_seconds": _rounded(facts.filter_seconds),
        "polynomial_order": facts.polynomial_order,
        "size_effect": form.value,
        "fixed": list(facts.fixed),
        "held": list(facts.held),
        "noise": {name: _rounded(getattr(facts.noise, name)) for name in _NOISE},
    }


def _estimator(table: Mapping[str, Any]) -> EstimatorFacts:
    return EstimatorFacts(
        name=str(table["name"]),
        sigma_points=str(table["sigma_points"]),
        states=int(table["states"]),
        update_interval=_number(table["update_interval"]),
        updates=int(table["updates"]),
        passes=int(table["passes"]),
        filter_seconds=_number(table["filter_seconds"]),
        polynomial_order=int(table["polynomial_order"]),
        fixed=_names(table.get("fixed", ())),
        held=_names(table.get("held", ())),
        noise=FinalNoise(*(_number(table["noise"].get(name)) for name in _NOISE)),
    )


def _robot_table(robot: RobotErrors) -> dict[str, Any]:
    table: dict[str, Any] = {"name": robot.name, "tcp": robot.tcp, "joints": list(robot.joints)}
    for name in ("placement", "gears", "compliance", "zeros"):
        errors = getattr(robot, name)
        if errors is not None:
            table[name] = _plain(errors.value)
            table[f"{name}_standard_deviation"] = _plain(errors.deviation)
    accuracies = {"found": robot.found, "believed_before": robot.before, "believed_after": robot.after}
    table["pose_error"] = {
        name: {"position_rms": _rounded(one.position), "orientation_rms": _rounded(one.orientation)}
        for name, one in accuracies.items()
    }
    return table | {"not_separable": list(robot.not_separable)}


def _robot(table: Mapping[str, Any]) -> RobotErrors:
    def errors(name: str) -> Measured | None:
        if name not in table:
            return None
        return Measured(*(np.array(table[key], dtype=float) for key in (name, f"{name}_standard_deviation")))

    def accuracy(name: str) -> PoseAccuracy:
        one = table["pose_error"][name]
        return PoseAccuracy(_number(one["position_rms"]), _number(one["orientation_rms"]))

    placement = errors("placement")
    if placement is None:
        raise KeyError("robot.placement")
    return RobotErrors(
        str(table["name"]), str(table["tcp"]), _names(table["joints"]), placement, errors("gears"),
        errors("compliance"), errors("zeros"),
        accuracy("believed_before"), accuracy("found"), accuracy("believed_after"),
        _names(table.get("not_separable", ())),
    )  # fmt: skip


# Consistency and verdict


def _consistency_table(facts: Consistency) -> dict[str, Any]:
    return {
        "nis_path": _rounded(facts.nis_path),
        "nis_standstill": _rounded(facts.nis_standstill),
        "updates": facts.updates,
        "rejected_updates": facts.rejected,
        "lag_one_correlation": _plain(facts.lag_one),
        "deviation_factor": _rounded(facts.correlation_factor),
        "synchronisation_correlation": _rounded(facts.synchronisation),
    }


def _consistency(table: Mapping[str, Any]) -> Consistency:
    return Consistency(
        nis_path=_number(table.get("nis_path")),
        nis_standstill=_number(table.get("nis_standstill")),
        updates=int(table.get("updates", 0)),
        rejected=int(table.get("rejected_updates", 0)),
        lag_one=_array(table.get("lag_one_correlation", [None] * 6), (6,)),
        correlation_factor=_number(table.get("deviation_factor", 1.0)),
        synchronisation=_number(table.get("synchronisation_correlation")),
    )


def _verdict_table(verdict: Verdict) -> dict[str, Any]:
    return {
        "accepted": verdict.accepted,
        "summary": verdict.summary,
        **({"sensors": dict(verdict.sensors)} if verdict.sensors else {}),
        **({"unasked": list(verdict.unasked)} if verdict.unasked else {}),
        "reasons": list(verdict.reasons),
        "unobservable": list(verdict.unobservable),
        "causes": [{"name": cause.name, "text": cause.text, "weight": float(cause.weight)} for cause in verdict.causes],
    }


def _verdict(table: Mapping[str, Any]) -> Verdict:
    accepted = table["accepted"]
    if not isinstance(accepted, bool):
        raise TypeError(f"verdict.accepted is {accepted!r}, expected true or false")
    causes = tuple(Cause(str(c["name"]), str(c["text"]), _number(c["weight"])) for c in table.get("causes", ()))
    return Verdict(
        accepted, _names(table.get("reasons", ())), _names(table.get("unobservable", ())), causes,
        _texts(_table(table, "sensors")), _names(table.get("unasked", ())),
    )  # fmt: skip


def _effect_table(effect: Considered) -> dict[str, Any]:
    return {
        "group": effect.group,
        "path": group_named(effect.group).path,
        "value": [_rounded(float(x)) for x in effect.value],
        "standard_deviation": [_rounded(float(x)) for x in effect.deviation],
        "gain": _rounded(effect.gain),
        "included": effect.included,
        "shift": _rounded(effect.shift),
        "shifted": effect.shifted,
    }


def _effect(table: Mapping[str, Any]) -> Considered:
    value, deviation = (np.array([_number(x) for x in table[name]]) for name in ("value", "standard_deviation"))
    included = table["included"]
    if not isinstance(included, bool):
        raise TypeError(f"considered.included is {included!r}, expected true or false")
    shift, shifted = _number(table["shift"]), str(table["shifted"])
    return Considered(str(table["group"]), value, deviation, _number(table["gain"]), included, shift, shifted)


def _budget_table(budget: Budget) -> dict[str, Any]:
    parameters = {
        name: {"standard_deviation": _rounded(sd), "percent": [round(100.0 * share, 3) for share in shares]}
        for name, sd, shares in zip(budget.names, budget.deviation.tolist(), budget.shares.tolist(), strict=True)
    }
    causes = [{"cause": cause, "source": str(source)} for cause, source in budget.causes.items()]
    return {"causes": causes, "parameters": parameters}


def _budget(table: Mapping[str, Any]) -> Budget:
    causes = {str(one["cause"]): Source(one["source"]) for one in table["causes"]}
    rows = _table(table, "parameters")
    shares = [_array(one["percent"], (len(causes),)) / 100.0 for one in rows.values()]
    deviation = np.array([_number(one["standard_deviation"]) for one in rows.values()])
    return Budget(_names(list(rows)), deviation, causes, np.array(shares).reshape(len(rows), len(causes)))


# Several recordings

_OWN = ("gyro_offset", "accel_offset", "turn", "shift")


def _joint_table(joint: JointFacts) -> dict[str, Any]:
    recordings = []
    for one in joint.recordings:
        values = {name: _plain(getattr(one, name).value) for name in _OWN}
        deviations = {name: _plain(getattr(one, name).deviation) for name in _OWN}
        recordings.append(
            {"name": one.name, **values, "timing": _timing_table(one.timing)}
            | {"standard_deviation": {**deviations, "timing": _timing_sd_table(one.timing)}}
        )
    return {
        "common": list(joint.common),
        "recordings": recordings,
        "left_out": [{"name": name, "reason": reason} for name, reason in joint.left_out],
        "chi_square": _rounded(joint.chi_square),
        "degrees_of_freedom": joint.degrees,
        "deviation_factor": _rounded(joint.factor),
        "differing": list(joint.differing),
    }


def _joint(table: Mapping[str, Any]) -> JointFacts:
    def recording(one: Mapping[str, Any]) -> JointRecording:
        sd = _table(one, "standard_deviation")
        own = {name: Measured(_array(one[name], (3,)), _array(sd[name], (3,))) for name in _OWN}
        return JointRecording(str(one["name"]), **own, timing=_timing(_table(one, "timing"), _table(sd, "timing")))

    return JointFacts(
        _names(table["common"]),
        tuple(recording(one) for one in table["recordings"]),
        tuple((str(one["name"]), str(one["reason"])) for one in table["left_out"]),
        _number(table["chi_square"]),
        int(table["degrees_of_freedom"]),
        _number(table["deviation_factor"]),
        _names(table["differing"]),
    )


# Numbers and texts


def _table(document: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    table = document.get(name, {})
    if not isinstance(table, Mapping):
        raise TypeError(f"{name} is {type(table).__name__}, expected a mapping")
    return table


def _array(value: Any, shape: tuple[int, ...]) -> Array:
    """Return numbers in a shape, null as not a number."""
    return np.array(value, dtype=float).reshape(shape)


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _optional(value: Any) -> float | None:
    return None if value is None else float(value)


def _names(values: Sequence[Any]) -> tuple[str, ...]:
    return tuple(str(value) for value in values)


def _get(tree: Mapping[str, Any], path: str) -> Any:
    """Return the entry at a path of names separated by dots; None where there is none."""
    here: Any = tree
    for name in path.split("."):
        here = here.get(name) if isinstance(here, Mapping) else None
    return here


def _put(tree: dict[str, Any], path: str, value: Any) -> None:
    """Put a value into a tree at a path of names separated by dots."""
    *above, last = path.split(".")
    for name in above:
        tree = tree.setdefault(name, {})
    tree[last] = value


def _rounded(value: float | None) -> float | None:
    """Return a number to six digits; null where there is none."""
    return None if value is None or not np.isfinite(value) else float(f"{value:.6g}")


def _plain(values: Array) -> Any:
    """Return an array as lists, and one without axes as a number; null for what is not a number."""
    array = np.asarray(values)
    if array.ndim:
        return [_plain(value) for value in array]
    return float(array) if np.isfinite(array) else None
