"""Specific force predicted for a unit of each parameter of the accelerometers, integrated twice along a motion."""

from __future__ import annotations

from kreisel._kernels.compiled import function
from kreisel._kernels.views import Array, Indices, IndicesView, NumbersView, TableView, check_indices, check_lengths

PARAMETERS = 15
"""Nine couplings, row by row, three offsets, and a lever arm all three have in common."""

_unit_forces = function("unit_forces", *[NumbersView] * 5)
_integrate_unit_forces = function(
    "integrate_unit_forces", NumbersView, *[TableView] * 4, IndicesView, NumbersView, TableView
)


def at_sample(q: Array, reading: Array, omega: Array, alpha: Array, out: Array) -> None:
    """Write the specific force in r predicted for a unit of each parameter, (45,): x for all, then y, then z.

    Parameters
    ----------
    q, reading, omega, alpha : (4,), (3,), (3,), (3,)
        Attitude q_rb, raw acceleration, rate and angular acceleration of one sample.
    """
    check_lengths(
        q=(q, (4,)), reading=(reading, (3,)), omega=(omega, (3,)), alpha=(alpha, (3,)), out=(out, (3 * PARAMETERS,))
    )
    _unit_forces(q, reading, omega, alpha, out)


def double_integrals(
    stamps: Array, q: Array, readings: Array, omega: Array, alpha: Array, before: Indices, share: Array, out: Array
) -> None:
    """Write double integrals of what `at_sample` writes from the first stamp to chosen moments, (m, 45).

    stamps (n,), q (n, 4), readings, omega and alpha (n, 3). before and share (m,) give the moments: see
    `quadrature.double_integral`, also for the values between samples.
    """
    n, m = stamps.size, before.size
    check_lengths(
        q=(q, (n, 4)), readings=(readings, (n, 3)), omega=(omega, (n, 3)), alpha=(alpha, (n, 3)), share=(share, (m,)),
        out=(out, (m, 3 * PARAMETERS)),
    )  # fmt: skip
    check_indices("before", before, 0, n - 1)
    _integrate_unit_forces(stamps, q, readings, omega, alpha, before, share, out)
