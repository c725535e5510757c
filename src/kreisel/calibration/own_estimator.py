"""A user's own estimator: what it is given, what it returns, and what that means to the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from kreisel.calibration.data_sheet import derive
from kreisel.calibration.result_sections import Measured
from kreisel.errors import EstimationError, unknown_name
from kreisel.geometry.rotation import Array, exp, matrix, multiply
from kreisel.inertial.sensor_model import SensorParameters, check_parameters
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.preparation.preparation import Preparation
from kreisel.synchronization.clock import Clock

Tree = Mapping[str, Mapping[str, Any]]
"""Numbers by section and name, as in the result file."""

_SHAPES: dict[str, dict[str, tuple[int, ...]]] = {
    "gyroscope": {"cross_coupling": (3, 3), "offset": (3,)},
    "accelerometer": {"cross_coupling": (3, 3), "offset": (3,), "lever_arms": (3, 3)},
    "timing": {"offset": ()},
    "alignment": {"gravity": (3,)},
}
"""What an own estimator may estimate."""

_FIELDS = {
    ("gyroscope", "cross_coupling"): "gyro_cross_coupling",
    ("gyroscope", "offset"): "gyro_offset",
    ("accelerometer", "cross_coupling"): "accel_cross_coupling",
    ("accelerometer", "offset"): "accel_offset",
    ("accelerometer", "lever_arms"): "lever_arms",
}
"""Groups of sensor parameters by section and name."""


@dataclass(frozen=True)
class Measurements:
    """What an own estimator is given: readings, poses and what is known before, all in SI units.

    Gaps are filled as for every other estimator: lost samples are put back where the stamps show them, and poses that
    belong to no reading are left out.

    Attributes
    ----------
    imu_seconds : (n,)
        Since the first sample.
    rates, forces : (n, 3)
        Raw angular rates, rad/s, and specific forces, m/s^2.
    pose_seconds : (m,)
        On the IMU's clock, by the first synchronisation: a hundredth of a second or better. If the poses are later by
        dt than these say, timing.offset is that of `start` plus dt.
    positions : (m, 3) or None
        Of the body in the reference's frame, m.
    quaternions : (m, 4) or None
        That turn vectors from the body to the reference's frame; Hamilton's, scalar first.
    standstills
        First and last second of each, on the IMU's clock.
    gyro_noise, accel_noise : (3,)
        Densities of white noise, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz).
    position_noise, orientation_noise
        Standard deviations of white noise of a pose on the path, of each component, m and rad. Errors that last, those
        of an arm's geometry and of its frames, come on top, and nothing here states them.
    earth_rate : (3,) or None
        Of the Earth in the reference's frame, rad/s, by the first values, whose north may be far off; None where no
        latitude is stated.
    start
        First values: cross_coupling and offset of gyroscope and accelerometer, the accelerometer's lever_arms,
        timing.offset, and gravity in the reference's frame (alignment.gravity), as in the result file.
    deviation
        Standard deviations of what is known of devices of the stated grade. First values are fitted to the same data:
        they are no prior.
    """

    imu_seconds: Array
    rates: Array
    forces: Array
    pose_seconds: Array
    positions: Array | None
    quaternions: Array | None
    standstills: tuple[tuple[float, float], ...]
    gyro_noise: Array
    accel_noise: Array
    position_noise: float
    orientation_noise: float
    earth_rate: Array | None
    start: dict[str, dict[str, Any]]
    deviation: dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Estimates:
    """What an own estimator returns.

    Attributes
    ----------
    values
        By section and name, as in `Measurements.start`; what is missing keeps its first value and is not compared.
    deviations
        Standard deviations of the same numbers.
    """

    values: Tree
    deviations: Tree


@runtime_checkable
class Estimator(Protocol):
    """An estimator of one's own, to compare with those of kreisel: anything with a name that estimates."""

    name: str

    def estimate(self, measured: Measurements) -> Estimates:
        """Return the parameters that the measurements show."""
        ...


