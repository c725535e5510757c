"""Which clock counts true seconds, where those of IMU and reference differ.

Rates are per second. Gyros are calibrated against the rotation by the reference, divided by the IMU's seconds: if these
are not true ones, the scale factors are wrong by as much. Which of the two is right is not in the data, so their
difference counts in the deviations, unless the user states it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.recording.recording import DataWarning, Recording
from kreisel.synchronization.clock import Clock

CRYSTALS, WORTH_SAYING = 5e-4, 1e-5
"""Largest difference of two clocks that have crystals, and the least that is worth a warning."""


def on_reference_clock(recording: Recording, clock: Clock) -> Recording:
    """Return the recording with the IMU's stamps in seconds of the reference."""
    imu = recording.imu
    first, ratio = imu.stamps_ns[0], 1.0 + float(clock.skew)

    def moved(stamps_ns: np.ndarray) -> np.ndarray:
        return first + np.round((stamps_ns - first) / ratio).astype(np.int64)

    stretched = replace(
        imu, stamps_ns=moved(imu.stamps_ns), broken_ns=moved(imu.broken_ns), stretch=(1.0 + imu.stretch) * ratio - 1.0
    )
    return replace(recording, imu=stretched)


def time_base_deviation(recording: Recording, clock: Clock) -> float:
    """Return the relative standard deviation of the IMU's seconds from true ones."""
    stated = recording.settings.imu.time_base
    if stated == "reference":
        return clock.skew_sd
    return 0.0 if stated == "imu" else abs(clock.skew)


def time_base_warning(recording: Recording, clock: Clock) -> list[DataWarning]:
    """Return the warning that it is not known which clock is right, or that the reference's was used."""
    imu, stated = recording.imu, recording.settings.imu.time_base
    if stated == "reference" and imu.stretch != 0.0:
        text = (
            f"the IMU's stamps were put onto the reference's clock, from which its own differs by {_text(imu.stretch)}"
        )
        return [DataWarning("clocks", text)]
    if stated is not None or abs(clock.skew) <= WORTH_SAYING + 3.0 * clock.skew_sd:
        return []
    more = ", more than crystals do," if abs(clock.skew) > CRYSTALS else ""
    text = (
        f"the clocks differ by {_text(clock.skew)}{more} and it is not known which is right: the gyros' scale factors "
        'are uncertain by as much. State imu.time_base = "imu", or "reference", in recording.toml'
    )
    return [DataWarning("clocks", text)]


def _text(ratio: float) -> str:
    return f"{1e6 * ratio:+.0f} ppm" if abs(ratio) < 1e-3 else f"{1e3 * ratio:+.2f} per mille"
