"""The recording: raw IMU samples, reference poses and joint angles, each on its own clock."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kreisel.geometry.rotation import Array
from kreisel.recording.header import NO_UNITS, HeaderUnits
from kreisel.recording.recording_settings import RecordingSettings

Stamps = NDArray[np.int64]

NO_STAMP = int(np.iinfo(np.int64).min)
"""In the place of a stamp that is missing in a file; `missing` leaves these rows out."""

Rows = NDArray[np.int64]
"""Numbers of rows as in the file, counted from 0."""

CHUNK = 1 << 17
"""Rows of one chunk of a long recording, which does not fit into memory at once."""


def chunks(size: int) -> list[slice]:
    """Return consecutive slices of `CHUNK` rows; a short remainder is added to the last."""
    starts = range(0, max(size - CHUNK // 4, 1), CHUNK)
    return [slice(start, size if start == starts[-1] else start + CHUNK) for start in starts]


def excerpt(values: Array, most: int = 4) -> list[Array]:
    """Return a few chunks of rows (n, …), spread evenly: enough for usual values such as medians."""
    all_of_them = chunks(len(values))
    chosen = np.unique(np.round(np.linspace(0, len(all_of_them) - 1, most)).astype(int))
    return [values[all_of_them[i]] for i in chosen]


def angles_over(q: Array, stride: int) -> Array:
    """Return the angles (m - stride,) between attitudes q (m, 4) that many rows apart, rad.

    By the chord between the quaternions, one of which stands for the same attitude with the other sign, too.
    """
    angle = np.empty(len(q) - stride)
    for part in chunks(angle.size):
        before, later = q[part], q[part.start + stride : part.stop + stride]
        same, other = (np.einsum("ni,ni->n", chord, chord) for chord in (later - before, later + before))
        angle[part] = 4.0 * np.arcsin(0.5 * np.sqrt(np.minimum(same, other)))
    return angle


def rows_of(rows: Rows | None, size: int, keep: slice | NDArray[np.bool_] | Rows) -> Rows:
    """Return the numbers of rows that a slice, a mask or indices select; `rows` is None where all `size` were there."""
    return np.arange(size)[keep] if rows is None else rows[keep]


@dataclass(frozen=True)
class DataWarning:
    """Something to know about the recording; `subject` is what the message is about."""

    subject: str
    message: str

    def __str__(self) -> str:
        return f"{self.subject}: {self.message}"


NO_REFERENCE = "reference"
"""Subject of what is said of a recording without a reference that may have one."""


@dataclass(frozen=True, eq=False)
class ImuSamples:
    """Raw readings on the IMU's clock.

    Attributes
    ----------
    stamps_ns : (n,)
    rates, accelerations : (n, 3)
        rad/s and m/s^2, as read, without corrections.
    source
        The file they came from, for messages.
    units
        Units that its header states.
    lateness
        By how much corrected stamps may all be late, s; 0 where they are as recorded.
    temperature : (n,) or None
        Of the sensor, degrees Celsius, where it was recorded.
    restarts_ns : (k,)
        Stamps of the first samples after places where the clock was set: by how much is not known before the reference
        is compared.
    placed_sd
        How accurately the parts after such places were put in place by the reference, s.
    stretch
        Seconds by its own stamps for one of these, less one: not zero where they were put onto the reference's clock.
    broken_ns : (k,)
        Stamps of samples of which nobody knows what they should have been: the motion must not be bridged there. Where
        a reference is, they were left out.
    rows : (n,) or None
        Which rows of the source the samples are, while the streams are checked and some were left out or sorted.
    """

    stamps_ns: Stamps
    rates: Array
    accelerations: Array
    source: Path
    units: HeaderUnits = NO_UNITS
    lateness: float = 0.0
    temperature: Array | None = None
    broken_ns: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    restarts_ns: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    placed_sd: float = 0.0
    stretch: float = 0.0
    rows: Rows | None = None

    def row_of(self, place: int) -> int:
        """Return the row of the source that a sample is, for messages."""
        return place if self.rows is None else int(self.rows[place])

    @cached_property
    def usual_temperature(self) -> float | None:
        """The mean temperature, to which the parameters belong; degrees Celsius."""
        return None if self.temperature is None else float(np.mean(self.temperature))

    @cached_property
    def temperature_difference(self) -> Array | None:
        """Temperature above the mean, K, (n,)."""
        usual = self.usual_temperature
        return None if self.temperature is None or usual is None else self.temperature - usual

    @cached_property
    def seconds(self) -> Array:
        """Seconds since the first sample, (n,)."""
        return (self.stamps_ns - self.stamps_ns[0]) * 1e-9

    @cached_property
    def interval(self) -> float:
        """Usual time between two samples, s."""
        return float(np.median(np.diff(self.stamps_ns))) * 1e-9


@dataclass(frozen=True, eq=False)
class ReferencePoses:
    """Poses of the body b in the reference frame r, on the reference's clock.

    Attributes
    ----------
    stamps_ns : (m,)
    positions : (m, 3) or None
        m.
    quaternions : (m, 4) or None
        q_rb, scalar first, unit length.
    lateness
        By how much rounded stamps may all be late, s; 0 where they are exact.
    doubtful : (m,) or None
        Poses of which the moment is not known well enough to be used by the filter.
    rows : (m,) or None
        Which rows of the source the poses are; see `ImuSamples`.
    """

    name: str
    stamps_ns: Stamps
    positions: Array | None
    quaternions: Array | None
    source: Path
    units: HeaderUnits = NO_UNITS
    lateness: float = 0.0
    doubtful: NDArray[np.bool_] | None = None
    rows: Rows | None = None

    def row_of(self, place: int) -> int:
        """Return the row of the source that a pose is, for messages."""
        return place if self.rows is None else int(self.rows[place])

    @cached_property
    def seconds(self) -> Array:
        """Seconds since the first pose, (m,)."""
        return (self.stamps_ns - self.stamps_ns[0]) * 1e-9

    @cached_property
    def interval(self) -> float:
        """Usual time between two poses, s."""
        return float(np.median(np.diff(self.stamps_ns))) * 1e-9

    @cached_property
    def extent(self) -> float:
        """Largest extent of the positions along an axis, m; 0 without positions."""
        return 0.0 if self.positions is None else float(np.max(np.ptp(self.positions, axis=0)))

    @cached_property
    def fastest(self) -> float:
        """Largest speed by the positions over a second, m/s; 0 without positions."""
        if self.positions is None:
            return 0.0
        apart = max(1, round(1.0 / self.interval))
        way = np.linalg.norm(self.positions[apart:] - self.positions[:-apart], axis=1)
        return float(np.max(way / (self.seconds[apart:] - self.seconds[:-apart]), initial=0.0))

    def with_quaternions(self, quaternions: Array) -> ReferencePoses:
        """Return the poses with other quaternions."""
        return replace(self, quaternions=quaternions)

    def part(self, keep: slice | NDArray[np.bool_] | Rows) -> ReferencePoses:
        """Return the poses that a slice, a mask or indices select."""
        return replace(
            self,
            stamps_ns=self.stamps_ns[keep],
            positions=None if self.positions is None else self.positions[keep],
            quaternions=None if self.quaternions is None else self.quaternions[keep],
            doubtful=None if self.doubtful is None else self.doubtful[keep],
            rows=rows_of(self.rows, self.stamps_ns.size, keep),
        )


@dataclass(frozen=True, eq=False)
class JointAngles:
    """Joint angles (m, joints) in rad, on the robot's clock; `rows` as of `ImuSamples`."""

    stamps_ns: Stamps
    angles: Array
    source: Path
    units: HeaderUnits = NO_UNITS
    rows: Rows | None = None

    def row_of(self, place: int) -> int:
        """Return the row of the source that angles are, for messages."""
        return place if self.rows is None else int(self.rows[place])

    def part(self, keep: NDArray[np.bool_] | Rows) -> JointAngles:
        """Return the angles that a mask or indices select."""
        rows = rows_of(self.rows, self.stamps_ns.size, keep)
        return replace(self, stamps_ns=self.stamps_ns[keep], angles=self.angles[keep], rows=rows)


