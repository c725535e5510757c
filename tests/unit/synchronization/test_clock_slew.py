"""A clock that is slewed: whose it was, when, and by how much is found, and its stamps are as if it had not been."""

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
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.clock_slew import ClockSlew, find_clock_slew

BEGIN, END, RATE = 50.0, 80.0, 5e-4


@cache
def recorded() -> Recording:
    cell = {"seed": 6, "run": 1, "seconds": 140.0, "imu": {"grade": "industrial-mems"}}
    return simulate(parse_cell(cell, Path("CELL.toml")), Path("slewed"))[1]


def later(stamps_ns: np.ndarray) -> np.ndarray:
    """Return stamps of a clock that ran faster for a while."""
    seconds = (stamps_ns - stamps_ns[0]) * 1e-9
    return stamps_ns + np.round(1e9 * RATE * np.clip(seconds - BEGIN, 0.0, END - BEGIN)).astype(np.int64)


@cache
def slewed(whose: str) -> Preparation:
    made = recorded()
    if whose == "IMU":
        return prepare_recording(
            replace(made, imu=replace(made.imu, stamps_ns=later(made.imu.stamps_ns))), CalibrationSettings()
        )
    reference = replace(made.reference, stamps_ns=later(made.reference.stamps_ns))
    joints = replace(made.joints, stamps_ns=later(made.joints.stamps_ns))
    return prepare_recording(replace(made, reference=reference, joints=joints), CalibrationSettings())


@pytest.mark.parametrize(("whose", "sign"), [("IMU", 1.0), ("reference", -1.0)])
def test_the_clock_that_was_slewed_is_found_and_corrected(whose, sign):
    found, steady = slewed(whose), prepare_recording(recorded(), CalibrationSettings())
    (text,) = [one.message for one in found.warnings if "slewed" in one.message]
    assert f"the {whose}'s clock" in text
    size = float(text.split(" by ")[1].split(" ")[0])
    own = float(text.split("± ")[1].split(" ")[0])
    assert 0.1 < own < 0.6
    assert size == pytest.approx(sign * 1e3 * RATE * (END - BEGIN), abs=2.0 * own)
    begin, end = (float(word) for word in text.split("from ")[1].split(" s after")[0].split(" to "))
    assert (begin, end) == (pytest.approx(BEGIN, abs=1.0), pytest.approx(END, abs=1.0))
    assert not [one for one in found.warnings if "jumped" in one.message]
    clock = found.rate_fit.clock
    assert clock.start == pytest.approx(steady.rate_fit.clock.start, abs=3e-4)
    assert clock.skew == pytest.approx(steady.rate_fit.clock.skew, abs=4e-6)
    off = (found.rate_fit.K_omega - steady.rate_fit.K_omega) / steady.rate_fit.K_omega_sd
    assert np.abs(off).max() < 1.0


def test_a_slew_that_begins_with_the_third_part_is_found_as_exactly():
    """Its size is not that of the first search, which looks for ramps between parts only."""
    cell = parse_cell({"seed": 1, "seconds": 300.0, "imu": {"grade": "industrial-mems"}}, Path("CELL.toml"))
    made = simulate(cell, Path("slewed"))[1]
    late = 1e-9 * (made.reference.stamps_ns - made.reference.stamps_ns[0])
    moved = np.round(-5e7 * np.clip((late - 50.0) / 100.0, 0.0, 1.0)).astype(np.int64)
    reference = replace(made.reference, stamps_ns=made.reference.stamps_ns + moved)
    joints = replace(made.joints, stamps_ns=made.joints.stamps_ns + moved)
    found = prepare_recording(replace(made, reference=reference, joints=joints), CalibrationSettings())
    (text,) = [one.message for one in found.warnings if "slewed" in one.message]
    assert text.startswith("the reference's clock was slewed by +50.0 ± 0.2 ms against the other one, from 50 to 150 s")
    assert abs(found.rate_fit.clock.skew) < 4.0 * found.rate_fit.clock.skew_sd


def test_steady_clocks_are_not_slewed():
    found = prepare_recording(recorded(), CalibrationSettings())
    assert not [one for one in found.warnings if "slewed" in one.message]


def test_all_stamps_of_a_controller_move_alike_and_those_of_the_imu_the_other_way():
    slew = ClockSlew(20.0, 40.0, 0.01, 1e-4)
    made = recorded()
    stamps = np.arange(0, 60_000_000_000, 100_000_000)
    reference = replace(made.reference, stamps_ns=stamps)
    moved = slew.taken_out(reference).stamps_ns - stamps
    assert moved[[0, 200, 300, 400, -1]].tolist() == [0, 0, 5_000_000, 10_000_000, 10_000_000]
    joints = JointAngles(stamps, np.zeros((stamps.size, 6)), Path("joint0"))
    np.testing.assert_array_equal(slew.taken_out_of_joints(joints, 0).stamps_ns, stamps + moved)
    imu = slew.taken_out_of_imu(replace(made.imu, stamps_ns=stamps), Clock(0.0))
    np.testing.assert_array_equal(imu.stamps_ns, stamps - moved)


@pytest.mark.parametrize("count", [3, 6, 7, 12])
def test_shifts_of_any_kind_are_fitted(count):
    """Parts without a shift are missing; a ramp must not be taken for the line."""
    rng, fit = np.random.default_rng(count), slewed("IMU").rate_fit
    for _ in range(20):
        tau = np.sort(rng.choice(np.arange(12.0), count, replace=False)) * 10.0
        drift = np.column_stack([tau, 0.02 * rng.normal(size=count).cumsum(), np.full(count, 1e-4)])
        found = find_clock_slew(replace(fit, clock_drift=drift))
        assert found is None or tau[0] < found.begin < found.end < tau[-1]
