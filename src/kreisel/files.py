"""Reading files of limited size, and replacing several files together."""

from __future__ import annotations

import errno
import os
import shutil
import tomllib
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

MAX_TEXT = 1 << 24
"""Largest size in bytes of a description, settings or a result, far above real ones: 16 MiB."""

MAX_YAML = 1 << 19
"""Largest size in bytes of a YAML file; reading it takes a thousand times as much memory."""


def read_bytes(path: Path, most: int = MAX_TEXT) -> bytes:
    """Return the content of a file of at most `most` bytes.

    Raises
    ------
    OSError
        If it cannot be read, is longer (no more than `most` is taken into memory), or is no regular file: reading a
        pipe could wait for ever.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    with path.open("rb") as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"longer than {most} bytes, the most kreisel reads of such a file", str(path))
    return data


def read_text(path: Path, most: int = MAX_TEXT) -> str:
    """Return the text of a UTF-8 file of at most `most` bytes, without a byte order mark.

    Raises
    ------
    OSError
        If it cannot be read, or is longer.
    UnicodeDecodeError
        If it is not UTF-8.
    """
    return read_bytes(path, most).decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")


def read_toml(path: Path, example: str, error: Callable[[str], Exception], remedy: str = "") -> dict[str, Any]:
    """Return the content of a TOML file; where it cannot be, raise `error` of a message with the example, or a remedy.

    remedy: what to do if there is no such file, or none that can be read.
    """
    try:
        return tomllib.loads(read_text(path))
    except OSError as failed:
        raise error(f"cannot be read: {failed.strerror}{remedy}") from failed
    except UnicodeDecodeError as failed:
        raise error(f"not UTF-8 text (byte {failed.start}); save it in UTF-8") from failed
    except (ValueError, RecursionError) as failed:
        raise error(f"not valid TOML: {failed}; {example}") from failed


def open_fresh(path: Path, mode: int = 0o666) -> BinaryIO:
    """Return a new, empty file for writing; whatever had its name is removed, but a link is not followed.

    Raises
    ------
    OSError
        If it cannot be made, for example where a folder has this name.
    """
    path.unlink(missing_ok=True)
    return open(path, "xb", opener=lambda name, flags: os.open(name, flags, mode))  # exclusive: no link is followed


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, text as UTF-8, and its folder; a file of this name is replaced once all of it is written.

    Raises
    ------
    OSError
        If it cannot be written; it names the file. An old one is kept.
    """
    data = content.encode() if isinstance(content, str) else content
    path = path.resolve() if path.is_symlink() else path
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a folder, where a file is to be written", str(path))
    if path.exists() and not path.is_file():  # a pipe or a device
        path.write_bytes(data)
        return
    partial = path.with_name(f"{path.name}.partial")
    try:
        with open_fresh(partial) as file:
            file.write(data)
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from error


def open_lock(path: Path) -> BinaryIO:
    """Return a file to be locked, made if it does not exist; a link is not followed.

    Raises
    ------
    OSError
        If it cannot be opened.
    """
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
    return os.fdopen(os.open(path, flags, 0o666), "r+b")


_WRITING, _WRITTEN, _MOVING = ".kreisel-writing", ".kreisel-written", ".kreisel-moving"


@contextmanager
def replaced_together(folder: Path, names: Collection[str]) -> Iterator[Path]:
    """Yield an empty folder for new files, which replace the files of certain names once the block has ended.

    Old and new files are never mixed, even if the process is interrupted: the old files stay until all new ones are
    complete; then the old ones are removed and the new ones moved in. If this step was interrupted,
    `finish_replacing` completes it. Files of other names are not changed.

    Parameters
    ----------
    folder
        Made if it does not exist.
    names
        Files that belong together; old files of these names are removed.

    Raises
    ------
    OSError
        If something cannot be written; the old files are kept.
    """
    folder.mkdir(parents=True, exist_ok=True)
    finish_replacing(folder, names)
    for name in names:
        if (folder / name).is_dir():
            raise IsADirectoryError(errno.EISDIR, "is a folder, where a file is to be written", str(folder / name))
    shutil.rmtree(folder / _WRITING, ignore_errors=True)  # left by a run that was killed
    writing = folder / _WRITING
    writing.mkdir()
    try:
        yield writing
    except BaseException:
        shutil.rmtree(writing, ignore_errors=True)
        raise
    writing.rename(folder / _WRITTEN)
    finish_replacing(folder, names)


def finish_replacing(folder: Path, names: Collection[str]) -> None:
    """Complete a `replaced_together` that was interrupted after all files were written."""
    written, moving = folder / _WRITTEN, folder / _MOVING
    if written.is_dir():
        for name in names:
            (folder / name).unlink(missing_ok=True)
        written.rename(moving)
    if moving.is_dir():
        for file in moving.iterdir():
            file.rename(folder / file.name)
        moving.rmdir()


_MAX_ENTRIES = 100_000
"""Entries of a YAML document. Chosen: fifty times those of the result of an arm with joint angles, which has 2000; a
list of that length still takes little memory."""


def check_entries(document: object) -> None:
    """Raise an error for more entries than a result can have; a YAML alias can stand for any number of them.

    Raises
    ------
    ValueError
        With the largest number.
    """
    waiting, count = [document], 0
    while waiting:
        entry = waiting.pop()
        parts = list(entry.values() if isinstance(entry, dict) else entry) if isinstance(entry, dict | list) else []
        waiting += parts
        count += len(parts)
        if count > _MAX_ENTRIES:
            raise ValueError(f"more than {_MAX_ENTRIES} entries")
