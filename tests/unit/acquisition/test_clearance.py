"""The program against the room, by brute force."""

import math

import numpy as np
import pytest

from kreisel.acquisition.clearance import (
    RADIUS,
    Room,
    _distance,
    approach,
    as_moved,
    check_room,
    check_way,
    parse_box,
    slowed,
    tool_peak,
)
from kreisel.acquisition.limits_used import limits_used, row_of
from kreisel.acquisition.movers import mover_at
from kreisel.acquisition.preflight import approach_share
from kreisel.devices.address import MOVERS, parse_address
from kreisel.errors import RobotError, SettingsError
from kreisel.robot.kinematics import load_arm, poses
from kreisel.robot.motion import Move
from kreisel.robot.program import Program

ARM = load_arm("ur10e")
START = np.radians([0, -90, 60, -60, -90, 0])
AWAY = np.radians([150, -80, 70, -40, -60, 20])
MOVER = mover_at(parse_address("urscript://127.0.0.1", MOVERS), 1.0, 2.0)


def test_distances_of_segments_are_those_of_many_points():
    generator = np.random.default_rng(2)
    shares = np.linspace(0.0, 1.0, 401)
    for _ in range(60):
        a, b, c, d = generator.normal(size=(4, 3))
        first, second = a + shares[:, None] * (b - a), c + shares[:, None] * (d - c)
        brute = np.linalg.norm(first[:, None] - second[None], axis=2).min()
        assert _distance((a, b, 0.0), (c, d, 0.0)) == pytest.approx(brute, abs=2e-2)
        assert _distance((a, b, 0.0), (c, d, 0.0)) <= brute + 1e-12


def test_parallel_segments_have_the_distance_of_their_lines():
    e = np.eye(3)
    assert _distance((np.zeros(3), e[0], 0.0), (e[1], e[1] + e[0], 0.0)) == pytest.approx(1.0)
    assert _distance((np.zeros(3), e[0], 0.0), (3.0 * e[0], 4.0 * e[0], 0.0)) == pytest.approx(2.0)


def test_the_fastest_moment_of_the_tool_is_that_of_fine_differences():
    s = np.linspace(0.0, 1.0, 20001)[:, None]
    lengths = np.linalg.norm(np.diff(poses(ARM, START + s * (AWAY - START))[0], axis=0), axis=1)
    brute = lengths.max() * 20000 / np.abs(AWAY - START).max()  # at 1 rad/s of the leading joint
    assert tool_peak(ARM, MOVER, START, AWAY, 1.0) == pytest.approx(brute, rel=1e-3)
    assert tool_peak(ARM, MOVER, START, START, 1.0) == 0.0


def test_a_program_is_slowed_to_the_speed_allowed_and_no_further():
    program = Program(START, (Move(AWAY, 1.0), Move(START, 1.0), Move(AWAY, 1.0, 0.05)))
    sent, text = slowed(ARM, program, MOVER, 0.25)
    at = START
    fastest = []
    for move in sent.moves:
        fastest.append(tool_peak(ARM, MOVER, at, move.target, move.speed))
        at = move.target
    assert max(fastest) == pytest.approx(0.25)
    assert sent.moves[2].speed == 0.05
    assert "slowed down, so that the tool stays below 0.25 m/s" in text
    free, text = slowed(ARM, program, MOVER, 9.0)
    assert [move.speed for move in free.moves] == [0.05, 1.0, 0.05]
    assert text == "the tool stays below 9 m/s"
    shares = [move.speed for move in as_moved(ARM, free, MOVER).moves]
    assert shares[1] == pytest.approx(1.0 / ARM.velocity[0])


def test_a_room_says_how_close_the_arm_comes():
    program = Program(START, (Move(AWAY, 1.0),))
    assert "above the floor" in check_room(ARM, program, Room(-1.0))
    with pytest.raises(RobotError, match=r"below the floor, which is taken to be at 2 m .*give --floor"):
        check_room(ARM, program, Room(2.0))
    inside = np.array([poses(ARM, AWAY[None])[0][0]] * 2)
    with pytest.raises(RobotError, match="keep-out box"):
        check_room(ARM, program, Room(-1.0, (inside,)))
    check_room(ARM, program, Room(-1.0, (inside + 10.0 * RADIUS + 3.0,)))


@pytest.mark.parametrize("text", ["", "1,2,3", "a,b,c,d,e,f", "1,2,3,4,5,nan", "1,2,3,4,5,6,7"])
def test_a_box_has_two_corners(text):
    with pytest.raises(SettingsError, match="expected two corners"):
        parse_box(text)
    np.testing.assert_array_equal(parse_box("1,2,3,0,-1,4"), [[0, -1, 3], [1, 2, 4]])
    assert math.isfinite(parse_box("1,2,3,0,-1,4").sum())


def test_the_way_to_the_start_keeps_clear_and_slow():
    """The start is 90 deg away about the vertical; a box stands half way, where neither end touches it."""
    program = Program(START, (Move(START, 1.0),))
    away = START + np.array([np.pi / 2, 0, 0, 0, 0, 0])
    share = approach(ARM, program, MOVER, away, Room(-1.0), 0.05)
    assert tool_peak(ARM, MOVER, away, START, share) == pytest.approx(0.05)
    assert approach(ARM, program, MOVER, away, Room(-1.0), 9.0) == approach_share(program, MOVER)
    assert approach(ARM, program, MOVER, START, Room(-1.0), 0.05) == approach_share(program, MOVER)
    half = poses(ARM, (START + away)[None] / 2)[0][0]
    box = np.array([half - 0.05, half + 0.05])
    for end in (START, away):
        check_way(ARM, end, end, Room(-1.0, (box,)), 0)
    with pytest.raises(RobotError, match="move 0 brings the arm into the keep-out box"):
        approach(ARM, program, MOVER, away, Room(-1.0, (box,)), 9.0)


def test_the_use_of_limits_is_that_of_the_fastest_move():
    program = Program(START, (Move(AWAY, 1.0, 0.5), Move(START, 1.0, 0.1)))
    uses = {one.what: one for one in limits_used(ARM, program, MOVER, Room(-1.0), 2.0)}
    way = np.abs(AWAY - START)
    leading = float(MOVER.peaks(AWAY - START, 0.5, ARM.velocity)[0].max())
    for k, name in enumerate(ARM.joints):
        assert uses[f"{name} speed"].share == pytest.approx(leading * way[k] / way.max() / ARM.velocity[k])
        ends = np.degrees([START[k], AWAY[k]])
        low, high = np.degrees([ARM.lower[k], ARM.upper[k]])
        shares = [angle / (high if angle > 0 else low) for angle in ends]
        assert uses[f"{name} angle"].share == pytest.approx(max(shares))
    assert uses["tool speed"].share == pytest.approx(tool_peak(ARM, MOVER, START, AWAY, 0.5) / 2.0)
    assert row_of(uses["tool speed"])[2] == "2 m/s"
    assert row_of(uses["distance of links"])[3] == ""
