"""Arrays in files: what is written stays after it is released, and the file goes with the array."""

import gc
import os

import numpy as np
import pytest

from kreisel import spill

pytestmark = pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="this system has memory only")


def resident():
    with open("/proc/self/statm") as file:  # noqa: PTH123
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_released_pages_keep_their_numbers():
    array = spill.room((1 << 24, 1), np.float64)
    array[:, 0] = np.arange(1 << 24)
    before = resident()
    spill.release()
    assert resident() < before - 100e6
    assert array[12345, 0] == 12345.0
    part = array[5:7]
    del array
    gc.collect()
    spill.release()
    np.testing.assert_array_equal(part[:, 0], [5.0, 6.0])


def test_a_file_is_given_back_with_its_array():
    known = len(spill._mapped)
    array = spill.room((1 << 23,), np.float64)
    assert len(spill._mapped) == known + 1
    del array
    gc.collect()
    spill.release()
    assert len(spill._mapped) <= known


def test_small_arrays_and_full_disks_take_memory(monkeypatch):
    assert spill.room((3, 2), np.float64).base is None

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    assert spill.room((1 << 24,), np.int64).base is None
