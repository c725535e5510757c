"""Stamps of one stream: what is kept, what is dropped, and when a new part begins."""

import pytest

from kreisel.acquisition.streams import AGREEING, Stream
from kreisel.devices.events import Arrival
from kreisel.protocols.samples import ImuSample

STEP_NS = 4_000_000


def reading(stamp_ns, host_ns):
    return Arrival(ImuSample(stamp_ns, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)), host_ns)


def taken(stamps_ns):
    """Return the stream, the stamps that were kept with their part, and the notes."""
    stream, kept, notes = Stream(), [], []
    for k, stamp_ns in enumerate(stamps_ns):
        found, said = stream.take(reading(stamp_ns, k * STEP_NS))
        kept += [(one.sample.stamp_ns, stream.epoch) for one in found]
        notes += said
    return stream, kept, notes


def clock(start_ns, count, first=0):
    return [start_ns + (first + k) * STEP_NS for k in range(count)]


@pytest.mark.parametrize("odd", [1, AGREEING - 1])
@pytest.mark.parametrize("other_ns", [0, 900 * 10**9])
def test_a_few_odd_stamps_are_dropped(odd, other_ns):
    normal = 10 * 10**9
    stamps = [*clock(normal, 20), *clock(other_ns, odd), *clock(normal, 20, 20 + odd)]
    stream, kept, notes = taken(stamps)
    assert stream.epoch == 1
    assert kept == [(stamp, 1) for stamp in (*clock(normal, 20), *clock(normal, 20, 20 + odd))]
    assert stream.odd == odd
    assert notes == [f"readings dropped: stamps on another clock than those before and after; {odd} so far"]


def test_readings_that_agree_begin_a_new_part_with_the_first_of_them():
    stream, kept, notes = taken([*clock(10 * 10**9, 20), *clock(0, 30)])
    assert kept[20:] == [(stamp, 2) for stamp in clock(0, 30)]
    assert (stream.count, stream.odd, stream.late) == (50, 0, 0)
    assert len(notes) == 1
    assert "clock leapt by -10.080 s" in notes[0]


def test_readings_that_come_twice_do_not_keep_a_new_part_from_beginning():
    twice = [stamp for stamp in clock(0, 30) for _ in range(2)]
    stream, kept, _ = taken([*clock(10 * 10**9, 20), *twice])
    assert kept[20:] == [(stamp, 2) for stamp in clock(0, 30)]
    assert stream.late == 30


def test_odd_stamps_that_do_not_agree_begin_no_part():
    scattered = [(1 + (7 * k) % 5) * 100 * 10**9 for k in range(40)]
    stream, kept, notes = taken([*clock(10 * 10**9, 20), *scattered, *clock(10 * 10**9, 20, 60)])
    assert stream.epoch == 1
    assert len(kept) == 40
    assert stream.odd == 40
    assert len(notes) == 2  # the first, and the tenth


@pytest.mark.parametrize("wrap_ns", [2**32, 2**16 * 10**6, 2**32 * 10**3])
def test_a_counter_that_begins_again_at_zero_goes_on(wrap_ns):
    stamps = [stamp % wrap_ns for stamp in clock(wrap_ns - 30 * STEP_NS + 1, 2_000)]
    stream, kept, notes = taken(stamps)
    assert kept == [(stamp, 1) for stamp in clock(wrap_ns - 30 * STEP_NS + 1, 2_000)]
    assert (stream.epoch, stream.odd, stream.late, notes) == (1, 0, 0, [])


def test_a_counter_begins_again_as_often_as_it_likes():
    wrap_ns = 2**32
    stamps = clock(0, 3_000)
    _, kept, _ = taken([stamp % wrap_ns for stamp in stamps])
    assert stamps[-1] > 2 * wrap_ns
    assert kept == [(stamp, 1) for stamp in stamps]


@pytest.mark.parametrize("start_ns", [0, 400 * 10**6])
def test_a_restart_before_the_end_of_the_counter_is_one(start_ns):
    before = clock(2**32 * 1_000 - 60 * 10**9, 100)
    stream, _, notes = taken([*before, *clock(start_ns, 100)])
    assert stream.epoch == 2
    assert "clock leapt" in notes[0]


def test_after_a_restart_a_counter_begins_again_too():
    wrap_ns = 2**16 * 10**6
    stamps = clock(wrap_ns - 20 * STEP_NS, 40)
    stream, kept, _ = taken([*clock(500 * 10**9, 50), *(stamp % wrap_ns for stamp in stamps)])
    assert kept[50:] == [(stamp, 2) for stamp in stamps]
    assert stream.epoch == 2
