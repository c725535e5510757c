"""The typed parts of a calibration: what each section of the result file holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from kreisel.estimation.uncertainty_budget import Budget
from kreisel.geometry.rotation import Array
from kreisel.inertial.counts import Counts
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.model.considered_terms import Considered
from kreisel.robot.pose_accuracy import PoseAccuracy


@dataclass(frozen=True)
class Measured:
    """A value and its standard deviation, arrays of one shape, SI or the unit a name states; 0 for what was fixed."""

    value: Array
    deviation: Array


@dataclass(frozen=True)
class DeviceTriad:
    """The device's own part of a calibration, in a frame s of its own; see `calibration.device_axes`.

    Attributes
    ----------
    gyro_matrix, accel_matrix : (3, 3)
        K from readings to axes of s.
    lever_arms : (3, 3)
        Row j is the position of accelerometer j in s, m.
    rotation : (3, 3)
        C_bs: turns a vector from s to b.
    rotation_vector : (3,)
        The same rotation, with its deviation, rad.
    position : (3,)
        Origin of s in b, m.
    """

    gyro_matrix: Measured
    accel_matrix: Measured
    lever_arms: Measured
    rotation: Array
    rotation_vector: Measured
    position: Measured


@dataclass(frozen=True)
class StatedNoise:
    """The IMU's noise as stated, SI, and where: densities of white noise, and of random walks of the offsets.

    Entries are None where nothing is stated.
    """

    source: str
    gyro_density: float | None
    accel_density: float | None
    gyro_walk: float | None
    accel_walk: float | None


@dataclass(frozen=True)
class Timing:
    """How the clocks relate: t_imu = t_ref + offset + skew (t_ref - first t_ref), s and 1.

    `skew_sd` is None where the ratio of the clocks was not estimated.
    """

    offset: float = 0.0
    skew: float = 0.0
    offset_sd: float | None = None
    skew_sd: float | None = None


@dataclass(frozen=True)
class Alignment:
    """Directions in r: gravity, m/s^2; north, a level vector of about unit length; the Earth's rotation, rad/s.

    North is there with a stated latitude, the Earth's rotation without one.
    """

    gravity: Measured
    north: Measured | None = None
    earth_rate: Measured | None = None


@dataclass(frozen=True)
class RecordingFacts:
    """The recording that was used.

    Attributes
    ----------
    temperature_c
        Its mean temperature, degrees Celsius, where it was recorded.
    noise
        The IMU's, as stated.
    device, certificate
        What `[device]` and `[certificate]` of recording.toml state, by key.
    digest
        SHA-256 of its data; see `recording.digest`.
    begin_ns
        The IMU's first stamp.
    reference_kind
        "robot" or "mocap", as stated; empty where it was not.
    counts
        What a count of raw converter readings is; None where they were quantities.
    """

    name: str
    reference: str
    imu_samples: int
    imu_rate_hz: float
    reference_poses: int
    duration_s: float
    warnings: tuple[str, ...] = ()
    temperature_c: float | None = None
    noise: StatedNoise | None = None
    device: Mapping[str, str] = field(default_factory=dict)
    certificate: Mapping[str, str] = field(default_factory=dict)
    digest: str | None = None
    begin_ns: int | None = None
    reference_kind: str = ""
    counts: Counts | None = None

    @property
    def title(self) -> str:
        """The device by maker, type and serial number, as far as they are stated; otherwise the recording's name."""
        words = [self.device.get(key, "") for key in ("maker", "type", "serial_number")]
        return " ".join(word for word in words if word) or self.name


@dataclass(frozen=True)
class FinalNoise:
    """Noise figures finally assumed, SI: densities of the IMU, rms over the axes, and the reference's deviations."""

    gyro_density: float
    accel_density: float
    position_sd: float
    orientation_sd: float
    standstill_position_sd: float
    standstill_orientation_sd: float


