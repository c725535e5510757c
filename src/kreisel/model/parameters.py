"""Groups of parameters: their names, and their values as fields and as stored in the state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.groups import REGISTRY, group_named
from kreisel.synchronization.clock import Clock

GROUPS = {group.name: group.meaning for group in REGISTRY}
"""All groups of parameters a calibration may estimate, as `--fix` names them."""

SENSOR_GROUPS = tuple(group.name for group in REGISTRY if group.is_sensor)
"""Groups every sensor parameter belongs to. They come first in the state; see `kalman.kernel_inputs`."""

_OF_SENSORS = {group_named(name).path for name in SENSOR_GROUPS}


def check_known(tables: Mapping[str, Mapping[str, object]]) -> None:
    """Raise an error for an entry of a sensor's table that is not known: readings would be corrected without it.

    Raises
    ------
    ValueError
        With its name.
    """
    for sensor in ("gyroscope", "accelerometer"):
        for name in tables[sensor]:
            if f"{sensor}.{name}" not in _OF_SENSORS:
                raise ValueError(f"{sensor}.{name} is no entry that this version knows")


PASSING_GROUPS = tuple(group.name for group in REGISTRY if group.passing)
"""Groups that change within seconds: noise with a memory."""

WALKING_GROUPS = ("gyro_offset", "accel_offset", "time_offset")
"""Groups that may walk at random during a recording."""

OF_EARTH = ("north", "earth_down")
"""The groups of the Earth's rotation, or of a reference that turns."""

DELAYS = ("gyro_axis_delay", "accel_delay", "accel_axis_delay")
SMOOTHINGS = ("gyro_axis_smoothing", "accel_smoothing", "accel_axis_smoothing", "reference_smoothing")
"""Groups that are terms of the series of a delayed and smoothed signal."""

ROBOT_GROUPS = tuple(group.name for group in REGISTRY if group.owner == "robot")
"""Groups of the robot's errors."""

REFERENCE_GROUPS = tuple(group.name for group in REGISTRY if group.owner == "reference")
"""Groups of errors of the reported poses, whatever reports them."""

POSE_GROUPS = tuple(group.name for group in REGISTRY if group.owner in ("reference", "robot"))
"""Groups that change the reported poses, linearly, but not the motion."""


def walk_of(group: str) -> str:
    """Return what the walk of a group is called in an account of uncertainty."""
    return f"walk of {GROUPS[group].split(',')[0]}"


@dataclass(frozen=True)
class RobotParameters:
    """Errors of an arm of n joints: the real arm against its controller's model.

    Attributes
    ----------
    placement : (n + 1, 6)
        Small motions of the placements of joints and tool; see `robot.kinematics.derivatives`.
    gears : (n, 2)
        Angle of a joint beyond its motor's, gears[:, 0] sin(angle) + gears[:, 1] cos(angle), rad.
    compliance : (n,)
        Deflection of a joint by gravity's torque, rad/(N m).
    zeros : (max(n - 2, 0),)
        Angle of a joint between the first and the last beyond its motor's, rad (m if it slides). Errors of the zeros
        of the first and the last joint are errors of the base and the tool frame.
    """

    placement: Array
    gears: Array
    compliance: Array
    zeros: Array

    @classmethod
    def none(cls, joints: int = 0) -> RobotParameters:
        """Return a faultless arm of so many joints."""
        return cls(
            np.zeros((joints + 1 if joints else 0, 6)),
            np.zeros((joints, 2)),
            np.zeros(joints),
            np.zeros(max(joints - 2, 0)),
        )

    @property
    def joints(self) -> int:
        """Number of joints; 0 where the reference is no robot, or nothing is known of its joints."""
        return self.compliance.size

    @property
    def vector(self) -> Array:
        """All errors (10 n + 4,), in the order of `ROBOT_GROUPS`."""
        return np.concatenate([self.placement.ravel(), self.gears.ravel(), self.compliance, self.zeros])

    def part(self, group: str) -> slice:
        """Return where a group lies in `vector`."""
        sizes = [self.placement.size, self.gears.size, self.compliance.size, self.zeros.size]
        i = ROBOT_GROUPS.index(group)
        return slice(sum(sizes[:i]), sum(sizes[: i + 1]))


_OF_FIELDS = frozenset({
    "gyro_cross_coupling", "gyro_offset", "gyro_polynomial", "accel_cross_coupling", "accel_offset", "accel_polynomial",
    "lever_arms", "alignment", "north", "earth_down", "gravity", "time_offset", "time_skew", *ROBOT_GROUPS,
})  # fmt: skip
"""Groups whose values are fields of `CellParameters` or `SensorParameters`; others are among the `others` of one."""


