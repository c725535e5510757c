"""Integrals, derivatives and values of sampled signals at arbitrary stamps, by local polynomials."""

from __future__ import annotations

from kreisel._kernels.compiled import check_count, function
from kreisel._kernels.views import Array, Indices, IndicesView, NumbersView, TableView, check_indices, check_lengths

POINTS = 6
"""Samples each polynomial goes through that is integrated."""

check_count("stencil", POINTS)

_interval_weights = function("interval_weights", NumbersView, IndicesView, TableView, TableView)
_integrate_intervals = function("integrate_intervals", IndicesView, TableView, TableView, TableView)
_differentiate = function("differentiate", NumbersView, IndicesView, TableView, TableView)
_double_integral = function("double_integral", NumbersView, TableView, IndicesView, NumbersView, TableView)
_interpolate = function("interpolate", NumbersView, TableView, NumbersView, IndicesView, TableView)
_integrate_attitude = function("integrate_attitude", NumbersView, TableView, TableView, TableView, TableView)


def interval_weights(stamps: Array, base: Indices, single: Array, twice: Array) -> None:
    """Write for every sampling interval [t_k, t_k+1] the weights of its two integrals.

    ``sum_i single[k, i] * u[base[k] + i]`` is the integral of u over the interval and
    ``sum_i twice[k, i] * u[base[k] + i]`` that of (t_k+1 - t) u, for u the quintic through the six
    samples from ``base[k]`` on. stamps (n,), base (n - 1,), single and twice (n - 1, 6).
    """
    n = stamps.size
    check_lengths(base=(base, (n - 1,)), single=(single, (n - 1, POINTS)), twice=(twice, (n - 1, POINTS)))
    check_indices("base", base, 0, n - POINTS + 1)
    _interval_weights(stamps, base, single, twice)


def integrate_intervals(base: Indices, single: Array, values: Array, out: Array) -> None:
    """Write the integral of every row of values (c, n) over every sampling interval, (c, n - 1).

    base (n - 1,), single (n - 1, 6): see `interval_weights`.
    """
    c, n = values.shape
    check_lengths(base=(base, (n - 1,)), single=(single, (n - 1, POINTS)), out=(out, (c, n - 1)))
    check_indices("base", base, 0, n - POINTS + 1)
    _integrate_intervals(base, single, values, out)


def differentiate(stamps: Array, first: Indices, values: Array, out: Array) -> None:
    """Write the derivative, (n, 3), of every column of values (n, 3) at stamps (n,).

    The derivative is that of the quartic through the five samples from ``first[k]`` on, first (n,), k among them.
    """
    n = stamps.size
    check_lengths(first=(first, (n,)), values=(values, (n, 3)), out=(out, (n, 3)))
    check_indices("first", first, 0, n - 4)
    _differentiate(stamps, first, values, out)


def double_integral(stamps: Array, values: Array, before: Indices, share: Array, out: Array) -> None:
    """Write the double integral (m, k) of values (n, k), sampled at stamps (n,), from the first to chosen moments.

    Moments lie a share (m,) of the interval after the samples `before` (m,), in ascending order. Values
    are taken as linear between samples, and so is what is written.
    """
    n, k = values.shape
    m = before.size
    check_lengths(stamps=(stamps, (n,)), share=(share, (m,)), out=(out, (m, k)))
    check_indices("before", before, 0, n - 1)
    _double_integral(stamps, values, before, share, out)


def interpolate(stamps: Array, values: Array, moments: Array, after: Indices, out: Array) -> None:
    """Write the values (n, c) at ascending moments (m,) by the cubic through the four samples around each, (m, c).

    after (m,): the place of the sample after each moment, from the second to the last. stamps (n,), at least four.
    """
    n, c = values.shape
    m = moments.size
    if n < 4:
        raise ValueError(f"a cubic needs four samples, got {n}")
    check_lengths(stamps=(stamps, (n,)), after=(after, (m,)), out=(out, (m, c)))
    _interpolate(stamps, values, moments, after, out)


def integrate_attitude(stamps: Array, rates: Array, integrals: Array, coefficients: Array, q: Array) -> None:
    """Write the attitudes q (n, 4) that start at the first and turn with the rate, coning included.

    stamps (n,), rates (P, n), integrals (P, n - 1): see `cell.Samples`; coefficients (P, 3): see `coefficients`.
    """
    P, n = rates.shape
    check_lengths(
        stamps=(stamps, (n,)), integrals=(integrals, (P, n - 1)), coefficients=(coefficients, (P, 3)), q=(q, (n, 4))
    )
    _integrate_attitude(stamps, rates, integrals, coefficients, q)
