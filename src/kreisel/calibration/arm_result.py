"""A robot calibrated by an IMU: errors of its joints and links, and the file they are written to."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kreisel.calibration.result import Calibration, write_document
from kreisel.calibration.result_sections import RobotErrors
from kreisel.model.robot_model import NOT_SEPARABLE
from kreisel.recording.recording import DataWarning
from kreisel.robot.pose_accuracy import PoseAccuracy

ARM_FILES = ("robot.yaml", "robot.urdf", "report.html", "calibration.yaml", "estimates.csv", "covariance.npz")
"""Files of a result."""

BEYOND_URDF = (
    "robot.urdf holds lengths, angles and zeros; gears and compliance, which such a file does not hold, are in "
    "robot.yaml: correct the joint angles by them"
)
"""What to know where such errors were found."""

NOT_SHOWN = (
    "where the base stands, and where the tool is on the last link: an IMU feels motion, not places; a laser tracker, "
    "or a touched reference point, shows them",
    "errors that this motion does not distinguish from others (separable: false): more configurations, or a tracker",
)
"""What an IMU does not show of a robot."""


@dataclass(frozen=True)
class UnusedPoses:
    """Errors of poses that were not used to find the arm's errors, found by their own IMU readings.

    Attributes
    ----------
    name, used
        Of the recording or the half, and of what the arm's errors were found from.
    before, after
        Errors by the nominal model, and what the errors found elsewhere leave of them.
    expected
        What is expected to be left, by the deviations of both.
    by_urdf
        What robot.urdf alone leaves of them, where errors were found that such a file does not hold.
    """

    name: str
    used: str
    before: PoseAccuracy
    after: PoseAccuracy
    expected: PoseAccuracy
    by_urdf: PoseAccuracy | None = None


@dataclass(frozen=True)
class ArmError:
    """One error of the arm: name, estimate, its standard deviation, and that of the prior, all SI.

    `title`, `unit` and `size` (of the unit, SI) are for people.
    """

    name: str
    title: str
    unit: str
    size: float
    value: float
    deviation: float
    prior: float

    @property
    def separable(self) -> bool:
        """Whether the motion shows it."""
        return self.deviation <= NOT_SEPARABLE * self.prior


@dataclass(frozen=True)
class ArmCalibration:
    """A robot calibrated by an IMU.

    Attributes
    ----------
    calibration
        Of the IMU, with the robot's errors.
    robot
        The errors by group, and the expected accuracy of poses.
    errors
        Each that was estimated.
    unused
        What they are worth where they were not found; empty if the recording is too short.
    warnings
        What to know about it.
    """

    calibration: Calibration
    robot: RobotErrors
    errors: tuple[ArmError, ...]
    unused: tuple[UnusedPoses, ...]
    warnings: tuple[DataWarning, ...]

    @property
    def document(self) -> dict[str, Any]:
        """The content of `robot.yaml`."""
        recording, verdict = self.calibration.recording, self.calibration.verdict
        return {
            "robot": self.robot.name,
            "tcp": self.robot.tcp,
            "joints": list(self.robot.joints),
            "recording": None if recording is None else recording.name,
            "errors": {
                one.name: {
                    "value": _number(one.value), "standard_deviation": _number(one.deviation),
                    "before": _number(one.prior), "separable": one.separable,
                }
                for one in self.errors
            },
            "pose_error": {
                "found": _table(self.robot.found), "believed_before": _table(self.robot.before),
                "believed_after": _table(self.robot.after),
            },
            "unused_poses": [
                {"of": one.name, "errors_from": one.used, "before": _table(one.before), "after": _table(one.after),
                 "expected_after": _table(one.expected),
                 **({} if one.by_urdf is None else {"after_by_urdf": _table(one.by_urdf)})}
                for one in self.unused
            ],
            "not_shown": list(NOT_SHOWN),
            "verdict": {"accepted": verdict.accepted, "reasons": list(verdict.reasons)},
        }  # fmt: skip

    def write(self, folder: Path) -> None:
        """Write `robot.yaml`, `robot.urdf` and the calibration into an empty folder."""
        self.calibration.write(folder)
        (folder / "robot_calibrated.urdf").rename(folder / "robot.urdf")
        write_document(self.document, folder / "robot.yaml")


def _number(value: float) -> float:
    return float(f"{value:.8g}")


def _table(accuracy: PoseAccuracy) -> dict[str, float]:
    return {"position_rms": _number(accuracy.position), "orientation_rms": _number(accuracy.orientation)}
