"""Kalibr's YAML of several IMUs proved by numbers: one motion of the tray, seen by all units, is one in the file.

Readings of every unit are made from a motion in closed form by kreisel's equations and the units' calibrations in axes
of the tool. Kalibr's model with the numbers in the file corrects them; T_i_b and time_offset bring them to imu0. The
places in `array.yaml` are in the file alone, so that a file that does not belong to the calibrations fails, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from kreisel.array.array_file import ArrayUnit
from kreisel.errors import RecordingError
from kreisel.exchange.kalibr_model import (
    KalibrModel,
    held_by_kalibr,
    inverse,
    matrix_of,
    rotation_of,
    triangle_of,
    uncoupled,
)
from kreisel.geometry.rotation import Array, lengths
from kreisel.inertial.sensor_model import size_effect
from kreisel.units import DEG, STANDARD_GRAVITY

_STEP = 2e-3
"""s, of the samples. Chosen: differences of the fifth order miss 1e-8 rad/s^2 of the angular acceleration."""

_TIMES: Array = _STEP * np.arange(2000.0)
"""s, of the samples."""

_EDGE = 20
"""Samples at either end that differences do not reach."""

_FREQUENCY = 2.0 * np.pi * np.array([[0.31, 0.47, 0.67], [0.73, 0.89, 0.41]])
"""rad/s, of two sines on each axis; those of the force are half as fast again."""

_PHASE = np.array([[0.3, 1.1, 2.5], [4.0, 5.2, 0.7]])
_RATE, _FORCE = 50.0 * DEG, 3.0
"""rad/s and m/s^2; amplitude of each sine."""

_TOOL = 3.0
"""m; units are not further away from the tool's origin in the digits of the stamps."""

_PASSES = 6
"""Rate and force depend on each other through g-sensitivity times arms, a millionth; each pass gains as much."""

RATE_FLOOR, FORCE_FLOOR = 1e-9, 1e-6
"""rad/s and m/s^2; bounds of the differences without what Kalibr's model leaves out. Chosen: far below any noise, and
ten times what differences of the rate miss of the force with arms of several metres."""


@dataclass(frozen=True)
class Difference:
    """The largest differences of any unit's rate and force from those of imu0, rad/s and m/s^2, and their bounds."""

    rate: float = 0.0
    force: float = 0.0
    rate_bound: float = RATE_FLOOR
    force_bound: float = FORCE_FLOOR

    def __str__(self) -> str:
        """Return the differences and their bounds."""
        return (
            f"{self.rate:.1e} rad/s and {self.force:.1e} m/s^2 at most (bounds {self.rate_bound:.1e}, "
            f"{self.force_bound:.1e})"
        )

    def or_larger(self, other: Difference) -> Difference:
        """Return the larger ones of two."""
        return Difference(*(max(pair) for pair in zip(astuple(self), astuple(other), strict=True)))

    def check(self, name: str, base: str) -> None:
        """Raise an error if the bounds are exceeded.

        Raises
        ------
        RecordingError
            It names the unit.
        """
        rows = (("rate", self.rate, self.rate_bound, "rad/s"), ("force", self.force, self.force_bound, "m/s^2"))
        for what, found, bound, si in rows:
            if not found <= bound:
                raise RecordingError(
                    f"{name}: the {what} of one motion by Kalibr's model of the file differs from that of {base} by "
                    f"{found:.2g} {si}, expected {bound:.2g} at most: places and calibrations do not belong together; "
                    "calibrate the tray again"
                )


@dataclass(frozen=True)
class ChainProof:
    """The differences with all accelerometers of a unit at its accelerometer x, and where they are.

    Kalibr holds the first case exactly; in the second its size effect acts along the axes of i in place of the
    sensitive axes, and the gyros' g-sensitivity does not include it.
    """

    at_one_place: Difference
    at_own_places: Difference

    @property
    def sentence(self) -> str:
        """The proof in a line."""
        return (
            "read back: readings of one motion of the tray, corrected by Kalibr's model and brought to imu0, differ by "
            f"{self.at_one_place}, with the size effect inside of units by {self.at_own_places}"
        )


@dataclass(frozen=True)
class _Imu:
    """What the file says of an IMU: its model, C_i_b (3, 3), its position in b (3,), m, and time_offset, s."""

    model: KalibrModel
    C_ib: Array
    r_b: Array
    time_offset: float


def proved(text: str, units: Sequence[ArrayUnit]) -> ChainProof:
    """Return the proof of a file.

    Parameters
    ----------
    text
        Its content: imu0, imu1 and so on are the units.

    Raises
    ------
    RecordingError
        If a difference is larger than its bound.
    """
    table = YAML(typ="safe").load(text)
    imus = [_imu(table[f"imu{k}"]) for k in range(len(units))]
    proof = ChainProof(Difference(), Difference())
    for unit, imu in zip(units, imus, strict=True):
        one = _difference(units[0], imus[0], unit, imu, apart=False)
        own = _difference(units[0], imus[0], unit, imu, apart=True)
        for found in (one, own):
            found.check(unit.name, units[0].name)
        proof = ChainProof(proof.at_one_place.or_larger(one), proof.at_own_places.or_larger(own))
    return proof


def _difference(base_unit: ArrayUnit, base: _Imu, unit: ArrayUnit, imu: _Imu, *, apart: bool) -> Difference:
    """Return how far a unit's motion is from that of the reference unit; apart: accelerometers at their own places."""
    if not apart:
        base, imu = (replace(one, model=replace(one.model, arms=np.zeros((3, 3)))) for one in (base, imu))
    # stamps of the unit at the motion's times t, and what they are for Kalibr
    there = (_TIMES - unit.offset) + imu.time_offset
    base_rate, base_force = _at_body(base, *_readings(base_unit, there, apart=apart))
    rate, force = _at_body(imu, *_readings(unit, _TIMES, apart=apart))
    inner = slice(_EDGE, -_EDGE)
    found = (float(np.abs(rate - base_rate)[inner].max()), float(np.abs(force - base_force)[inner].max()))
    return Difference(*found, *_bounds(base, imu, unit.offset))


