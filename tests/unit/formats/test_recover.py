"""What is kept of a damaged file, against the messages that were written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from kreisel.formats.mcap import McapWriter
from kreisel.formats.recover import recover

_CHUNKS, _EACH = 5, 20


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """Return a file of several chunks, the first of which holds the definitions."""
    path = tmp_path / "whole.mcap"
    values = np.random.default_rng(1).normal(size=(_CHUNKS * _EACH, 6))
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        for at, row in enumerate(values):
            writer.add_imu(at * 10**7, row[:3], row[3:])
            if at % _EACH == _EACH - 1:
                writer.flush()
        writer.finish()
    return path


def _chunks(path: Path) -> list[tuple[int, int]]:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return [(index.chunk_start_offset, index.chunk_length) for index in summary.chunk_indexes]


def test_a_damaged_first_chunk_takes_its_own_messages_alone(written: Path) -> None:
    content = bytearray(written.read_bytes())
    content[_chunks(written)[0][0] + 200] ^= 1
    written.write_bytes(content)

    found = recover(written)

    assert found.messages == {"/imu/data_raw": (_CHUNKS - 1) * _EACH}
    assert "is damaged, with 0.19 s of messages" in found.lost


@pytest.mark.parametrize("chunk", [1, 2])
def test_bytes_that_are_missing_take_one_chunk(written: Path, chunk: int) -> None:
    content = written.read_bytes()
    begin, length = _chunks(written)[chunk]
    written.write_bytes(content[: begin + length // 2] + content[begin + length // 2 + 300 :])

    found = recover(written)

    assert found.messages == {"/imu/data_raw": (_CHUNKS - 1) * _EACH}
    assert f"the chunk at byte {begin} is damaged" in found.lost


def test_garbage_between_chunks_takes_nothing(written: Path) -> None:
    content = written.read_bytes()
    begin, _ = _chunks(written)[2]
    written.write_bytes(content[:begin] + b"\xff" * 5000 + content[begin:])

    found = recover(written)

    assert found.messages == {"/imu/data_raw": _CHUNKS * _EACH}
    assert f"5000 bytes from byte {begin} on are lost" in found.lost