def measurements_of(preparation: Preparation, problem: Problem, until: float = np.inf) -> Measurements:
    """Return what an own estimator is given of a prepared recording, up to a second of the IMU's clock."""
    readings, reference, start = problem.sensor.readings, problem.reference, problem.prior.start
    at = start.clock.imu_time(reference.seconds)
    kept, own = at <= until, readings.stamps <= until
    gyro, accel = np.sqrt(readings.noise[:2])
    earth = problem.site.earth_rate_n
    return Measurements(
        imu_seconds=readings.stamps[own],
        rates=readings.rates[own],
        forces=readings.accelerations[own],
        pose_seconds=at[kept],
        positions=None if reference.positions is None else reference.positions[kept],
        quaternions=None if reference.quaternions is None else reference.quaternions[kept],
        standstills=tuple((one.start, one.stop) for one in preparation.standstills if one.stop <= until),
        gyro_noise=gyro,
        accel_noise=accel,
        position_noise=problem.noise.reference.position,
        orientation_noise=problem.noise.reference.orientation,
        earth_rate=None if earth is None else matrix(start.q_rn) @ earth,
        start=_tree(_values_of(preparation, start)),
        deviation=_tree(_deviations_of(problem)),
    )


def _tree(values: Mapping[tuple[str, str], Array | float]) -> dict[str, dict[str, Any]]:
    out: dict[str, dict[str, Any]] = {}
    for (section, name), value in values.items():
        out.setdefault(section, {})[name] = value
    return out


def _values_of(preparation: Preparation, known: CellParameters) -> dict[tuple[str, str], Any]:
    values: dict[tuple[str, str], Any] = {
        place: np.reshape(known.stored(group), _SHAPES[place[0]][place[1]]) for place, group in _FIELDS.items()
    }
    values["timing", "offset"] = _offset(preparation, known.start)
    values["alignment", "gravity"] = known.gravity * matrix(known.q_rn)[:, 2]
    return values


def _deviations_of(problem: Problem) -> dict[tuple[str, str], Any]:
    width = problem.prior.width
    values: dict[tuple[str, str], Any] = {
        place: np.reshape(problem.whole(group, width[group]), _SHAPES[place[0]][place[1]])
        for place, group in _FIELDS.items()
        if group in problem.layout
    }
    if "time_offset" in problem.layout:
        values["timing", "offset"] = float(width["time_offset"][0])
    return values


def _offset(preparation: Preparation, start: float) -> float:
    """Return the time offset of the result file for an IMU second of the first pose."""
    imu, reference = preparation.recording.imu, preparation.reference
    return Clock((1.0 + imu.stretch) * start).offset(int(imu.stamps_ns[0]), int(reference.stamps_ns[0]))


def checked(found: Any) -> Estimates:
    """Return what an own estimator returned.

    Raises
    ------
    EstimationError
        If it has other names or shapes than `Measurements.start`, or a number that is not finite.
    """
    if not isinstance(found, Estimates):
        raise EstimationError(f"estimate() returned {type(found).__name__}, expected kreisel.Estimates")
    values, deviations = _checked(found.values, "values"), _checked(found.deviations, "deviations")
    for section, own in values.items():
        for key in own:
            deviation = deviations.get(section, {}).get(key)
            if deviation is None:
                raise EstimationError(f"{section}.{key} has no standard deviation; give it in `deviations`")
            if not np.all(np.asarray(deviation) > 0.0):
                raise EstimationError(f"{section}.{key} has a standard deviation that is not above zero")
    if not values:
        raise EstimationError("estimate() returned no values")
    return Estimates(values, deviations)