def _imu(entry: dict[str, Any]) -> _Imu:
    gyro, accel = entry["gyroscopes"], entry["accelerometers"]
    model = KalibrModel(
        M_a=triangle_of(accel["M"]),
        M_w=triangle_of(gyro["M"]),
        C_gyro_i=rotation_of(gyro["C_gyro_i"]),
        A=matrix_of(gyro["A"]),
        arms=matrix_of([accel[f"r{axis}_i"] for axis in "xyz"]),
        bias_w=np.zeros(3),
        bias_a=np.zeros(3),
    )
    T_i_b = np.array(entry["T_i_b"], dtype=float)
    C_ib = rotation_of(T_i_b[:3, :3].tolist())
    return _Imu(model, C_ib, -C_ib.T @ T_i_b[:3, 3], float(entry["time_offset"]))


def _motion(t: Array) -> tuple[Array, Array, Array]:
    """Return rate, angular acceleration and specific force of the tool (n, 3) at times t, s."""
    omega, alpha, force = (
        np.zeros((t.size, 3)),
        np.zeros((t.size, 3)),
        np.tile([0.0, 0.0, STANDARD_GRAVITY], (t.size, 1)),
    )
    for frequency, phase in zip(_FREQUENCY, _PHASE, strict=True):
        angle = t[:, None] * frequency + phase
        omega += _RATE * np.sin(angle)
        alpha += _RATE * frequency * np.cos(angle)
        force += _FORCE * np.cos(1.5 * angle)
    return omega, alpha, force


def _readings(unit: ArrayUnit, t: Array, *, apart: bool) -> tuple[Array, Array]:
    """Return raw rates and accelerations (n, 3) of a unit at times t of the motion, by what Kalibr holds of it."""
    p = held_by_kalibr(unit.calibration.sensors)
    if not apart:
        p = replace(p, lever_arms=np.tile(p.lever_arms[0], (3, 1)))
    omega, alpha, force = _motion(t)
    a = force @ inverse(p.K_a).T + size_effect(omega, alpha, p)
    G = np.asarray(p.others.get("gyro_g_sensitivity", np.zeros(9)), dtype=float).reshape(3, 3)
    return omega @ inverse(p.K_omega).T - a @ G.T, a


def _at_body(imu: _Imu, w: Array, a: Array) -> tuple[Array, Array]:
    """Return rate and specific force of imu0 (n, 3) by readings of an IMU, with Kalibr's model and T_i_b."""
    model = imu.model
    M_a, M_w = inverse(model.M_a), inverse(model.M_w)
    omega, alpha = np.zeros_like(w), np.zeros_like(w)
    force = a @ M_a.T
    for _ in range(_PASSES):
        omega = (w - force @ (model.A @ model.C_gyro_i).T) @ (model.C_gyro_i.T @ M_w).T
        alpha = _derivative(omega)
        parts = [_moved(omega, alpha, arm)[:, k] for k, arm in enumerate(model.arms)]
        force = a @ M_a.T - np.column_stack(parts)
    omega, alpha, force = omega @ imu.C_ib, alpha @ imu.C_ib, force @ imu.C_ib
    return omega, force - _moved(omega, alpha, imu.r_b)


def _moved(omega: Array, alpha: Array, r: Array) -> Array:
    """Return alpha x r + omega x (omega x r), (n, 3)."""
    return np.asarray(np.cross(alpha, r) + np.cross(omega, np.cross(omega, r)))


def _derivative(values: Array) -> Array:
    """Return derivatives by five samples (n, 3); those of the outer samples are zero."""
    out = np.zeros_like(values)
    out[2:-2] = (values[:-4] - 8.0 * values[1:-3] + 8.0 * values[3:-1] - values[4:]) / (12.0 * _STEP)
    return out


def _bounds(base: _Imu, imu: _Imu, offset: float) -> tuple[float, float]:
    """Return bounds of the differences in rate, rad/s, and force, m/s^2.

    Kalibr's size effect acts along the axes of i, and its A responds to the force in the origin of i, kreisel's to
    readings; stamps have a last digit.
    """
    omega, alpha, force = _motion(_TIMES)
    field = float((lengths(alpha) + lengths(omega) ** 2).max())
    arms = max(float(lengths(one.model.arms).max()) for one in (base, imu))
    rate_error, force_error = RATE_FLOOR, FORCE_FLOOR
    for model in (base.model, imu.model):
        own = float(np.linalg.norm(inverse(model.M_a), 2)) * uncoupled(model) * field
        felt = float(np.linalg.norm(inverse(model.M_w), 2) * np.linalg.norm(model.A, 2))
        force_error += np.sqrt(3.0) * own
        rate_error += felt * (np.sqrt(3.0) * arms * field + own)
    fastest = 4.5 * float(_FREQUENCY.max())  # of products: a derivative is at most so many times as large
    span = float(np.linalg.norm(imu.r_b)) + 2.0 * arms
    largest = float(lengths(omega).max())
    digit = 2.0 * float(np.spacing(abs(offset) + _TIMES[-1]))
    sheer = fastest * float(np.abs(force).max() + field * (span + _TOOL))
    rate_error += digit * fastest * largest
    return rate_error, force_error + (fastest + 2.0 * largest) * span * rate_error + digit * sheer
