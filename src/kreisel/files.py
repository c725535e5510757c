"""Files read only as far as they may be long."""

from __future__ import annotations

import errno
from pathlib import Path

LARGEST_TEXT = 1 << 24
"""Bytes of a description, a table of settings or a result, far above what there is: 16 MiB."""

LARGEST_YAML = 1 << 19
"""Bytes of a file in YAML, which takes a thousand times as much memory to read."""


def read_bytes(path: Path, most: int = LARGEST_TEXT) -> bytes:
    """Return the content of a file of at most so many bytes.

    Raises
    ------
    OSError
        If it cannot be read, or is longer: no more than `most` is taken into memory.
    """
    with path.open("rb") as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"longer than {most} bytes, the most kreisel reads of such a file", str(path))
    return data


def read_text(path: Path, most: int = LARGEST_TEXT) -> str:
    """Return the text of a UTF-8 file of at most so many bytes, without the mark some editors put first.

    Raises
    ------
    OSError
        If it cannot be read, or is longer.
    UnicodeDecodeError
        If it is not UTF-8.
    """
    return read_bytes(path, most).decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