@dataclass(frozen=True)
class EstimatorFacts:
    """How the parameters were estimated.

    `filter_seconds` is the duration of the estimation; `fixed` are groups the user fixed, `held` those that
    earlier versions held at nominal values, because they were not observable.
    """

    name: str
    sigma_points: str
    states: int
    update_interval: float
    updates: int
    passes: int
    filter_seconds: float
    polynomial_order: int
    fixed: tuple[str, ...]
    noise: FinalNoise
    held: tuple[str, ...] = ()


@dataclass(frozen=True)
class RobotErrors:
    """The robot's own errors, joint by joint, and their effect on its poses.

    Attributes
    ----------
    placement : (n + 1, 6)
        Of joints and tool; see `model.parameters.RobotParameters`.
    gears, compliance, zeros : (n, 2), (n,), (n - 2,)
        None where they were not estimated.
    before, found, after
        Pose error expected before the estimation, removed by the estimated errors, and expected to remain.
    not_separable
        Names of errors that cannot be distinguished from others with this motion.
    """

    name: str
    tcp: str
    joints: tuple[str, ...]
    placement: Measured
    gears: Measured | None
    compliance: Measured | None
    zeros: Measured | None
    before: PoseAccuracy
    found: PoseAccuracy
    after: PoseAccuracy
    not_separable: tuple[str, ...]


@dataclass(frozen=True)
class Consistency:
    """Statistics of the innovations.

    Attributes
    ----------
    nis_path, nis_standstill
        Mean normalised innovation squared per degree of freedom; 1 is expected.
    updates, rejected
        Numbers of updates, and of those that were rejected.
    lag_one : (6,)
        Correlation of neighbouring whitened innovations of position and orientation.
    correlation_factor
        Factor on standard deviations for innovations that are correlated in time.
    synchronisation
        Correlation coefficient of the rates of IMU and reference.
    """

    nis_path: float
    nis_standstill: float
    updates: int
    rejected: int
    lag_one: Array
    correlation_factor: float
    synchronisation: float


@dataclass(frozen=True)
class Cause:
    """A cause of what does not fit: its name, its figure in words, and the log-likelihood by which the data show it."""

    name: str
    text: str
    weight: float


_NAMES = {"gyroscope": "gyros", "accelerometer": "accelerometers"}


@dataclass(frozen=True)
class Verdict:
    """Whether a result may be used: the same text on the terminal, in the report and in the result file.

    Attributes
    ----------
    accepted, reasons
        Whether it may be used, and the reasons if not. One that is accepted with a reason was read from a file of
        another program, and judged by nobody.
    unobservable
        Names of parameters that are not observable, or too weakly to be of use.
    causes
        What the data show beyond the usual model, the likeliest first; estimated, where that is possible.
    sensors
        Of gyroscope and accelerometer: accepted, not_observable (with this motion) or rejected. Empty in older files.
    unasked
        Reasons against a sensor that nobody asked for.
    """

    accepted: bool
    reasons: tuple[str, ...]
    unobservable: tuple[str, ...] = ()
    causes: tuple[Cause, ...] = ()
    sensors: Mapping[str, str] = field(default_factory=dict)
    unasked: tuple[str, ...] = ()

    @property
    def first_reason(self) -> str:
        """The first reason against it, in one line."""
        return self.reasons[0] if self.reasons else "no reason is in the file"

    @property
    def not_usable(self) -> tuple[str, ...]:
        """Sensors that are not accepted although the result is: nobody asked for them."""
        return tuple(sensor for sensor, state in self.sensors.items() if state != "accepted") if self.accepted else ()

    @property
    def caution(self) -> str:
        """A sentence about the sensor that is not accepted although the result is; empty without one."""
        if not self.not_usable:
            return ""
        sensor = self.not_usable[0]
        state = self.sensors[sensor].replace("_", " ")
        why = f" ({self.unasked[0]})" if self.unasked else ""
        return f"The {_NAMES[sensor]} are {state}{why}: do not rely on their parameters."

    @property
    def headline(self) -> str:
        """The verdict in a few words."""
        if not self.accepted:
            return "Rejected"
        if self.reasons:
            return "Not judged"
        if self.not_usable:
            return f"Accepted for the {_NAMES[next(s for s in self.sensors if s not in self.not_usable)]} alone"
        return "Accepted, not all observable" if self.unobservable else "Accepted"

    @property
    def sentence(self) -> str:
        """What to do with the result."""
        if not self.accepted:
            alone = [f"--only {sensor}" for sensor, state in self.sensors.items() if state == "accepted"]
            return f"Do not use this calibration{f' ({alone[0]} would be accepted)' if alone else ''}."
        if self.reasons:
            return f"{'; '.join(self.reasons)}."
        if self.not_usable:
            return f"The result fits the data and may be used for them. {self.caution}"
        lost = len(self.unobservable)
        if lost == 0:
            return "The result fits the data, and every estimated parameter is observable. It may be used."
        which, those = ("one parameter is", "it") if lost == 1 else (f"{lost} parameters are", "them")
        return (
            f"The result fits the data and may be used, but {which} not observable, or too weakly to be of use. "
            f"Do not rely on {those}."
        )

    @property
    def summary(self) -> str:
        """Headline and sentence."""
        return f"{self.headline}. {self.sentence}"


