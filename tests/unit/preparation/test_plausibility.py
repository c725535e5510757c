"""Faults put into a sound recording, and named from its start values."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kreisel.errors import ExcitationError, RecordingError, SynchronizationError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.preparation.acceleration_check import AccelerationFit
from kreisel.preparation.axis_order import angle, order
from kreisel.preparation.plausibility import _check_accelerometers, _check_lengths, check_start_values
from kreisel.preparation.prepare import prepare_recording
from kreisel.recording.header import HeaderUnits

from ...small_cell import simulate

DEG = np.pi / 180.0


@cache
def recorded(seed=1, seconds=30.0):
    return simulate(np.random.default_rng(seed), seconds, Path("run"), imu_rate=100.0)[1]


@cache
def sound():
    return prepare_recording(recorded(), CalibrationSettings())


def with_imu(**changed):
    recording = recorded()
    return replace(recording, imu=replace(recording.imu, **changed))


def with_poses(**changed):
    recording = recorded()
    return replace(recording, reference=replace(recording.reference, **changed))


def check(recording):
    check_start_values(prepare_recording(recording, CalibrationSettings()))


def with_fit(**changed):
    return replace(sound(), rate_fit=replace(sound().rate_fit, **changed))


def with_clock(**changed):
    return with_fit(clock=replace(sound().rate_fit.clock, **changed))


def refused(preparation, error=RecordingError):
    with pytest.raises(error) as caught:
        check_start_values(preparation)
    return str(caught.value)


def test_a_sound_recording_passes():
    check_start_values(sound())


def test_positions_alone_show_nothing_of_the_gyros():
    blind = replace(with_fit(K_omega=np.diag([1.0, 1.0, -7.0])), reference=replace(sound().reference, quaternions=None))
    check_start_values(blind)


# ---------------------------------------------------------------- gyros


@pytest.mark.parametrize(
    ("unit", "size"), [("deg s^-1", DEG), ("mdps", 1e-3 * DEG), ("deg/h", DEG / 3600.0)], ids=["deg", "mdps", "deg/h"]
)
def test_the_unit_of_the_gyros_is_named(unit, size):
    with pytest.raises(RecordingError) as caught:
        check(with_imu(rates=recorded().imu.rates / size))
    assert f"[{unit}]" in str(caught.value)
    assert caught.value.file == recorded().imu.source
    assert caught.value.line == 1


def test_rates_converted_though_they_were_radians_are_named():
    """The header says degrees, and the numbers were multiplied by pi / 180 for it."""
    imu = with_imu(rates=recorded().imu.rates * DEG, units=HeaderUnits(rate="deg/s"))
    with pytest.raises(RecordingError) as caught:
        check(imu)
    assert "[deg/s]" in str(caught.value)
    assert "[rad s^-1]" in str(caught.value)


@pytest.mark.parametrize(
    ("factors", "names"),
    [((1.0, 1.0, 1.0 / DEG), "w_z read 57.3"), ((1.0 / DEG, 1.0, 1.0 / DEG), "w_x and w_z read 57.3")],
)
def test_gyros_in_another_unit_than_the_others_are_named(factors, names):
    fit = sound().rate_fit
    mixed = with_fit(K_omega=fit.K_omega / factors, K_omega_sd=fit.K_omega_sd / factors)
    said = refused(mixed)
    assert names in said
    assert "look like deg s^-1" in said


def test_a_gyro_of_which_the_motion_shows_nothing_is_in_no_other_unit():
    fit = sound().rate_fit
    K, sd = fit.K_omega.copy(), fit.K_omega_sd.copy()
    K[:, 2] *= DEG
    sd[:, 2] = 0.2
    assert "too poor" in refused(with_fit(K_omega=K, K_omega_sd=sd), ExcitationError)


def test_angles_per_sample_are_named():
    with pytest.raises(RecordingError, match=r"0\.01 s"):
        check(with_imu(rates=recorded().imu.rates * recorded().imu.interval))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_axis_about_which_too_little_turned_is_named(axis):
    sd = np.full((3, 3), 0.01)
    sd[:, axis] = 0.2
    said = refused(with_fit(K_omega_sd=sd), ExcitationError)
    assert f"w_{'xyz'[axis]} " in said
    assert "20 %" in said
    sd[:, axis] = 0.14
    check_start_values(with_fit(K_omega_sd=sd))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_without_any_sensitivity_is_named(axis):
    K = np.eye(3)
    K[axis, axis] = 1e-3
    assert f"w_{'xyz'[axis]} " in refused(with_fit(K_omega=K), ExcitationError)


def test_gyros_off_by_factors_are_refused_with_them():
    said = refused(with_fit(K_omega=np.diag([1.0, 1.0, 0.25])))
    assert "1 to 4" in said
    assert "0.333 to 1" in refused(with_fit(K_omega=np.diag([1.0, 1.0, 3.0])))
    for factor in (0.45, 2.4):  # within the limits it is the sign that is named
        assert "left-handed" in refused(with_fit(K_omega=np.diag([1.0, 1.0, -factor])))


@pytest.mark.parametrize("flips", [[-1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]])
def test_gyros_of_a_left_handed_triad_are_named(flips):
    with pytest.raises(RecordingError, match="left-handed"):
        check(with_imu(rates=recorded().imu.rates * flips))


# ---------------------------------------------------------------- clocks


def drift(*shifts, sd=1e-4):
    return np.array([[10.0 * k, shift, sd] for k, shift in enumerate(shifts)])


@pytest.mark.parametrize("common", [0.0, 0.3])
def test_a_part_in_which_the_clocks_are_off_the_others_is_named(common):
    """Of the whole's own offset nothing is said: the median is taken off."""
    shifts = common + np.array([0.0, 1e-3, -25e-3, 0.0, 0.0])
    said = refused(with_fit(clock_drift=drift(*shifts)), SynchronizationError)
    assert " 20 s " in said
    assert "-25 ms" in said


