"""A recording that is followed for long: what is kept of it."""

from array import array

import numpy as np
import pytest

from kreisel.acquisition.tail import Rows, Tail, _Means
from kreisel.errors import RecordingError

STEP = 500_000  # ns


def rows(stamps, values):
    return Rows(None, 2, array("q", stamps.tolist()), ["imu"] * stamps.size, array("d", values.ravel().tolist()))


def in_pieces(means, stamps, values, cuts):
    out = [means.of(rows(s, v)) for s, v in zip(np.split(stamps, cuts), np.split(values, cuts), strict=True) if s.size]
    found = np.concatenate([np.array(part.stamps_ns, dtype=np.int64) for part in out])
    return found, np.concatenate([np.array(part.numbers).reshape(-1, 2) for part in out])


@pytest.mark.parametrize("cuts", [[], [1, 2, 150, 151, 700], list(range(7, 1000, 7))])
def test_readings_of_a_fast_imu_are_averaged_wherever_they_are_cut(cuts):
    stamps = 10**9 + STEP * np.arange(1000)
    values = np.random.default_rng(1).normal(size=(1000, 2))
    found, numbers = in_pieces(_Means(), stamps, values, cuts)
    assert found == pytest.approx(stamps.reshape(-1, 4).mean(axis=1))
    assert numbers == pytest.approx(values.reshape(-1, 4, 2).mean(axis=1), abs=1e-15)


def test_no_mean_reaches_across_a_gap():
    stamps = 10**9 + STEP * np.delete(np.arange(1010), np.arange(502, 512))
    values = np.column_stack([stamps * 1e-9, np.zeros(stamps.size)])
    found, numbers = in_pieces(_Means(), stamps, values, [300, 600])
    before, after = stamps[:500].reshape(-1, 4), stamps[502:998].reshape(-1, 4)
    assert found == pytest.approx(np.concatenate([before, after]).mean(axis=1))
    assert numbers[:, 0] == pytest.approx(1e-9 * found, abs=1e-12)


def test_a_slow_imu_is_kept_as_it_is():
    stamps = 10**9 + 5_000_000 * np.arange(300)
    values = np.random.default_rng(1).normal(size=(300, 2))
    means = _Means()
    found, numbers = in_pieces(means, stamps, values, [10, 200])
    assert means.group == 1
    assert np.array_equal(found, stamps)
    assert np.array_equal(numbers, values)


def test_a_file_that_is_replaced_is_not_read_on(tmp_path):
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / name).write_bytes(b"\x89MCAP0\r\n")
    tail = Tail(tmp_path / "a.mcap")
    assert tail.read() == {}
    assert tail.read() == {}
    (tmp_path / "b.mcap").replace(tmp_path / "a.mcap")
    with pytest.raises(RecordingError, match=r"a\.mcap: was replaced by another file while it was read; begin again"):
        tail.read()


def test_a_file_that_becomes_shorter_is_not_read_on(tmp_path):
    """As where it is written anew in place: reading on would wait for ever."""
    file = tmp_path / "a.mcap"
    file.write_bytes(b"\x89MCAP0\r\n")
    tail = Tail(file)
    assert tail.read() == {}
    file.write_bytes(b"\x89MCA")
    with pytest.raises(RecordingError, match=r"a\.mcap: became shorter while it was read \(4 bytes, 8 were read\)"):
        tail.read()
