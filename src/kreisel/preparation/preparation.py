"""What is known after the preparation of a recording, before the filter runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from kreisel.geometry.rotation import Array, Mask
from kreisel.inertial.readings import Readings
from kreisel.model.assumed_noise import ReferenceNoise
from kreisel.model.robot_model import RobotModel
from kreisel.model.site import Site
from kreisel.model.standstill import ImuStillness, OutsideStandstill, Standstill
from kreisel.recording.recording import DataWarning, Recording, ReferencePoses
from kreisel.synchronization.fits import Correlation, RateFit


@dataclass(frozen=True)
class ImuNoise:
    """Noise of the IMU, SI: densities (3,), random walks and prior deviations of its offsets.

    `gyro_bounds` and `accel_bounds` are the densities between which the data may change it: from the maker's figure
    to well above the readings' own scatter, because some errors grow with the motion. `gyro_scatter` is the noise of
    a single reading, rad/s. `gyro_gauss_markov` and `accel_gauss_markov` are deviations of what
    passes within seconds, `observed` the densities (2, 3) of gyros and accelerometers that the readings show. Of
    the sensors in `misstated` nothing that is stated is used: at rest they are so many times as noisy; those in
    `doubtful` are noisier than stated, too, but less so.
    """

    gyro: Array
    accel: Array
    gyro_bounds: tuple[float, float]
    accel_bounds: tuple[float, float]
    gyro_walk: float
    accel_walk: float
    given: bool
    gyro_offset_sd: float | None
    accel_offset_sd: float | None
    gyro_scatter: float
    gyro_gauss_markov: float = 0.0
    accel_gauss_markov: float = 0.0
    observed: Array = field(default_factory=lambda: np.full((2, 3), np.inf))
    misstated: Mapping[str, float] = field(default_factory=dict)
    doubtful: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class AccelerationWindows:
    """Accelerations over windows, by the readings (predicted) and by the reference.

    Attributes
    ----------
    regressor : (windows, 3, 15)
        Predicted acceleration for a unit of each parameter: see `_kernels.unit_forces`.
    reference : (windows, 3)
        By the positions; zero where there are none.
    standstill_regressor : (standstills, 3, 15)
        Means over standstills, of the same columns.
    """

    regressor: Array
    reference: Array
    standstill_regressor: Array


@dataclass(frozen=True)
class AccelerometerFit:
    """Start values found for the accelerometers and gravity.

    Attributes
    ----------
    K_a, k_a0, lever_arm, gravity
        (3, 3), (3,), (3,), (3,); SI, gravity in r.
    motion_slope
        Factor between reference accelerations and predicted ones, without gravity: about 1.
    residual_sd
        Standard deviation of the residual in a window, m/s^2.
    K_a_sd, k_a0_sd, lever_arm_sd, tilt_sd
        Standard deviations of the fit; that of gravity's direction in rad.
    windows
        The data of the fit.
    """

    K_a: Array
    k_a0: Array
    lever_arm: Array
    gravity: Array
    motion_slope: float
    residual_sd: float
    K_a_sd: Array
    k_a0_sd: Array
    lever_arm_sd: Array
    tilt_sd: float
    windows: AccelerationWindows


@dataclass(frozen=True)
class Preparation:
    """Results of all steps before the filter.

    wrong_stamps: (m,), whether the stamp of a pose is wrong by far more than those of others, by the gyros.
    """

    recording: Recording
    reference: ReferencePoses
    site: Site
    imu_noise: ImuNoise
    noise: ReferenceNoise
    readings: Readings
    correlation: Correlation
    rate_fit: RateFit
    accelerometer_fit: AccelerometerFit
    stillness: ImuStillness
    standstills: tuple[Standstill, ...]
    outside_standstill: OutsideStandstill | None
    robot: RobotModel | None
    wrong_stamps: Mask
    warnings: tuple[DataWarning, ...]
    time_base_sd: float = 0.0

    @property
    def joints(self) -> int:
        """Joints of the robot whose errors are estimated; 0 without one."""
        return 0 if self.robot is None else self.robot.joints
