"""A unit of a tray that errs in a way of its own: it is estimated or named, and the others are as good as ever."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kreisel.array.tray import calibrate_tray
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.device_axes import vector_of
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.units import STANDARD_GRAVITY
from kreisel.validation.checks import check_streams

NAMES, FAULTY = ("imu0", "imu1", "imu2", "imu3"), "imu2"


@cache
def tray():
    cell = Cell.model_validate({
        "seed": 1, "seconds": 100.0, "imu": {"grade": "industrial-mems"}, "tray": {"units": 4, "clock_offset": 1.0}
    })  # fmt: skip
    return {name: simulate(cell, Path("tray"), unit=k) for k, name in enumerate(NAMES)}


def calibrated(change):
    made = tray()
    recordings = {name: recording for name, (_, recording) in made.items()}
    recordings[FAULTY] = replace(recordings[FAULTY], imu=change(recordings[FAULTY].imu))
    outcome = calibrate_tray(recordings.__getitem__, NAMES, CalibrationSettings())
    worst = {
        unit.name: np.max(np.abs(
            (vector_of(unit.calibration.sensors) - vector_of(made[unit.name][0].sensors))
            / vector_of(unit.calibration.sensor_sd)
        )) for unit in outcome.units
    }  # fmt: skip
    return {unit.name: unit for unit in outcome.units}, worst


@pytest.mark.slow
@pytest.mark.parametrize("size", [pytest.param(2e-4, id="a quarter of it shows in the mean"), 5e-3])
def test_an_effect_of_one_unit_is_estimated(size):
    units, worst = calibrated(lambda imu: replace(imu, rates=imu.rates + size * imu.rates**3))
    assert all(unit.calibration.accepted for unit in units.values())
    assert units[FAULTY].share.any()
    cubic = [unit.calibration.sensors.effects["gyro_cubic"] for unit in units.values()]
    # the correction is added to what is read
    np.testing.assert_allclose(cubic[2], -size, rtol=0.05, atol=1.5e-4)
    assert np.abs(np.delete(cubic, 2, axis=0)).max() < 2e-4
    assert max(worst.values()) < 4.0


@pytest.mark.slow
def test_an_effect_of_one_unit_that_the_mean_does_not_bear_is_a_reason_against_this_unit(monkeypatch):
    def run(recording, settings, *rest, **options):
        outcome = run_calibration(recording, settings, *rest, **options)
        return outcome if settings.polynomial_order == 1 else replace(outcome, verdict=rejected(outcome.verdict))

    def rejected(verdict):
        return replace(verdict, accepted=False, reasons=("halves differ",))

    monkeypatch.setattr("kreisel.array.tray.run_calibration", run)
    units, worst = calibrated(lambda imu: replace(imu, rates=imu.rates + 2e-4 * imu.rates**2))
    assert [name for name, unit in units.items() if not unit.calibration.accepted] == [FAULTY]
    assert "its readings show gyro_polynomial" in units[FAULTY].calibration.verdict.reasons[-1]
    assert not units[FAULTY].share.any()
    assert max(worst[name] for name in NAMES if name != FAULTY) < 4.0


@pytest.mark.slow
def test_a_mount_that_bends_is_estimated_and_does_no_harm():
    cell = {"seed": 1, "seconds": 100.0, "imu": {"grade": "industrial-mems", "mount_bending_sd": 3e-5},
            "tray": {"units": 4, "clock_offset": 1.0}}  # fmt: skip
    truth, bent = simulate(Cell.model_validate(cell), Path("tray"), unit=2)
    units, worst = calibrated(lambda _: bent.imu)
    assert all(unit.calibration.accepted for unit in units.values())
    np.testing.assert_array_equal(truth.sensors.K_a, tray()[FAULTY][0].sensors.K_a)
    for name, unit in units.items():  # against the mean of all, which bends by a share of it
        against_mean = ((name == FAULTY) - units[FAULTY].share[0]) * truth.mount.bending
        assert np.abs((unit.fit.bending - against_mean) / unit.fit.bending_sd).max() < 4.5
    assert any("its mount bends by up to" in warning.message for warning in units[FAULTY].warnings)
    assert max(worst.values()) < 4.0


@pytest.mark.slow
def test_products_of_accelerations_are_a_reason_against_a_unit():
    """By 3e-4 g at 1 g of both others."""
    units, worst = calibrated(
        lambda imu: replace(
            imu,
            accelerations=imu.accelerations
            + 3e-5 * np.roll(imu.accelerations, 1, 1) * np.roll(imu.accelerations, 2, 1),
        )
    )
    assert [name for name, unit in units.items() if not unit.calibration.accepted] == [FAULTY]
    assert "products of accelerations" in units[FAULTY].calibration.verdict.reasons[-1]
    assert max(worst[name] for name in NAMES if name != FAULTY) < 4.0


@pytest.mark.slow
def test_coarse_rounding_of_one_unit_is_no_reason_against_it():
    """Steps of 8 mg: each attitude at rest has an error of its own, which noise does not average."""
    step = 8e-3 * STANDARD_GRAVITY
    units, worst = calibrated(lambda imu: replace(imu, accelerations=np.round(imu.accelerations / step) * step))
    assert all(unit.calibration.accepted for unit in units.values())
    assert units[FAULTY].share[1] < 0.1
    assert max(worst.values()) < 4.0


@pytest.mark.slow
def test_a_unit_whose_clock_jumps_is_named_and_does_not_spoil_the_others():
    def late(imu):
        half = imu.seconds > 0.5 * imu.seconds[-1]
        return replace(imu, stamps_ns=imu.stamps_ns + np.where(half, 5_000_000, 0))

    units, worst = calibrated(late)
    assert [name for name, unit in units.items() if not unit.calibration.accepted] == [FAULTY]
    assert "check its mount, its clock" in units[FAULTY].calibration.verdict.reasons[-1]
    assert not units[FAULTY].share.any()
    assert max(worst.values()) < 4.0


@pytest.mark.slow
def test_a_copy_of_another_units_readings_counts_once():
    other = tray()["imu1"][1].imu
    recordings = {name: recording for name, (_, recording) in tray().items()}
    recordings[FAULTY] = replace(recordings[FAULTY], imu=other)
    outcome = calibrate_tray(recordings.__getitem__, NAMES, CalibrationSettings())
    assert dict(outcome.left_out)[FAULTY].startswith("holds the readings of imu1")
    assert [unit.name for unit in outcome.units] == [name for name in NAMES if name != FAULTY]


@pytest.mark.slow
def test_a_clock_that_is_three_percent_fast_makes_no_unit_the_longest():
    units, worst = calibrated(lambda imu: replace(imu, stamps_ns=np.round(1.03 * imu.stamps_ns).astype(np.int64)))
    assert all(unit.calibration.accepted for unit in units.values())
    assert max(worst.values()) < 4.0


@pytest.mark.slow
def test_a_unit_that_ends_early_is_calibrated_and_not_in_the_mean():
    def cut(imu):
        n = 6 * imu.stamps_ns.size // 10
        return replace(imu, stamps_ns=imu.stamps_ns[:n], rates=imu.rates[:n], accelerations=imu.accelerations[:n])

    units, worst = calibrated(cut)
    assert all(unit.calibration.accepted for unit in units.values())
    assert not units[FAULTY].share.any()
    assert max(worst.values()) < 4.0


@pytest.mark.slow
def test_bursts_in_one_unit_cost_that_unit_these_moments_and_the_others_nothing():
    """Vibration of 3 m/s^2 for a twentieth of the time: its rows are left out, and would show in the mean."""

    def shaken(imu):
        rng = np.random.default_rng(7)
        bursts = (np.sin(2.0 * np.pi * imu.seconds / 10.0) > 0.988)[:, None]
        return replace(imu, accelerations=imu.accelerations + 3.0 * bursts * rng.normal(size=imu.accelerations.shape))

    units, worst = calibrated(shaken)
    assert all(unit.calibration.accepted for unit in units.values())
    assert [name for name, unit in units.items() if unit.warnings] == [FAULTY]
    assert "differ grossly from the motion of the other units for" in units[FAULTY].warnings[0].message
    assert not units[FAULTY].share.any()
    assert max(worst.values()) < 4.0


@pytest.mark.slow
def test_a_unit_with_an_axis_that_stays_is_left_out():
    def stuck(imu):
        rates = imu.rates.copy()
        rates[8000:9000, 1] = rates[8000, 1]
        return replace(imu, rates=rates)

    def read(name):
        recording = tray()[name][1]
        return check_streams(replace(recording, imu=stuck(recording.imu)) if name == FAULTY else recording)

    outcome = calibrate_tray(read, NAMES, CalibrationSettings())
    assert [unit.name for unit in outcome.units] == [name for name in NAMES if name != FAULTY]
    assert all(unit.calibration.accepted for unit in outcome.units)
    assert "stuck or dead channel" in dict(outcome.left_out)[FAULTY]


@pytest.mark.slow
def test_a_unit_with_which_the_tray_cannot_be_used_is_named():
    """A tenth of what a range of half the rates would clip: with it the clocks of the mean seem to run unevenly."""

    def clipped(imu):
        limit = 0.5 * float(np.abs(imu.rates).max())
        return replace(imu, rates=0.9 * imu.rates + 0.1 * np.clip(imu.rates, -limit, limit))

    units, worst = calibrated(clipped)
    assert [name for name, unit in units.items() if not unit.calibration.accepted] == [FAULTY]
    assert "differ from the motion of the other units" in units[FAULTY].calibration.verdict.reasons[-1]
    assert not units[FAULTY].share.any()
    assert max(worst[name] for name in NAMES if name != FAULTY) < 4.0
