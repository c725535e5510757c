"""Which static method is used: what the data show, what is stated, and what is missing."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from kreisel.errors import RecordingError, SettingsError
from kreisel.formats.loading import load
from kreisel.formats.write import write_folder
from kreisel.preparation.gravity import site_of
from kreisel.simulation.standstills import HandTurns, hand_turned
from kreisel.static.known_attitudes import Faces, HingeTurns, TableTurns, WholeTurns
from kreisel.static.rest_problem import RestProblem, raw_of
from kreisel.static.rest_search import find_rests
from kreisel.static.static_methods import with_method
from kreisel.static.static_verdict import _not_observable
from kreisel.validation.checks import check_streams


def case(seed=1, **how):
    _, recording = hand_turned(HandTurns("fog-mems", rest=3.0, **how), np.random.default_rng(seed))
    recording = check_streams(recording)
    imu = recording.imu
    return RestProblem(imu, raw_of(imu), find_rests(imu), site_of(recording.settings.site)[0]), recording.table


def chosen(stated, problem, table=None):
    return with_method(problem, stated, table)


@pytest.mark.parametrize(
    ("laid", "method", "kinds"),
    [("anyhow", "multi-position", ()), ("faces", "six-position", (Faces,)),
     ("whole turns", "ferraris", (Faces, WholeTurns)), ("turntable", "turntable", (TableTurns,)),
     ("hinge", "hinge", (HingeTurns,))],
)  # fmt: skip
def test_the_data_show_the_method(laid, method, kinds):
    problem, table = case(laid=laid, attitudes=12)
    found = chosen(None, problem, table)
    assert found.name == method
    assert tuple(type(one) for one in found.problem.known) == kinds
    assert bool(found.warnings) == (method in ("six-position", "ferraris", "hinge"))


def test_what_is_known_is_what_was_done():
    problem, _ = case(laid="whole turns", attitudes=6)
    faces, turns = chosen("ferraris", problem).problem.known
    assert faces.axis.tolist() == [0, 0, 1, 1, 2, 2]  # after a turn on the table a face is not laid down anew
    assert faces.sign.tolist() == [1, -1] * 3
    assert faces.node.tolist() == [0, 2, 3, 5, 6, 8]
    assert turns.node.tolist() == [0, 3, 6]
    assert chosen("six-position", problem).name == "six-position"
    assert chosen("multi-position", problem).problem.known == ()


def test_table_turns_have_the_angle_of_the_table_whatever_its_clock():
    problem, table = case(laid="turntable", attitudes=12)
    later = replace(table, stamps_ns=table.stamps_ns + 5_000_000_000)
    for one in (table, later):
        (turns,) = chosen(None, problem, one).problem.known
        assert turns.node.size == 9
        assert np.abs(turns.angle).max() > 2.0 * np.pi
        np.testing.assert_allclose(np.abs(turns.axis), [0.0, 0.0, 1.0], atol=0.1)
    angles = np.interp(problem.rests.seconds, table.seconds - 0.04, table.angles)
    np.testing.assert_allclose(turns.angle, np.diff(angles)[turns.node], atol=1e-3)


def test_a_table_whose_clock_drifts_by_less_than_is_looked_for_has_the_same_angles():
    problem, table = case(laid="turntable", attitudes=36)
    expected = chosen(None, problem, table).problem.known[0]
    first = table.stamps_ns[0]
    drifting = replace(table, stamps_ns=first + np.round(1.0008 * (table.stamps_ns - first)).astype(np.int64))
    (turns,) = chosen(None, problem, drifting).problem.known
    np.testing.assert_array_equal(turns.node, expected.node)
    np.testing.assert_allclose(turns.angle, expected.angle, atol=1e-5)


def test_a_table_is_found_though_a_hand_turns_the_device_faster():
    """The largest turns are those between mountings, and a shift of one stop makes most rates alike."""
    problem, table = case(laid="turntable", attitudes=18, turn=1.5)
    expected = chosen(None, problem, table).problem.known[0]
    for seconds in (0.3, 1.0, -2.0, 7.0):
        later = replace(table, stamps_ns=table.stamps_ns + round(seconds * 1e9))
        (turns,) = chosen(None, problem, later).problem.known
        assert turns.node.size >= expected.node.size
        np.testing.assert_allclose(turns.angle, expected.angle, atol=1e-3)


def test_a_hinge_has_an_axis_for_each_mounting_whatever_the_sense_of_its_turns():
    problem, _ = case(laid="hinge", attitudes=12, table_axis=(0.8, 0.6, 0.0))
    (turns,) = chosen(None, problem).problem.known
    assert turns.node.tolist() == [0, 1, 2, 4, 5, 6, 8, 9, 10]
    assert turns.mounting.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    np.testing.assert_allclose(np.abs(turns.axes), np.eye(3), atol=0.1)
    first = replace(problem, rests=problem.rests.part(np.arange(8)))
    (turns,) = chosen("hinge", first).problem.known
    assert turns.mounting.tolist() == [0, 0, 0, 1, 1, 1]


def test_turns_by_hand_are_no_hinge():
    for seed in range(4):
        problem, _ = case(seed=seed, attitudes=24)
        assert chosen(None, problem).name == "multi-position"


def test_what_is_missing_is_said():
    problem, table = case(laid="faces", attitudes=12)
    for stated, text in (
        ("ferraris", "no whole turn about the axis x, y, z is found"),
        ("turntable", "no table0/data.csv"),
        ("hinge", "no two turns in a row are about one axis"),
    ):
        with pytest.raises(RecordingError, match=text):
            chosen(stated, problem, table)
    with pytest.raises(SettingsError, match="unknown method"):
        chosen("guess", problem)
    some = replace(problem, rests=problem.rests.part(np.arange(10)[np.arange(10) % 6 != 1]))
    with pytest.raises(RecordingError, match="no standstill has the axis -x up"):
        chosen("six-position", some)


def test_a_table_of_another_motion_is_refused():
    problem, table = case(laid="turntable", attitudes=12)
    for wrong, text in (
        (replace(table, angles=3.0 * table.angles), "0 % of the table's turns agree with the gyros"),
        (replace(table, angles=np.linspace(0.0, 100.0, table.angles.size)), "never stands still"),
        (
            replace(table, angles=np.zeros(table.angles.size), stamps_ns=table.stamps_ns + 10**13),
            "0 % of the table's turns agree",
        ),
    ):
        with pytest.raises(RecordingError, match=text):
            chosen(None, problem, wrong)


def test_a_table_is_read_by_angle_and_by_rate(tmp_path):
    _, recording = hand_turned(HandTurns("fog-mems", laid="turntable", attitudes=6, rest=2.0), np.random.default_rng(2))
    write_folder(recording, tmp_path / "angle")
    read = load(tmp_path / "angle")
    assert read.reference is None
    np.testing.assert_allclose(read.table.angles, recording.table.angles, atol=1e-9)
    assert np.array_equal(read.table.stamps_ns, recording.table.stamps_ns)
    write_folder(recording, tmp_path / "rate")
    rate = np.degrees(np.gradient(recording.table.angles, recording.table.seconds))
    rows = "\n".join(f"{t},{w:.9f}" for t, w in zip(recording.table.stamps_ns, rate, strict=True))
    (tmp_path / "rate" / "table0" / "data.csv").write_text(f"#timestamp [ns],rate [deg/s]\n{rows}\n")
    by_rate = load(tmp_path / "rate").table
    assert by_rate.by_rate
    np.testing.assert_allclose(by_rate.angles - by_rate.angles[0], recording.table.angles, atol=2e-3)
    wrapped = np.angle(np.exp(1j * recording.table.angles))
    rows = "\n".join(f"{t},{a:.9f}" for t, a in zip(recording.table.stamps_ns, wrapped, strict=True))
    (tmp_path / "rate" / "table0" / "data.csv").write_text(f"#timestamp [ns],angle [rad]\n{rows}\n")
    np.testing.assert_allclose(load(tmp_path / "rate").table.angles, recording.table.angles, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [("#timestamp [ns],height [m]\n0,1\n1,2\n", "expected #timestamp"),
     ("#timestamp [ns],angle [rad]\n0,1\n", "two rows"),
     ("#timestamp [ns],angle [rad]\n5,1\n5,2\n7,3\n", "do not increase")],
)  # fmt: skip
def test_a_table_that_cannot_be_read_is_refused(tmp_path, text, message):
    _, recording = hand_turned(HandTurns("fog-mems", laid="turntable", attitudes=3, rest=2.0), np.random.default_rng(2))
    write_folder(recording, tmp_path / "own")
    (tmp_path / "own" / "table0" / "data.csv").write_text(text)
    with pytest.raises(RecordingError, match=message):
        load(tmp_path / "own")


def test_whole_turns_of_a_table_are_said_to_end_where_they_began():
    problem, table = case(laid="turntable", attitudes=12)
    (turns,) = chosen(None, problem, table).problem.known
    for angle, said in ((2.0 * np.pi, True), (6.0, False)):
        own = replace(problem, known=(replace(turns, angle=np.full(turns.angle.size, angle)),))
        text = _not_observable(SimpleNamespace(problem=own), "gyroscope", ["gyroscope.cross_coupling[0,0]"])
        assert ("other angles" in text) is said
