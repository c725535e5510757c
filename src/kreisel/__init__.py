"""kreisel: calibration of inertial measurement units while a robot, or motion capture, watches them move.

Conventions
-----------
Frames: i inertial; n local level (north, east, down); r robot base, or the world of the motion capture;
b the body whose pose the reference gives. ``C_rb`` turns a vector from b to r; neighbouring letters cancel.
Quaternions are Hamilton's, scalar first; small rotations are right perturbations, ``q exp(d)``.
Accelerometers measure specific force (at standstill +g, upward). SI units and radians everywhere inside;
stamps are integer nanoseconds in recordings and seconds from the first sample in computations.

References
----------
J. Fox, H. Janocha: Robotergestütztes Verfahren zur dynamischen Kalibrierung von Inertialmesssystemen (2005).
R. van der Merwe: Sigma-Point Kalman Filters for Probabilistic Inference in Dynamic State-Space Models (2004).
D. H. Titterton, J. L. Weston: Strapdown Inertial Navigation Technology (2nd edition, 2004).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kreisel._version import __version__

if TYPE_CHECKING:
    from kreisel.calibration.calibrate import calibrate
    from kreisel.calibration.joint import calibrate_joint
    from kreisel.calibration.method_comparison import compare_methods
    from kreisel.calibration.own_estimator import Estimates, Estimator, Measurements
    from kreisel.calibration.result import Calibration
    from kreisel.errors import KreiselError
    from kreisel.formats.loading import load
    from kreisel.model.calibration_settings import CalibrationSettings
    from kreisel.recording.recording import Recording
    from kreisel.report import matplotlib_figures as plot
    from kreisel.validation.recording_from_arrays import from_arrays

__all__ = [
    "Calibration",
    "CalibrationSettings",
    "Estimates",
    "Estimator",
    "KreiselError",
    "Measurements",
    "Recording",
    "__version__",
    "calibrate",
    "calibrate_joint",
    "compare_methods",
    "from_arrays",
    "load",
    "plot",
]

_HOMES = {
    "Calibration": "kreisel.calibration.result",
    "CalibrationSettings": "kreisel.model.calibration_settings",
    "Estimates": "kreisel.calibration.own_estimator",
    "Estimator": "kreisel.calibration.own_estimator",
    "KreiselError": "kreisel.errors",
    "Measurements": "kreisel.calibration.own_estimator",
    "Recording": "kreisel.recording.recording",
    "calibrate": "kreisel.calibration.calibrate",
    "calibrate_joint": "kreisel.calibration.joint",
    "compare_methods": "kreisel.calibration.method_comparison",
    "from_arrays": "kreisel.validation.recording_from_arrays",
    "load": "kreisel.formats.loading",
}

_MODULES = {"plot": "kreisel.report.matplotlib_figures"}


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)


def __getattr__(name: str) -> Any:
    """Import public names when they are asked for: `kreisel --help` needs none of them."""
    from importlib import import_module

    if name in _MODULES:
        return import_module(_MODULES[name])
    if name not in _HOMES:
        raise AttributeError(f"module 'kreisel' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)
