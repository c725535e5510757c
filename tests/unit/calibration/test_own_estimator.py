"""A user's own estimator: what it is given, what it may return, and what is said of what goes wrong."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import kreisel
from kreisel.calibration.own_code import load_estimator
from kreisel.calibration.own_estimator import (
    Estimates,
    checked,
    derived_of_own,
    measurements_of,
    parameters_of_own,
)
from kreisel.errors import EstimationError, SettingsError
from kreisel.geometry.rotation import matrix
from kreisel.units import DEG_PER_HOUR, PPM

from ...small_problem import prepared, recorded, small_problem

OFFSET = {"gyroscope": {"offset": [0.1, 0.2, 0.3]}}


def measured(until=np.inf):
    return measurements_of(prepared(), small_problem(), until)


class Repeating:
    """Returns what it is given, moved by some numbers."""

    name = "repeating"

    def __init__(self, moved=0.0, deviation=1e-3):
        self.moved, self.deviation = moved, deviation

    def estimate(self, measured):
        own = {"gyroscope": {"offset": measured.start["gyroscope"]["offset"] + self.moved}}
        return Estimates(own, {"gyroscope": {"offset": np.full(3, self.deviation)}})


def test_measurements_are_those_of_the_recording_on_one_clock():
    truth, _ = recorded()
    given = measured()
    assert given.rates.shape == given.forces.shape == (given.imu_seconds.size, 3)
    assert given.quaternions.shape == (given.pose_seconds.size, 4)
    # the angle that the gyros turned between two poses is the poses': they are on one clock
    i, j = np.searchsorted(given.pose_seconds, [12.0, 12.4])
    turn = Rotation.from_quat(given.quaternions[[i, j]], scalar_first=True)
    angle = (turn[0].inv() * turn[1]).magnitude()
    within = (given.imu_seconds >= given.pose_seconds[i]) & (given.imu_seconds < given.pose_seconds[j])
    turned = np.linalg.norm(given.rates[within].sum(axis=0)) * np.diff(given.imu_seconds[:2])[0]
    assert turned == pytest.approx(angle, rel=0.05)
    assert given.start["timing"]["offset"] == pytest.approx(truth.time_offset, abs=0.02)
    assert np.linalg.norm(given.start["alignment"]["gravity"]) == pytest.approx(9.81, abs=0.02)
    assert given.deviation.keys() <= given.start.keys()
    assert given.deviation["accelerometer"]["lever_arms"].shape == (3, 3)
    part = measured(until=20.0)
    assert part.imu_seconds[-1] <= 20.0 < given.imu_seconds[-1]
    assert part.pose_seconds[-1] <= 20.0
    assert all(stop <= 20.0 for _, stop in part.standstills)
    assert len(part.standstills) < len(given.standstills)


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ({"offset": 1.0}, "returned dict, expected kreisel.Estimates"),
        (Estimates({}, {}), "returned no values"),
        (Estimates([], {}), "values: got list, expected tables by section"),
        (Estimates({"gyro": {}}, {}), "unknown section 'gyro'; known are: accelerometer"),
        (Estimates({"gyroscope": 3.0}, {}), "gyroscope is float, expected a table"),
        (Estimates({"gyroscope": {"offsets": 1}}, {}), "unknown name in gyroscope 'offsets'"),
        (
            Estimates({"gyroscope": {"offset": [1.0, 2.0]}}, {}),
            r"gyroscope.offset has the shape \(2,\), expected \(3,\)",
        ),
        (Estimates({"timing": {"offset": [1.0]}}, {}), "expected one number"),
        (Estimates({"gyroscope": {"offset": "abc"}}, {}), "is not made of numbers"),
        (Estimates({"gyroscope": {"offset": [1.0, np.nan, 1.0]}}, {}), "a number that is not finite"),
        (Estimates(OFFSET, {}), "gyroscope.offset has no standard deviation"),
        (Estimates(OFFSET, {"gyroscope": {"offset": [1.0, -1.0, 1.0]}}), "a standard deviation that is not above zero"),
    ],
)
def test_what_it_returns_is_checked(found, message):
    with pytest.raises(EstimationError, match=message):
        checked(found)


def test_its_values_take_the_place_of_the_first_ones():
    problem, preparation = small_problem(), prepared()
    start = problem.prior.start
    given = measured()
    turned = np.array([0.3, -0.2, -9.7])
    own = Estimates(
        {
            "gyroscope": {"offset": np.array([1.0, 2.0, 3.0])},
            "accelerometer": {"lever_arms": np.full((3, 3), 0.5)},
            "timing": {"offset": given.start["timing"]["offset"] + 0.25},
            "alignment": {"gravity": turned},
        },
        {},
    )
    known = parameters_of_own(preparation, problem, own)
    np.testing.assert_array_equal(known.sensors.k_w[0], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(known.sensors.lever_arms, 0.5)
    np.testing.assert_array_equal(known.sensors.K_a, start.sensors.K_a)
    assert known.start - start.start == pytest.approx(0.25)
    np.testing.assert_allclose(matrix(known.q_rn)[:, 2], turned / np.linalg.norm(turned), atol=1e-12)
    same = parameters_of_own(preparation, problem, Estimates({"alignment": given.start["alignment"]}, {}))
    np.testing.assert_allclose(same.q_rn, start.q_rn, atol=1e-12)


def test_derived_quantities_have_its_deviations():
    K = np.diag([1.0 + 1e-4, 1.0, 1.0])
    values = {"gyroscope": {"cross_coupling": K, "offset": np.full(3, 1e-6)}}
    deviations = {"gyroscope": {"cross_coupling": np.full((3, 3), 2e-5), "offset": np.full(3, 3e-6)}}
    own = Estimates(values, deviations)
    derived = derived_of_own(parameters_of_own(prepared(), small_problem(), own).sensors, own)
    scale, bias = derived["gyro_scale_error_ppm"], derived["gyro_bias_deg_h"]
    assert scale.value[0] == pytest.approx(-1e-4 / PPM, rel=1e-3)
    assert scale.deviation[1] == pytest.approx(2e-5 / PPM, rel=1e-3)
    assert bias.deviation[0] == pytest.approx(3e-6 / DEG_PER_HOUR, rel=1e-6)
    assert np.isnan(derived["accel_bias_mg"].value).all()
    none = replace(small_problem().prior.start.sensors, K_omega=np.zeros((3, 3)))
    with pytest.raises(EstimationError, match="has no inverse"):
        derived_of_own(none, own)


def test_it_takes_part_in_a_comparison():
    class Failing(Repeating):
        name = "failing"

        def estimate(self, measured):
            return measured.rates[10**9]

    class Leaving(Repeating):
        name = "leaving"

        def estimate(self, measured):
            raise SystemExit("no licence")

    own_ones = [Repeating(), Failing(), Repeating(moved=np.inf), Leaving()]
    compared = kreisel.compare_methods(recorded()[1], ["ekf", *own_ones])
    first, own, failed, infinite, left = compared.found
    assert (first.result, own.result, failed.result) == ("accepted", "not judged", "failed")
    assert own.accepted is None
    assert set(own.estimate) == {f"gyroscope.offset[{i}]" for i in range(3)}
    assert own.standard_deviation["gyroscope.offset[0]"] == 1e-3
    assert own.drift is not None
    assert own.drift[0] > first.drift[0]
    assert failed.error.startswith("IndexError: index 1000000000 is out of bounds")
    assert "test_own_estimator.py, line" in failed.error
    assert "not finite" in infinite.error
    assert left.error.startswith("SystemExit: no licence")
    assert compared.unit > 0.0


def test_estimators_are_found_in_files(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "from dataclasses import dataclass\n"
        "@dataclass\nclass Mine:\n    name: str = 'mine'\n    def estimate(self, measured):\n        return None\n"
        "made = Mine('made')\nnothing = 3\n"
        "class Broken:\n    def __init__(self):\n        raise ValueError('no')\n"
    )
    assert load_estimator(f"{file}:Mine").name == "mine"
    assert load_estimator(f"{file}:made").name == "made"
    for name, message in (
        ("nothing", "needs a `name` and a method"),
        ("other", "has no other"),
        ("Broken", r"ValueError: no \(mine.py, line 11\)"),
    ):
        with pytest.raises(SettingsError, match=message):
            load_estimator(f"{file}:{name}")
    with pytest.raises(SettingsError, match=r"there is no file .*none.py"):
        load_estimator(str(tmp_path / "none.py"))
    file.write_text("def")
    with pytest.raises(SettingsError, match=r"SyntaxError: [^()]*\(mine.py, line 1\)$"):
        load_estimator(f"{file}:Mine")
    with pytest.raises(SettingsError, match=r"say which class of .*mine.py; write .*mine.py:NAME"):
        load_estimator(f"{file}")
    with pytest.raises(SettingsError, match="say which class"):
        load_estimator(f"{file}:")
