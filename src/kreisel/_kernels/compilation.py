"""The decorators that fix how kernels are compiled, and where what was compiled is kept."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
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
    """Return the folder compiled kernels are kept in, or None, with a warning, where there is no safe one.

    It lies in `NUMBA_CACHE_DIR` or else in the user's cache. Its name contains a hash of the kernels' source: a kernel
    is compiled together with those it calls, so after a change to any of them all are compiled again.

    What is read from it is run as code. So it must be the user's own with mode 0700, and nobody else may be able to
    put another folder in its place.
    """
    source = hashlib.sha256()
    for file in sorted(Path(__file__).parent.glob("*.py")):
        source.update(file.read_bytes())
    name = f"kreisel-kernels-{source.hexdigest()[:16]}"
    refused = []
    for parent in _parents():
        try:
            folder = _own_folder(parent, name)
        except OSError as error:
            refused.append(f"{parent / name}: {error.strerror or error}")
            continue
        if os.access(folder, os.W_OK):
            return folder
        refused.append(f"{folder}: not writable")
    warnings.warn(
        f"compiled kernels are not kept, so every process takes half a minute to compile them ({'; '.join(refused)}); "
        "set NUMBA_CACHE_DIR to a folder of your own in a place that nobody else can write to",
        RuntimeWarning,
        stacklevel=2,
    )
    return None


def _own_folder(parent: Path, name: str) -> Path:
    """Return a folder with mode 0700, made where it is not there yet.

    Raises
    ------
    OSError
        If it cannot be made, is not the user's own, or others may read it, write to it or replace it.
    """
    _make(parent)
    parent = parent.resolve(strict=True)
    folder = parent / name
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    if not hasattr(os, "getuid"):
        return folder
    _check_own(folder)
    root = Path(folder.anchor).stat().st_uid  # in a container's user namespace not 0
    for above in (parent, *parent.parents):
        facts = above.stat()
        if facts.st_uid not in (0, os.geteuid(), root):
            raise PermissionError(errno.EPERM, f"{above} belongs to user {facts.st_uid}")
        if facts.st_mode & 0o022 and not facts.st_mode & stat.S_ISVTX:
            raise PermissionError(errno.EPERM, f"{above} is writable by others (mode {stat.S_IMODE(facts.st_mode):o})")
    return folder


def _make(folder: Path) -> None:
    """Make a folder and those above it, each with mode 0700."""
    if folder.is_dir():
        return
    _make(folder.parent)
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)


def _check_own(folder: Path) -> None:
    facts = folder.lstat()
    if not stat.S_ISDIR(facts.st_mode):
        raise NotADirectoryError(errno.ENOTDIR, "is a link or a file, expected a folder")
    if facts.st_uid != os.geteuid():
        raise PermissionError(errno.EPERM, f"belongs to user {facts.st_uid}, expected {os.geteuid()}")
    if facts.st_mode & 0o777 != 0o700:
        raise PermissionError(errno.EPERM, f"has mode {facts.st_mode & 0o777:o}, expected 700: delete it")


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