@pytest.mark.parametrize(
    "parts",
    [
        drift(0.0, 0.0, 19e-3, 0.0),  # less than 20 ms
        drift(0.0, 0.0, 27e-3, 0.0, sd=3e-3),  # less than ten of its deviations
        drift(0.0, np.inf, 0.0, np.nan),
        drift(1.0, -1.0),  # of two nobody knows which is off
        np.zeros((0, 3)),
    ],
    ids=["small", "uncertain", "not known", "two", "none"],
)
def test_clocks_that_may_be_steady_pass(parts):
    check_start_values(with_fit(clock_drift=parts))


def test_stamps_rounded_to_ten_milliseconds_may_be_off_by_twice_that():
    found = sound().reference
    stamps = found.stamps_ns[0] + 10_000_000 * np.cumsum(np.resize([3, 4, 5], found.stamps_ns.size))
    rounded = replace(found, stamps_ns=stamps)
    for shift, bad in ((19e-3, False), (21e-3, True)):
        preparation = replace(with_fit(clock_drift=drift(0.0, 0.0, shift, 0.0)), reference=rounded)
        if bad:
            assert "21 ms" in refused(preparation, SynchronizationError)
        else:
            check_start_values(preparation)


def test_clocks_more_than_two_percent_apart_are_refused():
    assert "+2.40 %" in refused(with_clock(skew=0.024, skew_sd=1e-5), SynchronizationError)
    assert "-2.40 %" in refused(with_clock(skew=-0.024, skew_sd=1e-5), SynchronizationError)
    check_start_values(with_clock(skew=0.0219, skew_sd=0.0))
    check_start_values(with_clock(skew=0.024, skew_sd=1e-3))  # it may be less


# ---------------------------------------------------------------- accelerometers


def turned(caught):
    """The angle a message says, in degrees."""
    words = str(caught.value).split()
    return float(words[words.index("deg") - 1])


@pytest.mark.parametrize(
    ("write", "said", "degrees"),
    [
        (lambda a: -a, ["sign of all three", "+9.8"], None),
        (lambda a: a * [1.0, 1.0, -1.0], ["left-handed", "a_x lies along w_x", "-a_z lies along w_z"], None),
        (
            lambda a: a[:, [1, 0, 2]],
            ["left-handed", "a_y lies along w_x", "a_x lies along w_y", "a_z lies along w_z"],
            None,
        ),
        # what stands in column x is a_y: row by row, w_x finds its own in the last column
        (lambda a: a[:, [1, 2, 0]], ["a_z lies along w_x", "a_x lies along w_y", "a_y lies along w_z"], 120.0),
        (lambda a: a * [-1.0, -1.0, 1.0], ["-a_x lies along w_x", "-a_y lies along w_y"], 180.0),
    ],
    ids=["gravity", "one flipped", "two swapped", "cycled", "two flipped"],
)
def test_accelerometers_in_disorder_are_described(write, said, degrees):
    with pytest.raises(RecordingError) as caught:
        check(with_imu(accelerations=write(recorded().imu.accelerations)))
    for part in said:
        assert part in str(caught.value)
    if degrees is not None:
        assert turned(caught) == pytest.approx(degrees, abs=2.0)  # 8 mrad of misalignment in each of nine places
    assert caught.value.line == 1


def with_couplings(K, *, signed):
    """Return a fit of accelerometers with these couplings, good otherwise."""
    return AccelerationFit(K, np.full((3, 3), 1e-3), (0.0, np.inf), 1.0, 1.0, 1.0, signed=signed)


def test_accelerometers_are_not_accused_by_a_sign_that_positions_do_not_show():
    K = sound().rate_fit.K_omega
    _check_accelerometers(sound(), with_couplings(-K, signed=False))
    for wrong, signed in ((-K, True), (K[:, [1, 0, 2]], False), (-K[:, [1, 0, 2]], False)):
        with pytest.raises(RecordingError):
            _check_accelerometers(sound(), with_couplings(wrong, signed=signed))


