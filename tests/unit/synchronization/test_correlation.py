from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import SynchronizationError
from kreisel.recording.recording import ImuSamples, Recording, ReferencePoses
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.correlation import correlate

from ...small_cell import simulate

TRUE_OFFSET = 0.0271


@cache
def simulated() -> Recording:
    return simulate(np.random.default_rng(1), 40.0, Path("run"))[1]


def samples(imu: ImuSamples, keep: object) -> ImuSamples:
    return replace(imu, stamps_ns=imu.stamps_ns[keep], rates=imu.rates[keep], accelerations=imu.accelerations[keep])


def offset(imu: ImuSamples, reference: ReferencePoses) -> float:
    clock = correlate(imu, reference).clock
    return clock.offset(int(imu.stamps_ns[0]), int(reference.stamps_ns[0]))


def test_clocks_go_there_and_back() -> None:
    clock, tau = Clock(1.5, -0.003), np.array([0.0, 1.0, 100.0])
    np.testing.assert_allclose(clock.imu_time(tau), [1.5, 2.497, 101.2])
    np.testing.assert_allclose(clock.reference_time(clock.imu_time(tau)), tau, atol=1e-13)
    assert clock.offset(5_000_000_000, 2_000_000_000) == pytest.approx(4.5)


def test_the_offset_is_found_to_a_hundredth_of_a_second() -> None:
    r = simulated()
    assert offset(r.imu, r.reference) == pytest.approx(TRUE_OFFSET, abs=0.01)


@pytest.mark.parametrize("shift", [-1e9, -30.0, 12.3, 1.7e9])
def test_clocks_of_any_origin(shift: float) -> None:
    r = simulated()
    reference = replace(r.reference, stamps_ns=r.reference.stamps_ns - round(shift * 1e9))
    assert offset(r.imu, reference) - shift == pytest.approx(TRUE_OFFSET, abs=0.01)


@pytest.mark.parametrize("skew", [-0.01, -0.003, 0.004, 0.01])
def test_clocks_of_other_rates(skew: float) -> None:
    r = simulated()
    stamps = r.reference.stamps_ns
    slower = stamps[0] + np.round((stamps - stamps[0]) / (1.0 + skew)).astype(np.int64)
    found = correlate(r.imu, replace(r.reference, stamps_ns=slower))
    assert found.clock.skew == pytest.approx(skew, abs=5e-4)
    assert found.coefficient > 0.99


@pytest.mark.parametrize(("first", "last", "low", "high"), [(0.0, 25.0, 8.0, 40.0), (10.0, 40.0, 0.0, 24.0)])
def test_recordings_that_overlap_in_part(first: float, last: float, low: float, high: float) -> None:
    """The whole of neither fits anywhere so well as the common part where it belongs."""
    r = simulated()
    imu = samples(r.imu, (r.imu.seconds >= first) & (r.imu.seconds <= last))
    reference = r.reference.part((r.reference.seconds >= low) & (r.reference.seconds <= high))
    assert offset(imu, reference) == pytest.approx(TRUE_OFFSET, abs=0.01)


@pytest.mark.parametrize("stream", ["imu", "reference"])
@pytest.mark.parametrize("gap", [(20.0, 20.5), (14.0, 24.0)])
def test_gaps_say_nothing(stream: str, gap: tuple[float, float]) -> None:
    r = simulated()
    imu, reference = r.imu, r.reference
    if stream == "imu":
        imu = samples(imu, (imu.seconds < gap[0]) | (imu.seconds > gap[1]))
    else:
        reference = reference.part((reference.seconds < gap[0]) | (reference.seconds > gap[1]))
    assert offset(imu, reference) == pytest.approx(TRUE_OFFSET, abs=0.01)
    assert correlate(imu, reference).coefficient > 0.999


@pytest.mark.parametrize("half", ["quaternions", "positions"])
def test_a_reference_at_rest_is_refused(half: str) -> None:
    r = simulated()
    still = {name: np.repeat(getattr(r.reference, name)[:1], r.reference.stamps_ns.size, axis=0) for name in
             ("quaternions", "positions")}  # fmt: skip
    still[half] = None
    with pytest.raises(SynchronizationError, match="does not move"):
        correlate(r.imu, replace(r.reference, **still))


def test_poses_that_are_recorded_less_often_at_rest() -> None:
    """Those at rest are the most, and the usual interval is theirs."""
    r = simulated()
    moving, rng = r.reference, np.random.default_rng(2)
    rest = 10**8 * np.arange(1, moving.stamps_ns.size + 100)
    stamps = np.concatenate([moving.stamps_ns, moving.stamps_ns[-1] + rest])
    p, q = (np.concatenate([x, np.repeat(x[-1:], rest.size, axis=0)]) for x in (moving.positions, moving.quaternions))
    reference = replace(moving, stamps_ns=stamps, positions=p, quaternions=q)
    assert reference.interval == pytest.approx(0.1)
    still = round(rest[-1] * 1e-9 / r.imu.interval)
    w, a = (
        np.vstack([x, x[-100:].mean(axis=0) + rng.normal(0.0, 1e-3, (still, 3))])
        for x in (r.imu.rates, r.imu.accelerations)
    )
    later = r.imu.stamps_ns[-1] + round(1e9 * r.imu.interval) * np.arange(1, still + 1)
    imu = replace(r.imu, stamps_ns=np.append(r.imu.stamps_ns, later), rates=w, accelerations=a)
    assert offset(imu, reference) == pytest.approx(TRUE_OFFSET, abs=0.03)


