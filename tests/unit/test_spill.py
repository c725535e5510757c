"""Arrays in files: what is written stays after it is released, and the file goes with the array."""

import gc
import os
import time
from pathlib import Path

import numpy as np
import pytest

from kreisel import spill
from kreisel.memory import releasing_memory

pytestmark = pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="this system has memory only")


def resident():
    """Return the bytes of unlinked files that are in memory, from the page tables."""
    total, unlinked = 0, False
    for line in Path("/proc/self/smaps").read_text(encoding="utf-8").splitlines():
        if "-" in line.split(" ", 1)[0]:
            unlinked = line.endswith("(deleted)")
        elif unlinked and line.startswith("Rss:"):
            total += 1024 * int(line.split()[1])
    return total


def test_released_pages_keep_their_numbers():
    array = spill.room((1 << 24, 1), np.float64)
    array[:, 0] = np.arange(1 << 24)
    before = resident()
    spill.release()
    assert before > 100e6
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


def test_pages_are_released_while_a_body_runs():
    array = spill.room((1 << 24,), np.float64)
    with releasing_memory():
        array[:] = 1.0
        end = time.monotonic() + 10.0
        while resident() > 100e6 and time.monotonic() < end:
            time.sleep(0.02)
    assert resident() < 100e6
    assert array[12345] == 1.0
