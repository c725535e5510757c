"""Files read only as far as they may be long, and files written that take the place of others together."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

MAX_TEXT = 1 << 24
"""Bytes of a description, a table of settings or a result, far above what there is: 16 MiB."""

MAX_YAML = 1 << 19
"""Bytes of a file in YAML, which takes a thousand times as much memory to read."""


def read_bytes(path: Path, most: int = MAX_TEXT) -> bytes:
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


def read_text(path: Path, most: int = MAX_TEXT) -> str:
    """Return the text of a UTF-8 file of at most so many bytes, without the mark some editors put first.

    Raises
    ------
    OSError
        If it cannot be read, or is longer.
    UnicodeDecodeError
        If it is not UTF-8.
    """
    return read_bytes(path, most).decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")


_WRITING, _WRITTEN, _MOVING = ".kreisel-writing", ".kreisel-written", ".kreisel-moving"


@contextmanager
def replaced_together(folder: Path, names: Collection[str]) -> Iterator[Path]:
    """Yield an empty folder for new files, which take the place of those of certain names once the block has ended.

    However it is interrupted, files of before and new ones never stand side by side: until all new ones are whole those
    of before stay; then these are removed, and the new ones moved in. Where that was cut short, `finish_replacing`
    goes on. Files of other names stay as they are.

    Parameters
    ----------
    folder
        Made where it is not there.
    names
        Files that belong together; of those, none of before is left.

    Raises
    ------
    OSError
        If something cannot be written; what was there before is kept then.
    """
    folder.mkdir(parents=True, exist_ok=True)
    finish_replacing(folder, names)
    for name in names:
        if (folder / name).is_dir():
            raise IsADirectoryError(errno.EISDIR, "is a folder, where a file is to be written", str(folder / name))
    shutil.rmtree(folder / _WRITING, ignore_errors=True)  # of a run that was killed
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
    """Go on where `replaced_together` was cut short once all was written."""
    written, moving = folder / _WRITTEN, folder / _MOVING
    if written.is_dir():
        for name in names:
            (folder / name).unlink(missing_ok=True)
        written.rename(moving)
    if moving.is_dir():
        for file in moving.iterdir():
            file.rename(folder / file.name)
        moving.rmdir()
