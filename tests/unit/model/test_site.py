"""The Earth's rotation in the units of its parameters."""

import math

import numpy as np
import pytest

from kreisel.inertial.earth import EARTH_RATE, earth_rate_n
from kreisel.model.site import Site


@pytest.mark.parametrize("latitude", [-1.2, -0.3, 0.0, 0.86])
@pytest.mark.parametrize("heading", [-2.0, 0.4])
def test_with_a_latitude_a_unit_vector_of_north_and_one_downward_are_the_earths_rotation(latitude, heading):
    """(7): components in a level frame whose first axis lies `heading` from north."""
    site = Site(9.81, 0.01, earth_rate_n(latitude))
    level, down = site.earth_rate_units
    north = np.array([math.cos(heading), -math.sin(heading)])  # true north, in the axes of that frame
    rate = np.array([*(level * north), down * site.known_earth_down])
    turn = np.array(
        [[math.cos(heading), -math.sin(heading), 0.0], [math.sin(heading), math.cos(heading), 0.0], [0, 0, 1]]
    )
    axis = np.array([math.cos(latitude), 0.0, -math.sin(latitude)])  # of the Earth, in north, east, down
    np.testing.assert_allclose(turn @ rate, 7.292115e-5 * axis, rtol=0.0, atol=1e-18)


def test_without_a_latitude_both_units_are_the_earths_rate_and_nothing_is_known_of_its_downward_part():
    site = Site(9.81, 0.01, None)
    assert site.earth_rate_units == (EARTH_RATE, EARTH_RATE)
    assert site.known_earth_down == 0.0
