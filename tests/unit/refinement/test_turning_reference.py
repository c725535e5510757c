"""A reference whose heading drifts: the turn is found and the sensors stay as they are without it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.outcome import Outcome
from kreisel.geometry.rotation import apply, exp, matrix, multiply
from kreisel.inertial.earth import EARTH_RATE
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.site import earth_rate_r
from kreisel.refinement.turning_reference import turn_found, turn_warning, with_turn
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.validation.checks import check_streams

from ...small_problem import camera_problem, small_run

DRIFT = np.radians(1.0) / 60.0
"""rad/s: a degree per minute."""


def outcome(drift: float, *, place: bool) -> Outcome:
    content = {
        "seed": 4, "seconds": 150.0, "stated": {"place": place},
        "imu": {"grade": "industrial-mems", "gyro_g_sensitivity_sd": 0.0},
        "reference": {"kind": "mocap", "interval": 0.02}, "errors": {"path_correlation_time": 0.0},
    }  # fmt: skip
    recording = simulate(Cell.model_validate(content), Path("cell"))[1]
    reference = recording.reference
    assert reference is not None
    assert reference.positions is not None
    assert reference.quaternions is not None
    turned = exp(np.outer(drift * reference.seconds, [0.0, 0.0, 1.0]))
    poses = {
        "positions": apply(turned, reference.positions),
        "quaternions": multiply(turned, reference.quaternions),
    }
    return run_calibration(
        check_streams(replace(recording, reference=replace(reference, **poses))), CalibrationSettings()
    )


@pytest.mark.parametrize("place", [True, False], ids=["with latitude", "without latitude"])
def test_a_heading_that_drifts_is_a_turn_and_no_response_to_acceleration(place: bool) -> None:
    steady, turning = (outcome(drift, place=place) for drift in (0.0, DRIFT))
    assert turning.verdict.accepted
    assert "gyro_g_sensitivity" not in turning.problem.layout
    found = turn_found(turning.estimate.stated, turning.problem, turning.estimate.run)
    assert found is not None
    rate, deviation = found
    # r turns upward against the cell, so that the cell turns downward in it
    assert abs(abs(rate) - np.degrees(DRIFT) * 3600.0) < 4.0 * deviation + np.degrees(EARTH_RATE) * 3600.0
    assert any("heading drifts" in cause.text for cause in turning.verdict.causes)
    for group in ("gyro_cross_coupling", "gyro_offset"):
        part, own = turning.problem.layout[group], steady.problem.layout[group]
        away = turning.estimate.run.belief.mean[part] - steady.estimate.run.belief.mean[own]
        assert np.abs(away / turning.estimate.deviation[part]).max() < 3.0
    assert turn_found(steady.estimate.stated, steady.problem, steady.estimate.run) is None


def test_rates_without_the_rotation_of_the_earth_are_noticed() -> None:
    """A navigation system has taken it out: gyros seemed to respond to acceleration, 25 to 33 deviations."""
    cell = Cell.model_validate({"seed": 4, "seconds": 150.0, "imu": {"grade": "fog"}, "reference": {"kind": "mocap"}})
    recording = simulate(cell, Path("cell"))[1]
    plain = run_calibration(check_streams(recording), CalibrationSettings())
    p, imu, reference = plain.estimate.run.parameters, recording.imu, recording.reference
    assert reference is not None
    assert reference.quaternions is not None
    poses = np.searchsorted(reference.seconds, p.clock.reference_time(imu.seconds)).clip(0, reference.seconds.size - 1)
    in_b = matrix(reference.quaternions[poses]).swapaxes(1, 2) @ earth_rate_r(plain.problem.site, p)
    without = replace(imu, rates=imu.rates - in_b @ np.linalg.inv(p.sensors.K_omega).T)
    found = run_calibration(check_streams(replace(recording, imu=without)), CalibrationSettings())
    assert found.verdict.accepted
    assert found.verdict.causes[0].name == "no Earth rate"
    assert "gyro_g_sensitivity" not in {e.group for e in found.estimate.considered if e.included}
    assert any("no rotation of the Earth" in warning.message for warning in found.warnings)
    for group in ("gyro_cross_coupling", "gyro_offset"):
        part = found.problem.layout[group]
        away = found.estimate.run.belief.mean[part] - plain.estimate.run.belief.mean[plain.problem.layout[group]]
        assert np.abs(away / found.estimate.deviation[part]).max() < 3.0
    assert not plain.verdict.causes


def test_a_turn_is_a_wide_prior_of_the_vertical_rotation() -> None:
    problem, run = camera_problem(), small_run()
    wide = with_turn(problem, run, 30.0 * EARTH_RATE)
    assert wide.prior.covariance["earth_down"] == pytest.approx(900.0)
    assert turn_warning(problem, problem, run) == []
    (warning,) = turn_warning(
        problem, wide, replace(run, belief=replace(run.belief, factor=np.eye(wide.layout.degrees)))
    )
    assert "heading drifts" in warning.message
