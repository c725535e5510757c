"""Large arrays in unlinked files instead of memory: the system writes their pages out and reads them back as needed.

What a process has looked at of such an array counts as its memory until it is released; nothing is lost by that.
"""

from __future__ import annotations

import mmap
import os
import tempfile
import weakref
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

LARGE = 1 << 26
"""Bytes from which an array is worth a file."""

_mapped: list[weakref.ref[mmap.mmap]] = []


def room(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Return an array that is not set; in a file if it is large, and the disk has room for all of it."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    if size < LARGE or not hasattr(os, "posix_fallocate"):
        return np.empty(shape, dtype)
    try:
        with tempfile.TemporaryFile() as file:
            os.posix_fallocate(file.fileno(), 0, size)  # a disk that is full later would end the process
            mapping = mmap.mmap(file.fileno(), size)
    except OSError:
        return np.empty(shape, dtype)
    _mapped.append(weakref.ref(mapping))
    return np.frombuffer(mapping, dtype).reshape(shape)


def release() -> None:
    """Give back the pages of all such arrays that have been looked at."""
    for reference in list(_mapped):
        mapping = reference()
        if mapping is None:
            _mapped.remove(reference)
        else:
            mapping.madvise(mmap.MADV_DONTNEED)
