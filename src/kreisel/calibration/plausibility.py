"""Faults that show in the first values: wrong units, mirrored triads, a motion that is too poor."""

from __future__ import annotations

import numpy as np

from kreisel.calibration.setup import Preparation
from kreisel.errors import ExcitationError, RecordingError


def check_first_values(preparation: Preparation) -> None:
    """Raise an error if the first values betray wrong units, a mirrored triad or too poor a motion.

    Raises
    ------
    RecordingError, ExcitationError
        With the evidence and the remedy.
    """
    imu, fit, force = preparation.recording.imu, preparation.rate_fit, preparation.force_fit
    size = float(np.cbrt(abs(np.linalg.det(fit.K_omega))))
    if 0.012 < size < 0.025:
        raise RecordingError(
            f"the gyros read {1.0 / size:.1f} times the reference's rates: they look like deg/s. "
            "Write [deg s^-1] into the header, or convert to rad/s",
            file=imu.source,
            line=1,
        )
    singular = np.linalg.svd(fit.K_omega, compute_uv=False)
    if not 0.4 < singular[-1] <= singular[0] < 2.5:
        weak = singular[-1] < 0.4 < singular[0] < 2.5
        if weak:
            raise ExcitationError(
                f"{preparation.reference.source}: the motion is too poor: about one axis it shows only "
                f"{100 * singular[-1]:.0f} % of the gyros' sensitivity. Turn about all three axes"
            )
        raise RecordingError(
            f"gyro readings and the reference's rates differ by factors of {1 / singular[0]:.3g} to "
            f"{1 / singular[-1]:.3g}, expected near 1: check the unit of the gyros and the stamps of the reference",
            file=imu.source,
            line=1,
        )
    if np.linalg.det(fit.K_omega) < 0.0:
        raise RecordingError(
            "the gyro axes form a left-handed triad (the determinant of their cross-coupling is negative): "
            "one axis has the wrong sign, or two columns are swapped",
            file=imu.source,
            line=1,
        )
    if force.motion_slope < -0.2:
        raise RecordingError(
            f"the accelerometers move against the reference (slope {force.motion_slope:.2f}, expected 1): they give "
            "gravity instead of specific force. Change the sign of all three; at rest upward must read +9.8",
            file=imu.source,
            line=1,
        )
