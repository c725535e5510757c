"""A calibration applied to arrays: units of timestamps, and what is no possible argument."""

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kreisel.calibration.result import Calibration
from kreisel.calibration.result_document import from_document
from kreisel.calibration.result_sections import RecordingFacts
from kreisel.errors import RecordingError

N = 400
STEP_NS = 2_500_000
EPOCH_NS = 1_700_000_000_123_456_789
T = 1e-9 * STEP_NS * np.arange(N)
RATES = np.sin(np.outer(T, [3.0, 5.0, 7.0]))
FORCES = np.add(np.cos(np.outer(T, [2.0, 4.0, 6.0])), [0.0, 0.0, 9.8])


@pytest.fixture
def calibration() -> Calibration:
    table = {"cross_coupling": np.diag([1.1, 0.9, 1.0]).tolist(), "offset": [0.1, 0.2, 0.3]}
    arms = {"lever_arms": [[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3]]}
    document: dict[str, Any] = {"gyroscope": table, "accelerometer": table | arms, "verdict": {"accepted": True}}
    return Calibration(**vars(from_document(document)))


def refusal(calibration: Calibration, rates: Any = RATES, accelerations: Any = FORCES, timestamps: Any = T) -> str:
    with pytest.raises(RecordingError) as error:
        calibration.correct(rates, accelerations, timestamps)
    return str(error.value)


@pytest.mark.parametrize("kind", [np.int64, np.uint64])
@pytest.mark.parametrize("first", [0, EPOCH_NS])
def test_integers_are_nanoseconds_taken_exactly(calibration: Calibration, kind: type, first: int) -> None:
    want = calibration.correct(RATES, FORCES, T)
    got = calibration.correct(RATES, FORCES, first + STEP_NS * np.arange(N).astype(kind))
    for a, b in zip(got, want, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)


def test_lists_and_integers_of_32_bits_are_taken_too(calibration: Calibration) -> None:
    want = calibration.correct(RATES, FORCES, T)
    stamps = STEP_NS * np.arange(N, dtype=np.int32)
    for got in (calibration.correct(RATES.tolist(), FORCES.tolist(), T.tolist()),
                calibration.correct(RATES, FORCES, stamps)):  # fmt: skip
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-12)


def test_floats_since_1970_keep_a_fraction_of_a_microsecond(calibration: Calibration) -> None:
    want = calibration.correct(RATES, FORCES, T)
    got = calibration.correct(RATES, FORCES, 1.7e9 + T)
    np.testing.assert_allclose(got[1], want[1], rtol=0, atol=0.01)


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        (1e9 * T, "timestamps: floats are seconds, but the usual step is 2.5e+06 s; they look like nanoseconds"),
        (EPOCH_NS + 1e9 * T, "timestamps: floats are seconds, but the usual step is 2.5e+06 s"),
        (1e3 * T, "timestamps: floats are seconds, but the usual step is 2.5 s; give seconds"),
        (np.arange(N), "timestamps: integers are nanoseconds, but the usual step is 1 ns; give seconds as floats"),
        (T[:-1], "timestamps: got the shape (399,), expected (400,), one for each reading"),
        (T[:, None], "timestamps: got the shape (400, 1), expected (400,)"),
        (T[::-1], "timestamps[1] = 0.995 does not follow timestamps[0] = 0.9975; expected ascending stamps"),
        (np.where(T[7] == T, T[6], T), "timestamps[7] = 0.015 does not follow timestamps[6] = 0.015"),
        (np.array([5, 3, *range(6, 404)], dtype=np.uint64), "timestamps[1] = 3 does not follow timestamps[0] = 5"),
        (np.where(T[7] == T, np.nan, T), "timestamps[7] is nan; expected finite numbers"),
        (T.astype(str), "timestamps: got values of type <U"),
        (np.full(N, np.datetime64("NaT", "ns")), "timestamps: got values of type datetime64[ns]"),
        ((1.7e9 + T).astype(np.float32), "timestamps["),
        ((1e4 + T).astype(np.float32), "timestamps: float32 does not resolve steps of 0.00"),
    ],
)
def test_timestamps_that_cannot_be_are_refused(calibration: Calibration, stamps: Any, said: str) -> None:
    assert refusal(calibration, timestamps=stamps).startswith(said)


@pytest.mark.parametrize("name", ["rates", "accelerations"])
def test_readings_that_cannot_be_are_refused(calibration: Calibration, name: str) -> None:
    good = {"rates": RATES, "accelerations": FORCES}[name]
    holed = good.copy()
    holed[5, 2] = np.inf
    for values, said in (
        (good[:, :2], "got the shape (400, 2), expected (n, 3) with n = 6 or more"),
        (good.T, "got the shape (3, 400)"),
        (good[:5], "got the shape (5, 3)"),
        ([[1.0], [1.0, 2.0]], "not an array of numbers"),
        ("none", "not an array of numbers"),
        (good + 0j, "complex numbers"),
        (np.ma.masked_array(good, good > 0.5), "some values are masked"),
    ):  # fmt: skip
        assert refusal(calibration, **{name: values}).startswith(f"{name}: {said}")
    assert refusal(calibration, **{name: holed}).startswith(f"{name}[5, 2] is inf; expected finite numbers")


