"""Verdicts of units: columns in the wrong order or with wrong signs are a reason against one unit, not the others."""

import numpy as np
import pytest

from kreisel.array.unit_verdict import UnitFindings, unit_verdict
from kreisel.calibration.result_sections import Verdict
from kreisel.inertial.sensor_model import SensorParameters

ACCEPTED = Verdict(True, (), sensors={"gyroscope": "accepted", "accelerometer": "accepted"})


def findings(K_omega=np.eye(3), K_a=np.eye(3)):
    zero = np.zeros((1, 3))
    sensors = SensorParameters(np.array(K_omega), zero, np.array(K_a), zero, np.zeros((3, 3)))
    return UnitFindings(None, False, None, 0.0, {}, sensors)


def test_a_unit_without_findings_has_the_verdict_of_the_mean():
    assert unit_verdict(ACCEPTED, findings(1.02 * np.eye(3))) is ACCEPTED
    turned = np.roll(np.eye(3), 1, axis=0)
    assert unit_verdict(ACCEPTED, findings(turned, turned)) is ACCEPTED


@pytest.mark.parametrize(
    ("K_omega", "K_a", "said"),
    [
        (np.eye(3), np.eye(3)[[1, 0, 2]], "a_y lies along w_x, a_x lies along w_y, a_z lies along w_z"),
        (np.eye(3), -np.eye(3), "the accelerometers form a left-handed triad"),
        (np.diag([1.0, 1.0, -1.0]), np.eye(3), "the gyro axes form a left-handed triad"),
        (np.eye(3), np.diag([-1.0, -1.0, 1.0]), "rotated by 180 deg against the gyros"),
    ],
)
def test_axes_in_disorder_are_a_reason(K_omega, K_a, said):
    got = unit_verdict(ACCEPTED, findings(K_omega, K_a))
    assert not got.accepted
    assert said in got.reasons[-1]
    assert set(got.sensors.values()) == {"rejected"}
