"""The decorators that fix how kernels are compiled, and where what was compiled is kept."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, cast

import llvmlite.binding
import numba

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Return the function compiled on first use, kept on disk, and free of the interpreter lock.

    Fused multiply-add is allowed; no other liberty is taken with the order of floating point operations.
    """
    return _compiled(function, {"contract"})


def reassociating_kernel(function: F) -> F:
    """Return the function compiled as `kernel` does, with sums in any order: for long sums of squares and products."""
    return _compiled(function, {"contract", "reassoc"})


def cache_folder() -> Path | None:
    """Return the folder compiled kernels are kept in, or None where none can be written.

    It lies in `NUMBA_CACHE_DIR` or else in the user's cache. Its name tells the kernels' source: a kernel is
    compiled together with those it calls, so a change to any of them makes all of them anew.
    """
    source = hashlib.sha256()
    for file in sorted(Path(__file__).parent.glob("*.py")):
        source.update(file.read_bytes())
    name = f"kreisel-kernels-{source.hexdigest()[:16]}"
    for parent in _parents():
        folder = parent / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return None


def _parents() -> list[Path]:
    """Return where the folder may lie, best first."""
    given, user = os.environ.get("NUMBA_CACHE_DIR"), os.environ.get("XDG_CACHE_HOME")
    if given:
        return [Path(given)]
    own = getattr(os, "getuid", lambda: "user")()
    temporary = Path(tempfile.gettempdir()) / f"kreisel-{own}"
    try:
        return [Path(user) if user else Path.home() / ".cache", temporary]
    except RuntimeError:  # no home: a container's nameless user
        return [temporary]


_FOLDER = cache_folder()
_kernels: list[Any] = []


def is_cold(function: Callable[..., object]) -> bool:
    """Return whether a kernel would be kept if it were compiled, but has not been."""
    return _FOLDER is not None and not any(_FOLDER.rglob(f"*.{function.__name__}-*.nbi"))


def share_compiled() -> float:
    """Return how many of all kernels are kept compiled, as a share; some are never needed."""
    return 0.0 if _FOLDER is None else min(1.0, len([*_FOLDER.rglob("*.nbi")]) / max(1, len(_kernels)))


def compile_for(function: Callable[..., object], *examples: object) -> None:
    """Compile a kernel for arguments of the examples' types, without calling it."""
    cast(Any, function).compile(tuple(cast(Any, numba).typeof(example) for example in examples))


_compiling = 0


@contextmanager
def _short_loops() -> Iterator[None]:
    """Leave loops of unknown length as they are in what is compiled meanwhile: columns are few.

    Unrolled, they take the compiler a fifth of its time, and gain nothing that could be measured.
    """
    global _compiling
    if not _compiling:
        llvmlite.binding.set_option("kreisel", "-unroll-runtime=false")
    _compiling += 1
    try:
        yield
    finally:
        _compiling -= 1
        if not _compiling:
            llvmlite.binding.set_option("kreisel", "-unroll-runtime=true")


def part_of_kernel(function: F) -> F:
    """Return the function for use in kernels alone, of which it becomes a part where it is called.

    What is called in one place is compiled there once, not by itself and in every kernel above as well.
    """
    return cast(F, numba.njit(inline="always", nogil=True, error_model="numpy", fastmath={"contract"})(function))


def _compiled(function: F, liberties: set[str]) -> F:
    config = cast(Any, numba.config)
    elsewhere, config.CACHE_DIR = config.CACHE_DIR, str(_FOLDER)
    try:
        compiled = cast(Any, numba.njit)(
            cache=_FOLDER is not None, nogil=True, error_model="numpy", fastmath=liberties, no_cfunc_wrapper=True
        )(function)
    finally:
        config.CACHE_DIR = elsewhere
    _kernels.append(compiled)
    compile_one = compiled.compile

    def compile_with_short_loops(signature: object) -> object:
        with _short_loops():
            return compile_one(signature)

    compiled.compile = compile_with_short_loops
    return cast(F, compiled)
