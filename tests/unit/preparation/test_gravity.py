"""Gravity by what is stated of the site: its value, its uncertainty, and what is said of both."""

import math

import pytest

from kreisel.inertial.earth import normal_gravity
from kreisel.preparation.gravity import site_of
from kreisel.recording.recording_settings import SiteTable

EQUATOR_TO_POLE = (9.780, 9.832)


def site(**stated):
    found, warnings = site_of(SiteTable(**stated))
    return found, " ".join(map(str, warnings))


@pytest.mark.parametrize("height", [0.0, 300.0, 1500.0, 2240.0, 3640.0])
def test_a_latitude_without_height_covers_where_people_live(height):
    found, _ = site(latitude_deg=19.4)
    assert abs(found.gravity - normal_gravity(math.radians(19.4), height)) < 3.0 * found.gravity_sd
    assert found.gravity_sd < 4e-3


def test_a_height_leaves_the_anomaly():
    found, said = site(latitude_deg=49.26, height_m=250.0)
    assert found.gravity == pytest.approx(normal_gravity(math.radians(49.26), 250.0), abs=1e-12)
    assert 1e-4 < found.gravity_sd < 1e-3
    assert said == ""


@pytest.mark.parametrize("copied", [9.80665, 9.81, 9.8, 9.807])
def test_a_textbook_value_is_no_measurement(copied):
    found, said = site(gravity=copied)
    assert all(abs(g - found.gravity) < 2.5 * found.gravity_sd for g in EQUATOR_TO_POLE)
    assert "textbook" in said
    better, said = site(gravity=copied, latitude_deg=5.0)
    assert better.gravity == pytest.approx(normal_gravity(math.radians(5.0)), abs=2e-3)
    assert better.gravity_sd < 4e-3
    assert "textbook" in said or "contradict" in said or "but the latitude gives" in said


def test_a_value_of_the_place_is_taken():
    found, said = site(gravity=9.80936, latitude_deg=49.2571)
    assert (found.gravity, found.gravity_sd) == (9.80936, 3e-4)
    assert said == ""
    assert site(gravity=9.80936, gravity_sd=1e-5)[0].gravity_sd == 1e-5
    assert site(gravity=9.81, gravity_sd=1e-5)[0].gravity_sd == 1e-5


def test_a_value_that_contradicts_the_latitude_is_uncertain_by_the_difference():
    found, said = site(gravity=9.82345, latitude_deg=49.2571, height_m=200.0)
    assert found.gravity_sd == pytest.approx(abs(9.82345 - normal_gravity(math.radians(49.2571), 200.0)))
    assert "correct one of the two" in said


def test_nothing_stated_leaves_gravity_and_the_earths_rotation_open():
    found, said = site()
    assert all(abs(g - found.gravity) < 2.0 * found.gravity_sd for g in EQUATOR_TO_POLE)
    assert found.earth_rate_n is None
    assert found.known_earth_down == 0.0
    assert "latitude" in said
