"""KUKA's angles A, B, C: intrinsic rotations about z, y', x''; R = Rz(A) Ry(B) Rx(C). Single attitudes, rad."""

from __future__ import annotations

import math


def from_abc(a: float, b: float, c: float) -> tuple[float, float, float, float]:
    """Return the quaternion of three angles."""
    (ca, sa), (cb, sb), (cc, sc) = ((math.cos(0.5 * angle), math.sin(0.5 * angle)) for angle in (a, b, c))
    return (
        ca * cb * cc + sa * sb * sc,
        ca * cb * sc - sa * sb * cc,
        ca * sb * cc + sa * cb * sc,
        sa * cb * cc - ca * sb * sc,
    )


def to_abc(q: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """Return the three angles of a unit quaternion; C is zero where B is a right angle."""
    w, x, y, z = q
    up = max(-1.0, min(1.0, 2.0 * (w * y - x * z)))
    b = math.asin(up)
    if abs(up) > 1.0 - 1e-12:
        return 2.0 * math.atan2(z, w), b, 0.0
    a = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    c = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return a, b, c
