"""Decisions by limits: the three cases, with numbers by hand."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.limits import Decision, Limits, judged, limits_named, limits_of_grade
from kreisel.calibration.result_sections import Measured, Verdict
from kreisel.errors import RecordingError, SettingsError

from .example import calibration


def found(values: list[float], limit: float, unobservable: tuple[str, ...] = ()) -> tuple[Decision, ...]:
    own = replace(
        calibration(),
        derived={"accel_bias_mg": Measured(np.array(values), np.full(3, 0.5))},
        verdict=Verdict(True, (), unobservable),
    )
    (one,) = judged(own, Limits({"accel_bias_mg": (limit,) * 3}))
    np.testing.assert_array_equal(one.uncertainties, 1.0)
    return one.decisions


def test_a_guard_band_of_the_expanded_uncertainty_on_either_side():
    C, F, U = Decision.CONFORMS, Decision.FAILS, Decision.UNDECIDED
    assert found([0.0, 9.0, -9.0], 10.0) == (C, C, C)
    assert found([9.01, -10.9, 11.0], 10.0) == (U, U, U)
    assert found([11.01, -12.0, 1.0], 10.0) == (F, F, C)


def test_what_is_not_observable_is_not_decided():
    assert set(found([0.0, 0.0, 0.0], 10.0, ("accelerometer.offset[1]",))) == {Decision.UNDECIDED}
    assert set(found([0.0, 0.0, 0.0], 10.0, ("gyroscope.offset[1]",))) == {Decision.CONFORMS}


def test_what_the_user_stated_is_not_decided():
    """It has no deviation: any limit would be kept, whatever the data say."""
    derived = {"accel_bias_mg": Measured(np.zeros(3), np.array([0.0, 0.5, 0.0]))}
    (one,) = judged(replace(calibration(), derived=derived), Limits({"accel_bias_mg": (10.0,) * 3}))
    assert one.decisions == (Decision.UNDECIDED, Decision.CONFORMS, Decision.UNDECIDED)


def test_all_three_together():
    own = replace(calibration(), derived={"accel_bias_mg": Measured(np.array([0.0, 9.5, 20.0]), np.full(3, 0.5))})
    (one,) = judged(own, Limits({"accel_bias_mg": (10.0,) * 3}))
    assert one.decision is Decision.FAILS
    (one,) = judged(own, Limits({"accel_bias_mg": (20.5,) * 3}))
    assert one.decision is Decision.UNDECIDED
    (one,) = judged(own)
    assert one.decision is None


def test_limits_of_a_grade_are_three_of_its_deviations():
    limits = limits_of_grade("fog-mems").values
    assert limits["gyro_bias_deg_h"] == pytest.approx((60.0,) * 3)
    assert limits["accel_bias_mg"] == pytest.approx((75.0,) * 3)
    assert limits["accel_scale_error_ppm"] == pytest.approx((6000.0,) * 3)
    assert limits["gyro_non_orthogonality_mrad"] == pytest.approx((3.0 * np.hypot(10.0, 10.0),) * 3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[limits]\ngyro_bias = 3.0\n", "unknown quantity 'gyro_bias'; known are: accel_bias_mg"),
        ("[limits]\ngyro_bias_deg_h = -3.0\n", "expected a number above zero"),
        ("[limits]\ngyro_bias_deg_h = true\n", "expected a number above zero"),
        ("gyro_bias_deg_h = 3.0\n", r"expected one table, \[limits\]"),
        ("[limits\n", "not valid TOML"),
    ],
)
def test_files_of_limits_that_cannot_be_used(tmp_path, text, said):
    path = tmp_path / "limits.toml"
    path.write_text(text)
    with pytest.raises(RecordingError, match=said):
        limits_named(str(path))


def test_a_file_or_a_grade(tmp_path):
    path = tmp_path / "limits.toml"
    path.write_text("[limits]\ngyro_bias_deg_h = 20\n")
    assert limits_named(str(path)).values == {"gyro_bias_deg_h": (20.0, 20.0, 20.0)}
    path.write_text("[limits]\ngyro_bias_deg_h = [20, inf, 5.5]\n")
    assert limits_named(str(path)).values == {"gyro_bias_deg_h": (20.0, np.inf, 5.5)}
    assert limits_named("fog").grade == "fog"
    with pytest.raises(SettingsError, match="neither a file nor a grade"):
        limits_named("none")


def test_an_axis_without_a_limit_is_not_judged():
    own = replace(calibration(), derived={"accel_bias_mg": Measured(np.array([2.0, 99.0, -3.0]), np.full(3, 0.5))})
    (one,) = judged(own, Limits({"accel_bias_mg": (5.0, np.inf, 5.0)}))
    assert one.decisions == (Decision.CONFORMS, None, Decision.CONFORMS)
    assert one.decision is Decision.CONFORMS
    assert one.share == pytest.approx(0.8)
    (one,) = judged(own, Limits({"accel_bias_mg": (5.0, 50.0, 5.0)}))
    assert one.decision is Decision.FAILS
    assert one.share == pytest.approx(2.0)


@pytest.mark.parametrize("zeros", [400, 6000])
def test_numbers_that_no_computer_holds_are_named(tmp_path, zeros):
    (tmp_path / "limits.toml").write_text("[limits]\ngyro_bias_deg_h = 1" + zeros * "0", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"gyro_bias_deg_h = 10{10}|not valid TOML"):
        limits_named(str(tmp_path / "limits.toml"))
