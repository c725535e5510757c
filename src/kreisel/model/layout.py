"""The state of the filter: parameters by group, correlated errors of the reference, navigation."""

from __future__ import annotations

from collections.abc import Collection

from kreisel.estimation.state import Part, StateLayout
from kreisel.model.groups import group_named

NAVIGATION = (Part("velocity", 3), Part("position", 3), Part("attitude", 3, rotation=True))
"""What changes between updates; last in the state."""

STANDSTILL_ERROR = (Part("standstill_position", 3), Part("standstill_orientation", 3))
"""The reference's error at the present standstill: one draw for each standstill."""

PATH_ERROR = (Part("path_position", 3), Part("path_orientation", 3))
"""The reference's coloured noise on the path."""


def group_part(group: str, order: int, joints: int = 0, fixed: Collection[str] = ()) -> Part:
    """Return a group's part of the state, for sensor polynomials of an order and a robot of some joints.

    fixed: names of parameters that are not in the state.
    """
    known = group_named(group)
    names = known.names(order, joints)
    absent = tuple(i for i, name in enumerate(names) if name in fixed)
    return Part(group, len(names) - len(absent), rotation=known.rotation, absent=absent)


def with_coloured_noise(layout: StateLayout, present: tuple[bool, bool]) -> StateLayout:
    """Return a layout with coloured noise of the reference in position, in orientation, or both, before navigation."""
    kept = [part for part in layout if part not in (*PATH_ERROR, *NAVIGATION)]
    return StateLayout([*kept, *(part for part, there in zip(PATH_ERROR, present, strict=True) if there), *NAVIGATION])


def without(layout: StateLayout, groups: Collection[str]) -> StateLayout:
    """Return a layout without some groups of parameters."""
    return StateLayout([part for part in layout if part.name not in groups])
