"""The fused IMU: its noise, its errors against the truth, foreign clocks, gaps, and units that do not belong to it."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.array.clock_refinement import refined_clock
from kreisel.array.fused_imu import UnitReadings, fuse
from kreisel.array.lower_rate import smoothed, window_for
from kreisel.array.rest_density import standstills
from kreisel.errors import RecordingError
from kreisel.geometry.rotation import exp, matrix
from kreisel.synchronization.clock import Clock

from ...moving_tray import NOISE, RATE, START_NS, Motion, devices, moved

SECONDS = 120.0
UNITS = devices()
MOTION = Motion()


def part(imu, keep):
    return replace(imu, stamps_ns=imu.stamps_ns[keep], rates=imu.rates[keep], accelerations=imu.accelerations[keep])


def readings(units=UNITS, motion=MOTION, noise=1.0):
    return {unit.name: unit.record(motion, SECONDS, noise=noise) for unit in units}


def fused(raw, units=UNITS):
    return fuse([UnitReadings.of(unit.name, raw[unit.name], unit.calibration) for unit in units])


def errors(stamps_ns, rates, forces, motion=MOTION):
    """Return true times on the clock of the first unit, and errors of rates and forces."""
    t = (stamps_ns - START_NS) * 1e-9
    omega, _, f = motion.at(t)
    return t, rates - omega, forces - f


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


def density(x, seconds=0.1):
    """Return a noise density by averages, which interpolation and derivatives hardly touch."""
    n = round(seconds * RATE)
    return rms(x[: len(x) // n * n].reshape(-1, n, 3).mean(axis=1)) * seconds**0.5


@pytest.fixture(scope="module")
def whole():
    return fused(readings())


def test_noise_falls_with_the_sum_of_inverse_variances_at_rest_and_in_motion(whole):
    best = np.sum(NOISE**-2.0, axis=0) ** -0.5
    t, w, f = errors(whole.stamps_ns, whole.rates, whole.forces)
    assert whole.at_rest
    assert whole.lost == 0
    np.testing.assert_allclose([unit.density for unit in whole.units], NOISE, rtol=0.08)
    np.testing.assert_allclose(whole.predicted, best, rtol=0.08)
    np.testing.assert_allclose(whole.measured, best, rtol=0.1)
    for still in (True, False):
        assert density(w[moved(t) != still]) == pytest.approx(best[0], rel=0.1)
    # at shorter times the angular acceleration's noise at the lever arms counts
    assert density(f, 0.5) == pytest.approx(best[1], rel=0.1)


def test_weights_are_those_of_inverse_variances(whole):
    np.testing.assert_allclose(np.sum([unit.weight for unit in whole.units], axis=0), 1.0)
    right = NOISE**-2.0 / np.sum(NOISE**-2.0, axis=0)
    np.testing.assert_allclose([unit.weight for unit in whole.units], right, atol=0.05)


def test_errors_are_smaller_than_those_of_every_unit(whole):
    _, w, f = errors(whole.stamps_ns, whole.rates, whole.forces)
    for unit in UNITS:
        raw = unit.record(MOTION, SECONDS)
        omega, a = unit.calibration.correct(raw.rates, raw.accelerations, raw.stamps_ns)
        own = np.arange(raw.stamps_ns.size) + unit.phase
        true = MOTION.at(own / RATE)
        assert rms(w) < 0.8 * rms(omega - true[0])
        assert rms(f) < 0.8 * rms(a - true[2])


def test_clocks_are_found_to_a_thousandth_of_a_sample_and_do_no_harm():
    """Without noise what is left is the interpolation, and the drift of the base's clock, which is true here."""
    out = fused(readings(noise=1e-3))
    for unit, device in zip(out.units, UNITS, strict=True):
        t = np.array([0.0, SECONDS])
        stamped = t + device.offset + device.drift * t
        first = device.phase / RATE * (1.0 + device.drift) + device.offset
        found = stamped + unit.offset + unit.clock.skew * (stamped - first)
        assert np.abs(found - t).max() < 1e-3 / RATE, unit.name
    _, w, f = errors(out.stamps_ns, out.rates, out.forces)
    assert rms(w) < 2e-5
    assert rms(f) < 2e-3


