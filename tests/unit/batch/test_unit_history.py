"""Ageing and due dates: against closed forms, and against many histories drawn with a known line and scatter."""

import json
from dataclasses import replace
from datetime import date, timedelta

import numpy as np
import pytest

from kreisel.batch.job_result import Run, date_of
from kreisel.batch.unit_history import _STUDENT, aged, history_of, of_one_type
from kreisel.calibration.limits import Limits
from kreisel.calibration.result_sections import Measured, Verdict
from kreisel.errors import RecordingError, SettingsError

from ..calibration.example import calibration

DAY = date(2026, 1, 1)


def run(k: int, day: date | None, bias: float, sd: float = 0.5, *, accepted: bool = True) -> Run:
    own = calibration()
    zero = np.zeros(3)
    own = replace(
        own,
        derived={"accel_bias_mg": Measured(np.array([bias, 0.0, 0.0]), np.array([sd, sd, sd])),
                 "gyro_bias_deg_h": Measured(zero, zero + 1.0)},
        verdict=Verdict(accepted, () if accepted else ("no",)),
    )  # fmt: skip
    return Run(f"k{k}", f"run{k}", "0042", "m", "t", None if day is None else day.isoformat(), None,
               json.dumps(own.document))  # fmt: skip


def alone(t, y, sd):
    return aged(t, y[:, None], sd[:, None])[0]


def test_a_line_without_scatter_is_that_of_least_squares():
    t, sd = np.array([-3.0, -2.0, -0.5, 0.0]), np.array([0.5, 0.2, 0.4, 0.3])
    y = 7.0 + 2.0 * t + np.array([0.01, -0.02, 0.03, 0.0])
    found = alone(t, y, sd)
    p, P = np.polyfit(t, y, 1, w=1.0 / sd, cov="unscaled")
    assert found.scatter == 0.0
    assert (found.rate, found.level) == pytest.approx(tuple(p))
    assert (found.rate_sd, found.level_sd) == pytest.approx(tuple(np.sqrt(np.diag(P))))
    value, sd_at = found.at(np.array([1.0]))
    assert value[0] == pytest.approx(np.polyval(p, 1.0))
    assert sd_at[0] == pytest.approx(np.sqrt([1.0, 1.0] @ P @ [1.0, 1.0]))


def test_rates_have_their_deviations_and_the_scatter_is_found():
    """400 histories of 12 calibrations; scatter three times the deviations of single ones."""
    rng = np.random.default_rng(8)
    t = np.sort(rng.uniform(-6.0, 0.0, 12)) - 0.0
    scores, scatters = [], []
    for _ in range(400):
        y = 1.0 - 0.4 * t + rng.normal(0.0, 0.3, 12) + rng.normal(0.0, 0.1, 12)
        found = alone(t, y, np.full(12, 0.1))
        scores.append((found.rate + 0.4) / found.rate_sd)
        scatters.append(found.scatter)
    # Student's distribution with ten degrees of freedom: variance 10 / 8
    assert np.std(scores) == pytest.approx(np.sqrt(10.0 / 8.0), rel=0.12)
    assert np.sqrt(np.mean(np.square(scatters))) == pytest.approx(0.3, rel=0.05)


def test_one_date_has_no_rate():
    found = alone(np.zeros(3), np.array([1.0, 2.0, 3.0]), np.full(3, 10.0))
    assert found.level == pytest.approx(2.0)
    assert np.isnan(found.rate)
    assert not found.significant
    assert np.isfinite(found.at(np.array([5.0]))[1]).all()


def test_the_due_date_is_when_value_and_uncertainty_reach_the_limit():
    days = [DAY - timedelta(days=round(365.25 * k)) for k in (3, 2, 1, 0)]
    runs = [run(k, day, 10.0 - 2.0 * k, 1e-3) for k, day in zip((3, 2, 1, 0), days, strict=True)]
    found = history_of("0042", runs, Limits({"accel_bias_mg": (20.0,) * 3}))
    # 10 mg now, 2 mg a year: five years, to the step of the search
    assert found.due.day is not None
    assert abs((found.due.day - DAY).days - 5 * 365.25) < 5
    assert "Accelerometer bias x may reach its limit of 20 mg" in found.due.reason
    trend = next(one for one in found.trends if one.quantity.name == "accel_bias_mg")
    assert trend.ageing[0].significant
    assert not trend.ageing[1].significant


def test_without_limits_it_is_due_when_the_uncertainty_has_doubled():
    days = [DAY - timedelta(days=round(365.25 * k)) for k in (3, 2, 1, 0)]
    runs = [run(k, day, 10.0 - 2.0 * k) for k, day in zip((3, 2, 1, 0), days, strict=True)]
    found = history_of("0042", runs, None)
    ageing = next(one for one in found.trends if one.quantity.name == "accel_bias_mg").ageing[0]
    years = np.sqrt(3.0) * 2.0 * 0.5 / (ageing.rate + 2.0 * ageing.rate_sd)
    assert found.due.day is not None
    assert abs((found.due.day - DAY).days - years * 365.25) < 5
    assert "has doubled by ageing" in found.due.reason


