"""CELL.toml: all settings of a virtual cell, with their defaults."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kreisel.errors import SettingsError, unknown_name
from kreisel.files import read_toml
from kreisel.inertial.noise_figures import GRADES
from kreisel.recording.recording_settings import what_is_wrong


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _key(default: Any, text: str, **bounds: Any) -> Any:
    return Field(default, description=text, **bounds)


class Robot(_Table):
    """The arm as in its controller's model."""

    model: str = _key("kr125", "kr125, ur10e, or a .urdf file (meshes are not read)")
    tcp: str | None = _key(None, "frame of the tool; the last link by default")


class Motion(_Table):
    """What the arm does: random moves that excite all six sensors, or a program; or a body that no arm moves."""

    kind: Literal["arm", "flight", "hand"] = _key(
        "arm", "arm; flight: a drone; hand: a body that is turned without a rest. Both need cameras (reference.kind)"
    )
    program: str | None = _key(None, "a file of moves (see --example-program); random moves by default")
    first_rest: float = _key(4.0, "s at standstill before the first move", ge=1.0, le=600.0)
    rest: float = _key(1.5, "s at standstill between moves, on average", ge=0.1, le=600.0)
    range_share: float = _key(
        0.7, "share of the joints' ranges that random moves use; of usual angles and lengths without an arm",
        gt=0.0, le=1.0,
    )  # fmt: skip
    tool_speed: float = _key(1.5, "largest speed of the tool, m/s", gt=0.0, le=20.0)
    tool_acceleration: float = _key(6.0, "largest acceleration of the tool, m/s^2", gt=0.0, le=100.0)
    smoothing: float = _key(0.012, "time over which the controller averages its set points, s", ge=0.0, le=0.5)
    joints: tuple[int, ...] = _key((), "joints that random moves use, from 1; all if empty")
    still_poses: bool = _key(False, "poses are reported only at standstill")


class Errors(_Table):
    """Differences between the arm and the reports of its controller; standard deviations, terms of ISO 9283."""

    geometry_length_sd: float = _key(
        3e-4, "AP: placement of every joint and of the tool, each direction, m", ge=0.0, le=0.05
    )
    geometry_angle_sd: float = _key(3e-4, "AP: the same about each axis, rad", ge=0.0, le=0.05)
    zero_sd: float = _key(
        0.0, "AP: zero of each joint between the first and the last, beyond its placement, rad", ge=0.0, le=0.1
    )
    gear_eccentricity_sd: float = _key(0.0, "AP: once per turn of each joint, rad", ge=0.0, le=0.01)
    sag_sd: float = _key(0.0, "AP: elastic sag of each joint at its largest gravity torque, rad", ge=0.0, le=0.01)
    repeatability_position_sd: float = _key(1e-4, "RP: one draw for each rest, m", ge=0.0, le=0.05)
    repeatability_orientation_sd: float = _key(1e-4, "RP: one draw for each rest, rad", ge=0.0, le=0.05)
    path_position_sd: float = _key(5e-4, "AT: while moving, m", ge=0.0, le=0.05)
    path_orientation_sd: float = _key(4e-4, "AT: while moving, rad", ge=0.0, le=0.05)
    path_correlation_time: float = _key(
        0.15, "AT: correlation time of this error, s; 0: a new one for each pose", ge=0.0
    )
    servo_lag: float = _key(
        0.0, "AT: delay of the joints after their set points, about this, each differently, s", ge=0.0, le=0.2
    )
    oscillation_frequency: float = _key(0.0, "Hz: elastic joints swing after each stop; 0: stiff", ge=0.0, le=100.0)
    oscillation_damping: float = _key(0.05, "share of critical damping of that swing", gt=0.0, lt=1.0)
    encoder_step: float = _key(0.0, "rad: joint angles are rounded to this", ge=0.0, le=0.01)
    backlash_sd: float = _key(
        0.0, "rad: play of each gear; while it moves, its joint is half of it behind the motor", ge=0.0, le=0.01
    )
    sway: float = _key(
        0.0, "m rms: while the arm moves, its base sways; not reported by the controller", ge=0.0, le=0.1
    )
    sway_frequency: float = _key(4.0, "Hz, of that sway", gt=0.0, le=50.0)

    @classmethod
    def none(cls) -> Errors:
        """Return an arm without errors."""
        return cls.model_validate({name: 0.0 for name in cls.model_fields if name.endswith(("_sd", "_lag", "sway"))})