def test_a_clock_refined_from_milliseconds_off_has_errors_within_its_deviations():
    base, unit = (UnitReadings.of(u.name, u.record(MOTION, SECONDS), u.calibration) for u in UNITS[:2])
    start = (UNITS[1].phase - UNITS[0].phase) / RATE
    true = Clock(start, 1.0 / (1.0 + UNITS[1].drift) - 1.0)
    for off, skew in ((0.004, 0.0), (-0.007, 1e-4)):
        found = refined_clock(unit.imu, Clock(true.start + off, true.skew + skew), base.imu)
        assert found.clock.start_sd < 5e-5
        assert abs(found.clock.start - true.start) < 4.0 * found.clock.start_sd
        assert abs(found.clock.skew - true.skew) < 4.0 * found.clock.skew_sd
        assert found.turned < 0.002
        assert found.explained > 0.99


def test_units_of_other_sample_rates_lower_the_noise_by_all_their_samples():
    rates = (RATE, 0.5 * RATE, 2.0 * RATE, 4.0 * RATE)
    raw = {unit.name: unit.record(MOTION, SECONDS, rate=rate) for unit, rate in zip(UNITS, rates, strict=True)}
    out = fused(raw)
    np.testing.assert_allclose([unit.density for unit in out.units], NOISE, rtol=0.12)
    _, w, f = errors(out.stamps_ns, out.rates, out.forces)
    best = np.sum(NOISE**-2.0, axis=0) ** -0.5
    assert density(w) == pytest.approx(best[0], rel=0.1)
    assert density(f, 0.5) == pytest.approx(best[1], rel=0.1)


def test_smoothed_readings_are_the_true_ones_also_beside_a_gap():
    imu = UNITS[1].record(MOTION, 20.0, noise=0.0, rate=800.0)
    keep = np.ones(imu.stamps_ns.size, dtype=bool)
    keep[8000:8200] = False
    imu = part(imu, keep)
    window = window_for(imu, 1.0 / RATE)
    assert (window, window_for(imu, 1.0 / 800.0)) == (9, 1)
    found, done = smoothed(imu, window)
    assert 0 < int(np.sum(~done)) <= 4 * (window - 1)
    np.testing.assert_allclose(found.stamps_ns, imu.stamps_ns, atol=2)
    np.testing.assert_allclose(found.rates, imu.rates, atol=2e-5)
    few, none = smoothed(part(imu, np.arange(5)), window)
    assert (few.stamps_ns.size, none.any()) == (5, False)


