"""Poses that were lost though their stamps count on: found by the gyros, and all later stamps are as they were."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.preparation.preparation import Preparation
from kreisel.preparation.prepare import prepare_recording
from kreisel.recording.recording import Recording, ReferencePoses
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.synchronization.lost_samples import LostPoses


@cache
def filmed() -> Recording:
    """Poses of cameras: a robot's joint angles are not there."""
    cell = Cell.model_validate({"seed": 4, "seconds": 90.0, "imu": {"grade": "industrial-mems", "rate": 200.0}})
    made = simulate(cell, Path("filmed"))[1]
    settings = made.settings.model_copy(
        update={"reference": made.settings.reference.model_copy(update={"kind": "mocap"})}
    )
    return replace(made, joints=None, urdf=None, settings=settings)


def without(lost: list[int]) -> Recording:
    """Return the recording without some poses; the stamps of the others count on."""
    made = filmed()
    kept = np.delete(np.arange(made.reference.stamps_ns.size), lost)
    reference = made.reference.part(kept)
    return replace(made, reference=replace(reference, stamps_ns=made.reference.stamps_ns[: kept.size]))


def prepared(recording: Recording) -> Preparation:
    return prepare_recording(recording, CalibrationSettings())


def said(found: Preparation) -> list[str]:
    return [one.message for one in found.warnings if one.subject in ("clocks", "stamps")]


@pytest.mark.parametrize("lost", [[1500, 2100, 2101, 3300, 4400, 5900], [*range(1800, 3000, 120)]])
def test_lost_poses_are_found_and_those_after_them_have_their_stamps_again(lost):
    made, found = without(lost), prepared(without(lost))
    (text,) = said(found)
    assert f"{len(lost)} poses were lost without a gap" in text
    usual = made.reference.stamps_ns[1] - made.reference.stamps_ns[0]
    true = np.delete(filmed().reference.stamps_ns, lost)
    restored = found.reference.stamps_ns
    right = np.isin(restored, true)
    assert right.mean() > 0.95
    assert np.abs(restored - true).max() <= len(lost) * usual
    steady = prepared(filmed())
    assert found.rate_fit.clock.skew == pytest.approx(steady.rate_fit.clock.skew, abs=5e-6)
    assert found.rate_fit.residual_sd < 1.1 * steady.rate_fit.residual_sd
    off = (found.rate_fit.K_omega - steady.rate_fit.K_omega) / steady.rate_fit.K_omega_sd
    assert np.abs(off).max() < 2.0


def test_none_are_found_where_none_were_lost():
    assert said(prepared(filmed())) == []


def test_a_clock_that_was_slewed_has_lost_no_poses():
    """By 500 ppm for forty seconds, as services that set clocks do."""
    made = filmed()
    seconds = (made.reference.stamps_ns - made.reference.stamps_ns[0]) * 1e-9
    late = np.round(5e5 * np.clip(seconds - 25.0, 0.0, 40.0)).astype(np.int64)
    for sign in (1, -1):
        moved = replace(made.reference, stamps_ns=made.reference.stamps_ns + sign * late)
        (text,) = said(prepared(replace(made, reference=moved)))
        assert text.startswith("the reference's clock was slewed by")


def test_doubtful_poses_are_those_that_move_where_a_place_is_unsure():
    n = 1000
    stamps = 10_000_000 * np.arange(n)
    turned = np.zeros((n, 4))
    angle = np.where(np.arange(n) < 500, 0.0, 1e-3 * np.arange(n))
    turned[:, 0], turned[:, 3] = np.cos(0.5 * angle), np.sin(0.5 * angle)
    reference = ReferencePoses("pose0", stamps, None, turned, Path("pose0"))
    missing = LostPoses(np.array([400, 700]), np.array([2, 1]), 10_000_000, np.array([[3.5, 4.5], [6.945, 7.055]]))
    restored = missing.restored(reference)
    assert (restored.stamps_ns - stamps)[[0, 399, 400, 699, 700, -1]].tolist() == [
        0,
        0,
        20000000,
        20000000,
        30000000,
        30000000,
    ]
    assert np.flatnonzero(restored.doubtful).tolist() == list(range(695, 706))