@pytest.mark.parametrize(("degrees", "passes"), [(25.0, True), (40.0, False)])
def test_a_mount_of_its_own_is_not_disorder_until_thirty_degrees(degrees, passes):
    C = Rotation.from_rotvec(degrees * DEG * np.array([0.6, 0.0, 0.8])).as_matrix()
    recording = with_imu(accelerations=recorded().imu.accelerations @ C)
    if passes:
        check(recording)
    else:
        with pytest.raises(RecordingError) as caught:
            check(recording)
        assert turned(caught) == pytest.approx(degrees, abs=2.0)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1e3), ("cm", 100.0), ("ft", 3.281), ("km", 1e-3)])
def test_the_unit_of_the_positions_is_named(unit, factor):
    with pytest.raises(RecordingError) as caught:
        check(with_poses(positions=factor * recorded().reference.positions))
    assert f"[{unit}]" in str(caught.value)
    assert caught.value.file == recorded().reference.source


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_positions_off_by_no_units_factor_are_refused_with_it(factor):
    with pytest.raises(RecordingError) as caught:
        check(with_poses(positions=factor * recorded().reference.positions))
    words = str(caught.value).split()
    # fitted to a percent or two
    assert float(words[words.index("times") - 1]) == pytest.approx(factor, rel=0.04)


@pytest.mark.parametrize(
    ("bounds", "said"),
    [
        ((0.3, 0.5), "0.5 times"), ((1.4, 2.0), "1.4 times"), ((1.4, np.inf), "1.4 times"),  # the bound that is nearer
        ((0.5, 1.5), None), ((0.0, np.inf), None), ((1.05, 1.05), None), ((0.95, 0.95), None),
    ],
)  # fmt: skip
def test_positions_are_refused_only_where_both_bounds_lie_on_one_side(bounds, said):
    fit = AccelerationFit(np.eye(3), np.full((3, 3), 1e-3), bounds, 1.0, 1.0, 1.0)
    if said is None:
        _check_lengths(recorded().reference, fit, arm=False)
    else:
        with pytest.raises(RecordingError, match=said):
            _check_lengths(recorded().reference, fit, arm=False)


def test_positions_that_hardly_move_are_of_any_unit():
    fit = AccelerationFit(np.eye(3), np.full((3, 3), 1e-3), (0.01, 0.05), 1.0, 1.0, 0.01)
    _check_lengths(recorded().reference, fit, arm=False)


@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_a_few_percent_are_let_pass(factor):
    check(with_poses(positions=factor * recorded().reference.positions))


def test_positions_of_another_run_do_not_agree():
    with pytest.raises(RecordingError, match=r"agree by \d+ %.* 60 %") as caught:
        check(with_poses(positions=recorded(2).reference.positions))
    assert caught.value.file == recorded().reference.source


def test_accelerometers_that_do_not_work_do_not_agree():
    rng = np.random.default_rng(4)
    noise = rng.normal(0.0, 0.01, recorded().imu.accelerations.shape)
    with pytest.raises(RecordingError):
        check(with_imu(accelerations=noise))


def test_quaternions_only_accelerations_find_fault_with_are_named():
    """Scalar last and conjugated, they turn as the gyros do, about other axes of r."""
    longer = recorded(seconds=40.0)
    q = np.roll(longer.reference.quaternions * [1.0, -1.0, -1.0, -1.0], -1, axis=1)
    with pytest.raises(RecordingError, match="scalar last and conjugated"):
        check(replace(longer, reference=longer.reference.with_quaternions(q)))


# ---------------------------------------------------------------- words


def test_the_angle_of_a_turn_is_in_degrees():
    for degrees in (0.0, 30.0, 179.0):
        turn = Rotation.from_rotvec(degrees * DEG * np.array([0.36, 0.48, 0.8])).as_matrix()
        assert angle(turn) == pytest.approx(degrees, abs=1e-5)


def test_the_order_of_the_axes_is_that_of_the_largest_entries():
    F = np.array([[0.1, -0.9, 0.2], [0.0, 0.1, 1.0], [0.9, 0.3, 0.1]])
    assert order(F) == "-a_y lies along w_x, a_z lies along w_y, a_x lies along w_z"


def test_readings_without_gravity_are_named():
    """Those of the body when it is free of gravity: their lengths are those of its motion."""
    prepared = sound()
    windows = prepared.accelerometer_fit.windows
    down = np.einsum("nijk,jk->ni", windows.regressor[:, :, :9].reshape(-1, 3, 3, 3), prepared.rate_fit.K_omega).mean(
        axis=0
    )
    assert np.linalg.norm(down) == pytest.approx(9.81, abs=0.2)
    imu = prepared.recording.imu
    at = imu.accelerations - imu.accelerations.mean(axis=0)
    without = replace(
        prepared,
        recording=replace(prepared.recording, imu=replace(imu, accelerations=0.3 * at)),
        accelerometer_fit=replace(
            prepared.accelerometer_fit, windows=replace(windows, regressor=windows.regressor * 0.01)
        ),
    )
    assert "was gravity removed" in refused(without)