@pytest.mark.parametrize("name", ["imu0", "imu2"])
def test_a_gap_is_bridged_by_the_others(name):
    raw = readings()
    n = raw[name].stamps_ns.size
    keep = np.ones(n, dtype=bool)
    keep[n // 2 : n // 2 + 700] = False
    raw[name] = part(raw[name], keep)
    out = fused(raw)
    t, w, f = errors(out.stamps_ns, out.rates, out.forces)
    assert np.diff(out.stamps_ns).max() < 1.01e9 / RATE
    assert out.stamps_ns.size == pytest.approx(n, abs=2)
    inside = (t > 0.5 * SECONDS) & (t < 0.5 * SECONDS + 3.5)
    others = np.sum(np.delete(NOISE, int(name[3:]), axis=0) ** -2.0, axis=0) ** -0.5
    assert density(w[inside]) < 1.3 * others[0]
    assert density(f[inside]) < 1.3 * others[1]
    share = {unit.name: unit.share for unit in out.units}
    assert share[name] == pytest.approx(1.0 - 700 / n, abs=0.002)


def test_clipped_samples_are_those_of_the_others():
    raw = readings()
    largest = 0.8 * np.abs(raw["imu1"].rates).max()
    raw["imu1"] = replace(raw["imu1"], rates=np.clip(raw["imu1"].rates, -largest, largest))
    out = fused(raw)
    t, w, _ = errors(out.stamps_ns, out.rates, out.forces)
    assert density(w[moved(t)]) < 1.3 * float(np.sum(NOISE**-2.0, axis=0)[0] ** -0.5)
    assert out.units[1].share < 1.0


def test_a_unit_that_moves_by_itself_is_left_out():
    raw = readings()
    raw["imu2"] = UNITS[2].record(Motion(seed=9), SECONDS)
    out = fused(raw)
    assert [unit.name for unit in out.units] == ["imu0", "imu1", "imu3"]
    assert "imu0" in out.left_out["imu2"]


def dead_axis(imu):
    forces = imu.accelerations.copy()
    forces[:, 1] = 0.0
    return replace(imu, accelerations=forces)


def other_offsets(imu):
    return replace(imu, rates=np.add(imu.rates, [0.02, 0, 0]), accelerations=np.add(imu.accelerations, [1, 0, 0]))


@pytest.mark.parametrize("changed", [dead_axis, other_offsets])
def test_a_unit_whose_corrected_readings_differ_from_all_others_is_left_out(changed):
    raw = readings()
    name = UNITS[1].name
    got = fused({**raw, name: changed(raw[name])})
    assert list(got.left_out) == [name]
    assert "its corrected forces differ from those of the others by" in got.left_out[name]


@pytest.mark.parametrize("changed", ["spikes", "zeros"])
def test_spikes_and_rates_that_are_set_to_zero_do_not_go_into_the_mean(whole, changed):
    raw = readings()
    name = UNITS[1].name
    rates, forces = raw[name].rates.copy(), raw[name].accelerations.copy()
    if changed == "spikes":
        forces[500 : forces.shape[0] - 500 : 400, 1] += 50.0
    else:
        rates[np.abs(rates).max(axis=1) < 0.05] = 0.0
    got = fused({**raw, name: replace(raw[name], rates=rates, accelerations=forces)})
    assert not got.left_out
    _, w, f = errors(got.stamps_ns, got.rates, got.forces)
    _, right_w, right_f = errors(whole.stamps_ns, whole.rates, whole.forces)
    assert np.abs(w).max() < 1.5 * np.abs(right_w).max()
    assert np.abs(f).max() < 1.5 * np.abs(right_f).max()


def test_if_the_first_one_moves_by_itself_the_next_one_is_the_base():
    raw = readings()
    raw["imu0"] = UNITS[0].record(Motion(seed=9), SECONDS)
    out = fused(raw)
    assert [unit.name for unit in out.units] == ["imu1", "imu2", "imu3"]
    assert out.document["reference"] == "imu1"
    assert out.left_out.keys() == {"imu0"}


def test_a_unit_that_was_turned_on_its_mount_is_left_out():
    p = UNITS[3].calibration.sensors
    turned = replace(p, K_omega=matrix(exp(np.array([0.0, 0.05, 0.0]))) @ p.K_omega)
    calibration = replace(UNITS[3].calibration, sensors=turned)
    raw = readings()
    out = fused(raw, (*UNITS[:3], replace(UNITS[3], calibration=calibration)))
    assert [unit.name for unit in out.units] == ["imu0", "imu1", "imu2"]
    assert "turned on its mount" in out.left_out["imu3"]


def test_without_standstills_densities_are_by_third_differences():
    motion = Motion(rests=False)
    out = fused(readings(motion=motion))
    assert (out.at_rest, out.measured, out.document["fused"]["noise_density"]) == (False, None, None)
    np.testing.assert_allclose([unit.density for unit in out.units], NOISE, rtol=0.1)
    _, w, _ = errors(out.stamps_ns, out.rates, out.forces, motion)
    assert density(w) == pytest.approx(float(np.sum(NOISE**-2.0, axis=0)[0] ** -0.5), rel=0.1)


def test_one_unit_is_none_to_be_fused():
    with pytest.raises(RecordingError, match="no two units move together: there is one unit only"):
        fused(readings(UNITS[:1]), UNITS[:1])
    raw = readings(UNITS[:2])
    raw["imu1"] = UNITS[1].record(Motion(seed=9), SECONDS)
    with pytest.raises(RecordingError, match="no two units move together: imu1: "):
        fused(raw, UNITS[:2])


def test_standstills_are_the_true_ones():
    t = np.arange(round(SECONDS * RATE)) / RATE
    rng = np.random.default_rng(5)
    known = np.ones(t.size, dtype=bool)
    rates = MOTION.at(t)[0] + rng.normal(0.0, 1e-3, (t.size, 3))
    found = standstills(t, [rates], known)
    assert found.pairs.size > 200
    samples = found.pairs[:, None] * found.width + np.arange(2 * found.width)
    assert np.abs(MOTION.at(t[samples.ravel()])[0]).max() < 1e-3
    assert found.density(rates, np.zeros(t.size, dtype=bool)) is None


def test_slow_motion_that_accelerometers_alone_show_is_no_standstill():
    """Half of the time the body turns too slowly for its gyros; densities are those of the noise nevertheless."""
    t = np.arange(round(SECONDS * RATE)) / RATE
    rng = np.random.default_rng(6)
    slow = np.where(t % 8.0 > 4.0, t % 4.0, 0.0)[:, None] * [1e-2, 0.0, 0.0]
    rates, forces = (rng.normal(0.0, size, (t.size, 3)) for size in (1e-3, 5e-3))
    known = np.ones(t.size, dtype=bool)
    found = standstills(t, [rates, forces + slow], known)
    assert found.density(forces + slow, known) == pytest.approx(5e-3 * RATE**-0.5, rel=0.1)