def test_a_device_that_does_not_age_is_not_due():
    runs = [run(k, DAY - timedelta(days=3000 * k), 0.0, 1e-6) for k in range(8)]
    found = history_of("0042", runs, Limits({"accel_bias_mg": (20.0,) * 3}))
    assert found.due.day is None
    assert "within 20 years" in found.due.reason


def test_what_cannot_be_used_is_left_out_and_said():
    runs = [
        run(0, DAY, 1.0),
        run(1, DAY - timedelta(days=100), 1.0),
        run(2, None, 1.0),
        run(3, DAY, 9.0, accepted=False),
    ]
    found = history_of("0042", runs, None)
    assert [one.name for one in found.runs] == ["run1", "run0"]
    assert dict(found.left_out) == {"run2": "no date", "run3": "rejected"}
    with pytest.raises(SettingsError, match="1 accepted calibrations with a date, expected 2 or more.*run2: no date"):
        history_of("0042", runs[:1] + runs[2:3], None)


@pytest.mark.slow
def test_ageing_is_shown_as_often_as_said_also_by_few_calibrations():
    """Scatter of any size, no ageing: the thresholds are those of Student's distribution."""
    stats = pytest.importorskip("scipy.stats")
    for free, needed in enumerate(_STUDENT[1:], 1):
        assert needed == pytest.approx(stats.t.ppf(stats.norm.cdf(3.0), free), rel=1e-3)
    rng = np.random.default_rng(5)
    for count in (3, 4, 6):
        for scatter in (0.0, 1.0, 3.0, 20.0):  # of the deviations
            t, sd, shown = np.arange(1.0 - count, 1.0), np.full((count, 3), 0.05), 0
            for _ in range(300):
                y = rng.normal(0.0, 0.05 * np.hypot(1.0, scatter), (count, 3))
                shown += sum(one.significant for one in aged(t, y, sd))
            assert shown <= 9, (count, scatter)  # 0.27 % of 900 are 2.4
    two = alone(np.array([-1.0, 0.0]), np.array([0.0, 9.0]), np.full(2, 0.1))
    assert two.rate == pytest.approx(9.0)
    assert not two.significant


def test_two_dates_give_no_due_date_without_limits():
    runs = [run(0, DAY, 5.0), run(1, DAY - timedelta(days=365), 1.0)]
    found = history_of("0042", runs, None)
    assert found.due.day is None
    assert "two dates do not tell ageing from scatter" in found.due.reason
    assert history_of("0042", runs, Limits({"accel_bias_mg": (20.0,) * 3})).due.day is not None


def test_values_that_were_held_have_no_course():
    found = alone(np.array([-1.0, 0.0]), np.zeros(2), np.zeros(2))
    assert np.isnan([found.level, found.rate]).all()
    assert not found.significant
    one = alone(np.array([-2.0, -1.0, 0.0]), np.array([9.0, 1.0, 2.0]), np.array([0.0, 0.1, 0.1]))
    assert one.rate == pytest.approx(1.0)


def test_what_was_changed_in_the_file_of_results_is_told():
    runs = [run(0, DAY, 1.0), run(1, DAY - timedelta(days=100), 1.0), replace(run(2, DAY, 1.0), date="2020")]
    assert dict(history_of("0042", runs, None).left_out) == {"run2": "no date"}
    for text in ('{"recording": [1]}', "{}", "x"):
        with pytest.raises(RecordingError, match="the result of run0 in the file of results is damaged"):
            history_of("0042", [replace(runs[0], text=text), *runs], None)


def test_of_one_recording_the_last_result_counts():
    first, again = run(0, DAY, 1.0), replace(run(9, DAY, 5.0), name="run0")
    found = history_of("0042", [first, run(1, DAY - timedelta(days=100), 1.0), again], None)
    assert [one.key for one in found.runs] == ["k1", "k9"]


def test_devices_of_two_types_with_one_serial_number_are_not_one_unit():
    runs = [run(0, DAY, 1.0), run(1, DAY, 2.0), replace(run(2, DAY, 3.0), type="u")]
    with pytest.raises(SettingsError, match="serial number '0042': 'm t', 'm u'; choose by --type"):
        of_one_type("0042", runs, None)
    assert of_one_type("0042", runs, "u") == runs[2:]
    assert of_one_type("0042", runs, "m t") == runs[:2]
    with pytest.raises(SettingsError, match="--type v: unit '0042' is of 'm t', 'm u'"):
        of_one_type("0042", runs, "v")


@pytest.mark.parametrize(
    ("stated", "begin", "date"),
    [
        ("2026-11-23", 5, "2026-11-23"),
        ("2026-11-23T10:00", 5, "2026-11-23"),
        ("last week", 1_790_000_000_000_000_000, None),
        (None, 1_790_000_000_000_000_000, "2026-09-21"),
        (None, 1_000_000_000_000, None),
        (None, None, None),
    ],
)
def test_dates(stated, begin, date):
    assert date_of({} if stated is None else {"date": stated}, begin) == date
