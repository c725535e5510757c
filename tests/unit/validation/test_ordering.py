"""Packets that were swapped are sorted; a clock that was set is something else."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kreisel.validation.checks import check_streams
from kreisel.validation.ordering import order_of

from .test_checks import armed, message, recording, with_imu


def swapped(size: int, places: range, packet: int) -> np.ndarray:
    """Return indices of rows of which packets arrived after the next one."""
    order = np.arange(size)
    for k in places:
        order[k : k + 2 * packet] = np.roll(order[k : k + 2 * packet], packet)
    return order


@pytest.mark.parametrize("packet", [1, 5, 20])
def test_swapped_packets_are_sorted_in_all_streams(packet: int) -> None:
    r = armed()
    imu, poses, joints = r.imu, r.reference, r.joints
    a, b = swapped(imu.stamps_ns.size, range(600, 1200, 200), packet), swapped(960, range(500, 501), packet)
    broken = replace(
        with_imu(r, stamps_ns=imu.stamps_ns[a], rates=imu.rates[a], accelerations=imu.accelerations[a]),
        reference=poses.part(b),
        joints=joints.part(b),
    )
    got = check_streams(replace(broken, joints=replace(broken.joints, rows=None)))
    np.testing.assert_array_equal(got.imu.stamps_ns, imu.stamps_ns)
    np.testing.assert_array_equal(got.imu.rates, imu.rates)
    np.testing.assert_array_equal(got.reference.positions, poses.positions)
    np.testing.assert_array_equal(got.joints.angles, joints.angles)
    said = [str(w) for w in got.warnings]
    assert said[0] == (
        f"order: imu0: {6 * packet} of 2400 samples were not in the order of their stamps, in 3 places, the first at "
        "line 602; these rows were sorted"
    )
    assert [text.split(":")[1] for text in said] == [" imu0", " pose0", " joint0"]


@pytest.mark.parametrize("back", [0.1, 0.4, 0.6, 1.0, 1.3, 1.5, 2.0, 4.5, 10.0, 40.0, 300.0])
def test_a_clock_that_was_set_back_is_not_sorted(back: float) -> None:
    """More samples lie in the interval than it has room for."""
    r = recording()
    step = 5_000_000
    later = np.arange(r.imu.stamps_ns.size) >= 1200
    stamps = r.imu.stamps_ns - np.where(later, round((back + 1.0) * step), 0)
    assert order_of(stamps) is None
    assert "stamps run backwards" in message(with_imu(r, stamps_ns=stamps))


@pytest.mark.parametrize(("unit", "name"), [(1, "ns"), (1000, "us")])
def test_a_counter_that_begins_anew_is_recognised(unit: int, name: str) -> None:
    r = recording()
    later = np.arange(r.imu.stamps_ns.size) >= 1200
    wrapped = with_imu(r, stamps_ns=r.imu.stamps_ns - np.where(later, 2**32 * unit, 0))
    assert f"a counter of 32 bits begins anew: add 4294967296 {name} to all stamps" in message(wrapped)


def test_order_that_is_lost_altogether_is_not_sorted() -> None:
    r = recording()
    order = np.random.default_rng(1).permutation(r.imu.stamps_ns.size)
    assert order_of(r.imu.stamps_ns[order]) is None
    assert "stamps run backwards" in message(with_imu(r, stamps_ns=r.imu.stamps_ns[order]))


def test_lost_samples_and_jitter_beside_a_swap_do_not_matter() -> None:
    rng = np.random.default_rng(2)
    stamps = np.round(5e6 * (np.arange(2000) + rng.uniform(-0.3, 0.3, 2000))).astype(np.int64)
    stamps = np.delete(stamps, [501, 900, 901])
    order = swapped(stamps.size, range(500, 1000, 100), 1)
    np.testing.assert_array_equal(stamps[order][order_of(stamps[order])], stamps)


def test_parts_behind_a_restart_are_sorted_by_themselves() -> None:
    stamps = 5_000_000 * np.concatenate([np.arange(3000), np.arange(3000)])
    order = swapped(6000, range(1000, 5000, 900), 2)
    np.testing.assert_array_equal(stamps[order][order_of(stamps[order])], stamps)


@given(st.lists(st.integers(-(2**62), 2**62), min_size=0, max_size=40))
def test_any_stamps_are_sorted_or_left(stamps: list[int]) -> None:
    found = order_of(np.array(stamps, dtype=np.int64))
    if found is not None:
        assert sorted(found.tolist()) == list(range(len(stamps)))