class Reference(_Table):
    """How the controller records its poses, on its own clock."""

    kind: Literal["robot", "mocap"] = _key("robot", "robot, or mocap: then no joint angles are written")
    measures: Literal["pose", "position", "orientation"] = _key("pose", "pose, position or orientation")
    joints: bool = _key(True, "write joint angles and the robot's description too")
    interval: float = _key(0.012, "s between two poses", gt=0.0005, le=1.0)
    clock_offset: float = _key(0.0371, "t_imu - t_ref at the first pose, s", ge=-100.0, le=100.0)
    clock_drift_ppm: float = _key(0.0, "the IMU's clock against the reference's", ge=-10000.0, le=10000.0)
    clock_is_true: bool = _key(False, "its seconds are the true ones; otherwise the IMU's are")
    jitter: float = _key(0.0, "s: difference between the time of a pose and its stamp", ge=0.0, le=0.1)
    drop_share: float = _key(0.0, "share of poses that are lost", ge=0.0, le=0.9)
    position_scale_ppm: float = _key(0.0, "reported positions are longer by this", ge=-50000.0, le=50000.0)
    position_heading_deg: float = _key(
        0.0, "heading of the frame of reported positions against that of attitudes, about down", ge=-180.0, le=180.0
    )
    distortion: float = _key(
        0.0, "deviation of scales of axes, and of shears, of cameras' volume, in which a flat body of markers is seen",
        ge=0.0, le=0.05,
    )  # fmt: skip
    turning: float = _key(0.0, "rad/s: deviation of the rate at which the reference's frame turns", ge=0.0, le=0.01)
    smoothing: float = _key(
        0.0, "s: reported poses are means over a window of this standard deviation, as much before as after",
        ge=0.0, le=0.5,
    )  # fmt: skip
    interpolation: float = _key(
        0.0, "s: poses are taken at this interval, and interpolated linearly to their stamps; 0: not", ge=0.0, le=1.0
    )
    clock_walk: float = _key(0.0, "s per root second: random walk of the clock offset", ge=0.0, le=0.01)
    clock_jump: float = _key(0.0, "s: the clock offset jumps once, in the middle half", ge=-1.0, le=1.0)
    outlier_share: float = _key(0.0, "share of poses that are wrong by 20 mm and 20 mrad", ge=0.0, le=0.5)
    held: float = _key(0.0, "share of poses that repeat the one before, with a new stamp", ge=0.0, le=0.9)
    frozen: int = _key(0, "times that poses stay as they are for 0.3 s", ge=0, le=100)
    swapped: int = _key(0, "times that poses are those of a body turned by 120 deg for 0.3 s", ge=0, le=100)


