"""Calibrations from other programs as kreisel's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from kreisel.calibration.device_axes import NAMES, device_triads, with_vector
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import (
    Alignment,
    CalibrationParts,
    Consistency,
    Measured,
    RecordingFacts,
    Timing,
    Verdict,
)
from kreisel.errors import RecordingError
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect, check_parameters

_SLOWEST, _FASTEST = 1.0, 20e3
"""Samples a second that can be; others count as not stated."""


def imported(path: Path, sensors: SensorParameters, rate_hz: float, source: str) -> Calibration:
    """Return a calibration without deviations; its verdict says that nobody judged it.

    Raises
    ------
    RecordingError
        If the parameters are none that a sensor can have.
    """
    try:
        check_parameters(sensors)
    except ValueError as error:
        raise RecordingError(f"not a calibration of {source}: {error}", file=path) from error
    rate_hz = rate_hz if _SLOWEST <= rate_hz <= _FASTEST else 0.0
    nothing = np.full(3, np.nan)
    unknown = with_vector(sensors, np.full(len(NAMES), np.nan))
    parts = CalibrationParts(
        sensors=sensors,
        sensor_sd=unknown,
        size_effect=SizeEffect.COMPLETED,
        timing=Timing(),
        alignment=Alignment(Measured(nothing, nothing)),
        derived={},
        consistency=Consistency(np.nan, np.nan, 0, 0, np.full(6, np.nan), 1.0, np.nan),
        verdict=Verdict(True, (f"read from {path.name} ({source}); kreisel has not judged it",)),
        recording=RecordingFacts(path.name, source, 0, rate_hz, 0, 0.0),
    )
    parts = replace(parts, triads=device_triads(sensors, unknown, (), np.zeros((0, 0))))
    return Calibration(**vars(parts))
