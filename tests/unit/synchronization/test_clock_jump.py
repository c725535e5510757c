"""A clock that jumps: its size and moment are found, and the poses after it moved; walks and ratios are no jumps."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.preparation.preparation import Preparation
from kreisel.preparation.prepare import prepare_recording
from kreisel.recording.recording import JointAngles, Recording
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import parse_cell
from kreisel.synchronization.clock_jump import ClockJump

AT = 40.0


@cache
def recorded() -> Recording:
    cell = {
        "seed": 5, "run": 1, "seconds": 90.0, "reference": {"kind": "mocap"}, "imu": {"grade": "consumer-mems"},
    }  # fmt: skip
    return simulate(parse_cell(cell, Path("CELL.toml")), Path("jump"))[1]


def with_shift(shift) -> Recording:
    """Return the recording with poses stamped later by a function of reference seconds."""
    made = recorded()
    reference = made.reference
    moved = reference.stamps_ns + np.round(1e9 * shift(reference.seconds)).astype(np.int64)
    kept = np.append(True, np.diff(np.maximum.accumulate(moved)) > 0)
    return replace(
        made,
        reference=replace(
            reference,
            stamps_ns=moved[kept],
            positions=reference.positions[kept],
            quaternions=reference.quaternions[kept],
        ),
    )


def prepared(shift) -> Preparation:
    return prepare_recording(with_shift(shift), CalibrationSettings())


def told(preparation: Preparation) -> list[str]:
    return [str(warning) for warning in preparation.warnings if "jumped" in str(warning)]


@pytest.mark.parametrize("size", [0.25, *(pytest.param(size, marks=pytest.mark.slow) for size in (0.015, -0.065))])
def test_a_jump_is_found_and_taken_out(size):
    found = prepared(lambda tau: np.where(tau > AT, size, 0.0))
    (text,) = told(found)
    said, sd = map(float, text.split("jumped by ")[1].split(" ms")[0].split(" ± "))
    assert sd < 1.0
    # the stamps of the poses grew: the offset became less
    assert said == pytest.approx(-1e3 * size, abs=max(4.0 * sd, 0.3))
    at = float(text.split(" ms, ")[1].split(" s after")[0])
    assert at == pytest.approx(AT, abs=0.5)
    steady = prepare_recording(recorded(), CalibrationSettings()).rate_fit
    assert found.rate_fit.clock.start == pytest.approx(steady.clock.start, abs=1e-3)
    assert abs(found.rate_fit.clock.skew) < 2e-5
    assert found.reference.doubtful.any()
    assert np.abs(found.reference.seconds[found.reference.doubtful] - AT).max() < 1.2
    assert (np.diff(found.reference.stamps_ns) > 0).all()


@pytest.mark.parametrize(
    "shift",
    [
        lambda tau: 0.0 * tau,
        pytest.param(lambda tau: 5e-3 * tau, marks=pytest.mark.slow),
        pytest.param(lambda tau: 0.01 * np.sin(2.0 * np.pi * tau / 60.0), marks=pytest.mark.slow),
    ],
)
def test_other_clocks_do_not_jump(shift):
    assert not told(prepared(shift))


def test_joint_angles_move_with_the_poses():
    jump = ClockJump(tau=5.0, size=-0.5, size_sd=1e-3)
    stamps = np.arange(0, 10_000_000_000, 100_000_000)
    joints = JointAngles(stamps, np.zeros((stamps.size, 6)), Path("joint0"))
    reference = replace(
        recorded().reference, stamps_ns=stamps, positions=np.zeros((stamps.size, 3)),
        quaternions=np.tile([1.0, 0.0, 0.0, 0.0], (stamps.size, 1)),
    )  # fmt: skip
    moved = jump.taken_out(reference)
    np.testing.assert_array_equal(moved.stamps_ns, jump.taken_out_of_joints(joints, 0).stamps_ns)
    assert moved.stamps_ns.size == stamps.size - 5
    assert moved.stamps_ns[-1] == stamps[-1] - 500_000_000
