"""One recording without a reference, calibrated in several ways."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from kreisel._kernels.strapdown_pass import strapdown_seconds
from kreisel.calibration.by_method import ByMethod, Comparison, parameters_in
from kreisel.calibration.own_estimator import Estimates, derived_of_own
from kreisel.errors import KreiselError
from kreisel.preparation.gravity import site_of
from kreisel.progress import Progress
from kreisel.recording.recording import Recording
from kreisel.static.count_sizes import in_quantities
from kreisel.static.plain_method import plain_values
from kreisel.static.rest_problem import RestProblem, raw_of
from kreisel.static.rest_search import find_rests
from kreisel.static.static_result import calibrate_static

STATIC_ESTIMATORS = ("static", "constant-offsets", "tedaldi")
"""kreisel's, with offsets that may walk and without, and the published method."""


def compare_static(recording: Recording, methods: Sequence[str], progress: Progress | None = None) -> Comparison:
    """Return what each of `STATIC_ESTIMATORS` finds in a recording without a reference."""
    found = tuple(_found(recording, name, progress) for name in methods)
    imu = recording.imu
    return Comparison(recording.path.name, found, strapdown_seconds(imu.rates, imu.accelerations, imu.interval))


def _found(recording: Recording, name: str, progress: Progress | None) -> ByMethod:
    began = time.perf_counter()
    try:
        if name == "tedaldi":
            return _published(recording, began)
        found = calibrate_static(recording, constant_offsets=name == "constant-offsets", progress=progress).calibration
    except KreiselError as error:
        return ByMethod(name, time.perf_counter() - began, error=str(error))
    return ByMethod.of(name, time.perf_counter() - began, found)


def _published(recording: Recording, began: float) -> ByMethod:
    """Return what the published method finds: values without deviations."""
    site, _ = site_of(recording.settings.site)
    imu, _ = in_quantities(recording.imu, site.gravity)
    sensors = plain_values(RestProblem(imu, raw_of(imu), find_rests(imu), site))
    values = {
        "gyroscope": {"cross_coupling": sensors.K_omega, "offset": sensors.k_w[0]},
        "accelerometer": {"cross_coupling": sensors.K_a, "offset": sensors.k_a[0]},
    }
    unknown = {section: {key: np.full_like(one, np.nan) for key, one in own.items()} for section, own in values.items()}
    return ByMethod(
        "tedaldi",
        time.perf_counter() - began,
        parameters_in(values),
        derived=derived_of_own(sensors, Estimates(values, unknown)),
    )
