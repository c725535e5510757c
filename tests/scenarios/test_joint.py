"""One calibration from several recordings of one device: against the truth, and against one long recording."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import calibrate
from kreisel.calibration.joint import calibrate_joint
from kreisel.calibration.result import Calibration
from kreisel.errors import SettingsError
from kreisel.recording.recording import Recording
from kreisel.report.joint_page import write_joint
from kreisel.simulation.cell import Truth, simulate
from kreisel.simulation.cell_settings import parse_cell
from kreisel.study.truth_comparison import group_errors

MOUNTS = {1: ([0.0, 0.0, 0.0], [0.02, 0.03, 0.08]), 2: ([40.0, -30.0, 10.0], [0.05, 0.03, 0.02])}


@cache
def recorded(
    run: int, seconds: float = 60.0, mount: int = 1, seed: int = 21, **reference: object
) -> tuple[Truth, Recording]:
    turn, arm = MOUNTS[mount]
    cell = {
        "seed": seed, "run": run, "seconds": seconds, "reference": {"kind": "mocap", **reference},
        "imu": {"grade": "consumer-mems", "mounting_deg": turn, "lever_arm": arm},
    }  # fmt: skip
    return simulate(parse_cell(cell, Path("CELL.toml")), Path(f"run{run}"))


def worst(calibration: Calibration, truth: Truth) -> dict[str, float]:
    return {name: float(np.max(np.abs(g.error / g.deviation))) for name, g in group_errors(calibration, truth).items()}


@pytest.mark.parametrize("mount", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_recordings_fit_together_and_the_truth(mount):
    truth, first = recorded(1)
    others = [recorded(run, mount=mount)[1] for run in (2, 3)]
    joint = calibrate_joint([first, *others])
    found = joint.calibration
    assert found.accepted
    assert found.joint.factor == 1.0
    assert 0.5 < found.joint.chi_square / found.joint.degrees < 1.4
    assert max(worst(found, truth).values()) < 4.5
    alone = calibrate(first)
    assert (found.sensor_sd.K_omega < alone.sensor_sd.K_omega).all()
    for one in found.joint.recordings[1:]:
        turn = np.radians(MOUNTS[mount][0])
        assert np.max(np.abs(one.turn.value - turn) / one.turn.deviation) < 4.5


@pytest.mark.slow
def test_recordings_together_are_worth_more_than_the_sum_of_their_information():
    truth, _ = recorded(1)
    together = [recorded(run)[1] for run in (1, 2, 3)]
    joint = calibrate_joint(together, common=("robot", "site", "reference", "offsets", "mount")).calibration
    assert max(worst(joint, truth).values()) < 4.5
    each = [calibrate(one) for one in together]
    for name in ("K_omega", "K_a", "lever_arms"):
        # offsets and mount, which each finds for itself, are common
        alone = np.sum([getattr(one.sensor_sd, name) ** -2.0 for one in each], axis=0) ** -0.5
        assert 0.8 < np.mean(getattr(joint.sensor_sd, name)) / np.mean(alone) < 1.0


@pytest.mark.slow
def test_gravity_counts_once():
    together, apart = (
        calibrate_joint([recorded(run)[1] for run in (1, 2, 3)], common=common).calibration
        for common in (("robot", "site", "reference"), ("robot", "reference"))
    )
    scale, loose = (c.derived["accel_scale_error_ppm"].deviation for c in (together, apart))
    assert (loose < scale).all()
    _, first = recorded(1)
    gravity = 3e-4 / 9.81  # what the latitude tells
    assert (scale * 1e-6 > gravity).all()
    assert first.settings.site.latitude_deg is not None


def test_another_device_is_noticed():
    joint = calibrate_joint([recorded(1)[1], recorded(2)[1], recorded(3, seed=22)[1]])
    assert not joint.calibration.accepted
    assert "run3 (by" in joint.calibration.verdict.reasons[0]
    assert "not of the same device" in joint.calibration.verdict.reasons[0]


@pytest.mark.slow
def test_another_mount_is_noticed_where_it_is_stated_to_be_the_same():
    common = ("robot", "site", "reference", "mount")
    joint = calibrate_joint([recorded(1)[1], recorded(2, mount=2)[1]], common=common)
    assert not joint.calibration.accepted
    assert "leave out --same mount" in joint.calibration.verdict.reasons[0]


@pytest.mark.slow
def test_a_small_turn_of_the_mount_is_noticed_behind_the_errors_that_recordings_share():
    def turned(run: int, turn: float) -> Recording:
        cell = {
            "seed": 28, "run": run, "seconds": 60.0, "reference": {"joints": False},
            "imu": {"mounting_deg": [turn, turn, turn]},
        }  # fmt: skip
        return simulate(parse_cell(cell, Path("CELL.toml")), Path(f"run{run}"))[1]

    recordings = [turned(1, 0.15), *(turned(run, 0.0) for run in (2, 3))]
    assert calibrate_joint(recordings).calibration.accepted
    stated = calibrate_joint(recordings, common=("robot", "site", "reference", "mount")).calibration
    assert not stated.accepted
    assert "leave out --same mount" in stated.verdict.reasons[0]


@pytest.mark.slow
def test_another_place_is_noticed_where_nothing_is_stated():
    def at(run: int, latitude: float) -> Recording:
        cell = {
            "seed": 24, "run": run, "seconds": 60.0, "site": {"latitude_deg": latitude}, "stated": {"place": False},
            "reference": {"kind": "mocap"},
        }  # fmt: skip
        return simulate(parse_cell(cell, Path("CELL.toml")), Path(f"run{run}"))[1]

    found = calibrate_joint([at(1, 20.0), at(2, 60.0), at(3, 60.0)]).calibration
    assert not found.accepted
    assert "--own site" in found.verdict.reasons[0]


@pytest.mark.slow
def test_coefficients_of_temperature_hold_at_another_temperature():
    def warm(run: int, rise: float) -> tuple[Truth, Recording]:
        cell = {
            "seed": 8, "run": run, "seconds": 90.0, "reference": {"kind": "mocap"},
            "imu": {"grade": "industrial-mems", "temperature_rise": rise, "gyro_temperature_sd": 2e-5,
                    "gyro_scale_temperature_sd": 1e-4, "accel_temperature_sd": 1e-2,
                    "accel_scale_temperature_sd": 1e-4},
        }  # fmt: skip
        return simulate(parse_cell(cell, Path("CELL.toml")), Path(f"run{run}"))

    (truth, first), (_, second) = warm(1, 15.0), warm(2, 40.0)
    found = calibrate_joint([first, second], common=("robot", "site", "reference", "offsets")).calibration
    assert found.accepted
    assert found.joint.factor == 1.0
    assert max(worst(found, truth).values()) < 4.5
    # the same readings at the same temperature give the same, by the parameters of either recording
    rng = np.random.default_rng(1)
    rates, forces, t = rng.normal(size=(50, 3)), 10.0 * rng.normal(size=(50, 3)), 0.01 * np.arange(50)
    alone = [calibrate(one).correct(rates, forces, t, np.full(50, 40.0))[0] for one in (first, second)]
    together = found.correct(rates, forces, t, np.full(50, 40.0))[0]
    np.testing.assert_allclose(together, alone[1], atol=2e-3)
    np.testing.assert_allclose(alone[0], alone[1], atol=6e-3)


@pytest.mark.slow
def test_one_recording_without_temperature_does_not_stop_the_others():
    cell = {
        "seed": 21, "run": 7, "seconds": 60.0, "reference": {"kind": "mocap"},
        "imu": {"grade": "consumer-mems", "temperature_rise": 40, "gyro_temperature_sd": 1e-3},
    }  # fmt: skip
    warm = simulate(parse_cell(cell, Path("CELL.toml")), Path("warm"))[1]
    joint = calibrate_joint([recorded(1)[1], warm, recorded(2)[1]])
    assert set(joint.names) == {"run1", "warm", "run2"}
    assert joint.calibration.accepted


@pytest.mark.slow
def test_a_recording_without_orientations_has_a_body_of_its_own():
    truth, first = recorded(1)
    _, moved = recorded(2, measures="position")
    joint = calibrate_joint([moved, first], common=("robot", "site", "reference", "mount"), names=("p", "q"))
    assert joint.names == ("q", "p")  # b is that of the recording with orientations
    assert joint.calibration.accepted
    assert max(worst(joint.calibration, truth).values()) < 4.5


@pytest.mark.slow
def test_what_cannot_be_used_is_left_out_and_named(tmp_path):
    _, first = recorded(1)
    _, wrong = recorded(2)
    _, third = recorded(3)
    mixed = Recording(wrong.path, wrong.imu, third.reference, None, wrong.settings)
    joint = calibrate_joint([first, mixed, third], names=("a", "b", "c"))
    facts = joint.calibration.joint
    assert joint.names == ("a", "c")
    assert [name for name, _ in facts.left_out] == ["b"]
    assert any(w.subject == "b" and "not used" in w.message for w in joint.warnings)
    joint.calibration.save(tmp_path)
    again = Calibration.load(tmp_path)
    assert again.joint.left_out == facts.left_out
    assert [one.name for one in again.joint.recordings] == ["a", "c"]
    np.testing.assert_allclose(again.joint.recordings[1].turn.value, facts.recordings[1].turn.value)
    write_joint(joint, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "Not used" in page
    assert "<h1>a + c</h1>" in page
    with pytest.raises(SettingsError, match=r"fewer than two can be used \(b: "):
        calibrate_joint([first, mixed], names=("a", "b"))


def test_bad_arguments_are_named():
    with pytest.raises(SettingsError, match="run1 and run1 have the same readings"):
        calibrate_joint([recorded(1)[1], recorded(1)[1]])
    with pytest.raises(SettingsError, match="give two or more"):
        calibrate_joint([recorded(1)[1]])
    with pytest.raises(SettingsError, match="unknown thing in common 'foo'"):
        calibrate_joint([recorded(1)[1], recorded(2)[1]], common=("foo",))


@pytest.mark.slow
def test_motions_about_different_axes_complete_each_other():
    def of_joints(run: int, joints: list[int]) -> Recording:
        cell = {
            "seed": 21, "run": run, "seconds": 60.0, "reference": {"kind": "mocap"}, "motion": {"joints": joints},
            "imu": {"grade": "consumer-mems"},
        }  # fmt: skip
        return simulate(parse_cell(cell, Path("CELL.toml")), Path(f"run{run}"))[1]

    weak = of_joints(2, [1, 6])
    assert calibrate(weak).verdict.unobservable
    joint = calibrate_joint([of_joints(1, [2, 5]), weak, of_joints(3, [4, 5])], common=("site", "mount", "offsets"))
    found = joint.calibration
    assert found.accepted
    assert not found.verdict.unobservable
    assert max(worst(found, recorded(1)[0]).values()) < 4.5
