"""How much of each limit a program uses, as it will be sent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kreisel.acquisition.clearance import Room, check_way, tool_peak
from kreisel.acquisition.movers import Mover
from kreisel.acquisition.preflight import acceleration_limits
from kreisel.robot.description import Arm
from kreisel.robot.program import Program
from kreisel.units import DEG


@dataclass(frozen=True)
class LimitUse:
    """One limit: what it limits, what the program uses, the limit, and the share of it, nan where it has none."""

    what: str
    used: str
    limit: str
    share: float


COLUMNS = ("what", "used", "limit", "share")


def limits_used(arm: Arm, program: Program, mover: Mover, room: Room, tool_speed: float) -> tuple[LimitUse, ...]:
    """Return the use of every limit by a program's moves, at the speeds with which they are sent.

    Parameters
    ----------
    tool_speed
        The fastest allowed, m/s.
    """
    angles = np.array([program.start, *(move.target for move in program.moves)]) / DEG
    legs = list(program.legs())
    peaks = [mover.peaks(move.target - at, move.speed, arm.velocity) for _, at, move in legs]
    velocity = np.max([np.abs(one[0]) for one in peaks], axis=0)
    known = [np.abs(one[1]) for one in peaks if one[1] is not None]
    acceleration = np.max(known, axis=0) if known else None
    out = []
    for k, name in enumerate(arm.joints):
        low, high = arm.lower[k] / DEG, arm.upper[k] / DEG
        farthest = max(angles[:, k].max() / high if high > 0 else 0.0, angles[:, k].min() / low if low < 0 else 0.0)
        out += [
            _use(f"{name} angle", f"{angles[:, k].min():.0f} to {angles[:, k].max():.0f} deg",
                 f"{low:.0f} to {high:.0f} deg", farthest),
            _use(f"{name} speed", f"{velocity[k]:.2f} rad/s", f"{arm.velocity[k]:.2f} rad/s",
                 velocity[k] / arm.velocity[k]),
        ]  # fmt: skip
        if acceleration is not None:
            limit = acceleration_limits(arm)[k]
            out.append(_use(f"{name} acceleration", f"{acceleration[k]:.2f} rad/s^2", f"{limit:.2f} rad/s^2",
                            acceleration[k] / limit))  # fmt: skip
    fastest = max(tool_peak(arm, mover, at, move.target, move.speed) for _, at, move in legs)
    ways = [check_way(arm, at, move.target, room, number) for number, at, move in legs]
    out += [
        _use("tool speed", f"{fastest:.2f} m/s", f"{tool_speed:g} m/s", fastest / tool_speed),
        _use("height above the floor", f"{min(way[0] for way in ways):.2f} m", "0 m", math.nan),
        _use("distance of links", f"{min(way[1] for way in ways):.2f} m", "0 m", math.nan),
    ]
    return tuple(out)


def _use(what: str, used: str, limit: str, share: float) -> LimitUse:
    return LimitUse(what, used, limit, float(share))


def row_of(use: LimitUse) -> tuple[str, str, str, str]:
    """Return the cells of a limit, in the order of `COLUMNS`."""
    return use.what, use.used, use.limit, "" if math.isnan(use.share) else f"{100.0 * use.share:.0f} %"
