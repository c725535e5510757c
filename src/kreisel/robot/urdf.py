"""A robot's description with the estimated errors included."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence

import numpy as np

from kreisel.geometry.kuka import from_abc
from kreisel.geometry.pose import exp_motion
from kreisel.geometry.rotation import Array, matrix, roll_pitch_yaw
from kreisel.markup import screened
from kreisel.robot.description import Arm


def calibrated_urdf(arm: Arm, placement: Array, zeros: Sequence[float] | Array = ()) -> str:
    """Return the arm's description with the placements of joints and tool moved by errors (joints + 1, 6).

    zeros: of the joints between the first and the last (joints - 2,), whose origins they move as these joints do.
    Each error moves the origin of its joint; the error of the tool moves the fixed joint that the tool is attached
    to, or a new one where there is none. Comments and everything else are not changed.
    """
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.fromstring(screened(arm.urdf), parser=parser)
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    for name, error in zip(arm.joints, placement[:-1], strict=True):
        _move(joints[name], error)
    for k, zero in enumerate(zeros, 1):
        own = zero * arm.chain.axes[k]
        _move(joints[arm.joints[k]], np.r_[np.zeros(3), own] if arm.chain.turning[k] else np.r_[own, np.zeros(3)])
    holder = next((j for j in root.findall("joint") if _child(j) == arm.tcp), None)
    if holder is not None and holder.get("type") == "fixed":
        _move(holder, placement[-1])
    else:
        link, joint = f"{arm.tcp}_calibrated", f"{arm.tcp}_calibration"
        ElementTree.SubElement(root, "link", name=link)
        new = ElementTree.SubElement(root, "joint", name=joint, type="fixed")
        ElementTree.SubElement(new, "parent", link=arm.tcp)
        ElementTree.SubElement(new, "child", link=link)
        _move(new, placement[-1])
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _child(joint: ElementTree.Element) -> str | None:
    child = joint.find("child")
    return None if child is None else child.get("link")


def _move(joint: ElementTree.Element, error: Array) -> None:
    """Move a joint's origin by a small motion in its own coordinates."""
    origin = joint.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(joint, "origin")
    xyz, (roll, pitch, yaw) = (np.array(origin.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
    turn, shift = exp_motion(error)
    C = matrix(from_abc(yaw, pitch, roll))
    moved = xyz + C @ shift
    turned = roll_pitch_yaw(C @ turn)
    origin.set("xyz", " ".join(f"{v:.12g}" for v in moved))
    origin.set("rpy", " ".join(f"{v:.12g}" for v in turned))
