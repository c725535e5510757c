"""What is found of an array without a reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel.array.array_fit import ArrayFit
from kreisel.array.relative_pose import AXES, CLOCK, SCHEMA, RelativePose, clock_document
from kreisel.calibration.result import Calibration
from kreisel.recording.recording import Recording
from kreisel.synchronization.clock import Clock


@dataclass(frozen=True)
class ArrayMember:
    """An IMU of an array.

    Attributes
    ----------
    calibration
        By its standstills; None if there were too few, with the reason in `remark`.
    clipped
        Share of its samples that were clipped.
    """

    name: str
    calibration: Calibration | None
    remark: str
    clipped: float
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class ArrayOutcome:
    """Where the IMUs of an array lie.

    Attributes
    ----------
    clocks
        Seconds of the first IMU by those of another, each from its first sample.
    begin_ns
        First stamps.
    """

    recording: Recording
    members: tuple[ArrayMember, ...]
    fit: ArrayFit
    samples: int
    poses: dict[str, RelativePose]
    clocks: dict[str, Clock]
    begin_ns: dict[str, int]
    left_out: tuple[tuple[str, str], ...]

    @property
    def reference(self) -> str:
        """The IMU in whose axes the others' places are given."""
        return self.members[0].name

    @property
    def document(self) -> dict[str, Any]:
        """The content of `array.yaml`."""
        fit = self.fit
        return {
            "schema": SCHEMA,
            "reference": self.reference,
            "axes": AXES,
            "clock": CLOCK,
            "imus": {
                name: {
                    **pose.document,
                    "distance": float(np.linalg.norm(pose.position)),
                    "clock": clock_document(self.clocks[name], self.begin_ns[self.reference], self.begin_ns[name]),
                }
                for name, pose in self.poses.items()
            },
            "not_observable": ["the common scale of the gyros: all distances are uncertain by it, see `scale`"],
            "scale": {"standard_deviation": fit.scale_deviation},
            "accelerometers_behind_gyros": {"delay": fit.lag[0], "standard_deviation": fit.lag[1]},
            "moments_of_reading": {"standard_deviation": fit.delay},
            "residual": fit.residual,
            "samples": self.samples,
            "left_out": dict(self.left_out),
        }
