"""Exit statuses of results against limits."""

import itertools
from dataclasses import replace

import pytest

from kreisel.batch.outcomes import most_serious
from kreisel.calibration.limits import Decision, Limits
from kreisel.calibration.result_sections import Verdict
from kreisel.cli.batch import _some
from kreisel.cli.conformity import as_table, conformity, sentence, status_of
from kreisel.errors import SettingsError

from ..calibration.example import calibration


@pytest.mark.parametrize("statuses", list(itertools.permutations([0, 1, 3, 4])))
def test_a_failure_comes_before_a_rejection_before_no_decision(statuses):
    assert most_serious(statuses) == 1
    assert most_serious(status for status in statuses if status != 1) == 3
    assert most_serious(status for status in statuses if status not in (1, 3)) == 4
    assert most_serious([0, 0]) == most_serious([]) == 0


@pytest.mark.parametrize(
    ("decision", "status"), [(None, 0), (Decision.CONFORMS, 0), (Decision.FAILS, 3), (Decision.UNDECIDED, 4)]
)
def test_the_status_of_one_result(decision, status):
    own = calibration().in_axes("imu")
    assert status_of(own, decision) == status
    assert status_of(replace(own, verdict=Verdict(False, ("no",))), decision) == 3


def test_the_decision_names_what_it_is_due_to():
    own = calibration().in_axes("imu")
    bias = own.derived["accel_bias_mg"]
    k = int(abs(bias.value).argmax())
    near = float(abs(bias.value[k]))  # in the guard band
    for limit, decision in ((1e6, "conforms"), (near, "no decision"), (1e-3, "does not conform")):
        limits = Limits({"accel_bias_mg": (limit,) * 3, "gyro_scale_error_ppm": (1e9,) * 3}, file="limits.toml")
        judged, found = conformity(own, limits)
        assert found.value == decision
        assert as_table(judged, found, limits) == {
            "limits": "limits.toml",
            "decision": decision,
            "quantities": {"gyro_scale_error_ppm": "conforms", "accel_bias_mg": decision},
        }
        due = "" if decision == "conforms" else ": accelerometer bias"
        assert sentence(judged, found) == f"conformity: {decision}{due}"
    less = replace(own, derived={name: one for name, one in own.derived.items() if name != "accel_bias_mg"})
    with pytest.raises(SettingsError, match=r"limits\.accel_bias_mg: this calibration does not have it"):
        conformity(less, limits)


def test_many_names_are_cut():
    assert _some(["a", "b"]) == "a, b"
    assert _some([str(k) for k in range(12)]).endswith("8, 9 and 2 more")
