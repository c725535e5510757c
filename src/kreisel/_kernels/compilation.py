"""The one decorator that fixes how kernels are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Return the function compiled on first use, cached on disk, and free of the interpreter lock.

    Fused multiply-add is allowed; no other liberty is taken with the order of floating point operations.
    """
    compiled = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})(function)
    return cast(F, compiled)
