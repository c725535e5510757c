"""Parts of an IMU's recording between which its clock was set, placed by comparison with the reference."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from kreisel.errors import SynchronizationError
from kreisel.preparation.imu_noise import imu_noise_of, readings_of
from kreisel.recording.recording import DataWarning, ImuSamples, Recording, ReferencePoses
from kreisel.synchronization.correlation import correlate
from kreisel.synchronization.rate_fit import LinearFit, fit_rates


def with_parts_in_place(recording: Recording, reference: ReferencePoses) -> tuple[Recording, list[DataWarning]]:
    """Return the recording with the stamps of all parts on the clock of the first, and the warnings about them.

    Raises
    ------
    SynchronizationError
        If a part does not fit the reference, or parts overlap.
    """
    imu = recording.imu
    if not imu.restarts_ns.size:
        return recording, []
    if reference.quaternions is None:
        raise SynchronizationError(
            f"{imu.source}: the clock was set during the recording, and positions alone do not show by how much; split "
            "the recording there"
        )
    noise = imu_noise_of(recording)
    edges = [0, *np.searchsorted(imu.stamps_ns, imu.restarts_ns).tolist(), imu.stamps_ns.size]
    stamps, warnings, first, sd = imu.stamps_ns.copy(), [], None, 0.0
    for begin, end in pairwise(edges):
        part = _part(imu, begin, end)
        alone = replace(recording, imu=part)
        readings, first_guess = readings_of(alone, noise), correlate(part, reference).clock
        clock = fit_rates(readings, LinearFit.of(readings, reference.seconds, reference.quaternions, first_guess)).clock
        if first is None:
            first = clock
            continue
        # where the part's middle lies by the clock of the first one
        middle = part.seconds[-1:] * 0.5
        shift = float((first.imu_time(clock.reference_time(middle)) - middle)[0])
        sd = max(sd, float(np.hypot(clock.start_sd, first.start_sd)))
        stamps[begin:end] = stamps[0] + round(1e9 * shift) + (part.stamps_ns - part.stamps_ns[0])
        gap = 1e-9 * float(stamps[begin] - stamps[begin - 1])
        if gap <= 0.0:
            raise SynchronizationError(
                f"{imu.source}: the clock was set after {imu.seconds[begin - 1]:.1f} s, and by the reference the "
                "samples after it overlap with those before; split the recording there"
            )
        warnings.append(
            DataWarning(
                "stamps",
                f"the IMU's clock was set after {1e-9 * (stamps[begin - 1] - stamps[0]):.1f} s, as by a restart; the "
                f"samples after it begin {gap:.3f} s later, by comparison with the reference",
            )
        )
    return replace(
        recording, imu=replace(imu, stamps_ns=stamps, restarts_ns=imu.restarts_ns[:0], placed_sd=sd)
    ), warnings


def _part(imu: ImuSamples, begin: int, end: int) -> ImuSamples:
    return replace(
        imu,
        stamps_ns=imu.stamps_ns[begin:end],
        rates=imu.rates[begin:end],
        accelerations=imu.accelerations[begin:end],
        temperature=None if imu.temperature is None else imu.temperature[begin:end],
        restarts_ns=imu.restarts_ns[:0],
    )
