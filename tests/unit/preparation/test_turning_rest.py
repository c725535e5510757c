"""A rest outside the poses that is none: the device turns steadily."""

from types import SimpleNamespace

import numpy as np
import pytest

from kreisel.model.standstill import OutsideStandstill
from kreisel.preparation import prepare

OFFSET = np.array([2e-3, -1e-3, 5e-4])


def compared(sd: float = 1e-4, *, orientations: bool = True) -> SimpleNamespace:
    return SimpleNamespace(
        recording=SimpleNamespace(imu=None),
        reference=SimpleNamespace(quaternions=np.zeros((2, 4)) if orientations else None),
        fit=SimpleNamespace(clock=None, k_w0=-OFFSET, k_w0_sd=np.full(3, sd)),
        imu_noise=SimpleNamespace(gyro=np.full(3, 1e-4)),
    )


def outside(monkeypatch: pytest.MonkeyPatch, turn: float, **of: object) -> tuple[OutsideStandstill | None, str]:
    rest = OutsideStandstill(OFFSET + np.array([0.0, 0.0, turn]), 20.0)
    monkeypatch.setattr(prepare, "standstill_outside", lambda *_: rest)
    found, warnings = prepare._outside(compared(**of), None)
    return found, " ".join(one.message for one in warnings)


def test_a_steady_turn_is_no_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    found, words = outside(monkeypatch, np.radians(0.5))
    assert found is None
    assert "0.5 deg/s" in words
    assert "is not used" in words


@pytest.mark.parametrize(
    ("turn", "of"), [(3e-4, {}), (np.radians(0.5), {"sd": 1e-2}), (np.radians(5.0), {"orientations": False})]
)
def test_what_the_poses_do_not_contradict_is_used(monkeypatch: pytest.MonkeyPatch, turn: float, of: dict) -> None:
    """Noise; poses that do not show the offset; positions alone."""
    found, words = outside(monkeypatch, turn, **of)
    assert found is not None
    assert words.startswith("20.0 s of standstill without reference used")
