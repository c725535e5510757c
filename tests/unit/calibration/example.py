"""A calibration with numbers drawn at random: turned, with arms, a quadratic term and a full covariance."""

import numpy as np

from kreisel.calibration.device_axes import NAMES, with_vector
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
from kreisel.geometry.rotation import exp, matrix
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect


def calibration(mount=(0.05, -0.1, 1.5), seed: int = 3) -> Calibration:
    rng = np.random.default_rng(seed)
    C = matrix(exp(np.array(mount)))
    sensors = SensorParameters(
        K_omega=C @ (np.eye(3) + rng.normal(0.0, 0.02, (3, 3))),
        k_w=rng.normal(0.0, 0.01, (2, 3)),
        K_a=C @ (np.eye(3) + rng.normal(0.0, 0.02, (3, 3))),
        k_a=rng.normal(0.0, 0.1, (2, 3)) * [[1.0], [1e-3]],
        lever_arms=np.array([0.1, -0.05, 0.2]) + rng.normal(0.0, 0.02, (3, 3)),
    )
    polynomial = tuple(f"gyroscope.polynomial.2[{i}]" for i in range(3))
    names = (*(n for n in NAMES if n != "accelerometer.lever_arms[1,1]"), *polynomial)
    L = rng.normal(0.0, 1e-4, (len(names), len(names) + 4))
    known = np.full(33, 1e-4)
    known[NAMES.index("accelerometer.lever_arms[1,1]")] = 5e-4
    deviations = with_vector(sensors, known)
    deviations.k_w[1], deviations.k_a[1] = np.sqrt(np.diag(L @ L.T)[-3:]), 0.0
    facts = RecordingFacts("example", "pose0", 1000, 400.0, 500, 2.5)
    parts = CalibrationParts(
        sensors=sensors,
        sensor_sd=deviations,
        size_effect=SizeEffect.COMPLETED,
        timing=Timing(),
        alignment=Alignment(Measured(np.zeros(3), np.zeros(3))),
        derived={},
        consistency=Consistency(1.0, 1.0, 9, 0, np.zeros(6), 1.0, 1.0),
        verdict=Verdict(True, ()),
        recording=facts,
    )
    return Calibration(**vars(parts), names=names, covariance=L @ L.T, prior_deviation=np.ones(len(names)))