class Imu(_Table):
    """The device under test; values come from its grade unless they are set here."""

    grade: str = _key("fog-mems", f"one of {', '.join(sorted(GRADES))}")
    rate: float | None = _key(None, "samples a second", gt=10.0, le=10000.0)
    noise: bool = _key(True, "white noise, bias instability, random walks and rounding of the grade")
    errors: bool = _key(True, "scale, misalignment and offsets of the grade; false: a device without errors")
    mounting_deg: tuple[float, float, float] = _key((0.0, 0.0, 0.0), "rotation vector of the IMU in the tool's frame")
    lever_arm: tuple[float, float, float] = _key((0.02, 0.03, 0.08), "of the IMU in the tool's frame, m")
    lever_arm_spread: float = _key(0.02, "standard deviation of the accelerometers about it, m", ge=0.0, le=1.0)
    quadratic_gyro_sd: float = _key(0.0, "k_w2, per rad/s", ge=0.0, le=0.1)
    quadratic_accel_sd: float = _key(0.0, "k_a2, per m/s^2", ge=0.0, le=0.01)
    averaged: bool = _key(False, "readings are means over the interval before, not values at its end")
    bandwidth: float | None = _key(None, "Hz: second-order low-pass, with its group delay; 0: none", ge=0.0, le=5000.0)
    drop_share: float = _key(0.0, "share of samples that are lost", ge=0.0, le=0.5)
    counted: bool = _key(False, "stamps are counted: samples that are lost leave no gap")
    lateness: float = _key(
        0.0, "s: samples are stamped on arrival, so much late on average, and one in two hundred by 16 ms more",
        ge=0.0, le=0.1,
    )  # fmt: skip
    burst: int = _key(1, "samples that arrive together", ge=1, le=100)
    gyro_temperature_drift: float = _key(0.0, "change of each gyro offset over the recording, rad/s", ge=-1.0, le=1.0)
    accel_temperature_drift: float = _key(0.0, "the same for accelerometers, m/s^2", ge=-1.0, le=1.0)
    gyro_g_sensitivity_sd: float | None = _key(
        None, "response of the gyros to raw accelerations, rad/s per m/s^2; with noise, the grade's if not set",
        ge=0.0, le=0.01,
    )  # fmt: skip
    gyro_g_squared_sd: float | None = _key(
        None, "response to their squares, rad/s per (m/s^2)^2; with noise, the grade's if not set", ge=0.0, le=1e-3
    )
    gyro_asymmetry_sd: float = _key(0.0, "coefficient of |w'|: scale factors differ with the sign", ge=0.0, le=0.05)
    accel_asymmetry_sd: float = _key(0.0, "coefficient of |a'|", ge=0.0, le=0.05)
    accel_delay: float = _key(0.0, "s: accelerometers show what was so long before", ge=-0.1, le=0.1)
    accel_bandwidth: float | None = _key(
        None, "Hz: low-pass of the accelerometers, if it is not that of the gyros; 0: none", ge=0.0, le=5000.0
    )
    axis_delay: float = _key(0.0, "s: axis x of a sensor is so much earlier, z so much later than y", ge=0.0, le=0.05)
    axis_smoothing: float = _key(
        0.0, "s: axis z of both sensors is a mean over a window of this standard deviation, y of half of it",
        ge=0.0, le=0.05,
    )  # fmt: skip
    gyro_walk: float = _key(0.0, "further random walk of the offsets, rad/s per root second", ge=0.0, le=0.1)
    accel_walk: float = _key(0.0, "the same for accelerometers, m/s^2 per root second", ge=0.0, le=1.0)
    gyro_step: float = _key(0.0, "jump of every offset, up or down, once in the middle half, rad/s", ge=0.0, le=1.0)
    accel_step: float = _key(0.0, "the same for accelerometers, m/s^2", ge=0.0, le=10.0)
    gyro_warm_up: float = _key(0.0, "excess of every offset at the beginning, up or down, rad/s", ge=0.0, le=1.0)
    accel_warm_up: float = _key(0.0, "the same for accelerometers, m/s^2", ge=0.0, le=10.0)
    warm_up_time: float = _key(60.0, "s in which that excess falls to 37 %", gt=0.0, le=1e5)
    temperature_rise: float = _key(
        0.0, "K by which the sensor warms up from 25 degC, as warm_up_time says; with it a temperature is recorded",
        ge=-100.0, le=100.0,
    )  # fmt: skip
    gyro_temperature_sd: float = _key(0.0, "temperature coefficients of the offsets, rad/s/K", ge=0.0, le=0.01)
    accel_temperature_sd: float = _key(0.0, "the same for accelerometers, m/s^2/K", ge=0.0, le=1.0)
    gyro_scale_temperature_sd: float = _key(0.0, "temperature coefficients of the scale factors, 1/K", ge=0.0, le=0.01)
    accel_scale_temperature_sd: float = _key(0.0, "the same for accelerometers, 1/K", ge=0.0, le=0.01)
    vibration: float = _key(0.0, "m/s^2 rms, of a sine along one direction while moving", ge=0.0, le=100.0)
    vibration_frequency: float = _key(83.0, "Hz; above half the sample rate it aliases", gt=0.0, le=5000.0)
    gyro_quantum: float | None = _key(None, "step that rates are rounded to, rad/s; the grade's if not set", ge=0.0)
    accel_quantum: float | None = _key(None, "the same for accelerometers, m/s^2", ge=0.0)
    propellers: float = _key(
        0.0, "m/s^2 rms: shaking while moving, tones of rotors above half the sample rate and noise, uneven in time",
        ge=0.0, le=100.0,
    )  # fmt: skip
    gap: float = _key(0.0, "s without samples, once in the middle half", ge=0.0, le=600.0)
    slip_deg: float = _key(0.0, "the IMU turns in its mount by this, once in the middle half", ge=0.0, le=45.0)
    mount_bending_sd: float = _key(
        0.0, "elastic mount: rotation of the IMU for a specific force, rad per m/s^2", ge=0.0, le=1e-3
    )
    mount_deflection_sd: float = _key(0.0, "the same for its shift, m per m/s^2", ge=0.0, le=1e-3)
    stuck_share: float = _key(0.0, "share of samples that repeat the one before", ge=0.0, le=0.5)
    spike_share: float = _key(
        0.0, "share of samples one of whose readings is ten times as large as usual", ge=0.0, le=0.5
    )


