"""Decompression of limited size: a few compressed bytes can expand to gigabytes."""

from __future__ import annotations

import bz2
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path

import lz4.frame
import zstandard
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1.reader import decompressors
from rosbags.rosbag2 import Reader as Ros2Reader

from kreisel.files import MAX_YAML, read_text
from kreisel.formats.budget import MAX_CHUNK, MAX_EXPANSION, TooLargeError


def within(data: bytes, most: int = MAX_CHUNK) -> bytes:
    """Return data of at most `most` bytes; raise `TooLargeError` if it is more."""
    if len(data) > most:
        raise TooLargeError(f"more than {most} bytes, the most kreisel reads at once")
    return data


def unzstd(data: bytes, most: int = MAX_CHUNK) -> bytes:
    """Return the content of a zstd frame, at most `most` bytes; raise `TooLargeError` if it is more."""
    with zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK).stream_reader(BytesIO(data)) as reader:
        return within(reader.read(most + 1), most)


def unlz4(data: bytes, most: int = MAX_CHUNK) -> bytes:
    """Return the content of an lz4 frame; see `unzstd`."""
    return within(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most + 1), most)


def unbz2(data: bytes, most: int = MAX_CHUNK) -> bytes:
    """Return the content of a bz2 stream; see `unzstd`."""
    return within(bz2.BZ2Decompressor().decompress(data, max_length=most + 1), most)


_TAKE_OUT: dict[str, Callable[[bytes, int], bytes]] = {"zstd": unzstd, "lz4": unlz4, "": within}


def chunk_content(data: bytes, compression: str, size: int, crc: int) -> bytes:
    """Return the content of an MCAP chunk.

    Parameters
    ----------
    size, crc
        Stated size of the content in bytes, and its CRC-32; 0 where there is none.

    Raises
    ------
    ValueError
        If it is damaged, of another size, or larger than `MAX_CHUNK`.
    """
    if compression not in _TAKE_OUT:
        raise ValueError(f"compressed by '{compression[:20]}', expected zstd, lz4 or nothing")
    if size > MAX_CHUNK:
        raise TooLargeError(f"stated to have {size} bytes after decompression, expected {MAX_CHUNK} at most")
    content = _TAKE_OUT[compression](data, size)
    if len(content) != size:
        raise ValueError(f"{len(content)} bytes, expected {size}")
    if crc and zlib.crc32(content) != crc:
        raise ValueError("its checksum is wrong")
    return content


def unpacked(path: Path) -> Iterator[bytes]:
    """Yield the content of a zstd file in chunks.

    Raises
    ------
    TooLargeError
        Once the content is larger than that of a real file can be.
    """
    left = MAX_CHUNK + MAX_EXPANSION * path.stat().st_size
    with path.open("rb") as file:
        reader = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK).stream_reader(file, read_across_frames=True)
        while part := reader.read(1 << 20):
            left -= len(part)
            if left < 0:
                raise TooLargeError(
                    f"{path.name} decompresses to more than {MAX_EXPANSION} times its size: more than a real one"
                )
            yield part


def unpack(file: Path, target: Path) -> Path:
    """Return the file that a compressed one is unpacked into."""
    with target.open("wb") as stream:
        for part in unpacked(file):
            stream.write(part)
    return target


def check_files(folder: Path) -> None:
    """Raise an error for files of a bag that are too large to decompress, before the library does so."""
    if (folder / "metadata.yaml").is_file():
        read_text(folder / "metadata.yaml", MAX_YAML)
        for file in folder.glob("*.zstd"):
            for _ in unpacked(file):
                pass


def bounded(reader: Ros1Reader | Ros2Reader) -> Callable[[bytes], bytes]:
    """Limit the decompression of a library's reader; return the function that decompresses its messages."""
    if isinstance(reader, Ros1Reader):
        out = {decompressors["bz2"]: unbz2, decompressors["lz4"]: unlz4}
        for place, chunk in reader.chunks.items():
            reader.chunks[place] = chunk._replace(decompressor=out.get(chunk.decompressor, chunk.decompressor))
    elif reader.compression_mode == "message":
        reader.storage.metadata = reader.storage.metadata._replace(compression_mode=None)
        return unzstd
    return bytes
