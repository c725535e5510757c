"""The battery of situations: what is judged, what is kept, what is counted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from kreisel.calibration.result_sections import Verdict
from kreisel.errors import SettingsError
from kreisel.formats.loading import load
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.simulation.cell import Truth
from kreisel.simulation.cell_settings import Cell
from kreisel.simulation.device_errors import OffsetChange, Slip
from kreisel.study import robustness
from kreisel.study.robustness import Row, RowFile, numbers, run_numbered, table, total, worst_error
from kreisel.study.situations import BASES, Situation, situations

NAN = float("nan")


def test_every_situation_is_a_cell_of_its_own():
    everything = situations()
    assert len(everything) >= 300
    assert len({s.key for s in everything}) == len(everything)
    cells = [Cell.model_validate(dict(s.cell)) for s in everything]
    assert len(set(cells)) > len(everything) - len(BASES) - 4  # a clean cell is that of its grade, and a few defaults
    assert len({robustness.folder_name(s, 1) for s in everything}) == len(everything)
    assert {s.basis for s in everything} == set(BASES)
    for situation in everything:
        assert situation.size
        assert situation.words
        if situation.name == "clean":
            assert not situation.causes


def test_effects_that_the_program_may_estimate_have_their_names():
    named = {cause for s in situations() for cause in s.causes}
    assert {
        "gyro_g_sensitivity", "gyro_asymmetry", "accel_asymmetry", "gyro_polynomial", "accel_polynomial",
        "accel_delay", "accel_smoothing", "position_scale", "reference_smoothing", "mount_bending",
        "mount_deflection", "robot_gears", "robot_compliance",
        "robot_placement",
    } <= named  # fmt: skip


@pytest.mark.slow
def test_two_situations_run(tmp_path):
    everything = situations(30.0)
    clean = next(i for i, s in enumerate(everything) if s.key == "clean, fog-mems, joints")
    broken = next(i for i, s in enumerate(everything) if s.key == "slipping mount, 5 deg, mocap")
    file = RowFile(tmp_path, 30.0)
    wanted = [10_000 * i + 1 for i in (clean, broken)]
    for number in file.missing(wanted, 30.0):
        file.add(run_numbered(30.0, number))
    good, bad = (next(r for r in file.rows() if r.name == name) for name in ("clean", "slipping mount"))
    assert good.verdict == "accepted"
    assert good.worst < 5.0
    assert good.parameter.startswith(("gyroscope.", "accelerometer."))
    assert 0.2 < good.ratio < 2.0
    assert bad.verdict in ("rejected", "refused")
    assert bad.reasons
    # what is stored is read back, and not run again; a line that was cut is
    again = RowFile(tmp_path, 30.0)
    assert [replace(r, worst=0.0, ratio=0.0) for r in again.rows()] == [
        replace(r, worst=0.0, ratio=0.0) for r in file.rows()
    ]
    assert again.missing(wanted, 30.0) == []
    text = (tmp_path / "robustness.csv").read_text(encoding="utf-8")
    (tmp_path / "robustness.csv").write_text(text[:-20], encoding="utf-8")
    assert RowFile(tmp_path, 30.0).missing(wanted, 30.0) == [wanted[1]]
    with pytest.raises(SettingsError, match="another length"):
        RowFile(tmp_path, 31.0)


def test_recordings_are_written(tmp_path):
    index = next(i for i, s in enumerate(situations(20.0)) if s.key == "accel_delay, 10 ms, poses")
    name = robustness.write_numbered(20.0, tmp_path, 10_000 * index + 2)
    recording = load(tmp_path / name)
    assert recording.imu.seconds[-1] == pytest.approx(20.0, abs=0.1)
    assert (tmp_path / name / "truth.json").is_file()
    assert (tmp_path / name / "situation.json").is_file()
    assert robustness.write_numbered(20.0, tmp_path, 10_000 * index + 2) == name


def test_effects_are_chosen_by_name():
    assert len(numbers(2, ["clean"], 150.0)) == 2 * 15
    assert {n % 10_000 for n in numbers(3, [], 150.0)} == {1, 2, 3}
    with pytest.raises(SettingsError, match="unknown situation 'magic'; known are: clean, "):
        numbers(1, ["magic"], 150.0)


def test_a_fault_is_counted_and_ends_nothing(monkeypatch):
    def fail(*_arguments):
        raise ZeroDivisionError("no such luck")

    situation = situations(20.0)[0]
    monkeypatch.setattr(robustness, "run_calibration", fail)
    row = robustness.run_situation(situation, 1)
    assert (row.verdict, row.reasons) == ("crashed", ("ZeroDivisionError: no such luck",))
    impossible = replace(situation, cell={**situation.cell, "motion": {"joints": (9,)}})
    row = robustness.run_situation(impossible, 1)
    assert row.verdict == "crashed"
    assert row.reasons[0].startswith("simulation: ")


# What is judged


def outcome(sensors, unobservable=(), sd=0.1):
    spread = SensorParameters(*(np.full(shape, sd) for shape in ((3, 3), (1, 3), (3, 3), (1, 3), (3, 3))))
    calibration = SimpleNamespace(sensors=sensors, sensor_sd=spread)
    return SimpleNamespace(calibration=calibration, verdict=Verdict(True, (), tuple(unobservable)))


def truth(sensors, **more):
    return Truth(sensors, 0.0, 0.0, np.zeros(3), np.zeros(3), None, None, **more)


IDEAL = SensorParameters.ideal()


def test_the_worst_parameter_that_is_observable_counts():
    K = np.eye(3)
    K[0, 1] += 0.5
    arms = np.zeros((3, 3))
    arms[2, 0] = 0.9
    found = replace(IDEAL, K_omega=K, lever_arms=arms)
    worst, name, ratio = worst_error(outcome(found), truth(IDEAL))
    assert (worst, name) == (pytest.approx(9.0), "accelerometer.lever_arms[2,0]")
    assert ratio == pytest.approx(np.sqrt((81.0 + 25.0) / 33.0))
    worst, name, _ = worst_error(outcome(found, ["accelerometer.lever_arms[2,0]"]), truth(IDEAL))
    assert (worst, name) == (pytest.approx(5.0), "gyroscope.cross_coupling[0,1]")
    assert np.isnan(worst_error(outcome(found, sd=0.0), truth(IDEAL))[0])


def test_an_offset_that_changes_is_judged_by_the_nearer_of_mean_and_end():
    change = OffsetChange(np.full(3, 1.0), np.full(3, 2.0), np.zeros(3), np.zeros(3))
    for value, expected in ((1.0, 0.0), (2.0, 0.0), (1.5, 5.0), (0.0, 10.0), (2.7, 7.0)):
        found = replace(IDEAL, k_w=np.full((1, 3), value))
        assert worst_error(outcome(found), truth(IDEAL, offset_change=change))[0] == pytest.approx(expected)


def test_after_a_slip_there_are_two_truths():
    slip = Slip(np.array([0.0, 0.0, 0.4]), 5.0)
    after = slip.after(IDEAL)
    for found in (IDEAL, after):
        assert worst_error(outcome(found), truth(IDEAL, slip=slip))[0] < 1e-9
    between = Slip(np.array([0.0, 0.0, 0.2]), 5.0).after(IDEAL)
    assert worst_error(outcome(between), truth(IDEAL, slip=slip))[0] == pytest.approx(np.sin(0.2) / 0.1, rel=0.05)


def test_totals_count_what_they_say():
    def row(verdict, worst, named=(), name="gyro_asymmetry"):
        size = "50 ppm" if name == "gyro_asymmetry" else "fog"
        return Row(name, size, "joints", 1, verdict, worst, named=named)

    rows = [
        row("accepted", 1.0), row("accepted", 5.0, ("gyro_asymmetry",)), row("accepted", 7.0, ("other",)),
        row("accepted", 2.0, name="clean"), row("rejected", 2.0, ("gyro_asymmetry", "other")), row("rejected", 9.0),
        row("refused", NAN), row("crashed", NAN),
    ]  # fmt: skip
    totals = total(rows)
    assert totals.runs == 8
    assert dict(totals.verdicts) == {"accepted": 4, "rejected": 2, "refused": 1, "crashed": 1}
    assert (totals.wrong, totals.grossly_wrong, totals.needless) == (0.5, 0.25, 0.5)
    assert totals.noticed == pytest.approx(4 / 5)
    assert totals.named_rightly == pytest.approx(2 / 4)
    (clean, asymmetry) = table(rows)
    assert clean == ["clean", "fog", "joints", "1", "", "", "", "2.0", "", ""]
    assert asymmetry[3:] == ["3", "2", "1", "1", "7.0", "9.0", "29%"]
    assert np.isnan(total([]).wrong)
    document = robustness.as_document(total(rows), rows)
    assert document["rows"][6]["worst"] is None
    assert isinstance(situations()[0], Situation)