@pytest.mark.parametrize(("hertz", "steps"), [(10.0, 1.2), (20.0, 2.0)])
def test_seldom_positions_of_a_person_who_walks(hertz: float, steps: float) -> None:
    """Four positions take half a step or more; the sensor does not turn."""
    rng = np.random.default_rng(3)

    def walked(t: np.ndarray, order: int) -> np.ndarray:
        out = np.zeros((t.size, 3))
        strength = (np.array([0.02, 0.01, 0.04]), np.array([0.3, 0.4, 0.05]))
        for (size, rate), pace in zip(zip(strength, (steps, 0.11), strict=True), (0.4, 0.02), strict=True):
            phase = 2.0 * np.pi * (rate * t + pace * np.sin(0.3 * t) + pace * np.sin(0.07 * t))
            wave = size * np.sin(phase[:, None] + [0.0, 1.0, 2.0])
            out += wave if order == 0 else np.gradient(np.gradient(wave, t, axis=0), t, axis=0)
        return out

    t, tau = 0.005 * np.arange(24_000), np.arange(0.0, 119.0, 1.0 / hertz)
    force = walked(t, 2) + np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.02, (t.size, 3))
    imu = ImuSamples(np.round(1e9 * t).astype(np.int64), rng.normal(0.0, 1e-3, force.shape), force, Path("imu0"))
    stamps = 10**15 + np.round(1e9 * tau).astype(np.int64)
    positions = walked(tau + 0.4, 0) + rng.normal(0.0, 1e-3, (tau.size, 3))
    found = correlate(imu, ReferencePoses("pose0", stamps, positions, None, Path("pose0")))
    assert found.coefficient > 0.9
    assert found.clock.start == pytest.approx(0.4, abs=0.02)


def test_stamps_that_last_a_hundred_times_as_long_are_refused_at_once() -> None:
    r = simulated()
    stamps = 7 * 10**15 + 1000 * (r.reference.stamps_ns - r.reference.stamps_ns[0])
    with pytest.raises(
        SynchronizationError, match=r"the poses last 3.99e\+04 s, the readings 40 s, and by their stamps"
    ):
        correlate(r.imu, replace(r.reference, stamps_ns=stamps))


def test_what_has_nothing_in_common_is_refused_with_the_coefficient() -> None:
    r = simulated()
    noise = np.random.default_rng(4).normal(0.0, 0.3, r.imu.rates.shape)
    with pytest.raises(SynchronizationError, match=r"best correlation .* is -?0\.\d\d, expected 0\.6 or more") as error:
        correlate(replace(r.imu, rates=noise), r.reference)
    assert error.value.correlation < 0.6


def repeated() -> ImuSamples:
    """Return three times the same motion before the IMU."""
    imu = simulated().imu
    stamps = imu.stamps_ns[0] + int(np.median(np.diff(imu.stamps_ns))) * np.arange(3 * imu.stamps_ns.size)
    return replace(
        imu, stamps_ns=stamps, rates=np.tile(imu.rates, (3, 1)), accelerations=np.tile(imu.accelerations, (3, 1))
    )


@pytest.mark.parametrize("period", [0, 1, 2])
def test_of_a_motion_that_repeats_itself_the_period_by_the_stamps_is_taken(period: int) -> None:
    """Three times the same motion before the IMU, once before the reference."""
    r, imu = simulated(), repeated()
    later = replace(r.reference, stamps_ns=r.reference.stamps_ns + period * (imu.stamps_ns[-1] - imu.stamps_ns[0]) // 3)
    assert offset(imu, later) == pytest.approx(TRUE_OFFSET, abs=0.01)
    assert correlate(imu, later).periods == ()


def test_by_stamps_of_two_clocks_the_period_is_open() -> None:
    """Of three periods one is taken, and the two others are known."""
    r, imu = simulated(), repeated()
    period = 1e-9 * float(imu.stamps_ns[-1] - imu.stamps_ns[0]) / 3.0
    found = correlate(imu, replace(r.reference, stamps_ns=r.reference.stamps_ns - 10**12))
    places = np.sort([0.0, *found.periods]) - min(0.0, *found.periods)
    np.testing.assert_allclose(places, [0.0, period, 2.0 * period], atol=0.02)


def test_a_motion_that_does_not_repeat_itself_has_one_offset_whatever_the_stamps() -> None:
    r = simulated()
    assert correlate(r.imu, replace(r.reference, stamps_ns=r.reference.stamps_ns - 10**12)).periods == ()
