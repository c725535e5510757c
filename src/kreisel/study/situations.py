"""Situations in which a calibration must be right or rejected: every error at several sizes, in three basic cells."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from kreisel.inertial.noise_figures import GRADES
from kreisel.units import DEG, DEG_PER_HOUR, MG, MM, MRAD, MS, PPM, STANDARD_GRAVITY

Content = Mapping[str, Any]
"""Tables of a cell."""

BASES: dict[str, Content] = {
    "joints": {"imu": {"grade": "fog-mems"}},
    "poses": {"imu": {"grade": "industrial-mems"}, "reference": {"joints": False}, "stated": {"robot": False}},
    "mocap": {
        "imu": {"grade": "consumer-mems"},
        "reference": {"kind": "mocap", "interval": 0.01},
        "errors": {"path_position_sd": 3e-4, "path_orientation_sd": 5e-4, "path_correlation_time": 0.0},
        "stated": {"place": False},
    },
}
"""Basic cells: a robot with joint angles and description; one without, of whose errors nothing is said; cameras, and
nothing said about the place."""

_ROBOTS = ("joints", "poses")
_ALL = tuple(BASES)

RANDOM = "random physics"
"""Name of situations with errors that are on no list."""

_RANDOM = 20_261_123
"""Beginning of their random numbers."""

_ACCURACIES = (1e-4, 1e-3)
"""m and rad; placement of the joints of arms, from one that was measured to one that was not: an IRB 1600 as delivered
is 0.65 mm and 2.8 mrad off at its tool (Slamani, Nubiola and Bonev 2012), to which every joint contributes."""

_LATITUDES, _HEIGHT, _ANOMALY = (-40.0, 65.0), 280.0, 3e-4
"""deg, m and m/s^2; where most people live, the mean height (half of them below 194 m; Cohen and Small 1998), and the
deviation of gravity from its normal value."""

_VOLUME, _DISTORTION, _TURNING = 1000.0, 5e-4, 5e-7
"""ppm; deviation of the scale of cameras' positions: wands are measured to some tenths of a millimetre. Half as much of
the axes and shears of the volume; rad/s of its frame, 0.3 mrad in ten minutes."""

_FACTORS = (0.1, 0.3, 3.0, 10.0)
"""On what is stated."""

GYRO_CHANGES = ("gyro offset walks", "gyro offset steps", "gyros warm up", "gyro temperature")
ACCEL_CHANGES = ("accel offset walks", "accel offset steps", "accelerometers warm up", "accel temperature")
"""Situations in which offsets change; any of them counts as the cause of any other."""

_NOT_SHOWN = ("swinging joints", "sway", "reference_smoothing")
"""Motion that the reference does not show."""


@dataclass(frozen=True)
class Situation:
    """One situation.

    Attributes
    ----------
    name, size, basis
        The effect's name, its size with unit, and the basic cell (of `BASES`); together they are unique.
    words
        What is different from the basic cell.
    cell
        Content of a `Cell`.
    causes
        Names of causes that are true; empty where the model covers all that differs. Motion that the reference does not
        show (interpolated poses, an arm that swings) and poses that are smoothed look alike: either name is true.
    """

    name: str
    size: str
    basis: str
    words: str
    cell: Content
    causes: tuple[str, ...]

    @property
    def key(self) -> str:
        """Its unique name."""
        return f"{self.name}, {self.size}, {self.basis}"


@dataclass(frozen=True)
class _Effect:
    """An effect with its sizes: the text of each, and the tables it changes."""

    name: str
    words: str
    sizes: tuple[tuple[str, Content], ...]
    causes: tuple[str, ...] = ()
    bases: tuple[str, ...] = _ALL


@cache
def situations(seconds: float = 150.0) -> tuple[Situation, ...]:
    """Return all situations, each recording of this length (s)."""
    return tuple(_clean(seconds)) + tuple(
        Situation(
            effect.name, size, basis, effect.words, _cell(basis, seconds, change),
            (*effect.causes, *_of_grade(effect.causes, basis)),
        )
        for effect in (
            *_sensors(), *_samples(), *_changes(), *_reference(), *_arm(), *_statements(), *_motion(), *_foreign(),
            *_shapes(),
        )
        for basis in effect.bases
        for size, change in effect.sizes
    )  # fmt: skip


def random_situation(number: int, seconds: float = 150.0) -> Situation:
    """Return a situation with one to five errors that are on no list, of a device, a cell and a motion drawn for it.

    The accuracy of an arm is drawn too. Who records joint angles states it; who records poses alone does not. So are
    the place on Earth with its gravity, and the scale and shape of a volume of cameras whose frame turns.
    """
    rng = np.random.default_rng([_RANDOM, number])
    basis = str(rng.choice(_ALL))
    kinds = ("gyro", "accel", "reference", "clock", *(("joints",) if basis in _ROBOTS else ()))
    chosen = rng.choice(kinds, size=int(rng.integers(1, 6)))
    counts = {kind: int(np.sum(chosen == kind)) for kind in kinds if np.any(chosen == kind)}
    change: dict[str, Content] = {"imu": {"grade": str(rng.choice(list(GRADES)))}, "unlisted": counts}
    if basis in _ROBOTS and rng.random() < 0.3:
        change["robot"] = {"model": "ur10e"}
    if basis == "mocap" and rng.random() < 0.5:
        kind = str(rng.choice(["flight", "hand"]))
        change["motion"] = {"kind": kind}
        if kind == "hand":  # faster than the range of others
            change["imu"] = {"grade": "consumer-mems"}
    if basis in _ROBOTS:
        accuracy = float(np.exp(rng.uniform(*np.log(_ACCURACIES))))
        change["errors"] = {"geometry_length_sd": accuracy, "geometry_angle_sd": accuracy}
    change["site"] = {
        "latitude_deg": float(rng.uniform(*_LATITUDES)),
        "height_m": float(min(rng.exponential(_HEIGHT), 5000.0)),
        "gravity_anomaly": _ANOMALY * float(rng.normal()),
    }
    if basis == "mocap":
        scale = {"position_scale_ppm": _VOLUME * float(rng.normal())}
        change["reference"] = {**scale, "distortion": _DISTORTION, "turning": _TURNING}
    words = ", ".join(f"{count} of {kind}" for kind, count in counts.items())
    return Situation(RANDOM, str(number), basis, f"random functions: {words}", _cell(basis, seconds, change), ())


def _of_grade(causes: tuple[str, ...], basis: str) -> tuple[str, ...]:
    """Return the causes that a grade brings with it: cheaper gyros respond to acceleration."""
    grade = GRADES[BASES[basis]["imu"]["grade"]]
    return ("gyro_g_sensitivity",) if causes and grade.g_sensitivity and "gyro_g_sensitivity" not in causes else ()


def _cell(basis: str, seconds: float, change: Content) -> Content:
    """Return a basic cell with changed tables."""
    content: dict[str, Any] = {"seconds": seconds, **{name: dict(table) for name, table in BASES[basis].items()}}
    for name, value in change.items():
        content[name] = {**content.get(name, {}), **value} if isinstance(value, Mapping) else value
    return content


def _clean(seconds: float) -> Iterator[Situation]:
    """Return every grade in every basic cell, with nothing outside the model but what the grade brings with it."""
    for basis in _ALL:
        for grade in GRADES:
            words = "nothing differs from the model"
            yield Situation("clean", grade, basis, words, _cell(basis, seconds, {"imu": {"grade": grade}}), ())


def _sizes(table: str, key: str, unit: str, factor: float, *values: float) -> tuple[tuple[str, Content], ...]:
    """Return sizes of one key; the texts are `values` with their unit, `factor` in SI."""
    return tuple((f"{value:g} {unit}".strip(), {table: {key: value * factor}}) for value in values)


def _sensors() -> tuple[_Effect, ...]:
    """Return further terms of the sensor model."""
    per_g = DEG_PER_HOUR / STANDARD_GRAVITY
    return (
        _Effect(
            "gyro_g_sensitivity", "gyros respond to acceleration",
            _sizes("imu", "gyro_g_sensitivity_sd", "deg/h/g", per_g, 3, 30, 300, 1500), ("gyro_g_sensitivity",),
        ),
        _Effect(
            "gyro_asymmetry", "gyro scale factors differ with the sign",
            _sizes("imu", "gyro_asymmetry_sd", "ppm", PPM, 50, 300, 1500, 8000), ("gyro_asymmetry",),
        ),
        _Effect(
            "accel_asymmetry", "accelerometer scale factors differ with the sign",
            _sizes("imu", "accel_asymmetry_sd", "ppm", PPM, 50, 300, 1500, 8000), ("accel_asymmetry",),
        ),
        _Effect(
            "gyro_polynomial", "quadratic term of the gyros",
            _sizes("imu", "quadratic_gyro_sd", "s/rad", 1.0, 1e-4, 1e-3, 8e-3), ("gyro_polynomial",),
        ),
        _Effect(
            "accel_polynomial", "quadratic term of the accelerometers",
            _sizes("imu", "quadratic_accel_sd", "s^2/m", 1.0, 1e-5, 1e-4, 8e-4), ("accel_polynomial",),
        ),
        _Effect(
            "accel_delay", "accelerometers are late",
            _sizes("imu", "accel_delay", "ms", MS, 0.1, 0.5, 2, 10), ("accel_delay",),
        ),
        _Effect(
            "accel_smoothing", "a low-pass of the accelerometers alone",
            _sizes("imu", "accel_bandwidth", "Hz", 1.0, 80, 30, 8), ("accel_smoothing", "accel_delay"),
        ),
        _Effect(
            "axis delays", "axes are sampled one after another",
            _sizes("imu", "axis_delay", "ms", MS, 0.1, 0.5, 3), ("gyro_axis_delay", "accel_axis_delay"),
        ),
        _Effect(
            "axis bandwidths", "axes have unequal bandwidths", _sizes("imu", "axis_smoothing", "ms", MS, 2, 5, 15),
            ("gyro_axis_smoothing", "accel_axis_smoothing", "accel_smoothing", "reference_smoothing"),
        ),
        *_temperatures(),
        _Effect("bandwidth", "a low-pass of both sensors", _sizes("imu", "bandwidth", "Hz", 1.0, 60, 15)),
    )  # fmt: skip


def _temperatures() -> tuple[_Effect, ...]:
    """Return coefficients of a recorded temperature, which rises by nearly 10 K."""
    out = []
    for name, words, unit, size, values in (
        ("gyro_temperature", "gyro offsets", "deg/h/K", DEG_PER_HOUR, (2.0, 20.0, 200.0)),
        ("gyro_scale_temperature", "gyro scale factors", "ppm/K", PPM, (20.0, 200.0)),
        ("accel_temperature", "accelerometer offsets", "mg/K", MG, (0.02, 0.2, 2.0)),
        ("accel_scale_temperature", "accelerometer scale factors", "ppm/K", PPM, (20.0, 200.0)),
    ):
        sizes = tuple(
            (f"{value:g} {unit}", {"imu": {f"{name}_sd": value * size, "temperature_rise": 10.0}}) for value in values
        )
        out.append(_Effect(name, f"{words} follow a recorded temperature", sizes, (name,)))
    return tuple(out)


def _samples() -> tuple[_Effect, ...]:
    """Return what makes single readings wrong."""
    alias = {"vibration_frequency": 198.7}
    return (
        _Effect(
            "vibration", "a sine of 83 Hz while moving",
            _sizes("imu", "vibration", "m/s^2", 1.0, 0.2, 2, 15), ("vibration",),
        ),
        _Effect(
            "aliased vibration", "a sine of 198.7 Hz, sampled at 200 Hz",
            tuple((f"{v:g} m/s^2", {"imu": {"vibration": v, **alias}}) for v in (0.02, 0.2, 2)), ("vibration",),
        ),
        _Effect(
            "gyro rounding", "coarse steps of the rates",
            _sizes("imu", "gyro_quantum", "deg/s", DEG, 0.05, 0.5), ("rounding",),
        ),
        _Effect(
            "accel rounding", "coarse steps of the accelerations",
            _sizes("imu", "accel_quantum", "mg", MG, 2, 30), ("rounding",),
        ),
        _Effect(
            "stuck samples", "samples that repeat the one before",
            _sizes("imu", "stuck_share", "%", 0.01, 0.1, 2, 20), ("stuck samples",),
        ),
        _Effect(
            "spikes", "readings of ten times the usual size",
            _sizes("imu", "spike_share", "%", 0.01, 0.01, 0.2, 5), ("spikes",),
        ),
        _Effect("lost samples", "samples that are missing", _sizes("imu", "drop_share", "%", 0.01, 1, 10)),
        _Effect(
            "counted stamps", "samples that are missing without a gap in their stamps",
            tuple((f"{v:g} %", {"imu": {"drop_share": 0.01 * v, "counted": True}}) for v in (0.01, 0.1, 0.5)),
        ),
        _Effect(
            "stamps of arrival", "samples are stamped late", _sizes("imu", "lateness", "ms", MS, 0.3, 2, 8),
        ),
        _Effect(
            "bursts", "samples arrive several at once",
            tuple((f"{n} at once", {"imu": {"lateness": 1e-3, "burst": n}}) for n in (4, 16)),
        ),
    )  # fmt: skip


def _changes() -> tuple[_Effect, ...]:
    """Return what changes during the recording."""
    return (
        _Effect(
            "gyro offset walks", "random walk of the gyro offsets",
            _sizes("imu", "gyro_walk", "deg/h/√s", DEG_PER_HOUR, 0.2, 3, 30), GYRO_CHANGES,
        ),
        _Effect(
            "accel offset walks", "random walk of the accelerometer offsets",
            _sizes("imu", "accel_walk", "mg/√s", MG, 0.001, 0.02, 0.3), ACCEL_CHANGES,
        ),
        _Effect(
            "gyro offset steps", "a step of the gyro offsets",
            _sizes("imu", "gyro_step", "deg/h", DEG_PER_HOUR, 5, 60, 1000), GYRO_CHANGES,
        ),
        _Effect(
            "accel offset steps", "a step of the accelerometer offsets",
            _sizes("imu", "accel_step", "mg", MG, 0.05, 0.5, 10), ACCEL_CHANGES,
        ),
        _Effect(
            "gyros warm up", "gyro offsets settle within a minute",
            _sizes("imu", "gyro_warm_up", "deg/h", DEG_PER_HOUR, 10, 100, 2000), GYRO_CHANGES,
        ),
        _Effect(
            "accelerometers warm up", "accelerometer offsets settle within a minute",
            _sizes("imu", "accel_warm_up", "mg", MG, 0.1, 1, 20), ACCEL_CHANGES,
        ),
        _Effect(
            "gyro temperature", "gyro offsets drift along a line",
            _sizes("imu", "gyro_temperature_drift", "deg/h", DEG_PER_HOUR, 10, 200), GYRO_CHANGES,
        ),
        _Effect(
            "accel temperature", "accelerometer offsets drift along a line",
            _sizes("imu", "accel_temperature_drift", "mg", MG, 0.1, 3), ACCEL_CHANGES,
        ),
        _Effect(
            "slipping mount", "the IMU turns in its mount, once",
            _sizes("imu", "slip_deg", "deg", 1.0, 0.01, 0.05, 0.3, 5), ("slipping mount",),
        ),
    )  # fmt: skip


def _reference() -> tuple[_Effect, ...]:
    """Return errors of the poses and of their clock."""
    return (
        _Effect(
            "position_scale", "reported positions are too long",
            _sizes("reference", "position_scale_ppm", "ppm", 1.0, 50, 300, 2000), ("position_scale",),
        ),
        _Effect(
            "reference_smoothing", "reported poses are averaged",
            _sizes("reference", "smoothing", "ms", MS, 3, 10, 40), ("reference_smoothing",),
        ),
        _Effect(
            "mount_bending", "the mount bends with the force",
            _sizes("imu", "mount_bending_sd", "mrad/g", MRAD / STANDARD_GRAVITY, 0.05, 0.3, 2), ("mount_bending",),
        ),
        _Effect(
            "mount_deflection", "the mount shifts with the force",
            _sizes("imu", "mount_deflection_sd", "mm/g", MM / STANDARD_GRAVITY, 0.02, 0.1, 0.5), ("mount_deflection",),
        ),
        _Effect(
            "interpolated poses", "poses are interpolated between rarer ones",
            _sizes("reference", "interpolation", "ms", MS, 25, 60, 200), ("interpolated poses", "reference_smoothing"),
        ),
        _Effect(
            "clock walk", "the clock offset walks",
            _sizes("reference", "clock_walk", "us/√s", 1e-6, 3, 30, 500), ("clock walk", "clock jump"),
        ),
        _Effect(
            "clock jump", "the clock offset jumps, once",
            _sizes("reference", "clock_jump", "ms", MS, 0.1, 0.5, 3, 40), ("clock jump", "clock walk"),
        ),
        _Effect("clock ratio", "one clock is faster", _sizes("reference", "clock_drift_ppm", "ppm", 1.0, 20, 300)),
        _Effect(
            "jitter", "poses are taken at other times than stamped",
            _sizes("reference", "jitter", "ms", MS, 0.1, 1, 5), ("jitter",),
        ),
        _Effect(
            "pose outliers", "poses wrong by 20 mm and 20 mrad",
            _sizes("reference", "outlier_share", "%", 0.01, 0.1, 2, 20), ("pose outliers",),
        ),
        _Effect(
            "held poses", "poses that repeat the one before",
            _sizes("reference", "held", "%", 0.01, 2, 20, 60), ("held poses", "jitter", "reference_smoothing"),
        ),
        _Effect("lost poses", "poses that are missing", _sizes("reference", "drop_share", "%", 0.01, 10, 60)),
        _Effect(
            "slow path error", "the path error changes slowly",
            _sizes("errors", "path_correlation_time", "s", 1.0, 0.5, 3), ("path error",), _ROBOTS,
        ),
    )  # fmt: skip


def _arm() -> tuple[_Effect, ...]:
    """Return errors of the arm."""
    geometry = tuple(
        (f"{v:g} mm, {v:g} mrad", {"errors": {"geometry_length_sd": v * MM, "geometry_angle_sd": v * MRAD}})
        for v in (0.1, 1.0, 3.0)
    )
    swinging = tuple((f"{f:g} Hz", {"errors": {"oscillation_frequency": f}}) for f in (20.0, 9.0, 5.0))
    return (
        _Effect("robot_placement", "joints are elsewhere than the controller believes", geometry,
                ("robot_placement",), _ROBOTS),
        _Effect(
            "robot_zeros", "joints whose zeros were lost",
            _sizes("errors", "zero_sd", "mrad", MRAD, 2, 10, 40), ("robot_zeros",), _ROBOTS,
        ),
        _Effect(
            "robot_gears", "eccentric gears",
            _sizes("errors", "gear_eccentricity_sd", "mrad", MRAD, 0.03, 0.15, 1), ("robot_gears",), _ROBOTS,
        ),
        _Effect(
            "robot_compliance", "joints sag under gravity",
            _sizes("errors", "sag_sd", "mrad", MRAD, 0.05, 0.3, 2), ("robot_compliance",), _ROBOTS,
        ),
        _Effect(
            "servo lag", "each joint is late differently",
            _sizes("errors", "servo_lag", "ms", MS, 1, 5, 25), ("servo lag",), _ROBOTS,
        ),
        _Effect(
            "backlash", "play of the gears",
            _sizes("errors", "backlash_sd", "mrad", MRAD, 0.05, 0.3, 2), ("backlash",), _ROBOTS,
        ),
        _Effect("swinging joints", "elastic joints swing after stops", swinging, _NOT_SHOWN, _ROBOTS),
        _Effect(
            "sway", "the base sways while the arm moves",
            _sizes("errors", "sway", "mm", MM, 0.05, 0.4, 3), _NOT_SHOWN, _ROBOTS,
        ),
        _Effect(
            "encoder steps", "coarse joint angles",
            _sizes("errors", "encoder_step", "mrad", MRAD, 0.1, 1), ("encoder steps",), _ROBOTS,
        ),
    )  # fmt: skip


def _shapes() -> tuple[_Effect, ...]:
    """Return errors of known shape without a name in the sensor model; what they resemble may be named."""
    per_g2, at_250 = 1e-6 / STANDARD_GRAVITY, (250.0 * DEG) ** 2
    shaking = {"imu": {"vibration": 5.0, "vibration_frequency": 83.0}}
    products = _sizes("unlisted", "accel_products", "ug/g^2", per_g2, 20, 100, 500)
    return (
        _Effect("gyro cubic", "cubic term of the gyros, at 250 deg/s",
                _sizes("unlisted", "gyro_cubic", "ppm", PPM / at_250, 100, 1000, 5000), ("gyro_cubic",)),
        _Effect("accel products", "products of axes in the accelerometers", products),
        _Effect("vibration rectification", "the same while the IMU vibrates by 5 m/s^2",
                tuple((size, {**content, **shaking}) for size, content in products)),
        _Effect("scale drift", "scale factors drift over the run, without a thermometer",
                _sizes("unlisted", "scale_drift", "ppm", PPM, 50, 300, 2000)),
        _Effect("hysteresis", "readings lag by a play of half their rms",
                _sizes("unlisted", "hysteresis", "%", 0.01, 0.01, 0.1, 1)),
        _Effect("dead zone", "small rates read zero", _sizes("unlisted", "dead_zone", "deg/s", DEG, 0.02, 0.1, 0.5)),
        _Effect("axis scales", "cameras with a scale for each axis",
                _sizes("unlisted", "axis_scale", "ppm", PPM, 100, 500, 3000), bases=("mocap",)),
        _Effect("base tilt", "the base tilts by the tool's weight",
                _sizes("unlisted", "base_tilt", "mrad/m", MRAD, 0.1, 0.3, 1), bases=_ROBOTS),
        _Effect("reference jumps", "the reference's frame jumps once",
                _sizes("unlisted", "reference_jump", "mm and mrad", MM, 0.5, 3, 20), bases=("mocap",)),
        _Effect("reference drifts", "the reference's frame walks",
                _sizes("unlisted", "reference_drift", "mm and mrad/√s", MM, 0.1, 0.5, 3), bases=("mocap",)),
    )  # fmt: skip


def _statements() -> tuple[_Effect, ...]:
    """Return what the owner says wrongly, or does not say."""
    other_grades = tuple((grade, {"stated": {"grade": grade}}) for grade in ("ring-laser", "fog", "consumer-mems"))
    return (
        _Effect(
            "stated noise",
            "noise figures of the IMU are wrong",
            _sizes("stated", "noise_factor", "x", 1.0, *_FACTORS),
            ("stated noise",),
        ),
        _Effect(
            "stated offsets",
            "spread of the offsets is wrong",
            _sizes("stated", "offset_sd_factor", "x", 1.0, *_FACTORS),
            ("stated offsets",),
        ),
        _Effect(
            "stated reference",
            "accuracy of the poses is wrong",
            _sizes("stated", "reference_factor", "x", 1.0, *_FACTORS),
            ("stated reference",),
        ),
        _Effect(
            "stated grade", "another grade is named", other_grades, ("stated grade", "stated noise", "stated offsets")
        ),
        _Effect(
            "stated latitude",
            "another latitude is given",
            _sizes("stated", "latitude_deg", "deg", 1.0, 48.0, 40.0, 0.0, -49.0),
            ("stated latitude",),
            _ROBOTS,
        ),
        _Effect(
            "stated gravity",
            "another gravity is given",
            _sizes("stated", "gravity", "m/s^2", 1.0, 9.80665, 9.79),
            ("stated gravity",),
        ),
        _Effect("nothing stated", "recording.toml is empty", (("all", {"stated": {"settings": False}}),)),
        *_robot_statements(),
    )


def _robot_statements() -> tuple[_Effect, ...]:
    """Return what the owner says wrongly of the robot, or does not say."""
    return (
        _Effect(
            "stated robot",
            "accuracy of the robot is wrong",
            _sizes("stated", "robot_factor", "x", 1.0, *_FACTORS),
            ("stated robot", "robot_placement"),
            ("joints",),
        ),
        _Effect(
            "no joint angles", "joint angles are not given", (("all", {"stated": {"joints": False}}),), (), ("joints",)
        ),
        _Effect(
            "nothing of the robot",
            "nothing is said about the robot's errors",
            (("all", {"stated": {"robot": False}}),),
            (),
            ("joints",),
        ),
        _Effect(
            "wrong description",
            "one link of the URDF is too long",
            _sizes("stated", "urdf_length_error", "mm", MM, 0.3, 2, 20),
            ("wrong description", "robot_placement"),
            ("joints",),
        ),
        _Effect(
            "wrong tool",
            "the URDF's tool is elsewhere",
            _sizes("stated", "tcp_error", "mm", MM, 1, 10, 150),
            ("wrong tool", "robot_placement"),
            ("joints",),
        ),
    )


def _motion() -> tuple[_Effect, ...]:
    """Return motion that shows less."""
    joints = tuple(
        (f"joints {', '.join(map(str, some))}", {"motion": {"joints": some}})
        for some in ((4, 5, 6), (5, 6), (6,), (1, 2, 3))
    )
    return (
        _Effect(
            "small motion",
            "a small part of the joints' ranges",
            _sizes("motion", "range_share", "%", 0.01, 1, 5, 20),
            ("small motion",),
        ),
        _Effect(
            "slow motion", "a slow tool", _sizes("motion", "tool_speed", "m/s", 1.0, 0.08, 0.15, 0.4), ("slow motion",)
        ),
        _Effect("few joints", "only some joints move", joints, ("few joints", "small motion")),
        _Effect(
            "still poses", "poses at standstill alone", (("all", {"motion": {"still_poses": True}}),), ("still poses",)
        ),
        _Effect("rests", "long and short rests", _sizes("motion", "rest", "s", 1.0, 0.2, 10)),
        _Effect("short recording", "little data", tuple((f"{s:g} s", {"seconds": s}) for s in (20.0, 45.0))),
    )


def _foreign() -> tuple[_Effect, ...]:
    """Return what the first users met with their own data: flights, clocks and places of which nothing is said."""
    flight = {"kind": "flight"}
    clocks = tuple(
        (f"{ppm:g} ppm, reference true", {"reference": {"clock_drift_ppm": ppm, "clock_is_true": True}})
        for ppm in (50.0, 400.0, 3000.0, -8000.0)
    )
    heights = tuple((f"{h:g} m", {"site": {"height_m": h}, "stated": {"height": False}}) for h in (2600.0, 3640.0))
    twice: Content = {"noise_factor": 0.5, "reference_factor": 0.5}
    return (
        _Effect(
            "propellers", "a drone that shakes", tuple(
                (f"{v:g} m/s^2", {"imu": {"propellers": v}, "motion": flight}) for v in (0.5, 2.0, 6.0)
            ), ("vibration", "stated noise"), ("mocap",),
        ),
        _Effect(
            "gentle flight", "a drone that hardly moves", tuple(
                (f"{v:g} m/s^2", {"imu": {"propellers": v}, "motion": {**flight, "range_share": 0.2}})
                for v in (0.0, 2.0)
            ), ("vibration", "stated noise", "small motion"), ("mocap",),
        ),
        _Effect(
            "never at rest", "a body turned by hand", (("usual", {"motion": {"kind": "hand"}}),), (), ("mocap",),
        ),
        _Effect("clock of the reference", "the reference's seconds are the true ones", clocks, ("clocks",)),
        _Effect("unsaid height", "a place high above the sea, whose height is not said", heights, (), _ROBOTS),
        _Effect(
            "noise and lag", "noise stated two times too small, and joints late by different times", (
                ("lag 5 ms", {"stated": twice, "errors": {"servo_lag": 5e-3}}),
                ("lag 15 ms", {"stated": twice, "errors": {"servo_lag": 15e-3}}),
            ), ("servo lag", "stated noise"), _ROBOTS,
        ),
        _Effect(
            "noise and flicker", "noise stated two times too small, and nothing of flicker noise", tuple(
                (grade, {"imu": {"grade": grade}, "stated": {**twice, "densities": True}})
                for grade in ("consumer-mems", "industrial-mems")
            ), ("stated noise", *GYRO_CHANGES, *ACCEL_CHANGES),
        ),
        _Effect("frozen poses", "cameras lose the body for 0.3 s", _sizes("reference", "frozen", "times", 1, 1, 5),
                ("held poses", "pose outliers"), ("mocap",)),
        _Effect("swapped markers", "cameras take markers for each other for 0.3 s",
                _sizes("reference", "swapped", "times", 1, 1, 5), ("pose outliers",), ("mocap",)),
        _Effect("gap of the IMU", "no samples for some time", _sizes("imu", "gap", "s", 1.0, 2, 15, 40)),
        _Effect("ten minutes", "a long recording", (("usual", {"seconds": 600.0, "imu": {"grade": "consumer-mems"}}),),
                (), ("poses",)),
    )  # fmt: skip
