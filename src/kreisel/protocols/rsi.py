"""KUKA Robot Sensor Interface: one XML telegram in each UDP datagram, every 4 or 12 ms; the controller sends first.

Lengths are mm, angles degrees; A, B, C are intrinsic rotations about z, y', x''. IPOC is the controller's time in ms;
the answer returns it. In ONLYSEND mode no answer is sent, and nothing can move the robot.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree

from kreisel.errors import ProtocolError
from kreisel.geometry.kuka import from_abc, to_abc
from kreisel.markup import screened
from kreisel.protocols.samples import RobotSample, checked_stamp, finite

MAX_BYTES = 8192
"""Largest number of bytes of a telegram; the controller's own limit is lower."""

_NAME = "RSI"
_FRAME = ("X", "Y", "Z", "A", "B", "C")
_DEGREE = math.pi / 180.0  # rad
_DELAY = re.compile(rb'<Delay\s+D="(\d{1,9})"')


def decode(datagram: bytes) -> RobotSample:
    """Return the pose (`RIst`) and the joint angles (`AIPos`) in a controller's telegram; one of them may be missing.

    Raises
    ------
    ProtocolError
        If it is not such a telegram, or has impossible values.
    """
    robot = parse_xml(datagram, _NAME, "Rob")
    frame = _numbers(robot, "RIst", _FRAME)
    axes = _numbers(robot, "AIPos", tuple(f"A{k}" for k in range(1, 7)))
    if not frame and not axes:
        raise ProtocolError(_NAME, "the telegram has neither RIst nor AIPos; add one of them to the RSI configuration")
    position = quaternion = None
    if frame:
        position = (frame[0] * 1e-3, frame[1] * 1e-3, frame[2] * 1e-3)
        quaternion = from_abc(*(angle * _DEGREE for angle in frame[3:]))
    ipoc = ipoc_of(robot)
    return RobotSample(
        checked_stamp(ipoc * 1_000_000, _NAME), position, quaternion, tuple(axis * _DEGREE for axis in axes)
    )


def late_answers(datagram: bytes) -> int:
    """Return how many answers the controller has missed so far, 0 if it does not report that.

    It stops the robot after the number that its configuration allows.
    """
    found = _DELAY.search(datagram, 0, MAX_BYTES)
    return 0 if found is None else int(found.group(1))


def encode(sample: RobotSample, late: int = 0) -> bytes:
    """Return the controller's telegram with a pose and the number of late answers (simulator's side)."""
    parts = ['<Rob TYPE="KUKA">']
    if sample.position is not None and sample.quaternion is not None:
        values = (*(1e3 * x for x in sample.position), *(angle / _DEGREE for angle in to_abc(sample.quaternion)))
        pose = " ".join(f'{name}="{value:.4f}"' for name, value in zip(_FRAME, values, strict=True))
        parts.append(f"<RIst {pose}/><RSol {pose}/>")
    if sample.joints:
        axes = " ".join(f'A{k}="{angle / _DEGREE:.4f}"' for k, angle in enumerate(sample.joints, start=1))
        parts.append(f"<AIPos {axes}/><ASPos {axes}/>")
    parts.append(f'<Delay D="{late}"/><IPOC>{round(sample.stamp_ns * 1e-6)}</IPOC></Rob>')
    return "".join(parts).encode()


def encode_answer(datagram: bytes) -> bytes:
    """Return the answer to a controller's telegram: no path correction, and the telegram's IPOC.

    Raises
    ------
    ProtocolError
        If it is not a telegram of a controller.
    """
    ipoc = ipoc_of(parse_xml(datagram, _NAME, "Rob"))
    return (
        f'<Sen Type="ImFree"><RKorr X="0.0" Y="0.0" Z="0.0" A="0.0" B="0.0" C="0.0"/><IPOC>{ipoc}</IPOC></Sen>'.encode()
    )


def decode_answer(datagram: bytes) -> int:
    """Return the IPOC in an answer (simulator's side).

    Raises
    ------
    ProtocolError
        If it is not an answer.
    """
    return ipoc_of(parse_xml(datagram, _NAME, "Sen"))


def parse_xml(data: bytes, protocol: str, root: str) -> ElementTree.Element:
    """Return the root element of a telegram; its name must be `root`.

    Raises
    ------
    ProtocolError
        If it is too long, not well-formed, has another name, or declares a document type: entities of such a
        declaration can make XML grow without bounds.
    """
    if len(data) > MAX_BYTES:
        raise ProtocolError(protocol, f"telegram of {len(data)} bytes, expected {MAX_BYTES} at most")
    try:
        text = screened(data)
    except ValueError as error:
        raise ProtocolError(protocol, f"telegram: {error}: {data[:60]!r}") from error
    if "<!" in text:
        raise ProtocolError(protocol, "the telegram has a declaration or comment ('<!'), which no controller sends")
    try:
        element = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise ProtocolError(protocol, f"telegram is not well-formed XML ({error}): {data[:60]!r}") from error
    if element.tag != root:
        raise ProtocolError(protocol, f"telegram begins with <{str(element.tag)[:40]}>, expected <{root}>")
    return element


def ipoc_of(telegram: ElementTree.Element) -> int:
    """Return the IPOC of a telegram.

    Raises
    ------
    ProtocolError
        If there is none, or it is not a whole number.
    """
    text = (telegram.findtext("IPOC") or "").strip()
    if not (text.isascii() and text.isdigit()) or len(text) > 19:
        raise ProtocolError(_NAME, f"IPOC is '{text[:40]}', expected a whole number of milliseconds")
    return int(text)


def _numbers(telegram: ElementTree.Element, tag: str, names: tuple[str, ...]) -> tuple[float, ...]:
    """Return the numbers in an element's attributes; empty if the element is missing."""
    element = telegram.find(tag)
    if element is None:
        return ()
    missing = [name for name in names if name not in element.attrib]
    if missing:
        raise ProtocolError(_NAME, f"<{tag}> has no {', '.join(missing)}")
    try:
        values = tuple(float(element.attrib[name]) for name in names)
    except ValueError as error:
        raise ProtocolError(_NAME, f"<{tag}> holds a value that is not a number: {dict(element.attrib)}") from error
    return finite(values, _NAME, f"<{tag}>")
