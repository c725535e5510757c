from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import RecordingError, SynchronizationError
from kreisel.geometry.rotation import apply, conjugate, exp, multiply
from kreisel.inertial.readings import Readings
from kreisel.recording.recording import Recording, ReferencePoses
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.conventions import acceleration_share, better_reading, checked_fit

from ...small_cell import simulate

CLOCK = Clock(0.05)
TURN = exp(np.array([0.3, -0.5, 0.9]))


def readings(r: Recording, rates: np.ndarray) -> Readings:
    return Readings(r.imu.seconds, rates, r.imu.accelerations, ((0, rates.shape[0] - 1),))


@cache
def simulated() -> tuple[Readings, ReferencePoses]:
    _, r = simulate(np.random.default_rng(1), 40.0, Path("run"))
    return readings(r, r.imu.rates), r.reference


def scalar_last(q: np.ndarray) -> np.ndarray:
    return np.roll(q, -1, axis=1)


@pytest.mark.parametrize("turned", [False, True], ids=["as it stands", "another base frame"])
@pytest.mark.parametrize(
    ("write", "name"),
    [(conjugate, "their conjugates"), (scalar_last, "scalar last (q_x")],
    ids=["conjugated", "scalar last"],
)
def test_other_conventions_are_named(write: Callable[[np.ndarray], np.ndarray], name: str, turned: bool) -> None:
    signal, reference = simulated()
    p, q = reference.positions, reference.quaternions
    if turned:
        p, q = apply(np.broadcast_to(TURN, q.shape), p), multiply(TURN, q)
    with pytest.raises(RecordingError, match="the quaternions fit the gyros only when read") as error:
        checked_fit(signal, replace(reference, positions=p, quaternions=write(q)), CLOCK)
    assert name in str(error.value)
    assert " or " not in str(error.value)


def test_without_positions_both_candidates_are_named() -> None:
    """Parts in another order are the conjugate between two constant turns: the gyros see no difference."""
    signal, reference = simulated()
    broken = replace(reference, positions=None, quaternions=scalar_last(reference.quaternions))
    with pytest.raises(RecordingError, match=r"as their conjugates .* or scalar last"):
        checked_fit(signal, broken, CLOCK)


def test_what_the_gyros_cannot_see_the_accelerometers_do() -> None:
    signal, reference = simulated()
    broken = replace(reference, quaternions=scalar_last(conjugate(reference.quaternions)))
    checked_fit(signal, broken, CLOCK)
    assert better_reading(signal, broken, CLOCK).startswith("scalar last and conjugated")


def test_a_sound_reference_passes() -> None:
    signal, reference = simulated()
    checked_fit(signal, reference, CLOCK)
    assert better_reading(signal, reference, CLOCK) is None
    assert better_reading(signal, replace(reference, positions=None), CLOCK) is None
    assert acceleration_share(signal, reference, reference.quaternions, CLOCK) > 0.8


def test_poses_of_another_run_are_refused_with_the_share() -> None:
    signal, reference = simulated()
    with pytest.raises(SynchronizationError, match=r"the gyros explain \d+ % of the rotation, expected 80 %") as error:
        checked_fit(signal, replace(reference, quaternions=reference.quaternions[::-1]), CLOCK)
    assert error.value.correlation < 0.8


def test_a_silent_gyro_is_named() -> None:
    _, reference = simulated()
    _, r = simulate(np.random.default_rng(1), 40.0, Path("run"))
    noise = np.random.default_rng(2).normal(0.0, 1e-3, len(r.imu.rates))
    rates = np.column_stack([r.imu.rates[:, :2], noise])
    with pytest.raises(SynchronizationError, match="w_z hardly changes"):
        checked_fit(readings(r, rates), reference, CLOCK)
