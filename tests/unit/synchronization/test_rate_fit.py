from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import SynchronizationError
from kreisel.inertial.readings import Readings
from kreisel.recording.recording import Recording
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.fits import RateFit
from kreisel.synchronization.rate_fit import CLOCK_DRIFT_PARTS, LinearFit, check_overlap, explained_share, fit_rates

from ...small_cell import Truth, simulate

START = 0.05
"""IMU seconds of the first pose."""


@cache
def simulated() -> tuple[Truth, Recording]:
    return simulate(np.random.default_rng(1), 40.0, Path("run"))


def readings_of(r: Recording, segments: tuple[tuple[int, int], ...] | None = None) -> Readings:
    whole = ((0, r.imu.stamps_ns.size - 1),)
    return Readings(r.imu.seconds, r.imu.rates, r.imu.accelerations, segments or whole)


def fit(r: Recording, segments: tuple[tuple[int, int], ...] | None = None, start: float = START + 0.05) -> RateFit:
    readings = readings_of(r, segments)
    return fit_rates(readings, LinearFit.of(readings, r.reference.seconds, r.reference.quaternions, Clock(start)))


def test_gyros_and_clock_are_found_from_a_tenth_of_a_second_off() -> None:
    truth, r = simulated()
    found = fit(r)
    assert np.abs((found.K_omega - truth.sensors.K_omega) / found.K_omega_sd).max() < 4.0
    assert found.clock.start == pytest.approx(START, abs=4.0 * found.clock.start_sd)
    assert found.clock.skew == pytest.approx(0.0, abs=4.0 * found.clock.skew_sd)
    assert found.explained > 0.9999


def test_steady_clocks_do_not_wander() -> None:
    found = fit(simulated()[1])
    assert found.clock_drift.shape == (CLOCK_DRIFT_PARTS, 3)
    assert np.abs(found.clock_drift[:, 1] / found.clock_drift[:, 2]).max() < 4.0


def test_a_clock_that_leaps_wanders() -> None:
    _, r = simulated()
    late = r.reference.seconds > 20.0
    leapt = replace(r.reference, stamps_ns=r.reference.stamps_ns + 20_000_000 * late)
    wander = fit(replace(r, reference=leapt)).clock_drift
    assert np.abs(wander[:, 1]).max() > 5e-3
    assert np.abs(wander[:, 1] / wander[:, 2]).max() > 10.0


def test_nothing_is_compared_across_a_gap() -> None:
    truth, r = simulated()
    keep = np.r_[:3400, 3500:8001]  # half a second, in a move
    imu = replace(
        r.imu, stamps_ns=r.imu.stamps_ns[keep], rates=r.imu.rates[keep], accelerations=r.imu.accelerations[keep]
    )
    found = fit(replace(r, imu=imu), ((0, 3399), (3400, keep.size - 1)))
    assert np.abs((found.K_omega - truth.sensors.K_omega) / found.K_omega_sd).max() < 4.0
    assert found.clock.start == pytest.approx(START, abs=4.0 * found.clock.start_sd)


def test_an_axis_that_never_turns_is_told_by_its_deviation() -> None:
    _, r = simulated()
    flat = replace(r, imu=replace(r.imu, rates=r.imu.rates * [1.0, 1.0, 1e-6]))
    assert fit(flat).K_omega_sd[:, 2].max() > 1.0


@pytest.mark.parametrize("start", [-60.0, 60.0])
def test_too_little_in_common_is_refused(start: float) -> None:
    _, r = simulated()
    with pytest.raises(SynchronizationError, match=r"run/pose0/data.csv: overlaps .* by 0\.0 s, in 0 rotations"):
        check_overlap(readings_of(r), r.reference, Clock(start))


def test_the_share_explained_needs_no_knowledge_of_the_mount() -> None:
    _, r = simulated()
    turned = replace(r.imu, rates=r.imu.rates[:, [1, 2, 0]])
    q = r.reference.quaternions
    assert explained_share(readings_of(replace(r, imu=turned)), r.reference.seconds, q, Clock(START)) > 0.999
    assert explained_share(readings_of(r), r.reference.seconds, q[::-1], Clock(START)) < 0.8
