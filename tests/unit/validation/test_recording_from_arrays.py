"""Recordings from arrays: the same as from files, and every bad argument is named."""

import numpy as np
import pytest

import kreisel
from kreisel.errors import RecordingError
from kreisel.validation.checks import check_streams

from ...small_problem import recorded


def arguments(**changed):
    r = recorded()[1]
    given = {
        "imu_stamps": r.imu.stamps_ns, "rates": r.imu.rates, "accelerations": r.imu.accelerations,
        "pose_stamps": r.reference.stamps_ns, "positions": r.reference.positions,
        "quaternions": r.reference.quaternions, "settings": r.settings,
    }  # fmt: skip
    return given | changed


def test_arrays_are_the_same_recording():
    want = check_streams(recorded()[1])
    got = kreisel.from_arrays(**arguments())
    for stream in ("imu", "reference"):
        np.testing.assert_array_equal(getattr(got, stream).stamps_ns, getattr(want, stream).stamps_ns)
    np.testing.assert_array_equal(got.imu.rates, want.imu.rates)
    np.testing.assert_array_equal(got.reference.quaternions, want.reference.quaternions)
    a, b = (kreisel.calibrate(one).sensors for one in (got, want))
    np.testing.assert_array_equal(a.K_omega, b.K_omega)
    assert got.imu.rates is not recorded()[1].imu.rates  # the caller may change theirs


def test_seconds_and_dates_are_stamps_too():
    stamps = recorded()[1].imu.stamps_ns
    for given in (stamps * 1e-9, stamps.astype("datetime64[ns]"), (stamps * 1e-9).tolist()):
        got = kreisel.from_arrays(**arguments(imu_stamps=given))
        assert np.abs(got.imu.stamps_ns - stamps).max() <= 120  # a double of a thousand seconds


def test_frames_of_pandas():
    pandas = pytest.importorskip("pandas")
    r = recorded()[1]
    frame = pandas.DataFrame(r.imu.rates, columns=["gx", "gy", "gz"]).assign(t=r.imu.stamps_ns)
    got = kreisel.from_arrays(**arguments(imu_stamps=frame["t"], rates=frame[["gx", "gy", "gz"]]))
    np.testing.assert_array_equal(got.imu.rates, r.imu.rates)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"rates": lambda x: x.T}, r"rates: got the shape \(3, 4001\), expected \(4001, 3\); transpose it"),
        ({"rates": lambda x: x[:-1]}, r"rates: got the shape \(4000, 3\)"),
        ({"accelerations": lambda x: [["a"] * 3] * 4001}, "accelerations: not an array of numbers"),
        ({"quaternions": lambda x: x[:, :3]}, r"quaternions: got the shape \(3326, 3\), expected \(3326, 4\)"),
        (
            {"positions": lambda x: np.where(np.arange(len(x))[:, None] > 7, np.nan, x)},
            r"without a number \(p_x = nan\)",
        ),
        ({"imu_stamps": lambda x: x.astype(float)}, "imu_stamps: floats are seconds, but the usual step is 1e[+]07 s"),
        ({"imu_stamps": lambda x: x // 10**6}, "imu_stamps: integers are nanoseconds, but the usual step is 10 ns"),
        ({"imu_stamps": lambda x: x.astype(str)}, "imu_stamps: got values of type <U"),
        ({"imu_stamps": lambda x: x[:, None]}, "imu_stamps: got the shape"),
        ({"pose_stamps": lambda x: None}, "pose_stamps: are missing"),
        ({"pose_stamps": lambda x: 1e-6 * (x - x[0])}, r"lasts .* s, imu .* s; they look like \[ms\]: give seconds"),
        ({"positions": lambda x: None, "quaternions": lambda x: None}, "positions, quaternions: are missing"),
        ({"rates": lambda x: np.degrees(x)}, r"they look like \[deg s\^-1\]; give them in rad/s"),
        ({"accelerations": lambda x: x / 9.81}, r"they look like \[g\]; give them in m/s\^2"),
        ({"positions": lambda x: x * 1e3}, r"they look like \[mm\]; give them in m"),
        ({"settings": lambda x: {"imu": {"grade": "best"}}}, "settings: .*unknown grade 'best'"),
        ({"imu_stamps": lambda x: (x * 1e-9).astype(np.float32)}, "imu_stamps: float32 resolves"),
        ({"rates": lambda x: np.ma.masked_array(x, x > 1.0)}, "rates: some values are masked"),
        ({"rates": lambda x: x + 0j}, "rates: complex numbers"),
        ({"joint_stamps": lambda _: np.arange(9)}, "joint_angles: are missing"),
        ({"settings": lambda x: {"imu": 3}}, "settings: imu = 3 is not accepted"),
    ],
)
def test_a_bad_argument_is_named(changed, words):
    given = arguments()
    given |= {name: change(given.get(name)) for name, change in changed.items()}
    with pytest.raises(kreisel.errors.KreiselError, match=words):
        kreisel.calibrate(kreisel.from_arrays(**given))


def test_a_fault_in_a_row_names_the_row():
    stamps = recorded()[1].imu.stamps_ns.copy()
    stamps[500] = stamps[499]
    with pytest.raises(RecordingError, match="<arrays>/imu: row 501: the stamp .* occurs twice"):
        kreisel.from_arrays(**arguments(imu_stamps=stamps))


def test_the_public_names_are_shown():
    assert dir(kreisel) == sorted(kreisel.__all__)
    assert {"Recording", "calibrate", "load"} <= set(dir(kreisel))
