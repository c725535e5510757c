"""A robot's description with the estimated errors included."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.markup import screened
from kreisel.robot.kinematics import Arm, pinocchio


def calibrated_urdf(arm: Arm, placement: Array) -> str:
    """Return the arm's description with the placements of joints and tool moved by errors (joints + 1, 6).

    Each error moves the origin of its joint; the error of the tool moves the fixed joint that the tool is attached
    to, or a new one where there is none. Comments and everything else are not changed.
    """
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.fromstring(screened(arm.urdf), parser=parser)
    joints = {joint.get("name"): joint for joint in root.iter("joint")}
    for name, error in zip(arm.joints, placement[:-1], strict=True):
        _move(joints[name], error)
    holder = next((j for j in root.iter("joint") if _child(j) == arm.tcp), None)
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
    pin = pinocchio()
    origin = joint.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(joint, "origin")
    xyz, rpy = (np.array(origin.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
    step = pin.exp6(pin.Motion(error[:3], error[3:]))
    C = pin.rpy.rpyToMatrix(rpy)
    moved = xyz + C @ step.translation
    turned = pin.rpy.matrixToRpy(C @ step.rotation)
    origin.set("xyz", " ".join(f"{v:.12g}" for v in moved))
    origin.set("rpy", " ".join(f"{v:.12g}" for v in turned))