class Site(_Table):
    """Place of the cell on Earth, and its orientation."""

    latitude_deg: float = _key(49.2571, "by default Saarbruecken, where the paper was written", ge=-90.0, le=90.0)
    height_m: float = _key(200.0, "above the ellipsoid", ge=-500.0, le=9000.0)
    gravity_anomaly: float = _key(0.0, "m/s^2: gravity above its normal value there", ge=-0.01, le=0.01)
    heading_deg: float = _key(30.0, "the base's x axis, from north to east", ge=-360.0, le=360.0)
    tilt_sd: float = _key(2e-3, "rad: tilt of the base", ge=0.0, le=0.5)


class Stated(_Table):
    """What the owner writes into recording.toml, where it differs from the truth; nothing differs by default."""

    settings: bool = _key(True, "false: recording.toml is empty")
    grade: str = _key("", "name of another grade; the device's own if empty")
    densities: bool = _key(False, "noise densities are stated instead of the grade")
    noise_factor: float = _key(1.0, "on both noise densities of the IMU", gt=0.0, le=1000.0)
    offset_sd_factor: float = _key(1.0, "on the standard deviations of its offsets", gt=0.0, le=1000.0)
    place: bool = _key(True, "false: nothing is said about the place on Earth")
    latitude_deg: float | None = _key(None, "another latitude than the cell's", ge=-90.0, le=90.0)
    gravity: float | None = _key(None, "a value of gravity, m/s^2; only the place if not set", ge=9.7, le=9.9)
    reference_factor: float = _key(1.0, "on the standard deviations of the poses", gt=0.0, le=1000.0)
    robot: bool = _key(True, "false: nothing is said about the robot's errors")
    robot_factor: float = _key(1.0, "on the standard deviations of the robot's errors", gt=0.0, le=1000.0)
    joints: bool = _key(True, "false: joint angles and the robot's description are not given")
    urdf_length_error: float = _key(0.0, "m: one link of the robot's description is too long", ge=-0.1, le=0.1)
    tcp_error: float = _key(0.0, "m: its tool is so much off, across the flange's axis", ge=-0.5, le=0.5)
    height: bool = _key(True, "false: the height is not given")


class Unlisted(_Table):
    """Errors that the sensor model has no name for: numbers of random smooth functions, and sizes of known shapes."""

    gyro: int = _key(0, "of rates, forces, their slopes, what was before, time", ge=0, le=5)
    accel: int = _key(0, "the same for accelerometers", ge=0, le=5)
    reference: int = _key(0, "of the pose and time", ge=0, le=5)
    joints: int = _key(0, "of each joint's angle, in the reported poses of an arm", ge=0, le=5)
    clock: int = _key(0, "of time: by how much poses are late", ge=0, le=5)
    size: float = _key(1.0, "factor on the sizes, which go up to what data sheets state", ge=0.0, le=10.0)
    gyro_cubic: float = _key(0.0, "coefficient of w'^3, either sign, (rad/s)^-2", ge=0.0, le=0.01)
    accel_products: float = _key(0.0, "sd of the coefficients of products of two axes, (m/s^2)^-1", ge=0.0, le=1e-3)
    scale_drift: float = _key(0.0, "change of the scale factors over the recording, up or down", ge=0.0, le=0.1)
    hysteresis: float = _key(0.0, "share of a play of half the rms of the readings", ge=0.0, le=0.1)
    dead_zone: float = _key(0.0, "rad/s: smaller rates read zero", ge=0.0, le=0.1)
    axis_scale: float = _key(0.0, "reported x are shorter by this, z longer", ge=0.0, le=0.05)
    base_tilt: float = _key(0.0, "rad/m: the base tilts by the tool's weight, not reported", ge=0.0, le=0.02)
    reference_jump: float = _key(
        0.0, "m, and rad: the reference's frame jumps once, in the middle half", ge=0.0, le=0.5
    )
    reference_drift: float = _key(0.0, "m and rad per root s: its random walk", ge=0.0, le=0.1)


