"""The reference's assumed noise: what is stated, defaults, rounded stamps, and scatter drawn and found again."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.geometry.rotation import exp, multiply
from kreisel.model.assumed_noise import ReferenceNoise
from kreisel.model.standstill import Standstill
from kreisel.preparation.reference_noise import assumed_noise, stamp_resolution, white_noise, with_measured_jitter
from kreisel.recording.recording import ReferencePoses
from kreisel.recording.recording_settings import ReferenceTable
from kreisel.synchronization.clock import Clock

MS = 1_000_000
NOISE = ReferenceNoise(1e-3, 1e-3, 2e-4, 2e-4, 2e-5, 2e-5, 2e-4, 0.0)


def poses_at(stamps, p=None, q=None):
    return ReferencePoses("pose0", np.asarray(stamps, dtype=np.int64), p, q, Path("pose0/data.csv"))


def stated(reference=None, **table):
    """Return the noise assumed where this is stated of the reference."""
    own = ReferenceTable(**table)
    return assumed_noise(own, own.kind or "robot", EVEN if reference is None else reference)


EVEN = poses_at(np.arange(100) * 12 * MS + 17)


def test_what_is_stated_is_taken():
    table = {
        "position_sd": 3e-3, "orientation_sd": 4e-3, "standstill_position_sd": 5e-3, "standstill_orientation_sd": 6e-3,
    }  # fmt: skip
    noise = stated(kind="mocap", **table)
    assert (noise.position, noise.orientation) == (3e-3, 4e-3)
    # stated even where a standstill would be worse than the path
    assert (noise.standstill_position, noise.standstill_orientation) == (5e-3, 6e-3)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [(None, (1e-3, 1e-3, 2e-4, 2e-4)), ("robot", (1e-3, 1e-3, 2e-4, 2e-4)), ("mocap", (1e-3, 3e-3, 1e-3, 3e-3))],
)
def test_what_is_not_stated_is_that_of_the_kind(kind, expected):
    n = stated(kind=kind)
    assert (n.position, n.orientation, n.standstill_position, n.standstill_orientation) == expected
    assert (n.jitter_position, n.jitter_orientation) == pytest.approx((0.1 * expected[2], 0.1 * expected[3]))
    assert n.velocity == expected[2]
    assert n.stamp == 0.0


def test_a_reference_that_is_good_on_the_path_is_no_worse_at_standstill():
    n = stated(position_sd=5e-5, orientation_sd=6e-5)
    assert (n.standstill_position, n.standstill_orientation) == (5e-5, 6e-5)


def test_rounded_stamps_err_as_a_uniform_variable_does():
    exact = np.cumsum(np.random.default_rng(1).uniform(20e6, 30e6, 20_000))
    rounded = poses_at(np.round(exact / MS) * MS)
    error = (rounded.stamps_ns - exact) * 1e-9
    # the variance of n uniform errors scatters by sqrt(0.8 / n): 0.3 % of the deviation
    assert stated(rounded).stamp == pytest.approx(error.std(), rel=0.015)


@pytest.mark.parametrize("unit", [1, 4, 10])
def test_the_step_of_rounding_is_found_whatever_the_first_stamp_is(unit):
    exact = np.cumsum(np.random.default_rng(1).uniform(3.0, 8.0, 500)) * unit * MS
    stamps = np.round(exact / (unit * MS)) * unit * MS + 123_456
    assert stamp_resolution(poses_at(stamps)) == pytest.approx(unit * 1e-3, rel=1e-12)


@pytest.mark.parametrize(
    "steps",
    [
        np.full(200, 12 * MS),  # even steps are no sign of rounding
        np.random.default_rng(1).integers(9_000_000, 15_000_000, 200),  # full resolution
        np.random.default_rng(1).integers(90, 150, 200) * 100_000,  # tenths of a millisecond are good enough
        np.random.default_rng(1).integers(1, 4, 200) * 10 * MS,  # multiples of the step from frames that were lost
    ],
    ids=["even", "nanoseconds", "tenths", "lost frames"],
)
def test_other_stamps_were_not_rounded(steps):
    assert stamp_resolution(poses_at(np.concatenate([[0], np.cumsum(steps)]))) == 0.0


COUNT = 400
"""Poses in each standstill: a deviation of 3 axes in them scatters by 1 / sqrt(2 * 1200) = 2 %."""


def standing(scatter_p, scatter_q, stops=5):
    """Poses at stops, each elsewhere, with scatter; and the standstills, on a clock 10 s late."""
    rng = np.random.default_rng(7)
    t = np.arange(stops * COUNT) * 0.01
    number = np.arange(stops * COUNT) // COUNT
    p = (
        rng.normal(0.0, 1.0, (stops, 3))[number]
        + rng.normal(0.0, 1.0, (t.size, 3)) * np.asarray(scatter_p)[number, None]
    )
    turn = exp(rng.normal(0.0, 1.0, (stops, 3)))[number]
    q = multiply(turn, exp(rng.normal(0.0, 1.0, (t.size, 3)) * np.asarray(scatter_q)[number, None]))
    inside = tuple(Standstill(10.0 + 4.0 * k - 0.005, 10.0 + 4.0 * k + 3.995) for k in range(stops))
    return poses_at(np.round(t * 1e9), p, q), inside


def test_scatter_within_standstills_is_found():
    reference, standstills = standing([3e-4] * 5, [5e-3] * 5)
    found = with_measured_jitter(NOISE, reference, standstills, Clock(10.0))
    assert found.jitter_position == pytest.approx(3e-4, rel=0.08)
    assert found.jitter_orientation == pytest.approx(5e-3, rel=0.08)
    assert found.standstill_position == NOISE.standstill_position
    assert found.position == NOISE.position


def test_signs_of_quaternions_are_no_scatter():
    reference, standstills = standing([3e-4] * 5, [5e-3] * 5)
    signs = np.random.default_rng(8).choice([-1.0, 1.0], (5 * COUNT, 1))
    flipped = reference.with_quaternions(reference.quaternions * signs)
    plain, found = (with_measured_jitter(NOISE, r, standstills, Clock(10.0)) for r in (reference, flipped))
    assert found.jitter_orientation == pytest.approx(plain.jitter_orientation, rel=1e-9)


def test_one_standstill_that_shook_is_not_the_usual_one():
    reference, standstills = standing([3e-4, 3e-4, 0.05, 3e-4, 3e-4], [5e-3, 5e-3, 0.2, 5e-3, 5e-3])
    found = with_measured_jitter(NOISE, reference, standstills, Clock(10.0))
    assert found.jitter_position == pytest.approx(3e-4, rel=0.08)
    assert found.jitter_orientation == pytest.approx(5e-3, rel=0.08)


def test_less_scatter_than_assumed_changes_nothing():
    reference, standstills = standing([1e-6] * 5, [1e-6] * 5)
    assert with_measured_jitter(NOISE, reference, standstills, Clock(10.0)) == NOISE


def test_without_standstills_or_with_four_poses_in_each_nothing_is_measured():
    reference, standstills = standing([1.0] * 5, [1.0] * 5)
    assert with_measured_jitter(NOISE, reference, (), Clock(10.0)) == NOISE
    short = tuple(Standstill(s.start, s.start + 0.04) for s in standstills)
    assert with_measured_jitter(NOISE, reference, short, Clock(10.0)) == NOISE
    elsewhere = Clock(1000.0)
    assert with_measured_jitter(NOISE, reference, standstills, elsewhere) == NOISE


def test_what_a_reference_does_not_show_has_no_scatter():
    reference, standstills = standing([3e-4] * 5, [5e-3] * 5)
    only_p = poses_at(reference.stamps_ns, reference.positions)
    only_q = poses_at(reference.stamps_ns, None, reference.quaternions)
    assert with_measured_jitter(NOISE, only_p, standstills, Clock(10.0)).jitter_orientation == NOISE.jitter_orientation
    assert with_measured_jitter(NOISE, only_q, standstills, Clock(10.0)).jitter_position == NOISE.jitter_position


def moving(rate, noise, *, seconds=60.0, uneven=0.0, seed=4):
    """Return poses of a smooth motion of 0.2 m and 0.3 rad, with white noise of positions and orientations."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / rate)
    t = t + uneven / rate * rng.uniform(-0.5, 0.5, t.size)
    stamps = np.round(t * 1e9).astype(np.int64)
    phases = 2.0 * np.pi * stamps[:, None] * 1e-9 * np.array([0.31, 0.42, 0.55])
    p = 0.2 * np.sin(phases) + noise[0] * rng.standard_normal((t.size, 3))
    q = multiply(exp(0.3 * np.cos(phases)), exp(noise[1] * rng.standard_normal((t.size, 3))))
    return poses_at(stamps, p, q)


