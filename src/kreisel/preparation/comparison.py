"""IMU and reference compared by their rotations: what the stages that repair the clocks hand on to each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from kreisel.inertial.readings import Readings
from kreisel.preparation.imu_noise import imu_noise_of, readings_of
from kreisel.preparation.preparation import ImuNoise
from kreisel.recording.recording import DataWarning, ImuSamples, Recording, ReferencePoses
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.conventions import checked_fit
from kreisel.synchronization.correlation import correlate, quietest_second
from kreisel.synchronization.fits import Correlation, RateFit
from kreisel.synchronization.rate_fit import fit_rates
from kreisel.tasks import Executor


@dataclass(frozen=True)
class Comparison:
    """A recording beside its reference, with the stamps as they are taken so far.

    Attributes
    ----------
    imu_noise
        Noise of the IMU; it does not depend on the stamps of the reference.
    correlation, fit
        Of the rates by both: coarse clocks, and the fit of gyros and clocks.
    warnings
        What was repaired.
    """

    recording: Recording
    reference: ReferencePoses
    imu_noise: ImuNoise
    correlation: Correlation
    readings: Readings
    fit: RateFit
    warnings: tuple[DataWarning, ...]

    def of(self, recording: Recording, reference: ReferencePoses | None = None) -> Comparison:
        """Return the comparison of a recording, or a reference, with other stamps."""
        reference = self.reference if reference is None else reference
        correlation = correlate(recording.imu, reference)
        readings, fit = _fitted(recording, reference, self.imu_noise, correlation)
        return replace(
            self, recording=recording, reference=reference, correlation=correlation, readings=readings, fit=fit
        )

    def with_warning(self, warning: DataWarning) -> Comparison:
        """Return the comparison with a further warning."""
        return replace(self, warnings=(*self.warnings, warning))


def compare(recording: Recording, reference: ReferencePoses, executor: Executor) -> Comparison:
    """Return the comparison of a recording with its reference.

    Raises
    ------
    SynchronizationError
        If the two do not belong together.
    """
    noise, correlation = executor([partial(imu_noise_of, recording), partial(correlate, recording.imu, reference)])
    readings, fit = _fitted(recording, reference, noise, correlation)
    return Comparison(recording, reference, noise, correlation, readings, fit, ())


def _fitted(
    recording: Recording, reference: ReferencePoses, noise: ImuNoise, correlation: Correlation
) -> tuple[Readings, RateFit]:
    """Return the readings, and the fit of the gyros and clocks to the reference."""
    readings = readings_of(recording, noise)
    if reference.quaternions is None:
        return readings, _rates_without_attitude(recording.imu, reference, correlation.clock)
    return readings, fit_rates(readings, checked_fit(readings, reference, correlation.clock))


def _rates_without_attitude(imu: ImuSamples, reference: ReferencePoses, clock: Clock) -> RateFit:
    """Return what is known of the gyros without attitudes: their mean in the quietest second."""
    still = quietest_second(imu)
    return RateFit(
        K_omega=np.eye(3),
        k_w0=-imu.rates[still].mean(axis=0),
        clock=clock,
        skewed=abs(clock.skew) > 4.0 * clock.skew_sd or clock.skew_sd * float(reference.seconds[-1]) > 5e-3,
        explained=float("nan"),
        residual_sd=float("nan"),
        K_omega_sd=np.full((3, 3), 0.0025),
        k_w0_sd=np.full(3, 1e-3),
    )
