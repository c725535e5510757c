"""A robot's description with the estimated errors included."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np

from kreisel.geometry.kuka import from_abc
from kreisel.geometry.pose import exp_motion
from kreisel.geometry.rotation import Array, matrix
from kreisel.markup import screened
from kreisel.robot.description import Arm


def calibrated_urdf(arm: Arm, placement: Array) -> str:
    """Return the arm's description with the placements of joints and tool moved by errors (joints + 1, 6).

    Each error moves the origin of its joint; the error of the tool moves the fixed joint that the tool is attached
    to, or a new one where there is none. Comments and everything else are not changed.
    """
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.fromstring(screened(arm.urdf), parser=parser)
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    for name, error in zip(arm.joints, placement[:-1], strict=True):
        _move(joints[name], error)
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
    turned = _roll_pitch_yaw(C @ turn)
    origin.set("xyz", " ".join(f"{v:.12g}" for v in moved))
    origin.set("rpy", " ".join(f"{v:.12g}" for v in turned))


def _roll_pitch_yaw(C: Array) -> tuple[float, float, float]:
    """Return the angles of a rotation matrix; near a pitch of 90 deg, where they are not unique, they fit together."""
    yaw = np.arctan2(C[1, 0], C[0, 0])
    pitch = np.arctan2(-C[2, 0], np.hypot(C[0, 0], C[1, 0]))
    sine, cosine = np.sin(yaw), np.cos(yaw)
    roll = np.arctan2(sine * C[0, 2] - cosine * C[1, 2], cosine * C[1, 1] - sine * C[0, 1])
    return float(roll), float(pitch), float(yaw)
