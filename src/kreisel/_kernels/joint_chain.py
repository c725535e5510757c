"""A chain of joints, as the library takes it."""

from __future__ import annotations

from typing import NamedTuple

from kreisel._kernels.views import Mask, Table

MAX_JOINTS = 64
"""Joints of a chain, as MAX_JOINTS in chain.hpp, whose arrays on the stack have this size. Chosen: arms have six or
seven, with a track and a positioner a few more."""


class Chain(NamedTuple):
    """A chain of joints, each turning about or moving along one axis.

    Attributes
    ----------
    rotations, translations : (joints + 1, 9), (joints + 1, 3)
        Placement of each joint on the link before, matrices row by row; the last is that of the tool on the last link.
    axes : (joints, 3)
        In the placement's own frame.
    turning : (joints,)
        Whether it turns about its axis; else it moves along it.
    bodies : (joints, 4)
        Mass of what moves with each joint, kg, and its centre in the joint's frame, m.
    """

    rotations: Table
    translations: Table
    axes: Table
    turning: Mask
    bodies: Table
