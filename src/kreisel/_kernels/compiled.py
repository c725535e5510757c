"""The compiled library: where it lies, which instructions of the processor it uses, how its functions are called."""

from __future__ import annotations

import ctypes
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from kreisel.errors import LibraryError

FILE = {"darwin": "libkernels.dylib", "win32": "kernels.dll"}.get(sys.platform, "libkernels.so")
"""The library's name in this package's folder."""

VARIANTS = ("avx2", "baseline")
"""Sets of instructions: AVX2 with fused multiply-add, and what every processor of the platform has."""


def _load() -> ctypes.CDLL:
    path = Path(__file__).with_name(FILE)
    here = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        reason = f"is missing: {path}" if not path.is_file() else f"does not load: {error}"
        raise LibraryError(
            f"the compiled library {reason} ({here}); install the wheel for this platform, or, from a checkout, run "
            "`pip install -e .`, which compiles it with the C++ compiler it finds or with the package `ziglang`"
        ) from error


def _variant(library: ctypes.CDLL) -> str:
    """Return the variant for this processor, or the one that `KREISEL_INSTRUCTIONS` asks for."""
    fastest = VARIANTS[0] if library.kreisel_has_avx2() else VARIANTS[1]
    asked = os.environ.get("KREISEL_INSTRUCTIONS", fastest)
    if asked not in VARIANTS[VARIANTS.index(fastest) :]:
        raise LibraryError(
            f"KREISEL_INSTRUCTIONS is {asked!r}; this processor has {' and '.join(VARIANTS[VARIANTS.index(fastest) :])}"
        )
    return asked


_LIBRARY = _load()
variant = _variant(_LIBRARY)
"""The variant in use."""


def sources() -> str:
    """Return the hash of the sources the library was compiled from, as `hatch_build.py` computes it."""
    _LIBRARY.kreisel_sources.restype = ctypes.c_char_p
    return str(_LIBRARY.kreisel_sources().decode())


def function(name: str, *types: Any) -> Callable[..., None]:
    """Return a function of the library that takes arguments of these types.

    The interpreter lock is released while it runs. It raises a MemoryError if there is not enough memory, and a
    LibraryError if parts of the library do not fit together.
    """
    call = getattr(_LIBRARY, f"kreisel_{variant}_{name}")
    call.argtypes, call.restype, call.errcheck = types, ctypes.c_int, _check
    return call


def _check(status: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    del function, arguments
    if status == 1:
        raise MemoryError("not enough memory for the filter")
    if status != 0:
        raise LibraryError("features that are counted and features that are computed differ: see coefficients.hpp")
