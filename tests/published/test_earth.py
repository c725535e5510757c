"""Normal gravity: NIMA TR8350.2, third edition (2000), tables 3.3 and 3.4."""

import math

import pytest

from kreisel.inertial.earth import earth_rate_n, normal_gravity


@pytest.mark.parametrize(("latitude_deg", "gravity"), [(0.0, 9.7803253359), (90.0, 9.8321849378)])
def test_gravity_at_equator_and_pole(latitude_deg, gravity):
    # the last published digit is 1e-10 m/s^2
    assert normal_gravity(math.radians(latitude_deg)) == pytest.approx(gravity, abs=1e-9)


def test_free_air_gradient():
    # 0.3086 mGal/m, the usual figure for mid-latitudes; 0.0003 of it is its spread with latitude
    gradient = (normal_gravity(math.radians(45.0), 100.0) - normal_gravity(math.radians(45.0))) / 100.0
    assert gradient == pytest.approx(-3.086e-6, abs=5e-9)


def test_earth_rate_is_one_turn_in_a_sidereal_day():
    rate = earth_rate_n(math.radians(49.0))
    assert 2.0 * math.pi / math.hypot(*rate) == pytest.approx(86164.1, abs=0.1)  # s
    assert rate[2] < 0.0 < rate[0]  # north component up north, down component upwards
