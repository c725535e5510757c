"""Rates that a device sets to zero while it rests: not used beside a reference, and told from rounding."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.validation.checks import check_streams

from ...small_problem import recorded

QUIET = slice(1000, 1400)


@pytest.fixture(scope="module")
def recording():
    return recorded()[1]


def with_rates(recording, change):
    rates = recording.imu.rates.copy()
    change(rates)
    return replace(recording, imu=replace(recording.imu, rates=rates))


def silence(rates):
    rates[QUIET] = 0.0


def test_samples_of_silenced_gyros_are_not_used(recording):
    found = check_streams(with_rates(recording, silence))
    (text,) = [warning.message for warning in found.warnings if warning.subject == "silenced"]
    assert "exactly 0 in 10% of the samples, for up to 4 s" in text
    assert "line 1002" in text
    stamps = recording.imu.stamps_ns
    np.testing.assert_array_equal(found.imu.stamps_ns, np.delete(stamps, np.arange(stamps.size)[QUIET]))


@pytest.mark.parametrize("digit", [0.0, 0.05], ids=["as they are", "coarse digits"])
def test_zeros_by_rounding_are_readings(recording, digit):
    def rounded(rates):
        if digit:
            rates[:] = digit * np.round(rates / digit)

    found = check_streams(with_rates(recording, rounded))
    assert not [warning for warning in found.warnings if warning.subject == "silenced"]


def test_without_a_reference_nothing_is_left_out(recording):
    alone = replace(with_rates(recording, silence), reference=None, joints=None)
    assert check_streams(alone).imu.stamps_ns.size == recording.imu.stamps_ns.size
