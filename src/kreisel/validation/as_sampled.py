"""Readings of an IMU as its sensors took them: over their own intervals, at the moments of sampling."""

from __future__ import annotations

import numpy as np

from kreisel.recording.recording import DataWarning, ImuSamples
from kreisel.validation.accumulated_readings import with_lost_samples
from kreisel.validation.interval_readings import with_own_intervals
from kreisel.validation.masking import part_of
from kreisel.validation.sampling import regularly_sampled


def as_sampled(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples with increments over their own intervals and stamps of sampling, and the warnings about it."""
    imu, divided = with_own_intervals(imu)
    imu, sampling = regularly_sampled(imu)
    return imu, divided + sampling


def sampled_rows(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the same samples as a calibration takes them, none added or left out, and the warnings about it.

    Readings that are sums or means over lost samples are those of the last of them.
    """
    if imu.stamps_ns.size < 2 or np.any(np.diff(imu.stamps_ns) <= 0):
        return imu, []
    imu, found = as_sampled(imu)
    restored, lost = with_lost_samples(imu)
    own = np.isin(restored.stamps_ns, imu.stamps_ns, assume_unique=True)
    return (part_of(restored, own) if lost else imu), found + lost
