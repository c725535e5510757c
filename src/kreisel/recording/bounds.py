"""Compressed data taken out only as far as they may be long: a few bytes can stand for gigabytes."""

from __future__ import annotations

import bz2
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import lz4.frame
import zstandard

LARGEST_CHUNK = 1 << 26
"""Bytes of one chunk or message once it is taken out: 64 MiB; recorders write chunks of 1 to 4 MiB."""

MOST_TIMES = 100
"""How many times larger than its file the messages of a recording may be; readings shrink by ten at most."""

_OF_A_MESSAGE = 128  # bytes Python takes for each beside its content


class TooLargeError(ValueError):
    """More than may be taken into memory."""


class Budget:
    """How much may still be kept of a file.

    Parameters
    ----------
    size
        Bytes of the file.
    """

    def __init__(self, size: int) -> None:
        self._most = self._left = LARGEST_CHUNK + MOST_TIMES * size

    def take(self, size: int) -> None:
        """Count a message of so many bytes.

        Raises
        ------
        TooLargeError
            If the messages are more than they can be.
        """
        self._left -= size + _OF_A_MESSAGE
        if self._left < 0:
            raise TooLargeError(
                f"messages of more than {self._most} bytes, over {MOST_TIMES} times the file: more than real ones"
            )


def within(data: bytes, most: int = LARGEST_CHUNK) -> bytes:
    """Return data of at most so many bytes; `TooLargeError` if it is more."""
    if len(data) > most:
        raise TooLargeError(f"more than {most} bytes, the most kreisel reads at once")
    return data


def unzstd(data: bytes, most: int = LARGEST_CHUNK) -> bytes:
    """Return what a zstd frame holds, at most so many bytes; `TooLargeError` if it is more."""
    with zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK).stream_reader(BytesIO(data)) as reader:
        return within(reader.read(most + 1), most)


def unlz4(data: bytes, most: int = LARGEST_CHUNK) -> bytes:
    """Return what an lz4 frame holds; see `unzstd`."""
    return within(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most + 1), most)


def unbz2(data: bytes, most: int = LARGEST_CHUNK) -> bytes:
    """Return what a bz2 stream holds; see `unzstd`."""
    return within(bz2.BZ2Decompressor().decompress(data, max_length=most + 1), most)


_TAKE_OUT: dict[str, Callable[[bytes, int], bytes]] = {"zstd": unzstd, "lz4": unlz4, "": within}


def chunk_content(data: bytes, compression: str, size: int, crc: int) -> bytes:
    """Return the content of an MCAP chunk.

    Parameters
    ----------
    size, crc
        Bytes it is said to have, and their CRC-32; 0 where there is none.

    Raises
    ------
    ValueError
        If it is damaged, of another size, or larger than `LARGEST_CHUNK`.
    """
    if compression not in _TAKE_OUT:
        raise ValueError(f"compressed by '{compression[:20]}', expected zstd, lz4 or nothing")
    if size > LARGEST_CHUNK:
        raise TooLargeError(f"said to have {size} bytes once taken out, expected {LARGEST_CHUNK} at most")
    content = _TAKE_OUT[compression](data, size)
    if len(content) != size:
        raise ValueError(f"{len(content)} bytes, expected {size}")
    if crc and zlib.crc32(content) != crc:
        raise ValueError("its checksum does not fit")
    return content


def check_file(path: Path) -> None:
    """Raise an error for a zstd file that would become more than it can be, without keeping any of it.

    Raises
    ------
    TooLargeError
        If so.
    """
    left = LARGEST_CHUNK + MOST_TIMES * path.stat().st_size
    with path.open("rb") as file:
        reader = zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK).stream_reader(file, read_across_frames=True)
        while part := reader.read(1 << 20):
            left -= len(part)
            if left < 0:
                raise TooLargeError(f"becomes more than {MOST_TIMES} times as large: more than a real one")
