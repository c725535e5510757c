"""Rules of a station: units tested again, and the unit that is known."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from kreisel.batch.attempt import ENDED, Attempt
from kreisel.batch.lot import units_of
from kreisel.calibration.limits import Limits
from kreisel.calibration.result_sections import Measured, Verdict
from kreisel.station.golden_unit import SCORE, golden_check
from kreisel.station.retest import DAYS, outcome_of, recent_tests

from ..batch.test_lot import run
from ..calibration.example import calibration

LIMITS = Limits({"accel_bias_mg": (10.0,) * 3})


def outcome(now, *before, sd=0.1):
    (unit,) = units_of([run(0, now, sd)], LIMITS)
    return outcome_of(unit, [run(k + 1, bias, sd) for k, bias in enumerate(before)], LIMITS)


def test_a_lucky_repetition_does_not_make_a_unit_good():
    assert outcome(9.5) == ("conforms", "")
    assert outcome(9.5, 9.6) == ("conforms", "")
    found, why = outcome(9.5, 11.0)  # mean 10.25 +- 0.14: outside
    assert found == "does not conform"
    assert "the mean of 2 tests, 10.25 ± 0.14 mg, is not within ± 10" in why
    assert outcome(9.5, 10.4)[0] == "no decision"  # mean 9.95 +- 0.14
    assert outcome(11.0, 2.0)[0] == "does not conform"  # its own outcome, whatever was before


def test_rejected_runs_do_not_enter_the_mean():
    (unit,) = units_of([run(0, 9.5)], LIMITS)
    assert outcome_of(unit, [run(1, 99.0, accepted=False), run(2, error="no poses")], LIMITS) == ("conforms", "")
    (unit,) = units_of([run(0, 9.5)], None)
    assert outcome_of(unit, [run(1, 99.0)], None) == ("accepted", "")


def test_only_decisive_attempts_count_as_tests():
    now = datetime(2026, 3, 1, tzinfo=UTC)
    one = Attempt(1, "a", "unit", "", "", (now - timedelta(days=2)).isoformat(), state=ENDED)
    outcomes = ("conforms", "does not conform", "rejected", "no decision", "interrupted", "failed", "")
    assert len(recent_tests([replace(one, outcome=outcome) for outcome in outcomes], now)) == 4
    assert recent_tests([replace(one, kind="golden", outcome="conforms")], now) == []
    # a unit that comes back after a year is calibrated anew
    assert recent_tests([replace(one, outcome="conforms")], now + timedelta(days=DAYS)) == []


def known(scale, sd=3.0, bias=0.0, *, accepted=True):
    derived = {
        "gyro_scale_error_ppm": Measured(np.array([scale, 0.0, 0.0]), np.full(3, sd)),
        "gyro_bias_deg_h": Measured(np.full(3, bias), np.full(3, 0.1)),
    }
    return replace(calibration(), derived=derived, verdict=Verdict(accepted, () if accepted else ("it does not fit",)))


def test_the_known_unit_is_compared_by_both_deviations():
    within = 0.98 * SCORE * np.hypot(3.0, 4.0)
    found = golden_check(known(0.0), known(within, 4.0, bias=50.0))  # an offset may change
    assert found.passed
    assert found.worst == pytest.approx(0.98 * SCORE)
    found = golden_check(known(0.0), known(within / 0.9, 4.0))
    assert not found.passed
    assert "Gyroscope scale" in found.reasons[0] or "scale" in found.reasons[0]
    assert not golden_check(known(0.0), known(0.0, accepted=False)).passed


def test_a_good_station_is_seldom_in_doubt():
    rng = np.random.default_rng(2)
    wrong = 0
    for _ in range(500):
        old, new = (
            replace(calibration(), derived={
                f"{sensor}_scale_error_ppm": Measured(rng.normal(0.0, 2.0, 3), np.full(3, 2.0))
                for sensor in ("gyro", "accel")
            })
            for _ in range(2)
        )  # fmt: skip
        wrong += not golden_check(old, new).passed
    assert wrong <= 6  # 500 x 6 figures beyond 3.5 deviations: 1.4 expected