def test_readings_in_other_units_are_refused(calibration: Calibration) -> None:
    assert refusal(calibration, rates=np.degrees(RATES)).endswith("is above 40 rad/s; are they in deg/s?")
    assert refusal(calibration, accelerations=FORCES / 9.8).endswith("are they in g? Give m/s^2")
    spiked = RATES.copy()
    spiked[7] = 1e3
    calibration.correct(spiked, FORCES, T)
    calibration.correct(RATES[:50], 0.1 * FORCES[:50], T[:50])


def test_a_rejected_calibration_warns_unless_nothing_is_checked(calibration: Calibration) -> None:
    rejected = replace(calibration, verdict=replace(calibration.verdict, accepted=False, reasons=("it was dropped",)))
    with pytest.warns(UserWarning, match=r"this calibration was rejected \(it was dropped\)") as said:
        rejected.correct(RATES, FORCES, T)
    assert said[0].filename == __file__
    with pytest.warns(UserWarning, match="what it corrects may be wrong"):
        rejected.stream()
    rejected.correct(RATES, FORCES, T, check=False)
    rejected.stream(check=False)


def test_dates_are_moments_too(calibration: Calibration) -> None:
    dates = np.datetime64("2026-11-30T10:00:00", "ns") + STEP_NS * np.arange(N)
    for a, b in zip(calibration.correct(RATES, FORCES, dates), calibration.correct(RATES, FORCES, T), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)


def test_a_stream_takes_nanoseconds_alone_and_can_be_kept(calibration: Calibration) -> None:
    stamps = STEP_NS * np.arange(N)
    with pytest.raises(RecordingError, match="integers are nanoseconds, but the usual step is 2500 ns"):
        calibration.stream().push(RATES, FORCES, stamps // 1000)
    stream = calibration.stream()
    first = stream.push(RATES[:200], FORCES[:200], stamps[:200])
    stream = pickle.loads(pickle.dumps(stream))
    parts = [first, stream.push(RATES[200:], FORCES[200:], stamps[200:]), stream.close()]
    np.testing.assert_allclose(
        np.concatenate([part[2] for part in parts]), calibration.correct(RATES, FORCES, stamps)[1], rtol=0, atol=1e-9
    )


def test_samples_that_arrive_at_once_are_no_other_unit(calibration: Calibration) -> None:
    """One by one, as a callback gets them; few of another unit are refused at the end."""
    stamps = STEP_NS * np.arange(N)
    stamps[50] = stamps[49] + 5_000
    stream = calibration.stream()
    for k in range(N):
        stream.push(RATES[k : k + 1], FORCES[k : k + 1], stamps[k : k + 1])
    short = calibration.stream()
    short.push(RATES[:50], FORCES[:50], stamps[:50] // 1000)
    with pytest.raises(RecordingError, match="the usual step is 2500 ns"):
        short.close()


def test_temperatures_are_in_degrees_celsius(calibration: Calibration) -> None:
    warm = {"temperature": [1e-5] * 3}
    table = {"cross_coupling": np.eye(3).tolist(), "offset": [0.0] * 3}
    arms = {"lever_arms": np.zeros((3, 3)).tolist()}
    document: dict[str, Any] = {
        "gyroscope": table | warm, "accelerometer": table | arms, "verdict": {"accepted": True},
    }  # fmt: skip
    facts = RecordingFacts("r", "", N, 400.0, 0, 1.0, temperature_c=25.0)
    found = replace(Calibration(**vars(from_document(document))), recording=facts)
    found.correct(RATES, FORCES, T, np.full(N, 30.0))
    for given, said in (
        (np.full(N, 303.0), "temperatures: 303 degC is that of no sensor"),
        (["cold"] * N, "temperatures: not an array of numbers"),
    ):
        with pytest.raises(RecordingError, match=said):
            found.correct(RATES, FORCES, T, given)


def test_calibrations_are_compared_by_identity(calibration: Calibration) -> None:
    assert calibration == calibration
    assert calibration != replace(calibration)
    assert len({calibration, replace(calibration)}) == 2


def test_arrays_of_different_lengths_are_refused(calibration: Calibration) -> None:
    said = refusal(calibration, accelerations=FORCES[:-1])
    assert said == "accelerations: got the shape (399, 3), expected (400, 3) as of rates"
