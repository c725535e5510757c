"""What makes a result better, and the words of parameters, against direct calculations."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.outcome import Outcome
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.groups import REGISTRY
from kreisel.report.budget_figure import parts_of
from kreisel.report.improvement import Block, Repetition, improvement_table
from kreisel.report.reader_names import by_quantity, in_words, reader_name, unobservable_table

from ...small_cell import simulate


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    recording = simulate(np.random.default_rng(5), 60.0, Path("small"), imu_rate=100.0)[1]
    return run_calibration(recording, CalibrationSettings(), budget=True)


def test_repeated_parts_add_their_information(outcome: Outcome) -> None:
    budget, lack = outcome.calibration.budget, outcome.lack
    assert budget is not None
    assert lack is not None
    repeated = Repetition.of(outcome, budget)
    assert repeated is not None
    factor = outcome.estimate.run.belief.factor[repeated.places]
    P = factor @ factor.T
    rest = repeated.total - repeated.moving
    for part, times, own in (
        (3, 2.0, lack.blocks.information[3]),
        (7, 25.0, lack.blocks.information[7]),
        (-1, 1.0, lack.blocks.information.sum(axis=0)),
    ):
        then = np.diag(np.linalg.inv(np.linalg.inv(P) + times * own))
        for place in range(0, len(P), 5):
            expected = np.sqrt(rest[place] + repeated.moving[place] * then[place] / P[place, place])
            found = repeated.deviation(part, times, repeated.places[[place]])
            assert found == pytest.approx(expected, rel=1e-6)
    assert repeated.deviation(-1, 0.0, repeated.places[:1]) == pytest.approx(budget.deviation[repeated.places[0]])


def test_every_quantity_of_the_sensors_is_told_what_helps(outcome: Outcome) -> None:
    table = improvement_table(outcome)
    assert table is not None
    words = [row.cells[0] for row in table.rows]
    assert "Gyro scale factors" in words
    assert "Accelerometer misalignment, mounting" in words
    assert not {"Gravity", "Direction of north"} & set(words)
    parts = {part.words: part for part in parts_of(outcome)}
    for row in table.rows:
        assert row.cells[1] == parts[row.cells[0]].text(parts[row.cells[0]].deviation)
        assert row.cells[3]
    moves = [row for row in table.rows if "more move" in row.cells[3]]
    for row in moves:
        now, then = (float(row.cells[k].split()[0].replace("·10⁻", "e-")) for k in (1, 4))
        assert 0.3 * now < then <= 0.52 * now  # the fewest that halve it, as rounded
    assert moves
    assert improvement_table(replace(outcome, calibration=replace(outcome.calibration, budget=None))) is None
    without = improvement_table(replace(outcome, lack=None))
    assert without is not None
    assert not [row for row in without.rows if "move" in row.cells[3]]


def test_a_part_is_named_by_how_it_stands_and_turns() -> None:
    still, nothing = np.array([0.1, -0.97, 0.2]), np.full(3, np.nan)
    turned = np.array([3.0, 20.0, 120.4])
    assert Block(26.0, 30.2, turned, still).words == (
        "from 26 s to 30 s (standing with −y upward, then mostly about z, 120 deg)"
    )
    assert Block(26.0, 30.2, turned, nothing).words == "from 26 s to 30 s (mostly about z, 120 deg)"
    assert Block(1.0, 2.0, np.ones(3), np.array([0.7, 0.0, 0.71])).words == (
        "from 1 s to 2 s (standing with x and z upward, then no turn)"
    )


def test_every_parameter_has_words_of_its_own() -> None:
    names = [name for group in REGISTRY for name in group.names(3, 6)]
    words = [in_words(name) for name in names]
    assert not [name for name, word in zip(names, words, strict=True) if name == word or "." in word or "[" in word]
    several = {word for word in words if words.count(word) > 1}
    assert several <= {"Direction of north", *(f"Gear of robot joint {k + 1}" for k in range(6))}
    assert reader_name("gyroscope.cross_coupling[1,1]") == ("Gyro scale factor", "y")
    assert reader_name("accelerometer.cross_coupling[0,2]") == ("Accelerometer misalignment", "xz")
    assert reader_name("robot.placement[2,3]") == ("Placement of robot joint 3", "about x")
    assert reader_name("what nobody knows") == ("what nobody knows", "")
    assert by_quantity(["gyroscope.offset[0]", "timing.offset", "gyroscope.offset[2]"]) == [
        ("Gyro bias", "x, z"), ("Time offset of the reference", ""),
    ]  # fmt: skip


def test_what_is_not_shown_is_told_with_what_shows_it(outcome: Outcome) -> None:
    assert unobservable_table(replace(outcome, observability=replace(outcome.observability, unobservable=()))) is None
    lost = "gyroscope.cross_coupling[0,1]", "gyroscope.cross_coupling[2,1]", "accelerometer.offset[2]"
    seen = replace(outcome.observability, unobservable=lost, not_narrowed=lost[:1])
    table = unobservable_table(replace(outcome, observability=seen))
    assert table is not None
    gyro, bias = table.rows
    assert gyro.cells[:3] == ("Gyro misalignment", "xy, zy", "mrad")
    assert "turns about y of the sensor" in gyro.cells[-1]
    assert "hardly" in gyro.cells[-2]
    assert bias.cells[:3] == ("Accelerometer bias", "z", "mg")
    assert "standstills with z of the sensor" in bias.cells[-1]
    assert "too uncertain" in bias.cells[-2]