@dataclass(frozen=True)
class CellParameters:
    """Everything a calibration estimates except the motion itself.

    Attributes
    ----------
    sensors
        The sensor model's parameters.
    q_rn : (4,)
        Rotation of the reference frame r against the local level n. Down is along gravity; which level axis is
        called north is a choice: the true one lies along `north`.
    north : (2,)
        Components of true north along n's first two axes. Estimated as a vector, not an angle: the readings
        are linear in it, and no prior knowledge of it is needed. Of unit length where the latitude is given;
        in units of the Earth's rate where it is not.
    gravity
        Magnitude, m/s^2.
    start, skew
        See `synchronization.clock.Clock`.
    earth_down
        Downward part of the Earth's rotation: 1 by the latitude given; in units of the Earth's rate where
        none is.
    others
        Values of groups of the registry that have no field here, as they are stored; nominal where they are missing.
    """

    sensors: SensorParameters
    q_rn: Array
    north: Array
    gravity: float
    start: float
    skew: float
    robot: RobotParameters = field(default_factory=RobotParameters.none)
    earth_down: float = 1.0
    others: Mapping[str, Array] = field(default_factory=dict)

    @property
    def clock(self) -> Clock:
        """The reference's clock against the IMU's."""
        return Clock(self.start, self.skew)

    def with_order(self, order: int) -> CellParameters:
        """Return the values with room for sensor polynomials of an order or more, zero beyond the present one."""
        s = self.sensors
        k_w, k_a = (np.vstack([k, np.zeros((max(order - len(k), 0), 3))]) for k in (s.k_w, s.k_a))
        return replace(self, sensors=replace(s, k_w=k_w, k_a=k_a))

    def stored(self, group: str) -> Array:
        """Return a group's numbers as they are stored in the state."""
        s = self.sensors
        values: dict[str, Array] = {
            "gyro_cross_coupling": s.K_omega.ravel(),
            "gyro_offset": s.k_w[0],
            "gyro_polynomial": s.k_w[1:].ravel(),
            "accel_cross_coupling": s.K_a.ravel(),
            "accel_offset": s.k_a[0],
            "accel_polynomial": s.k_a[1:].ravel(),
            "lever_arms": s.lever_arms.ravel(),
            "alignment": self.q_rn,
            "north": self.north,
            "earth_down": np.array([self.earth_down]),
            "gravity": np.array([self.gravity]),
            "time_offset": np.array([self.start]),
            "time_skew": np.array([self.skew]),
            "robot_placement": self.robot.placement.ravel(),
            "robot_gears": self.robot.gears.ravel(),
            "robot_compliance": self.robot.compliance,
            "robot_zeros": self.robot.zeros,
        }
        if group in values:
            return np.asarray(values[group], dtype=float)
        order, others = s.k_w.shape[0], s.others if group in SENSOR_GROUPS else self.others
        return np.asarray(others.get(group, group_named(group).nominal(order, self.robot.joints)), dtype=float)

    @classmethod
    def from_stored(cls, values: dict[str, Array]) -> CellParameters:
        """Return the parameters from every group's stored numbers."""
        others = {group: values[group] for group in SENSOR_GROUPS if group not in _OF_FIELDS}
        return cls(
            replace(sensor_fields(values), others=others),
            values["alignment"],
            values["north"],
            float(values["gravity"][0]),
            float(values["time_offset"][0]),
            float(values["time_skew"][0]),
            RobotParameters(
                values["robot_placement"].reshape(-1, 6),
                values["robot_gears"].reshape(-1, 2),
                values["robot_compliance"],
                values["robot_zeros"],
            ),
            float(values["earth_down"][0]),
            {group: value for group, value in values.items() if group not in {*_OF_FIELDS, *SENSOR_GROUPS}},
        )


def sensor_fields(values: Mapping[str, Array]) -> SensorParameters:
    """Return the fields of the sensors' parameters, or of their deviations, from every group's numbers."""
    return SensorParameters(
        K_omega=values["gyro_cross_coupling"].reshape(3, 3),
        k_w=np.vstack([values["gyro_offset"], values["gyro_polynomial"].reshape(-1, 3)]),
        K_a=values["accel_cross_coupling"].reshape(3, 3),
        k_a=np.vstack([values["accel_offset"], values["accel_polynomial"].reshape(-1, 3)]),
        lever_arms=values["lever_arms"].reshape(3, 3),
    )


def parameter_names(group: str, order: int, joints: int = 0) -> tuple[str, ...]:
    """Return the names of a group's parameters: their paths in the result file."""
    return group_named(group).names(order, joints)


def other_groups() -> tuple[str, ...]:
    """Return the groups of the registry whose values are no fields of `CellParameters`."""
    return tuple(group for group in GROUPS if group not in _OF_FIELDS)
