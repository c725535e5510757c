"""The linear part of a result with further terms, against a regression of what it makes of the readings."""

from dataclasses import replace

import numpy as np

from kreisel.inertial.correction import Block, corrected
from kreisel.inertial.sensor_model import SizeEffect
from kreisel.study.linear_part import with_linear_part

from ...small_problem import calibrated


def with_terms():
    """A calibration whose gyros have two further terms, of sizes that no estimate gave them."""
    outcome = calibrated()
    others = {"gyro_asymmetry": np.array([2e-3, -1e-3, 5e-4]), "gyro_g_sensitivity": np.arange(9.0) * 1e-5}
    sensors = replace(outcome.calibration.sensors, others={**outcome.calibration.sensors.others, **others})
    return replace(outcome, calibration=replace(outcome.calibration, sensors=sensors)), others


def test_it_is_the_best_linear_description_of_the_corrected_rates():
    outcome, _ = with_terms()
    imu, found = outcome.recording.imu, with_linear_part(outcome, {}).sensors
    seconds = (imu.stamps_ns - imu.stamps_ns[0]) * 1e-9
    block = Block(seconds, imu.rates, imu.accelerations)
    whole = corrected(block, outcome.calibration.sensors, SizeEffect.COMPLETED).rates
    rates = imu.rates
    products = np.stack([rates[:, i] * rates[:, k] for i in range(3) for k in range(i, 3)], axis=1)
    slopes = np.gradient(rates, seconds, axis=0)
    basis = np.hstack([np.ones((seconds.size, 1)), rates, imu.accelerations, slopes, products])
    share = np.linalg.lstsq(basis, whole, rcond=None)[0]
    np.testing.assert_allclose(found.K_omega, share[1:4].T, atol=2e-6)
    np.testing.assert_allclose(found.K_omega @ found.k_w[0], share[0], atol=2e-7)
    assert not np.allclose(found.k_w[0], outcome.calibration.sensors.k_w[0], atol=1e-5)


def test_terms_that_the_device_has_count_on_both_sides():
    outcome, others = with_terms()
    found = with_linear_part(outcome, others).sensors
    np.testing.assert_allclose(found.K_omega, outcome.calibration.sensors.K_omega, atol=1e-12)
    np.testing.assert_allclose(found.k_w[0], outcome.calibration.sensors.k_w[0], atol=1e-12)


def test_deviations_stay_where_no_further_term_is_estimated():
    outcome, _ = with_terms()
    sd, before = with_linear_part(outcome, {}).sensor_sd, outcome.calibration.sensor_sd
    np.testing.assert_allclose(sd.K_omega, before.K_omega)
    np.testing.assert_allclose(sd.k_w[0], before.k_w[0])
