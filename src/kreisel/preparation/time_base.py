"""Which clock counts true seconds, where those of IMU and reference differ by more than crystals do.

Rates are per second. Gyros are calibrated against the rotation by the reference, divided by the IMU's seconds: if these
are not true ones, the scale factors are wrong by as much. An IMU whose stamps are counted with a nominal interval has a
timer of its own behind them, often without a crystal.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.recording.recording import DataWarning, ImuSamples, Recording
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.lost_samples import counted_interval

CRYSTALS = 5e-4
"""Largest difference of two clocks that have crystals."""


def on_reference_clock(recording: Recording, clock: Clock) -> Recording:
    """Return the recording with the IMU's stamps in seconds of the reference."""
    imu = recording.imu
    first, ratio = imu.stamps_ns[0], 1.0 + clock.skew

    def moved(stamps_ns: np.ndarray) -> np.ndarray:
        return first + np.round((stamps_ns - first) / ratio).astype(np.int64)

    stretched = replace(
        imu, stamps_ns=moved(imu.stamps_ns), broken_ns=moved(imu.broken_ns), stretch=(1.0 + imu.stretch) * ratio - 1.0
    )
    return replace(recording, imu=stretched)


def time_base_deviation(recording: Recording, clock: Clock) -> float:
    """Return the relative standard deviation of the IMU's seconds from true ones."""
    imu, stated = recording.imu, recording.settings.imu.time_base
    if stated == "reference":
        return clock.skew_sd
    if stated == "imu" or not _differs(imu, clock):
        return 0.0
    return abs(clock.skew)


def _differs(imu: ImuSamples, clock: Clock) -> bool:
    return abs(clock.skew) > CRYSTALS + 3.0 * clock.skew_sd and counted_interval(imu.stamps_ns) is not None


def time_base_warning(recording: Recording, clock: Clock) -> list[DataWarning]:
    """Return the warning that it is not known which clock is right, or that the reference's was used."""
    imu, stated = recording.imu, recording.settings.imu.time_base
    if stated == "reference" and imu.stretch != 0.0:
        text = (
            f"the IMU's stamps were put onto the reference's clock, from which its own differs by {_text(imu.stretch)}"
        )
        return [DataWarning("clocks", text)]
    if stated is not None or not _differs(imu, clock):
        return []
    text = (
        f"the clocks differ by {_text(clock.skew)}, more than crystals do, and it is not known which is right: the "
        'gyros\' scale factors are uncertain by as much. State imu.time_base = "imu", or "reference" if the IMU\'s '
        "stamps are counted, in recording.toml"
    )
    return [DataWarning("clocks", text)]


def _text(ratio: float) -> str:
    return f"{1e3 * ratio:+.2f} per mille"
