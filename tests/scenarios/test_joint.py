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
from kreisel.report.joint import write_joint
from kreisel.simulation.cell import Truth, simulate
from kreisel.simulation.settings import parse_cell
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


@pytest.mark.parametrize("mount", [1, 2])
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


def test_three_recordings_are_worth_one_of_the_same_length():
    truth, _ = recorded(1)
    together = [recorded(run)[1] for run in (1, 2, 3)]
    joint = calibrate_joint(together, common=("robot", "site", "reference", "offsets", "mount")).calibration
    _, long = recorded(4, seconds=180.0)
    one = calibrate(long)
    assert max(worst(joint, truth).values()) < 4.5
    for a, b in (
        (joint.sensor_sd.K_omega, one.sensor_sd.K_omega),
        (joint.sensor_sd.K_a, one.sensor_sd.K_a),
        (joint.sensor_sd.lever_arms, one.sensor_sd.lever_arms),
    ):
        assert np.mean(a) / np.mean(b) == pytest.approx(1.0, abs=0.15)


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
    assert "not of the same device" in joint.calibration.verdict.reasons[0]


def test_another_mount_is_noticed_where_it_is_stated_to_be_the_same():
    common = ("robot", "site", "reference", "mount")
    joint = calibrate_joint([recorded(1)[1], recorded(2, mount=2)[1]], common=common)
    assert not joint.calibration.accepted
    assert "leave out --same" in joint.calibration.verdict.reasons[0]


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
    with pytest.raises(SettingsError, match="give two or more"):
        calibrate_joint([recorded(1)[1]])
    with pytest.raises(SettingsError, match="unknown thing in common 'foo'"):
        calibrate_joint([recorded(1)[1], recorded(2)[1]], common=("foo",))


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
