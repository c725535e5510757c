"""Rows of a stream before one that cannot be read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import RecordingError
from kreisel.formats.imu_lines import ImuLines

_HEADER = b"#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z\n"


def _row(number: int) -> bytes:
    return f"{number * 5_000_000},0.1,0.2,{number},0,0,9.8\n".encode()


@pytest.mark.parametrize("header", [_HEADER, _HEADER.lstrip(b"#")])
@pytest.mark.parametrize("bad", [b"7,abc\n", b"0,0,0,0,0,0,0\n", b"900000000,inf,0,0,0,0,9.8\n"])
def test_rows_before_an_unreadable_one_come_first(bad: bytes, header: bytes) -> None:
    lines = ImuLines(Path("stream"))
    good = b"".join(_row(number) for number in range(1, 41))

    found = lines.feed(header + good + bad + _row(300))

    assert found is not None
    np.testing.assert_array_equal(found.rates[:, 2], np.arange(1.0, 41.0))
    for call in (lambda: lines.feed(_row(301)), lines.close):
        with pytest.raises(RecordingError) as error:
            call()
        assert error.value.line == 42


def test_a_first_row_that_is_unreadable_is_named_at_once() -> None:
    with pytest.raises(RecordingError, match="line 2"):
        ImuLines(Path("stream")).feed(_HEADER + b"7,abc\n" + _row(1))


def test_columns_of_words_are_kept_as_they_are() -> None:
    lines = ImuLines(Path("-"))
    rows = lines.feed(_HEADER.replace(b"\n", b",frame\n") + b"10,1,2,3,4,5,6,imu\n20,1,2,3,4,5,6,7\n")
    assert rows is not None
    later = lines.feed(b"30,1,2,3,4,5,6,none\n")
    assert later is not None
    assert rows.others + later.others == [",imu", ",7", ",none"]