@pytest.mark.parametrize(
    ("rate", "noise"), [(5.0, (1e-2, 2e-2)), (30.0, (1e-2, 2e-2)), (30.0, (2e-3, 4e-3)), (200.0, (2e-3, 4e-3))]
)
def test_white_noise_is_found_in_motion(rate, noise):
    assert white_noise(moving(rate, noise)) == pytest.approx(noise, rel=0.12)


def test_steps_that_are_not_even_do_not_look_like_noise():
    assert white_noise(moving(30.0, (1e-3, 2e-3), uneven=0.8)) == pytest.approx((1e-3, 2e-3), rel=0.12)


@pytest.mark.parametrize("rate", [5.0, 30.0, 200.0])
def test_motion_alone_shows_no_noise(rate):
    assert max(white_noise(moving(rate, (0.0, 0.0)))) < 2e-5


def test_corners_of_a_path_do_not_look_like_noise():
    corners = np.interp(np.arange(0.0, 60.0, 0.07), np.arange(0.0, 61.0), np.arange(61) % 2 * 0.3)
    p = np.column_stack([corners, 0.5 * corners, np.zeros_like(corners)])
    assert white_noise(poses_at((np.arange(len(p)) * 70 * MS), p))[0] < 1e-5


def test_few_poses_show_no_noise():
    assert white_noise(moving(1.0, (1e-2, 2e-2))) == (0.0, 0.0)


def test_noise_that_is_much_larger_than_usual_replaces_the_default_alone():
    noisy = moving(30.0, (1e-2, 2e-2))
    found = stated(noisy, kind="mocap")
    assert (found.position, found.orientation) == pytest.approx((1e-2, 2e-2), rel=0.1)
    assert (found.standstill_position, found.standstill_orientation) == (1e-3, 3e-3)
    own = stated(noisy, kind="mocap", position_sd=1e-3, orientation_sd=2e-3)
    assert (own.position, own.orientation) == (1e-3, 2e-3)
    assert stated(moving(30.0, (2e-3, 6e-3)), kind="mocap").position == 1e-3
