"""Whether a result from standstills may be used, with the reasons if not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kreisel.calibration.data_sheet import MAX_ANGLE, MAX_SCALE, MAX_SPREAD, non_orthogonality, sensitivity
from kreisel.calibration.result_sections import Verdict
from kreisel.geometry.rotation import Array
from kreisel.model.calibration_settings import SENSORS
from kreisel.model.groups import group_named
from kreisel.refinement.observability import MAX_SHARE
from kreisel.static.known_attitudes import HingeTurns, TableTurns
from kreisel.static.multi_position import StaticEstimate

MAX_LEFT_OUT = 0.2
"""Share of standstills, or of turns, that may be left out. Chosen: of more nobody knows which ones are right."""

MAX_FORCE = 0.1
"""m/s^2; largest error of the force at a standstill: 10 mrad. Chosen: a hand that is no longer still."""

_CONTRADICTING, _MOST_AGAINST = 2, 0.4
"""Turns by hand that contradict a table, and share of all of them, from which on the table is not trusted."""

_WHOLE = 0.05
"""rad; turns by a table that differ less from whole ones show nothing new. Chosen: turns of 358 deg suffice."""

_FEW = 10
"""Standstills, below which more of them are asked for where something is not observable."""

MAX_HALVES = 4.5
"""Deviations by which both halves of a recording may differ, as in `calibrate`."""


LOST = 2e-3
"""Share of lost samples from which on it is said. Chosen: that of usual scale factors after calibration."""

SKIPPED = (
    "{share:.2g} % or more of the readings change by twice as much from the one before: samples are lost without a gap "
    "in the stamps, and turns are too small by it, or the device is asked more slowly than it measures; record every "
    "sample with the stamp of the device"
)
"""What is said then."""


def judge_static(
    found: StaticEstimate,
    deviation: Array,
    halves: Array | None,
    only: str | None,
    against_gyros: Sequence[str] = (),
    skipped: float = 0.0,
) -> Verdict:
    """Return the verdict.

    Parameters
    ----------
    deviation : (P,)
        Of the result, with all contributions.
    halves : (P,)
        Difference of both halves over its deviation, if there are enough standstills.
    only
        The sensor that is asked for.
    against_gyros
        Further reasons against the gyros' result.
    skipped
        Share of samples that are lost, at least.
    """
    names = found.problem.names[: deviation.size]
    judged = [(name, _weakness(name, sd)) for name, sd in zip(names, deviation, strict=True)]
    weak = [(name, narrowed) for name, narrowed in judged if narrowed is not None]
    reasons: dict[str, list[str]] = {sensor: [] for sensor in SENSORS}
    hidden: dict[str, str] = {}
    for sensor in SENSORS:
        lost = [name for name, narrowed in weak if name.startswith(sensor) and not narrowed]
        if lost:
            hidden[sensor] = _not_observable(found, sensor, lost, skipped)
            reasons[sensor].append(hidden[sensor])
            continue  # what is implausible beside that is a consequence
        reasons[sensor] += _device(found, sensor) + _left_out(found, sensor)
        if sensor == "gyroscope":
            reasons[sensor] += _against_a_table(found)
        if halves is not None:
            far = [(abs(s), n) for s, n in zip(halves, names, strict=True) if n.startswith(sensor)]
            if far and max(far)[0] > MAX_HALVES:
                reasons[sensor].append(
                    f"both halves of the recording differ by {max(far)[0]:.1f} deviations in {max(far)[1]}: something "
                    "changed that is not modelled"
                )
    reasons["gyroscope"] += against_gyros
    count = found.problem.rests.count
    if found.noise.force > MAX_FORCE:
        text = f"forces at standstills err by {found.noise.force:.2g} m/s^2: the device was not at rest" + (
            f", or {count} standstills are too few: more are needed"
            if count < _FEW
            else ", or turns between them are not measured as a whole"
        )
        for own in reasons.values():  # the gyros are measured by gravity's turns
            own.append(text)
    asked = SENSORS if only is None else (only,)
    states = {
        s: "accepted" if not own else "not_observable" if own == [hidden.get(s)] else "rejected"
        for s, own in reasons.items()
    }
    against = dict.fromkeys(r for s in asked for r in reasons[s])  # one may be a reason against both
    unasked = [r for s in SENSORS if s not in asked for r in reasons[s]]
    return Verdict(not against, tuple(against), tuple(n for n, _ in weak), sensors=states, unasked=tuple(unasked))


def _not_observable(found: StaticEstimate, sensor: str, lost: list[str], skipped: float = 0.0) -> str:
    """Return why parameters of a sensor are not observable."""
    imu, count = found.problem.imu, found.problem.rests.count
    values = imu.rates if sensor == "gyroscope" else imu.accelerations
    dead = [axis for axis, one in zip("xyz", np.ptp(values, axis=0) == 0.0, strict=True) if one]
    if dead:
        return f"{sensor}: the readings of {', '.join(dead)} never change: it is not connected, or broken"
    names = f"{', '.join(lost[:4])}{' and others' if len(lost) > 4 else ''}"
    if skipped > LOST and sensor == "gyroscope":
        return f"not observable with these samples: {names}; {SKIPPED.format(share=100.0 * skipped)}"
    which = f"not observable with these standstills: {names}"
    tables = [one.angle for one in found.problem.known if isinstance(one, TableTurns)]
    if tables and all(np.abs(angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi))).max() < _WHOLE for angle in tables):
        return f"{which}; whole turns of a table end where they began: turn it by other angles, too, such as 90 deg"
    if any(isinstance(one, HingeTurns) for one in found.problem.known):
        return (
            f"{which}; turn it about a hinge that is not upright, by quarters of a turn, and fix it in three ways, "
            "along axes of the device at right angles"
        )
    return (
        f"{which}; lay the device on each of its faces and on edges, and turn it about all axes"
        f"{f', more often: {count} standstills are few' if count < _FEW else ''}"
    )


def _weakness(name: str, deviation: float) -> bool | None:
    """Return whether a parameter that is of no use was narrowed down at all; None for one of use."""
    group = next((g for g in _SENSOR_GROUPS if name.startswith(g.path + "[")), None)
    if group is None:
        return None
    if deviation > MAX_SHARE * (group.usual_sd or np.inf):
        return False
    return True if deviation > group.useful_sd else None


_SENSOR_GROUPS = [
    group_named(name) for name in ("gyro_cross_coupling", "gyro_offset", "accel_cross_coupling", "accel_offset")
]


def _device(found: StaticEstimate, sensor: str) -> list[str]:
    """Return the reasons about scale factors and axes that no device has."""
    sensors = found.parameters.sensors
    K = sensors.K_omega if sensor == "gyroscope" else sensors.K_a
    scale, off = sensitivity(K)[0], non_orthogonality(K)
    if scale.max() > MAX_SCALE or scale.min() < 1.0 / MAX_SCALE:
        return [f"{sensor} scale factors {np.round(scale, 3).tolist()} are far from 1: check its unit and range"]
    if float(np.ptp(scale)) > 2.0 * MAX_SPREAD or float(np.abs(off).max()) > 2.0 * MAX_ANGLE:
        return [f"{sensor} scale and axes are those of no device: the standstills are none, or readings are lost"]
    return []


def _against_a_table(found: StaticEstimate) -> list[str]:
    """Return the reason that turns by hand contradict those of a table."""
    tables = [one.node for one in found.problem.known if isinstance(one, TableTurns)]
    if not tables:
        return []
    by_hand = np.setdiff1d(found.rows["turn"].node, np.concatenate(tables))
    against = np.intersect1d([node for kind, node in found.left_out if kind == "turn"], by_hand).size
    if against < _CONTRADICTING or against < _MOST_AGAINST * by_hand.size:
        return []
    return [
        f"{against} of {by_hand.size} turns by hand do not fit those of the table: its scale, or its clock, is wrong, "
        "or it was not the device alone that was turned"
    ]


def _left_out(found: StaticEstimate, sensor: str) -> list[str]:
    kinds = ("force", "face") if sensor == "accelerometer" else ("rate", "turn", "whole turn", "table")
    out = [node for kind, node in found.left_out if kind in kinds]
    if len(out) <= MAX_LEFT_OUT * found.problem.rests.count:
        return []
    return [
        f"{len(out)} of {found.problem.rests.count} standstills, or turns after them, do not fit the others: hold the "
        "device still, and turn it more gently"
    ]
