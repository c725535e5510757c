"""Parts of a recording between which the IMU's clock was set."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.errors import RecordingError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.preparation.prepare import prepare_recording
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.truth_comparison import group_errors
from kreisel.validation.checks import check_streams


@cache
def complete():
    return simulate(Cell.model_validate({"seed": 4, "seconds": 90.0, "reference": {"joints": False}}), Path("run"))


def set_at(first, last, to_ns):
    """Return the recording without samples from first to last, and with a clock that begins anew at a stamp."""
    _, r = complete()
    s, keep = r.imu.stamps_ns, np.ones(r.imu.stamps_ns.size, dtype=bool)
    keep[first:last] = False
    stamps = s.copy()
    stamps[last:] += to_ns - s[last]
    imu = replace(r.imu, stamps_ns=stamps[keep], rates=r.imu.rates[keep], accelerations=r.imu.accelerations[keep])
    return replace(r, imu=imu), s[keep]


@pytest.mark.parametrize("to_ns", [7_000_000, 9_000_000_000_000_000])
def test_a_part_is_put_where_the_reference_shows_it(to_ns):
    broken, true = set_at(9000, 10_200, to_ns)
    found = prepare_recording(check_streams(broken), CalibrationSettings())
    off = 1e-9 * (found.recording.imu.stamps_ns - true)
    assert np.ptp(off) < 5.0 * found.recording.imu.placed_sd
    assert np.ptp(off) < 1e-3
    assert [w.message for w in found.warnings if "clock was set" in w.message]
    assert len(found.readings.segments) == 2


def test_the_result_is_right():
    truth, _ = complete()
    outcome = run_calibration(check_streams(set_at(9000, 10_200, 7_000_000)[0]), CalibrationSettings())
    assert outcome.verdict.accepted, outcome.verdict.reasons
    for name, group in group_errors(outcome.calibration, truth).items():
        if name not in ("time_offset",):
            known = group.deviation > 0.0
            assert np.abs(group.error[known] / group.deviation[known]).max() < 4.5, name


def test_a_clock_that_is_set_often_is_refused():
    _, r = complete()
    stamps = r.imu.stamps_ns.copy()
    for k in range(2000, stamps.size, 4000):
        stamps[k:] -= 8_000_000_000
    with pytest.raises(RecordingError, match="stamps run backwards"):
        check_streams(replace(r, imu=replace(r.imu, stamps_ns=stamps)))