@dataclass(frozen=True)
class JointRecording:
    """What one of several recordings has of its own.

    Attributes
    ----------
    gyro_offset, accel_offset
        Rad/s and m/s^2, as corrections.
    turn, shift
        Its mount against that of the first recording: the rotation vector (rad) from vectors in the first body b to
        those in its own, and the position of the first body's origin in its own, m.
    timing
        Its clocks.
    """

    name: str
    gyro_offset: Measured
    accel_offset: Measured
    turn: Measured
    shift: Measured
    timing: Timing


@dataclass(frozen=True)
class JointFacts:
    """How several recordings of one device were brought together.

    Attributes
    ----------
    common
        What they have in common besides the device.
    recordings
        In the order given; the result is in the body b of the first one.
    left_out
        Names of recordings that were not used, and the reasons.
    chi_square, degrees
        Of what the recordings say of common parameters, and the number expected.
    factor, differing
        Factor on standard deviations, and the recordings that differ from the others by more than by chance.
    """

    common: tuple[str, ...]
    recordings: tuple[JointRecording, ...]
    left_out: tuple[tuple[str, str], ...]
    chi_square: float
    degrees: int
    factor: float = 1.0
    differing: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class CalibrationParts:
    """The content of `calibration.yaml`.

    Attributes
    ----------
    sensors, sensor_sd
        Parameters of the sensor model, and their standard deviations in the same form.
    size_effect
        Form of the eccentricity term the parameters belong to.
    timing, alignment
        Clocks and directions.
    derived
        The sensors' errors in the terms of data sheets, by name; see `calibration.data_sheet`.
    consistency, verdict
        What supports the result, and whether it may be used.
    recording, estimator
        The recording, and how the parameters were estimated; None if the file does not contain it.
    robot
        The robot's own errors, where they were estimated.
    others
        Groups of parameters without a field of their own, by their path in the result file.
    considered
        Effects beyond the usual ones, whether or not the data show them.
    joint
        Where the calibration is one from several recordings.
    axes
        The axes that `sensors` turns readings into; see `calibration.device_axes`.
    triads
        The device's own part, with the mounting split off, by choice of axes; of a calibration in axes of the tool.
    budget
        Where the uncertainty comes from; of a calibration from one recording, in axes of the tool.
    """

    sensors: SensorParameters
    sensor_sd: SensorParameters
    size_effect: SizeEffect
    timing: Timing
    alignment: Alignment
    derived: Mapping[str, Measured]
    consistency: Consistency
    verdict: Verdict
    recording: RecordingFacts | None = None
    estimator: EstimatorFacts | None = None
    robot: RobotErrors | None = None
    others: Mapping[str, Measured] = field(default_factory=dict)
    considered: tuple[Considered, ...] = ()
    joint: JointFacts | None = None
    axes: str = "tool"
    triads: Mapping[str, DeviceTriad] = field(default_factory=dict)
    budget: Budget | None = None