class Tray(_Table):
    """Further IMUs on the same tool, each a device of its own."""

    units: int = _key(1, "IMUs on the tool, in a square grid from the lever arm on", ge=1, le=256)
    spacing: float = _key(0.05, "m between neighbours, along x and y of the tool", ge=0.0, le=1.0)
    turned_deg: tuple[float, float, float] = _key((0.0, 0.0, 0.0), "rotation vector of odd units against even ones")
    clock_offset: float = _key(0.0, "s: standard deviation of the offset of a further unit's clock", ge=0.0, le=1e4)
    clock_drift_ppm: float = _key(0.0, "the same of its drift", ge=0.0, le=5000.0)
    slipping: int | None = _key(None, "number of the only unit that imu.slip_deg turns", ge=0, lt=256)


class Cell(_Table):
    """A virtual cell."""

    seed: int = _key(1, "all randomness follows from it", ge=0)
    run: int = _key(
        0, "number of the recording: runs of one seed have the same device, arm and place", ge=0, lt=1000000
    )
    seconds: float = _key(600.0, "length of the recording", ge=10.0, le=100_000.0)
    robot: Robot = Robot()
    motion: Motion = Motion()
    errors: Errors = Errors()
    reference: Reference = Reference()
    imu: Imu = Imu()
    site: Site = Site()
    stated: Stated = Stated()
    unlisted: Unlisted = Unlisted()
    tray: Tray = Tray()


def read_cell(path: Path) -> Cell:
    """Return the cell that a TOML file describes; paths of a program or a URDF in it are relative to the file.

    Raises
    ------
    SettingsError
        If it cannot be read, has an unknown key (the known ones are listed) or an impossible value.
    """
    example = "`kreisel simulate --example` prints a cell"
    content = read_toml(path, example, lambda text: SettingsError(f"{path}: {text}"))
    return parse_cell(content, path)


def parse_cell(content: dict[str, Any], path: Path) -> Cell:
    """Return the cell of a parsed file; see `read_cell`."""
    fields = Cell.model_fields
    for name, value in content.items():
        if name not in fields:
            raise SettingsError(f"{path}: {unknown_name('key', name, fields)}")
        table = fields[name].annotation
        if isinstance(table, type) and issubclass(table, BaseModel):
            if not isinstance(value, dict):
                raise SettingsError(f"{path}: '{name}' must be a table: write [{name}]")
            for key in value:
                if key not in table.model_fields:
                    raise SettingsError(f"{path}: {unknown_name('key', f'{name}.{key}', table.model_fields)}")
    for section, key in (("robot", "model"), ("motion", "program")):
        named = content.get(section, {}).get(key)
        if isinstance(named, str) and (path.parent / named).is_file():
            content[section][key] = str(path.parent / named)
    try:
        cell = Cell.model_validate(content)
    except ValidationError as error:
        raise SettingsError(f"{path}: {what_is_wrong(error)}") from error
    for grade in (cell.imu.grade, cell.stated.grade):
        if grade and grade not in GRADES:
            raise SettingsError(f"{path}: {unknown_name('grade', grade, GRADES)}")
    return cell


def example() -> str:
    """Return a CELL.toml with every key, its default and what it means."""
    lines = ["# A virtual cell for `kreisel simulate CELL.toml -o RECORDING`. Every key is optional.", ""]
    tables = []
    for name, info in Cell.model_fields.items():
        table = info.annotation
        if isinstance(table, type) and issubclass(table, BaseModel):
            tables.append((name, table))
        else:
            lines.append(_line(name, info.default, info.description))
    for name, table in tables:
        lines += ["", f"# {table.__doc__}", f"[{name}]"]
        lines += [_line(key, info.default, info.description) for key, info in table.model_fields.items()]
    return "\n".join(lines) + "\n"


def _line(key: str, default: Any, description: str | None) -> str:
    unset = default is None
    value = "" if unset else json.dumps(list(default) if isinstance(default, tuple) else default)
    return f"{'# ' if unset else ''}{key} = {value:<{max(1, 34 - len(key) - 2 * unset)}} # {description}"
