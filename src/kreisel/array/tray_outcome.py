"""What is found of the units of a tray."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.array.mount_watch import Turn
from kreisel.array.relative_pose import AXES, CLOCK, SCHEMA, RelativePose, clock_document
from kreisel.array.unit_fit import UnitFit
from kreisel.calibration.device_axes import NAMES
from kreisel.calibration.outcome import Outcome
from kreisel.calibration.result import Calibration
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import DataWarning, Recording
from kreisel.synchronization.clock import Clock


@dataclass(frozen=True)
class UnitOutcome:
    """One unit of a tray.

    Attributes
    ----------
    share : (2,)
        Of gyros and accelerometers in the mean.
    turn
        Its turn on its mount during the recording, where there was one.
    warnings
        What the motion of the others shows of it.
    """

    name: str
    calibration: Calibration
    fit: UnitFit
    share: Array
    turn: Turn | None
    warnings: tuple[DataWarning, ...] = ()


@dataclass(frozen=True)
class TrayOutcome:
    """The units of a tray, the mean by which they were calibrated, and which could not be used, with the reasons.

    Attributes
    ----------
    poses
        Where the units lie against the first one, by name.
    covariance : (6 k, 6 k)
        Of all k places, one after the other.
    gain : (2,)
        How many equal units have the noise of the mean, of gyros and accelerometers.
    joint : (33 N, 33 N)
        Covariance of all units' parameters, in the order of `parameter_names`.
    """

    recording: Recording
    mean: Outcome
    units: tuple[UnitOutcome, ...]
    left_out: tuple[tuple[str, str], ...]
    poses: dict[str, RelativePose]
    covariance: Array
    gain: Array
    joint: Array

    @property
    def reference(self) -> str:
        """The unit in whose axes the others' places are given."""
        return self.units[0].name

    @property
    def clocks(self) -> dict[str, Clock]:
        """Clocks of the other units by name: seconds of the reference unit by those of a unit, from the first."""
        base = self.units[0].fit.clock
        return {unit.name: _against(base, unit.fit.clock) for unit in self.units[1:]}

    def _clock_document(self, name: str) -> dict[str, float]:
        """Return what `array.yaml` says of a unit's clock."""
        first = {unit.name: unit.calibration.recording for unit in self.units}
        begin, own = ((0 if one is None else one.begin_ns or 0) for one in (first[self.reference], first[name]))
        return clock_document(self.clocks[name], begin, own)

    @property
    def place_names(self) -> list[str]:
        """What the rows of the covariance are of."""
        parts = [f"{what}.{axis}" for what in ("position", "rotation") for axis in "xyz"]
        return [f"{name}.{part}" for name in self.poses for part in parts]

    @property
    def parameter_names(self) -> list[str]:
        """What the rows of the joint covariance are of."""
        return [f"{unit.name}.{name}" for unit in self.units for name in NAMES]

    @property
    def array_document(self) -> dict[str, object]:
        """The content of `array.yaml`."""
        return {
            "schema": SCHEMA,
            "reference": self.reference,
            "axes": AXES,
            "clock": CLOCK,
            "imus": {name: {**pose.document, "clock": self._clock_document(name)} for name, pose in self.poses.items()},
            "left_out": dict(self.left_out),
        }


def _against(base: Clock, own: Clock) -> Clock:
    """Return the clock of a unit against that of the base unit, both given against a third one."""
    start, skew = base.reference_time(np.array([own.start]))[0], (1.0 + own.skew) / (1.0 + base.skew) - 1.0
    return Clock(
        float(start), skew, float(np.hypot(base.start_sd, own.start_sd)), float(np.hypot(base.skew_sd, own.skew_sd))
    )
