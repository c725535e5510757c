"""Which effects a unit's readings show beyond those that are estimated: one after the other, by Wald's test.

The mean of a tray shows an effect of one unit among sixteen at a sixteenth of its size, and may not show it at all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from kreisel.geometry.rotation import Array, Indices

_CANDIDATES = {
    "gyro_polynomial": 3, "gyro_cubic": 3, "gyro_g_sensitivity": 9, "gyro_axis_smoothing": 3,
    "accel_polynomial": 3, "accel_axis_delay": 3, "accel_axis_smoothing": 3,
}  # fmt: skip
"""Effects that are looked for, and their numbers of parameters. Delays of the gyros' axes are not among them: with
those of accelerometers and the clock they are one too many."""

_PARTS_OF = {"accel_axis_delay": "accel_delay", "accel_axis_smoothing": "accel_smoothing"}
"""Effects of each axis, and what they contain that is common to the axes: they are not estimated together."""

PRODUCTS = "products of accelerations in the accelerometers"
"""An effect that is looked for and cannot be estimated."""

BENDING, OF_BENDING = "mount_bending", 9
"""An effect of a unit's mount, and its number of parameters."""

_MOST = 4
"""Effects of one unit that are added at most. Chosen: no device in the robustness study has more."""


def candidates(estimated: Mapping[str, int]) -> dict[str, int]:
    """Return the effects that may be found beyond those that are estimated, with their numbers of parameters."""
    out = {
        group: size
        for group, size in _CANDIDATES.items()
        if group not in estimated and _PARTS_OF.get(group) not in estimated
    }
    if estimated.get("gyro_polynomial", 0) > _CANDIDATES["gyro_polynomial"]:
        out.pop("gyro_cubic", None)  # it is in the polynomial
    return out


def products(values: Array, axis: int) -> Array:
    """Return what an accelerometer may respond to beside its own reading, (n, 4): products of readings (n, 3).

    Of the squares of the two other axes it is the difference: with their sum, and the square of its own, accelerations
    at rest are like an offset.
    """
    x, y, z = values.T
    others = np.delete(values, axis, axis=1) ** 2
    return np.column_stack([x * y, y * z, z * x, others[:, 0] - others[:, 1]])


def shown_effects(
    fitted: Callable[[Indices], tuple[Array, Array]],
    base: Indices,
    places: Mapping[str, Indices],
    of_products: Indices,
    drift: Indices,
) -> dict[str, float]:
    """Return the effects that data show, the clearest first, and the chi-square of each over its `limit`.

    Parameters
    ----------
    fitted
        Returns values (p,) and covariance (p, p) of the parameters at some places, estimated together.
    base
        Places of the parameters that are estimated anyway.
    places
        Of the parameters of each effect that may be added.
    of_products, drift
        Of the parameters of `PRODUCTS`, which must be nothing else, and of offsets that drift.
    """

    def weight(known: Indices, own: Indices) -> float:
        x, P = fitted(np.concatenate([known, own]))
        x, P = x[-own.size :], P[-own.size :, -own.size :]
        return float(x @ np.linalg.solve(P, x)) / limit(own.size)

    found: dict[str, float] = {}
    while len(found) < _MOST:
        known = np.concatenate([base, *(places[group] for group in found)])
        weights = {group: weight(known, own) for group, own in places.items() if group not in found}
        best = max(weights, key=lambda group: weights[group], default=None)
        if best is None or weights[best] < 1.0:
            break
        found[best] = weights[best]
    if of_products.size and (last := weight(np.concatenate([base, drift, *places.values()]), of_products)) >= 1.0:
        found[PRODUCTS] = last
    return found


def bending(axis: Array, turned: Array, load: Array, by: Array, load_changes: Array) -> Array:
    """Return what a reading changes by for a mount that bends, (n, 9), by the entries of the bending.

    Parameters
    ----------
    axis : (3,)
        What the reading is of: a row of the inverse of K_omega or K_a.
    turned : (n, 3)
        Rates, or forces, which a turn of the unit turns.
    load : (n, 3)
        Force less its mean.
    by : (3,), load_changes : (n, 3)
        What a reading changes by for a rate of the unit, or an angular acceleration; that derivative of the force.
    """
    of_turn = np.cross(axis, turned)[:, :, None] * load[:, None, :] + by[:, None] * load_changes[:, None, :]
    return np.asarray(of_turn.reshape(len(load), OF_BENDING))


def limit(degrees: int) -> float:
    """Return the chi-square from which an effect counts: 1e-4 by chance, by Wilson and Hilferty's approximation."""
    share = 2.0 / (9.0 * degrees)
    return degrees * float(1.0 - share + 3.719 * np.sqrt(share)) ** 3
