"""Priors and values of single parameters: against conditioned Gaussians, and groups that are fixed as a whole."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.outcome import Outcome
from kreisel.errors import SettingsError
from kreisel.formats.loading import load
from kreisel.formats.write import write
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.stated_parameters import place_of
from kreisel.recording.recording import Recording
from kreisel.report.report_page import write_report

from ..small_problem import recorded

NAME = "gyroscope.cross_coupling[0,1]"


@cache
def recording() -> Recording:
    """Cameras: no errors of frames are added to what the filter says."""
    made = recorded(60.0)[1]
    reference = made.settings.reference.model_copy(update={"kind": "mocap"})
    return replace(made, settings=made.settings.model_copy(update={"reference": reference}))


def calibrated(**settings: object) -> Outcome:
    return run_calibration(recording(), CalibrationSettings(**settings))


@cache
def usual() -> Outcome:
    return calibrated()


def test_a_prior_acts_as_another_measurement():
    base = usual()
    names = base.calibration.names
    n, i = len(names), names.index(NAME)
    P = base.estimate.run.belief.covariance[:n, :n]
    sd = np.sqrt(np.diag(P))
    value, own = base.calibration.sensors.K_omega[0, 1] + 0.8 * sd[i], 0.5 * sd[i]
    found = calibrated(priors={NAME: (value, own)})
    gain = P[:, i] / (P[i, i] + own**2)
    expected, left = gain * 0.8 * sd[i], P - np.outer(gain, P[i])
    moved = found.calibration.sensors.K_omega - base.calibration.sensors.K_omega
    places = [names.index(f"gyroscope.cross_coupling[{a},{b}]") for a in range(3) for b in range(3)]
    np.testing.assert_allclose(moved.ravel() / sd[places], expected[places] / sd[places], atol=0.1)
    after = found.estimate.run.belief.standard_deviation[places] ** 2
    np.testing.assert_allclose(after, np.diag(left)[places], rtol=0.15)
    assert found.verdict.accepted


@pytest.mark.parametrize("group", ["lever_arms", "accel_offset"])
def test_all_parameters_of_a_group_fixed_one_by_one_are_the_group_fixed(group):
    base = usual().calibration
    if group == "lever_arms":
        value = base.sensors.lever_arms + 1e-4
        single = {f"accelerometer.lever_arms[{i},{j}]": value[i, j] for i in range(3) for j in range(3)}
    else:
        value = base.sensors.k_a[0] + 1e-5
        single = {f"accelerometer.offset[{i}]": value[i] for i in range(3)}
    whole, parts = calibrated(fixed={group: value}).calibration, calibrated(fixed=single).calibration
    np.testing.assert_allclose(parts.sensors.K_a, whole.sensors.K_a, atol=0.01 * float(whole.sensor_sd.K_a.min()))
    np.testing.assert_allclose(parts.sensor_sd.K_a, whole.sensor_sd.K_a, rtol=0.01)
    deviation = parts.sensor_sd.lever_arms if group == "lever_arms" else parts.sensor_sd.k_a
    assert not deviation.any()
    assert parts.names == whole.names
    assert set(parts.estimator.fixed) == set(single)


def test_a_parameter_that_is_fixed_is_not_in_the_state(tmp_path):
    """Some of every matrix and vector; against priors of a hundredth of the usual deviations."""
    base = usual().calibration
    values = {
        "gyroscope.cross_coupling[1,2]": base.sensors.K_omega[1, 2],
        "gyroscope.offset[1]": base.sensors.k_w[0, 1],
        "accelerometer.cross_coupling[0,0]": base.sensors.K_a[0, 0] + 2.0 * base.sensor_sd.K_a[0, 0],
        "accelerometer.offset[2]": base.sensors.k_a[0, 2],
        "accelerometer.lever_arms[2,0]": base.sensors.lever_arms[2, 0],
        "alignment.north[1]": 0.1,
        "timing.skew": 2e-6,
    }
    fixed = calibrated(fixed=values)
    sd = dict(zip(base.names, np.sqrt(np.diag(base.covariance)), strict=True))
    narrow = calibrated(priors={name: (value, 0.01 * sd.get(name, 1e-4)) for name, value in values.items()})
    found, other = fixed.calibration, narrow.calibration
    assert set(found.names) == set(other.names) - set(values)
    assert fixed.problem.layout.degrees == narrow.problem.layout.degrees - len(values)
    assert found.sensors.K_omega[1, 2] == values["gyroscope.cross_coupling[1,2]"]
    assert found.sensors.K_a[0, 0] == values["accelerometer.cross_coupling[0,0]"]
    assert found.sensors.k_a[0, 2] == values["accelerometer.offset[2]"]
    assert found.timing.skew == pytest.approx(2e-6, rel=1e-9)
    for part in ("K_omega", "k_w", "K_a", "k_a", "lever_arms"):
        own, theirs = (getattr(one.sensor_sd, part) for one in (found, other))
        kept = own > 0.0
        assert (kept.size - kept.sum()) == 1
        np.testing.assert_allclose(own[kept], theirs[kept], rtol=0.02)
        change = getattr(found.sensors, part) - getattr(other.sensors, part)
        assert np.abs(change[kept] / own[kept]).max() < 0.05
    fixed.calibration.save(tmp_path)
    document = fixed.calibration.document
    assert document["standard_deviation"]["gyroscope"]["offset"][1] == 0.0
    write_report(fixed, tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size > 0


def test_what_the_recording_does_not_have_cannot_be_fixed():
    with pytest.raises(SettingsError, match=r"'alignment.earth_down' has a prior or a value, but is no parameter"):
        calibrated(fixed={"alignment.earth_down": 0.5})


def test_a_prior_far_from_the_data_is_named():
    sd = usual().calibration.sensor_sd.K_omega[0, 1]
    value = usual().calibration.sensors.K_omega[0, 1] + 30.0 * sd
    verdict = calibrated(priors={NAME: (value, 0.1 * sd)}).verdict
    assert not verdict.accepted
    assert any(reason.startswith(f"{NAME} lies") for reason in verdict.reasons)


@pytest.mark.parametrize("parameter", ["gyroscope.offset[2]", "accelerometer.lever_arms[1,0]", "timing.skew"])
def test_a_value_that_is_fixed_far_from_the_data_is_named(parameter):
    """Against the deviation of the estimate in which it is not fixed; within one deviation nothing is said."""
    base = usual()
    group, place = place_of(parameter, 1)
    value = float(base.estimate.run.parameters.stored(group)[place])
    i = base.calibration.names.index(parameter)
    sd = float(np.sqrt(base.calibration.covariance[i, i]))
    wrong = calibrated(fixed={parameter: value + 20.0 * sd}).verdict
    assert not wrong.accepted
    assert wrong.reasons[0].startswith(f"{parameter} is fixed, and the data without that differ from it by -")
    right = calibrated(fixed={parameter: value + sd}).verdict
    assert right.accepted, right.reasons


def test_a_group_that_is_fixed_at_its_start_value_is_compared_too():
    """The arms start in the middle of the device; each is elsewhere."""
    verdict = calibrated(fixed=["lever_arms"]).verdict
    assert any(r.startswith("accelerometer.lever_arms[") and "is fixed" in r for r in verdict.reasons)
    assert calibrated(fixed=["gravity"]).verdict.accepted


def test_priors_in_the_recording_are_used_and_kept(tmp_path):
    made = recording()
    text = {"gyroscope.offset[0]": "1e-5 +- 1e-7", "gravity": {"value": 9.8093, "sd": 1e-6}}
    table = made.settings.model_validate(
        made.settings.model_dump() | {"prior": text, "fixed": {"timing": {"skew": 0.0}, "lever_arms": True}}
    )
    stated = replace(made, settings=table)
    found = run_calibration(stated, CalibrationSettings()).calibration
    assert found.sensor_sd.k_w[0, 0] < 3e-7  # the prior, and the walk of the offset
    assert usual().calibration.sensor_sd.k_w[0, 0] > 1e-6
    assert set(found.estimator.fixed) == {"lever_arms", "timing.skew"}
    assert np.linalg.norm(found.alignment.gravity.value) == pytest.approx(9.8093, abs=5e-6)
    for name in ("folder", "file.mcap"):
        write(stated, tmp_path / name)
        again = load(tmp_path / name)
        assert again.settings.prior == stated.settings.prior
        assert again.settings.fixed == stated.settings.fixed


def test_a_parameter_that_the_recording_does_not_have_is_named():
    with pytest.raises(SettingsError, match=r"'robot.placement\[3,2\]' has a prior or a value, but is no parameter"):
        calibrated(priors={"robot.placement[3,2]": (0.0, 1e-4)})
