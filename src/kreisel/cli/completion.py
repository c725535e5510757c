"""Values that a shell completes: names that options take.

A shell waits for them while somebody types: what heavy modules know stands here again, and a test compares it. Values
are pairs of text and help; the command line's library leaves out those that do not begin with what was typed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import typer

Items = list[tuple[str, str]]
"""Texts, each with its help."""

ESTIMATORS = {
    "ekf": "extended Kalman filter, the default",
    "iekf": "iterated extended Kalman filter",
    "spkf": "sigma-point Kalman filter, the paper's",
    "ukf": "sigma points: unscented",
    "cdkf": "sigma points: central-difference",
    "ckf": "sigma points: cubature",
    "inverse": "predicts readings from a smooth motion",
    "batch": "least squares of everything",
}
COMPARED = ESTIMATORS | {
    "static": "standstills, of a recording without poses",
    "constant-offsets": "standstills, with offsets that do not change",
    "tedaldi": "standstills, by the published method",
}
TARGETS = ("kalibr", "openvins", "ros", "px4", "ardupilot", "imu_tk", "c", "rust", "matlab", "json", "urdf", "ros-tf")
SOURCES = ("kalibr", "openvins", "px4")
AXES = {
    "tool": "those of b, the body on the robot or in motion capture",
    "imu": "the device's own, by the accelerometers",
    "gyro": "the device's own, by the gyros",
    "nominal": "those of b, turned by right angles",
}
METHODS = ("dynamic", "static")
STATIC_METHODS = ("multi-position", "six-position", "ferraris", "turntable", "hinge")
STUDY_METHODS = tuple(name for name in ESTIMATORS if name != "cdkf")
WEIGHTS = ("central-difference", "unscented", "cubature")
SIZE_EFFECTS = ("completed", "fox2005")
SENSORS, USES = ("gyroscope", "accelerometer"), ("orientations",)
SHARED = ("offsets", "mount", "robot", "site", "reference")
LANGUAGES = {"en": "English", "de": "German"}
FIELDS = (
    "maker", "type", "serial_number", "number", "customer", "laboratory", "operator", "place", "date", "temperature",
    "reference", "traceability", "procedure", "remarks",
)  # fmt: skip
COLUMNS = {
    "imu": ("file", "time", "rate", "acceleration", "acceleration_file", "acceleration_time", "temperature"),
    "reference": ("file", "time", "position", "orientation"),
    "joints": ("file", "time", "angles"),
}
PRIOR = "=VALUE+-DEVIATION, in SI"


def one_of(names: Sequence[str] | dict[str, str]) -> Callable[[str], Items]:
    """Return what completes one of some names."""
    helps = names if isinstance(names, dict) else dict.fromkeys(names, "")

    def values(incomplete: str) -> Items:
        del incomplete
        return list(helps.items())

    return values


def several_of(names: Sequence[str] | dict[str, str]) -> Callable[[str], Items]:
    """Return what completes names with commas between: the last one, of those that are not there yet."""
    helps = names if isinstance(names, dict) else dict.fromkeys(names, "")

    def values(incomplete: str) -> Items:
        before, comma, _ = incomplete.rpartition(",")
        return [(before + comma + name, text) for name, text in helps.items() if name not in before.split(",")]

    return values


fields = one_of({f"{name}=": "" for name in FIELDS})
columns = one_of({f"{table}.{name}=": "" for table, names in COLUMNS.items() for name in names})


def grades(incomplete: str) -> Items:
    """Return the grades of devices."""
    from kreisel.inertial.noise_figures import GRADES

    del incomplete
    return [(name, "grade of a device") for name in GRADES]


def parameters(incomplete: str) -> Items:
    """Return groups of parameters; the single ones, by their paths, once a part of a path is there."""
    from kreisel.model.groups import REGISTRY

    groups = [group for group in REGISTRY if not group.passing]
    out = [(group.name, group.meaning) for group in groups]
    owners = list(dict.fromkeys(group.path.partition(".")[0] + "." for group in groups if group.owner != "robot"))
    if not any(incomplete.startswith(owner) for owner in owners):
        return [*out, *((owner, "single parameters") for owner in owners)]
    named = (group for group in groups if group.owner != "robot" and not group.rotation)
    return [(name, group.meaning) for group in named for name in group.names(2)]


def priors(incomplete: str) -> Items:
    """Return parameters, and what follows their names."""
    return [(name if name.endswith(".") else f"{name}=", text) for name, text in parameters(incomplete)]


def error_terms(incomplete: str) -> Items:
    """Return groups that are estimated by choice."""
    from kreisel.model.groups import REGISTRY

    del incomplete
    return [(group.name, group.meaning) for group in REGISTRY if group.by_choice]


def robot_terms(incomplete: str) -> Items:
    """Return groups of a robot that are estimated by choice."""
    return [(name, text) for name, text in error_terms(incomplete) if name.startswith("robot_")]


def accuracies(incomplete: str) -> Items:
    """Return groups for which an accuracy may be stated, with their units."""
    from kreisel.model.groups import REGISTRY

    del incomplete
    shown = (group for group in REGISTRY if not group.passing and group.owner != "robot")
    return [(f"{group.path}=", f"{'ppm' if group.unit == '1' else group.unit}: {group.meaning}") for group in shown]


def situations(incomplete: str) -> Items:
    """Return the situations of the study of robustness."""
    from kreisel.study.situations import situations as all_situations

    del incomplete
    return [(name, "") for name in dict.fromkeys(one.name for one in all_situations())]


def arms(incomplete: str) -> Items:
    """Return the robots that are known by name."""
    from kreisel.robot.arm_library import LIBRARY
    from kreisel.robot.kinematics import MODELS

    del incomplete
    return [*((name, "") for name in MODELS), *((arm.name, arm.title) for arm in LIBRARY.values())]


def _addresses(table: str) -> Callable[[str], Items]:
    def values(incomplete: str) -> Items:
        from kreisel.devices import address

        del incomplete
        schemes = getattr(address, table)
        return [(f"{name}://", scheme.example) for name, scheme in schemes.items()]

    return values


imus, robots, movers = (_addresses(table) for table in ("IMUS", "ROBOTS", "MOVERS"))


def streams(ctx: typer.Context) -> Items:
    """Return the folders with data in the recording that stands on the command line."""
    folder = next((Path(word) for word in ctx.args if Path(word).is_dir()), None)
    if folder is None:
        return []
    found = {path.parent.name for path in (*folder.glob("*/data.csv"), *folder.glob("mav0/*/data.csv"))}
    return [(name, "") for name in sorted(found)]
