"""A recording made ready stretch by stretch is the recording made ready at once."""

import numpy as np
import pytest

from kreisel.inertial import readings as module
from kreisel.inertial.effects import features_of
from kreisel.inertial.readings import Readings, attitudes_at
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.inertial.strapdown import integrate_attitude, prepare

from ...navigation import SensorColumns, preintegrate

SEGMENTS = ((0, 1499), (1520, 3999))


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CHUNK", 1024)


def some(segments: tuple[tuple[int, int], ...] = SEGMENTS) -> Readings:
    rng = np.random.default_rng(3)
    stamps = np.cumsum(rng.uniform(0.0024, 0.0026, 4000))
    t = stamps[:, None]
    rates = np.sin(t * [2.0, 3.0, 5.0]) + rng.normal(0.0, 1e-3, (4000, 3))
    forces = np.cos(t * [3.0, 1.0, 2.0]) + np.array([0.0, 0.0, 9.8])
    return Readings(stamps, rates, forces, segments, noise=rng.uniform(1e-6, 1e-5, (4, 3)))


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize(
    ("first", "last"), [(0, 190), (900, 1023), (1000, 1100), (1021, 1024), (3060, 3300), (3900, 3999)]
)
def test_increments_are_the_same_to_the_last_bit(first: int, last: int) -> None:
    r = some()
    whole = prepare(r.stamps, r.rates, r.accelerations, segments=r.segments, noise=r.noise)
    columns = SensorColumns.single(SensorParameters.ideal(1), SizeEffect.COMPLETED)
    part, until = r.holding(first, last)
    assert last <= until
    assert part.stamps.size <= 1024 + 1024 // 4 + 12
    got = preintegrate(part, first - part.begin, last - part.begin, columns).motion
    expected = preintegrate(whole, first, last, columns).motion
    for name in ("dq", "dv", "dp", "omega_end", "alpha_end", "u_path"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name), err_msg=name)


@pytest.mark.usefixtures("short")
def test_stretches_cover_everything_and_some_are_spread_evenly() -> None:
    r = some()
    begins = [part.begin for part in r.chunks()]
    assert begins == [0, *(k * 1024 - module._REACH for k in (1, 2, 3))]
    ends = [part.begin + part.stamps.size for part in r.chunks()]
    assert ends == [*(k * 1024 + module._REACH + 1 for k in (1, 2, 3)), 4000]


def test_raw_chunks_have_the_features_and_integrals_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_RAW_CHUNK", 700)
    r = some()
    sizes = {"gyro_axis_smoothing": 3, "gyro_asymmetry": 3}
    whole = prepare(r.stamps, r.rates, r.accelerations, segments=r.segments, estimated=sizes).samples
    features, integrals, last = [], [], 0
    for chunk in r.raw_chunks():
        own = features_of(chunk.readings, sizes, "gyroscope")
        assert chunk.first == last
        last = chunk.last
        features.append(chunk.own(own)[:, :-1])
        integrals.append(chunk.integrals(own))
    assert last == 3999
    np.testing.assert_array_equal(np.hstack(features), whole.rates[4:, :-1])
    np.testing.assert_array_equal(np.hstack(integrals), whole.integrals[4:])


@pytest.mark.usefixtures("short")
def test_an_excerpt_lies_where_it_is_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    r = some()
    monkeypatch.setattr(module, "EXCERPT", 2)
    assert [part.begin for part in r.excerpt(-1.0, 100.0)] == [0, 3072 - module._REACH]
    at = r.stamps[1500]
    assert [part.begin for part in r.excerpt(at, at + 0.1)] == [1024 - module._REACH]
    assert [part.begin for part in r.excerpt(at, r.stamps[2500])] == [1024 - module._REACH, 2048 - module._REACH]
    assert list(r.excerpt(50.0, 60.0)) == []


@pytest.mark.usefixtures("short")
def test_a_motion_longer_than_a_stretch_is_made_ready_as_a_whole() -> None:
    part, until = some().holding(500, 3500)
    assert (part.begin, until) == (500 - module._REACH, 3500)


@pytest.mark.usefixtures("short")
def test_only_a_few_stretches_are_held() -> None:
    r = some()
    for _ in r.chunks():
        r.holding(1000, 1100)
    assert len(r._prepared.chunks) <= module._HELD


def test_readings_with_effects_are_prepared_once() -> None:
    r = some()
    effects = [{"gyro_g_sensitivity": np.full(9, size)} for size in (0.0, 1e-3, 2e-3)]
    plain, one, two = (r.with_effects({}, applied) for applied in effects)
    assert plain is r
    (first, *_), (bent, *_) = plain.chunks(), one.chunks()
    assert (bent.rates != first.rates).any()
    again = r.with_effects({}, {"gyro_g_sensitivity": np.full(9, 1e-3)}).with_noise(2.0, 1.0)
    assert next(again.chunks()).samples.rates is bent.samples.rates
    assert next(two.chunks()).samples.rates is not bent.samples.rates
    assert next(r.with_effects({"gyro_g_sensitivity": 9}, effects[1]).chunks()).samples.rates.shape[0] == 7
    assert len(r._family) == module._FAMILY
    np.testing.assert_array_equal(next(plain.chunks()).rates, first.rates)
    other = one.with_values(rates=r.rates + 1.0)
    np.testing.assert_allclose(next(other.chunks()).rates, bent.rates + 1.0)


@pytest.mark.usefixtures("short")
def test_attitudes_are_carried_from_stretch_to_stretch() -> None:
    r = some(((0, 3999),))
    rate = np.vstack([[0.01, 0.02, -0.01], np.eye(3)])
    samples = np.array([0, 5, 1018, 1023, 1030, 2047, 2048, 3999])
    whole = integrate_attitude(prepare(r.stamps, r.rates, r.accelerations), rate)
    np.testing.assert_allclose(attitudes_at(r, rate, samples), whole[samples], atol=1e-9)


def test_noise_is_scaled_by_deviations_and_not_in_what_is_held() -> None:
    r = some()
    before, _ = r.holding(0, 100)
    louder = r.with_noise(2.0, 3.0)
    after, _ = louder.holding(0, 100)
    np.testing.assert_allclose(after.samples.noise, before.samples.noise * np.array([4.0, 9.0, 2.0, 3.0])[:, None])
    np.testing.assert_array_equal(r.holding(0, 100)[0].samples.noise, r.noise)
