"""IMUs of an array whose clocks depart from a straight line in a recording; and such whose clocks do not."""

import numpy as np
import pytest

from kreisel.array.unsteady_clock import unsteady_clock

from .test_sudden_change import RATE, T, units


def counted(rates, slope, number, lost, seed=3):
    """Let samples of one unit be lost whose stamps go on as if none were: later ones come too early, less a line."""
    late = np.cumsum(np.isin(np.arange(T.size), np.random.default_rng(seed).choice(T.size, lost, replace=False))) / RATE
    late -= np.polyval(np.polyfit(T, late, 1), T)
    rates[number] += late[:, None] * slope


@pytest.mark.parametrize("count", [2, 3, 8])
@pytest.mark.parametrize("bent", [0.0, 2e-5])
def test_steady_clocks_are_not_accused(count, bent):
    assert unsteady_clock(T, *units(count, bent=bent)) is None


@pytest.mark.parametrize(("count", "number"), [(2, 1), (3, 0), (4, 2), (8, 7)])
@pytest.mark.parametrize("lost", [6, 60])
def test_a_unit_that_lost_samples_without_a_gap_is_named(count, number, lost):
    rates, slope = units(count)
    counted(rates, slope, number, lost)
    found = unsteady_clock(T, rates, slope)
    assert found.number == number
    assert "its clock departs from a straight line by " in found.text


def test_spikes_are_no_clock():
    rates, slope = units(4)
    rates[1][::150] += 5.0
    assert unsteady_clock(T, rates, slope) is None
