"""The compiled library: where it lies, which instructions of the processor it uses, how its functions are called."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import sys
from collections.abc import Callable, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any, cast

from kreisel._kernels.views import LANES, Pointer, described
from kreisel.errors import LibraryError

FILE = {"darwin": "libkernels.dylib", "win32": "kernels.dll"}.get(sys.platform, "libkernels.so")
"""The library's name in this package's folder."""

VARIANTS = ("avx2", "baseline")
"""Sets of instructions: AVX2 with fused multiply-add, and what every processor of the platform has."""


_AGAIN = "install kreisel again, or, from a checkout, run `pip install -e .`, which compiles it"


class Library:
    """A compiled library: its functions for this processor, and what it says of itself.

    Attributes
    ----------
    variant
        The set of instructions in use.
    sources
        Hash of the sources it was compiled from.
    """

    def __init__(self, path: Path) -> None:
        """Load a library; raise LibraryError where it is missing, does not load, or is older than this package."""
        self._loaded = _load(path)
        self.variant = _variant(self._loaded)
        self._loaded.kreisel_sources.restype = ctypes.c_char_p
        self.sources = str(self._loaded.kreisel_sources().decode())
        self._layout = self._described()
        self.check_count("lanes", LANES)

    def function(self, name: str, *types: Any) -> Callable[..., None]:
        """Return a function of the library that takes arguments of these types.

        The interpreter lock is released while it runs. It raises a MemoryError if there is not enough memory, and a
        LibraryError if parts of the library do not fit together.

        Raises
        ------
        LibraryError
            If a structure has other fields than the library's, or in another order.
        """
        for kind in types:
            for structure in kind.structures if isinstance(kind, Pointer) else []:
                self._check_structure(structure)
        call = getattr(self._loaded, f"kreisel_{self.variant}_{name}")
        call.argtypes, call.restype, call.errcheck = types, ctypes.c_int, _check
        return cast("Callable[..., None]", call)

    def order(self, name: str) -> dict[str, int]:
        """Return the places of numbers in an array that the library has an order for, by name."""
        places: dict[str, int] = {}
        for text in self._layout["order", name].split(", "):
            number, _, place = text.lower().partition(" = ")
            places[number] = int(place) if place else len(places)
        return places

    def check_count(self, name: str, own: int) -> None:
        """Raise a LibraryError where the library is made for another number."""
        if (theirs := int(self._layout["count", name])) != own:
            raise LibraryError(f"{_NOT_THIS}: it is made for {theirs} {name}, expected {own}; {_AGAIN}")

    def check_order(self, name: str, own: Mapping[str, int]) -> None:
        """Compare an order with the places that numbers have here, by name; -1 where any place will do.

        Raises
        ------
        LibraryError
            If the library has others; the message names the first.
        """
        for number, place in self.order(name).items():
            if own.get(number) not in (place, -1):
                here = f"place {own[number]}" if number in own else "nothing of this name"
                raise LibraryError(f"{_NOT_THIS}: {name} has {number} at {place}, expected {here}; {_AGAIN}")

    def _described(self) -> dict[tuple[str, str], str]:
        """Return what the library says of its structures and orders, by kind and name: see `layout.hpp`."""
        try:
            tell = getattr(self._loaded, f"kreisel_{self.variant}_layout")
        except AttributeError as error:
            raise LibraryError(f"the compiled library is older than this package; {_AGAIN}") from error
        tell.restype = ctypes.c_char_p
        lines = [line.split(":", 1) for line in tell().decode().splitlines()]
        heads = [(head.split(), text.strip()) for head, text in lines]
        return {(head[0], head[1]): " ".join([*head[2:], text]).strip() for head, text in heads}

    def _check_structure(self, structure: type[ctypes.Structure]) -> None:
        """Raise a LibraryError that names the first field in which a structure differs from the library's of its name.

        Structures that the library does not describe are those of its parts, which tests call.
        """
        theirs, own = self._layout.get(("struct", structure.__name__)), described(structure)
        if theirs is None or theirs == own:
            return
        (size, _, here), (other, _, there) = own.partition(" "), theirs.partition(" ")
        pairs = zip_longest(here.split(", "), there.split(", "), fillvalue="nothing")
        wanted, given = next(((a, b) for a, b in pairs if a != b), (f"{size} bytes", f"{other} bytes"))
        raise LibraryError(
            f"{_NOT_THIS}: {structure.__name__} has {given}, expected {wanted} (field, place, type); {_AGAIN}"
        )


_NOT_THIS = "the compiled library does not fit this package"


def _load(path: Path) -> ctypes.CDLL:
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


def source_hash(folder: Path) -> str:
    """Return the hash of sources in a folder, as `hatch_build.py` computes it."""
    return hashlib.sha256(b"".join(f.read_bytes() for f in sorted(folder.glob("*.?pp")))).hexdigest()[:16]


def check_sources(library: str, folder: Path) -> None:
    """Compare the library with its sources, where they are there, as in a checkout.

    Raises
    ------
    LibraryError
        If it was compiled from others.
    """
    if (folder / "exports.cpp").is_file() and (wanted := source_hash(folder)) != library:
        raise LibraryError(
            f"the compiled library is older than its sources: it was compiled from {library}, {folder} holds {wanted}; "
            f"{_AGAIN}"
        )


def _check(status: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    del function, arguments
    if status == 1:
        raise MemoryError("not enough memory for the filter")
    if status != 0:
        raise LibraryError("features that are counted and features that are computed differ: see coefficients.hpp")


LIBRARY = Library(Path(__file__).with_name(FILE))
"""That of this package."""

check_sources(LIBRARY.sources, Path(__file__).resolve().parents[2] / "kernels")
variant = LIBRARY.variant
"""The set of instructions in use."""

function, order, check_count, check_order = LIBRARY.function, LIBRARY.order, LIBRARY.check_count, LIBRARY.check_order
