"""Recursions over time that simulation needs."""

from __future__ import annotations

from kreisel._kernels.compiled import function
from kreisel._kernels.views import Array, NumbersView, StackView, TableView, check_lengths

_drive_oscillators = function("drive_oscillators", TableView, NumbersView, NumbersView, TableView, StackView)
_gauss_markov = function("gauss_markov", NumbersView, TableView, TableView)


def drive_oscillators(step: Array, now: Array, later: Array, u: Array, x: Array) -> None:
    """Write the states x (2, n, m) of m oscillators driven by u (n, m), from standstill.

    x_k+1 = step x_k + now u_k + later u_k+1, with step (2, 2), now and later (2,); x_0 is given.
    """
    check_lengths(step=(step, (2, 2)), now=(now, (2,)), later=(later, (2,)), x=(x, (2, *u.shape)))
    _drive_oscillators(step, now, later, u, x)


def gauss_markov(keep: Array, white: Array, out: Array) -> None:
    """Write a stationary Gauss-Markov process of unit variance, (n, m), from white noise (n, m) and keep (n - 1,)."""
    check_lengths(keep=(keep, (white.shape[0] - 1,)), out=(out, white.shape))
    _gauss_markov(keep, white, out)
