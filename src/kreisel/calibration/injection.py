"""Injection: known errors are added to the raw readings, and it is checked whether they are found."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.evidence import Injection
from kreisel.calibration.outcome import Outcome
from kreisel.fitting.stored_state import stored_state
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import SENSOR_GROUPS, CellParameters
from kreisel.model.stated_parameters import Known, place_of
from kreisel.progress import Progress
from kreisel.units import DEG_PER_HOUR, MG


def inject(outcome: Outcome, progress: Progress | None = None) -> Injection:
    """Return whether a new calibration finds known errors that are added to the raw readings.

    The errors are 5 mg and -3 mg and 4 mg of accelerometer offset, 20, -30 and 10 deg/h of gyro offset,
    and 2000 ppm of scale on the first axis of either. The paper did the same with its accelerometer offsets.
    """
    errors = _errors()
    imu = outcome.recording.imu
    changed = replace(
        imu,
        rates=(imu.rates + errors.gyro_offset) * (1.0 + errors.gyro_scale),
        accelerations=(imu.accelerations + errors.accel_offset) * (1.0 + errors.accel_scale),
    )
    problem, base = outcome.estimate.problem, outcome.estimate.run.parameters
    injected = replace(base, sensors=errors.apply(base.sensors))
    known = {
        g: tuple(injected.stored(g).tolist()) if g in SENSOR_GROUPS else v for g, v in problem.settings.fixed_values
    }
    settings = replace(
        problem.settings, fixed_values=tuple(known.items()), priors=_changed(problem.settings, injected)
    )  # known values change with the readings
    again = run_calibration(replace(outcome.recording, imu=changed), settings, progress)
    n = len(problem.parameter_names)
    zero = stored_state(problem, base)

    def moved(parameters: CellParameters) -> Array:
        return problem.layout.minus(stored_state(problem, parameters)[:, None], zero)[:n, 0]

    return Injection(
        problem.parameter_names,
        moved(injected),
        moved(again.estimate.run.parameters),
        outcome.estimate.deviation[:n],
    )


def _changed(settings: CalibrationSettings, injected: CellParameters) -> tuple[Known, ...]:
    """Return what is known of single parameters, with the injected values of those of the sensors that are fixed."""
    out = []
    for name, value, deviation in settings.priors:
        group, index = place_of(name, settings.polynomial_order)
        changes = deviation == 0.0 and value is not None and group in SENSOR_GROUPS
        out.append((name, float(injected.stored(group)[index]) if changes else value, deviation))
    return tuple(out)


@dataclass(frozen=True)
class _Errors:
    gyro_offset: Array
    accel_offset: Array
    gyro_scale: Array
    accel_scale: Array

    def apply(self, p: SensorParameters) -> SensorParameters:
        """Return the parameters that undo the errors: raw = (old + offset) (1 + scale)."""
        gyro, k_w = _composed(p.k_w, self.gyro_offset, self.gyro_scale)
        accel, k_a = _composed(p.k_a, self.accel_offset, self.accel_scale)
        # the sensitive axes, and with them the size effect, change with K_a
        return replace(p, K_omega=p.K_omega * gyro, k_w=k_w, K_a=p.K_a * accel, k_a=k_a)


def _composed(k: Array, offset: Array, scale: Array) -> tuple[Array, Array]:
    """Return factors (3,) and coefficients (N, 3) for raw readings with errors: factor (raw + k'_0 + sum k'_i raw^i).

    Equal to old + k_0 + sum k_i old^i, with raw = (old + offset) (1 + scale), axis by axis.
    """
    order = k.shape[0]
    coefficients = np.empty((order + 1, 3))
    for axis in range(3):
        old = Polynomial([-offset[axis], 1.0 / (1.0 + scale[axis])])
        total = Polynomial([k[0, axis], 1.0, *k[1:, axis]])(old)
        coefficients[:, axis] = np.pad(total.coef, (0, order + 1 - total.coef.size))
    factor = coefficients[1]
    return factor, np.vstack([coefficients[0], coefficients[2:]]) / factor


def _errors() -> _Errors:
    return _Errors(
        gyro_offset=np.array([20.0, -30.0, 10.0]) * DEG_PER_HOUR,
        accel_offset=np.array([5.0, -3.0, 4.0]) * MG,
        gyro_scale=np.array([2e-3, 0.0, 0.0]),
        accel_scale=np.array([2e-3, 0.0, 0.0]),
    )
