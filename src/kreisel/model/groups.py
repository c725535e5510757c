"""The registry of parameter groups: everything the program knows of a group except the physics that uses it.

State layout, priors, observability, result file, report and settings go through `REGISTRY`. How to add a group is
described in CONTRIBUTING.md, "An error term".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.units import DEG_PER_HOUR, MG, MM, MRAD, MS, PPM, STANDARD_GRAVITY

Indices = Callable[[int, int], tuple[str, ...]]
"""From the order of the sensor polynomials and the number of joints to what follows the path in each name."""

USUAL_SKEW = 0.012
"""Deviation of the ratio of clocks of usual devices: half of what is searched; see `synchronization.clock.MAX_SKEW`."""

_NO_MEAN = 1e-6
"""Variance left to a mean or a trace that is zero, relative: 1 us for delays. Chosen: small beside any use, far above
rounding."""


@dataclass(frozen=True)
class ParameterGroup:
    """One group of parameters.

    Attributes
    ----------
    name
        Name in settings, `--fix` and the code.
    meaning
        One line for lists of groups.
    symbol
        Symbol in the equations; HTML.
    owner
        What it belongs to: a sensor, the cell (site, frames, clocks), the reference's poses, or the robot.
    path
        Its path in the result file.
    indices
        What follows the path in the name of each parameter; as many as there are degrees of freedom.
    unit, size
        The unit it is shown in, and that unit in SI.
    usual_sd
        Standard deviation of usual devices, SI: a parameter whose deviation does not fall well below it is not
        observable. None where the prior itself gives it.
    useful_sd
        Standard deviation, SI, above which a value is of no use, whatever was known before.
    known_before
        Whether something is known of it before any look at the data, so that its deviation need not decrease.
    by_choice
        Whether it is estimated only if asked for.
    rare
        Whether it is looked for only in devices whose grade has it.
    common_elsewhere
        Whether the mean of its parameters is a parameter of another group, so that their sum is zero.
    traceless
        Whether it is a matrix whose trace is zero.
    passing
        Whether it changes within seconds: it is a part of the noise, and not of the result.
    rotation
        Whether it is a rotation, stored as a quaternion.
    shape
        Shape of a value for it, as a function of the order of the polynomials; None if it takes no value.
    limits
        Of such a value, SI.
    """

    name: str
    meaning: str
    symbol: str
    owner: Literal["gyroscope", "accelerometer", "cell", "reference", "robot"]
    path: str
    indices: Indices
    unit: str
    size: float
    usual_sd: float | None = None
    useful_sd: float = np.inf
    known_before: bool = False
    by_choice: bool = False
    rare: bool = False
    common_elsewhere: bool = False
    traceless: bool = False
    passing: bool = False
    rotation: bool = False
    shape: Callable[[int], tuple[int, ...]] | None = None
    limits: tuple[float, float] = (-np.inf, np.inf)

    def names(self, order: int, joints: int = 0) -> tuple[str, ...]:
        """Return the name of each parameter: its path in the result file."""
        return tuple(self.path + index for index in self.indices(order, joints))

    def degrees(self, order: int, joints: int = 0) -> int:
        """Return the degrees of freedom."""
        return len(self.indices(order, joints))

    def usual_covariance(self, count: int, sd: float | None = None) -> Array:
        """Return the covariance (n, n) of usual devices for `count` of its parameters; sd: if not `usual_sd`."""
        shape = np.eye(count)
        if self.common_elsewhere and count > 1:
            shape -= (1.0 - _NO_MEAN) / count
        if self.traceless:
            of_trace = np.eye(3).ravel()
            shape -= (1.0 - _NO_MEAN) / 3.0 * np.outer(of_trace, of_trace)
        return (sd or self.usual_sd or 1.0) ** 2 * shape

    def nominal(self, order: int, joints: int = 0) -> Array:
        """Return the value of a faultless cell as it is stored, for groups that have no field of their own."""
        return np.array([1.0, 0.0, 0.0, 0.0]) if self.rotation else np.zeros(self.degrees(order, joints))

    @property
    def is_sensor(self) -> bool:
        """Whether it belongs to the device that is calibrated."""
        return self.owner in ("gyroscope", "accelerometer")


def _matrix(_order: int, _joints: int) -> tuple[str, ...]:
    return tuple(f"[{i},{j}]" for i in range(3) for j in range(3))


def _axes(_order: int, _joints: int) -> tuple[str, ...]:
    return ("[0]", "[1]", "[2]")


def _two(_order: int, _joints: int) -> tuple[str, ...]:
    return ("[0]", "[1]")


def _one(_order: int, _joints: int) -> tuple[str, ...]:
    return ("",)


def _powers(order: int, _joints: int) -> tuple[str, ...]:
    return tuple(f".{power}[{i}]" for power in range(2, order + 1) for i in range(3))


def _placements(_order: int, joints: int) -> tuple[str, ...]:
    return tuple(f"[{j},{i}]" for j in range(joints + 1) for i in range(6)) if joints else ()


def _pairs_of_joints(_order: int, joints: int) -> tuple[str, ...]:
    return tuple(f"[{j},{i}]" for j in range(joints) for i in range(2))


def _each_joint(_order: int, joints: int) -> tuple[str, ...]:
    return tuple(f"[{j}]" for j in range(joints))


def _inner_joints(_order: int, joints: int) -> tuple[str, ...]:
    """Return the joints whose zeros no error of the base or the tool frame could stand for."""
    return tuple(f"[{i}]" for i in range(1, joints - 1))


REGISTRY: tuple[ParameterGroup, ...] = (
    ParameterGroup(
        "gyro_cross_coupling", "K_omega: scale, misalignment and mounting of the gyros", "K<sub>ω</sub>",
        "gyroscope", "gyroscope.cross_coupling", _matrix, "1", 1.0, 0.05, 3e-3, shape=lambda _: (3, 3),
    ),
    ParameterGroup(
        "gyro_offset", "k_w0, rad/s", "k<sub>ω0</sub>",
        "gyroscope", "gyroscope.offset", _axes, "deg/h", DEG_PER_HOUR, 0.02, 5e-3, shape=lambda _: (3,),
    ),
    ParameterGroup(
        "gyro_polynomial", "k_wi, i = 2 and above", "k<sub>ωi</sub>",
        "gyroscope", "gyroscope.polynomial", _powers, "SI", 1.0, 0.02, shape=lambda order: (order - 1, 3),
    ),
    ParameterGroup(
        "gyro_g_sensitivity", "G: gyro readings per specific force, rad/s per m/s^2", "G",
        "gyroscope", "gyroscope.g_sensitivity", _matrix, "deg/h/g", DEG_PER_HOUR / STANDARD_GRAVITY, 2e-4,
        known_before=True, by_choice=True, shape=lambda _: (3, 3),
    ),
    ParameterGroup(
        "gyro_g_squared", "G_2: gyro readings per squared specific force, rad/s per (m/s^2)^2", "G<sub>2</sub>",
        "gyroscope", "gyroscope.g_squared", _matrix, "deg/h/g²", DEG_PER_HOUR / STANDARD_GRAVITY**2, 2e-6,
        known_before=True, by_choice=True, rare=True, shape=lambda _: (3, 3),
    ),
    ParameterGroup(
        "gyro_asymmetry", "scale of the gyros by the sign of the rate: times |w'|", "b<sub>ω</sub>",
        "gyroscope", "gyroscope.asymmetry", _axes, "ppm", PPM, 3e-4, known_before=True, by_choice=True,
        shape=lambda _: (3,),
    ),
    ParameterGroup(
        "gyro_cubic", "cubic term of the gyros without a square one, (rad/s)^-2: times w'^3", "k<sub>ω3</sub>",
        "gyroscope", "gyroscope.cubic", _axes, "ppm/(rad/s)²", PPM, 1e-4, known_before=True, by_choice=True,
        shape=lambda _: (3,),
    ),
    ParameterGroup(
        "gyro_axis_delay", "delay of each gyro axis beyond the mean of the three, s: times dw'/dt", "τ<sub>ω</sub>",
        "gyroscope", "gyroscope.axis_delay", _axes, "ms", MS, 1e-3, known_before=True, by_choice=True,
        shape=lambda _: (3,), common_elsewhere=True,
    ),
    ParameterGroup(
        "gyro_axis_smoothing", "smoothing of each gyro axis, s^2: times -d^2w'/dt^2", "κ<sub>ω</sub>",
        "gyroscope", "gyroscope.axis_smoothing", _axes, "ms²", MS**2, 3e-5, known_before=True, by_choice=True,
        shape=lambda _: (3,),
    ),
    ParameterGroup(
        "gyro_temperature", "temperature coefficient of the gyro offsets: times T - T_0", "c<sub>ω</sub>",
        "gyroscope", "gyroscope.temperature", _axes, "deg/h/K", DEG_PER_HOUR, 1e-4, known_before=True,
        by_choice=True, shape=lambda _: (3,),
    ),
    ParameterGroup(
        "gyro_scale_temperature", "temperature coefficient of the gyro scale factors: times T - T_0",
        "s<sub>ω</sub>", "gyroscope", "gyroscope.scale_temperature", _axes, "ppm/K", PPM, 3e-4,
        known_before=True, by_choice=True, shape=lambda _: (3,),
    ),
    ParameterGroup(
        "gyro_gauss_markov", "bias instability of the gyros: what passes within seconds", "d<sub>ω</sub>",
        "gyroscope", "gyroscope.gauss_markov", _axes, "deg/h", DEG_PER_HOUR, known_before=True, passing=True,
    ),
    ParameterGroup(
        "accel_cross_coupling", "K_a: scale, misalignment and mounting of the accelerometers", "K<sub>a</sub>",
        "accelerometer", "accelerometer.cross_coupling", _matrix, "1", 1.0, 0.05, 5e-3,
        shape=lambda _: (3, 3),
    ),
    ParameterGroup(
        "accel_offset", "k_a0, m/s^2", "k<sub>a0</sub>",
        "accelerometer", "accelerometer.offset", _axes, "mg", MG, 0.6, 0.1, shape=lambda _: (3,),
    ),
    ParameterGroup(
        "accel_polynomial", "k_ai, i = 2 and above", "k<sub>ai</sub>",
        "accelerometer", "accelerometer.polynomial", _powers, "SI", 1.0, 0.005,
        shape=lambda order: (order - 1, 3),
    ),
    ParameterGroup(
        "accel_asymmetry", "scale of the accelerometers by the sign of the force: times |a'|", "b<sub>a</sub>",
        "accelerometer", "accelerometer.asymmetry", _axes, "ppm", PPM, 3e-4, known_before=True, by_choice=True,
        shape=lambda _: (3,),
    ),
    ParameterGroup(
        "accel_cubic", "cubic term of the accelerometers without a square one, (m/s^2)^-2: times a'^3",
        "k<sub>a3</sub>", "accelerometer", "accelerometer.cubic", _axes, "ppm/g²", PPM / STANDARD_GRAVITY**2, 1e-5,
        known_before=True, by_choice=True, rare=True, shape=lambda _: (3,),
    ),
    ParameterGroup(
        "accel_delay", "delay of the accelerometers against the gyros, s: times da'/dt", "τ",
        "accelerometer", "accelerometer.delay", _one, "ms", MS, 5e-3, known_before=True, by_choice=True,
        shape=lambda _: (),
    ),
    ParameterGroup(
        "accel_smoothing", "smoothing of the accelerometers against the gyros, s^2: times -d^2a'/dt^2", "κ<sub>a</sub>",
        "accelerometer", "accelerometer.smoothing", _one, "ms²", MS**2, 3e-5, known_before=True, by_choice=True,
        shape=lambda _: (),
    ),
    ParameterGroup(
        "accel_axis_delay", "delay of each accelerometer axis beyond the common one, s: times da'/dt", "τ<sub>a</sub>",
        "accelerometer", "accelerometer.axis_delay", _axes, "ms", MS, 1e-3, known_before=True, by_choice=True,
        shape=lambda _: (3,), common_elsewhere=True,
    ),
    ParameterGroup(
        "accel_axis_smoothing", "smoothing of each accelerometer axis beyond the common one, s^2: times -d^2a'/dt^2",
        "κ<sub>aj</sub>", "accelerometer", "accelerometer.axis_smoothing", _axes, "ms²", MS**2, 3e-5,
        known_before=True, by_choice=True, shape=lambda _: (3,), common_elsewhere=True,
    ),
    ParameterGroup(
        "accel_temperature", "temperature coefficient of the accelerometer offsets: times T - T_0", "c<sub>a</sub>",
        "accelerometer", "accelerometer.temperature", _axes, "mg/K", MG, 1e-2, known_before=True,
        by_choice=True, shape=lambda _: (3,),
    ),
    ParameterGroup(
        "accel_scale_temperature", "temperature coefficient of the accelerometer scale factors: times T - T_0",
        "s<sub>a</sub>", "accelerometer", "accelerometer.scale_temperature", _axes, "ppm/K", PPM, 3e-4,
        known_before=True, by_choice=True, shape=lambda _: (3,),
    ),
    ParameterGroup(
        "accel_gauss_markov", "bias instability of the accelerometers: what passes within seconds", "d<sub>a</sub>",
        "accelerometer", "accelerometer.gauss_markov", _axes, "mg", MG, known_before=True, passing=True,
    ),
    ParameterGroup(
        "lever_arms", "r_j: positions of the accelerometers in b, m", "r",
        "accelerometer", "accelerometer.lever_arms", _matrix, "mm", MM, 0.1, 0.03, shape=lambda _: (3, 3),
    ),
    ParameterGroup(
        "alignment", "tilt of the reference frame against the local level", "φ",
        "cell", "alignment.tilt", _two, "mrad", MRAD, 0.05, known_before=True, rotation=True,
    ),
    ParameterGroup(
        "north", "level part of the Earth's rotation: where north lies", "n",
        "cell", "alignment.north", _two, "1", 1.0, 0.7, known_before=True,
    ),
    ParameterGroup(
        "earth_down", "downward part of the Earth's rotation, where the latitude is not given", "n<sub>d</sub>",
        "cell", "alignment.earth_down", _one, "1", 1.0, 3**-0.5, known_before=True,
    ),
    ParameterGroup(
        "gravity", "magnitude of gravity, within the uncertainty of the latitude's or the stated value", "g",
        "cell", "alignment.gravity_magnitude", _one, "m/s²", 1.0, known_before=True, shape=lambda _: (),
        limits=(9.7, 9.9),
    ),
    ParameterGroup(
        "time_offset", "offset of the reference's clock", "t<sub>0</sub>",
        "cell", "timing.offset", _one, "ms", MS, 0.01, 2e-3, shape=lambda _: (),
    ),
    ParameterGroup(
        "time_skew", "ratio of the clocks, less one", "s",
        "cell", "timing.skew", _one, "ppm", PPM, USUAL_SKEW, shape=lambda _: (), limits=(-0.02, 0.02),
    ),
    ParameterGroup(
        "position_scale", "scale of the reported positions, less one", "s<sub>p</sub>",
        "reference", "reference.position_scale", _one, "ppm", PPM, 5e-4, known_before=True, by_choice=True,
        shape=lambda _: (),
    ),
    ParameterGroup(
        "position_heading", "heading of the frame of the reported positions against that of the attitudes",
        "ψ<sub>p</sub>", "reference", "reference.position_heading", _one, "mrad", MRAD, 1e-2, known_before=True,
        by_choice=True, shape=lambda _: (),
    ),
    ParameterGroup(
        "reference_smoothing", "smoothing of the reported poses against the gyros, s^2: pose + this d^2 pose/dt^2",
        "κ<sub>r</sub>", "reference", "reference.smoothing", _one, "ms²", MS**2, 3e-5, known_before=True,
        by_choice=True, shape=lambda _: (),
    ),
    ParameterGroup(
        "mount_bending", "elastic mount, rad per m/s^2: rotation of b against the reported pose, times f", "B",
        "reference", "reference.mount_bending", _matrix, "mrad/g", MRAD / STANDARD_GRAVITY, 2e-5,
        known_before=True, by_choice=True, shape=lambda _: (3, 3), traceless=True,
    ),
    ParameterGroup(
        "mount_deflection", "elastic mount, m per m/s^2: shift of b against the reported pose, times f", "D",
        "reference", "reference.mount_deflection", _matrix, "mm/g", MM / STANDARD_GRAVITY, 2e-5,
        known_before=True, by_choice=True, shape=lambda _: (3, 3),
    ),
    ParameterGroup(
        "robot_placement", "errors of the robot's joint placements: lengths and angles", "robot",
        "robot", "robot.placement", _placements, "mm, mrad", 1e-3, known_before=True,
    ),
    ParameterGroup(
        "robot_gears", "gear eccentricity: sine and cosine of each joint angle, rad", "gears",
        "robot", "robot.gears", _pairs_of_joints, "mrad", MRAD, known_before=True, by_choice=True,
    ),
    ParameterGroup(
        "robot_compliance", "elastic sag: compliance of each joint against gravity's torque, rad/(N m)", "sag",
        "robot", "robot.compliance", _each_joint, "rad/(N m)", 1.0, known_before=True, by_choice=True,
    ),
    ParameterGroup(
        "robot_zeros", "zeros of the joints between the first and the last, beyond the placements' errors", "zeros",
        "robot", "robot.zeros", _inner_joints, "mrad", MRAD, known_before=True, by_choice=True,
    ),
)  # fmt: skip
"""All groups, in the order of the state: the sensors' first, gyros before accelerometers. See `kalman.kernel_inputs`
for the reason."""


def group_named(name: str) -> ParameterGroup:
    """Return the group of a known name."""
    return next(group for group in REGISTRY if group.name == name)