@dataclass(frozen=True, eq=False)
class TableAngles:
    """Angles of a turntable (m,) in rad, over whole turns, on its own clock.

    `by_rate` says whether they were integrated from rates.
    """

    stamps_ns: Stamps
    angles: Array
    source: Path
    by_rate: bool = False

    @cached_property
    def seconds(self) -> Array:
        """Seconds since the first one, (m,)."""
        return (self.stamps_ns - self.stamps_ns[0]) * 1e-9


@dataclass(frozen=True)
class Datasheet:
    """Noise figures that a recording contains but its user did not state (EuRoC's sensor.yaml), SI.

    Densities per root hertz; random walks of the offsets, unit per second and root hertz.
    """

    gyro_noise_density: float
    accel_noise_density: float
    gyro_random_walk: float
    accel_random_walk: float


_NO_ROBOT = ("vicon", "leica", "state_groundtruth", "mocap")
"""Starts of the names of references that are not robots."""


@dataclass(frozen=True, eq=False)
class Recording:
    """All data of one run of the cell.

    `urdf` is the text of the robot's description, `sha256` the fingerprint of the data as they were read; see
    `recording.digest`. `table` is a turntable's motion.
    """

    path: Path
    imu: ImuSamples
    reference: ReferencePoses | None
    joints: JointAngles | None = None
    settings: RecordingSettings = field(default_factory=RecordingSettings)
    warnings: tuple[DataWarning, ...] = ()
    datasheet: Datasheet | None = None
    urdf: str | None = None
    sha256: str | None = None
    table: TableAngles | None = None

    @property
    def name(self) -> str:
        """Name of the recording's folder or file."""
        return self.path.resolve().name

    @property
    def reference_kind(self) -> Literal["robot", "mocap"]:
        """Kind of the reference: as stated, or by its name as in EuRoC recordings."""
        stated = self.settings.reference.kind
        if stated is not None:
            return stated
        return "mocap" if self.reference is not None and self.reference.name.startswith(_NO_ROBOT) else "robot"

    def with_warnings(self, *warnings: DataWarning) -> Recording:
        """Return the recording with further warnings."""
        return replace(self, warnings=(*self.warnings, *warnings))