def _checked(tree: Any, what: str) -> dict[str, dict[str, Any]]:
    if not isinstance(tree, Mapping):
        raise EstimationError(f"{what}: got {type(tree).__name__}, expected tables by section")
    out: dict[str, dict[str, Any]] = {}
    for section, own in tree.items():
        if section not in _SHAPES:
            raise EstimationError(f"{what}: {unknown_name('section', str(section), _SHAPES)}")
        if not isinstance(own, Mapping):
            raise EstimationError(f"{what}: {section} is {type(own).__name__}, expected a table")
        for key, given in own.items():
            if key not in _SHAPES[section]:
                raise EstimationError(f"{what}: {unknown_name(f'name in {section}', str(key), _SHAPES[section])}")
            shape = _SHAPES[section][key]
            try:
                value = np.asarray(given, dtype=float)
            except (TypeError, ValueError) as error:
                raise EstimationError(f"{what}: {section}.{key} is not made of numbers") from error
            if value.shape != shape:
                expected = f"{shape}" if shape else "one number"
                raise EstimationError(f"{what}: {section}.{key} has the shape {value.shape}, expected {expected}")
            if not np.isfinite(value).all():
                raise EstimationError(f"{what}: {section}.{key} has a number that is not finite")
            out.setdefault(section, {})[key] = value if shape else float(value)
    return out


def parameters_of_own(preparation: Preparation, problem: Problem, found: Estimates) -> CellParameters:
    """Return the parameters that an own estimator found, and first values of what it did not estimate."""
    known = problem.prior.start
    known = replace(known, sensors=_with_groups(known.sensors, _groups_in(found.values)))
    timing, alignment = found.values.get("timing", {}), found.values.get("alignment", {})
    if "offset" in timing:
        moved = float(timing["offset"]) - _offset(preparation, known.start)
        known = replace(known, start=known.start + moved)
    if "gravity" in alignment:
        gravity = np.asarray(alignment["gravity"])
        down, wanted = matrix(known.q_rn)[:, 2], gravity / np.linalg.norm(gravity)
        across = np.cross(down, wanted)
        angle = np.arctan2(np.linalg.norm(across), down @ wanted)
        axis = across / max(float(np.linalg.norm(across)), 1e-300)
        known = replace(known, q_rn=multiply(exp(angle * axis), known.q_rn))
    return known


def _groups_in(tree: Tree) -> dict[str, Array]:
    """Return the numbers of sensor parameters, flat, by group."""
    return {
        group: np.ravel(tree[section][name])
        for (section, name), group in _FIELDS.items()
        if name in tree.get(section, {})
    }


def _with_groups(sensors: SensorParameters, groups: Mapping[str, Array]) -> SensorParameters:
    k_w, k_a = sensors.k_w.copy(), sensors.k_a.copy()
    k_w[0], k_a[0] = groups.get("gyro_offset", k_w[0]), groups.get("accel_offset", k_a[0])
    matrices = {"K_omega": "gyro_cross_coupling", "K_a": "accel_cross_coupling", "lever_arms": "lever_arms"}
    own = {field: groups[group].reshape(3, 3) for field, group in matrices.items() if group in groups}
    K_omega, K_a, arms = (own.get(field, getattr(sensors, field)) for field in matrices)
    return replace(sensors, K_omega=K_omega, k_w=k_w, K_a=K_a, k_a=k_a, lever_arms=arms)


def derived_of_own(sensors: SensorParameters, found: Estimates) -> dict[str, Measured]:
    """Return the quantities of data sheets with deviations, as if the numbers' errors were independent."""
    try:
        check_parameters(sensors)
    except ValueError as error:
        raise EstimationError(str(error)) from error
    values, deviations = _groups_in(found.values), _groups_in(found.deviations)
    sd = np.concatenate([np.zeros(0), *(deviations[group] for group in values)])
    ends = np.cumsum([0, *(value.size for value in values.values())])

    def moved(change: Array) -> SensorParameters:
        parts = zip(values.items(), ends, ends[1:], strict=False)
        return _with_groups(sensors, {group: value + change[begin:end] for (group, value), begin, end in parts})

    unknown = [group for group in _FIELDS.values() if group not in values]
    return derive(sensors, np.diag(sd**2), moved, unknown)
