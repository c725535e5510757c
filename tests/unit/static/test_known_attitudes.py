"""What is known of attitudes: derivatives against differences, that the truth solves the equations, and parts."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.geometry.rotation import exp, from_two_vectors, matrix, multiply
from kreisel.preparation.gravity import site_of
from kreisel.simulation.standstills import HandTurns, hand_turned
from kreisel.static.first_values import first_values
from kreisel.static.known_attitudes import Faces, HingeTurns, TableTurns, WholeTurns
from kreisel.static.rest_chain import ATTITUDE
from kreisel.static.rest_problem import RestProblem, raw_of
from kreisel.static.rest_search import find_rests
from kreisel.validation.checks import check_streams


@pytest.fixture(scope="module")
def problem():
    _, recording = hand_turned(HandTurns(attitudes=8, rest=2.0), np.random.default_rng(3))
    imu = check_streams(recording).imu
    return RestProblem(imu, raw_of(imu), find_rests(imu), site_of(recording.settings.site)[0])


def attitudes(rng, count):
    q = rng.normal(size=(count, 4))
    return matrix(q / np.linalg.norm(q, axis=1, keepdims=True))


def kinds(rng):
    return (
        Faces(np.array([0, 2, 3]), np.array([0, 2, 1]), np.array([1.0, -1.0, 1.0]), 2e-3),
        WholeTurns(np.array([1, 4])),
        TableTurns(
            np.array([0, 3, 5]),
            np.array([0.7, -9.0, 2.0]),
            np.array([0.6, 0.0, 0.8]),
            1e-3,
            np.array([0.0, -1.0, 1.0]),
            2e-3,
            rng.uniform(-2.0, 2.0, (3, 4)),
            2e-3,
        ),
        HingeTurns(np.array([0, 1, 4, 5]), np.array([0, 0, 1, 1]), np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 0.0]])),
    )


def near(known, C, rng):
    """Return attitudes of which what is known holds but for 3 mrad, where rotation vectors are linear in rotations."""
    C, wobble = C.copy(), exp(3e-3 * rng.normal(size=(len(C), 3)))
    if isinstance(known, Faces):
        for node, axis, sign in zip(known.node, known.axis, known.sign, strict=True):
            C[node] = matrix(multiply(from_two_vectors(sign * np.eye(3)[axis], [0.0, 0.0, -1.0]), wobble[node]))
    elif isinstance(known, WholeTurns):
        C[known.node + 1] = C[known.node] @ matrix(wobble[known.node])
    elif isinstance(known, HingeTurns):
        for node, mounting in zip(known.node, known.mounting, strict=True):
            turn = exp(rng.uniform(-9.0, 9.0) * known.axes[mounting])
            C[node + 1] = C[node] @ matrix(multiply(turn, wobble[node]))
    else:
        for node, angle in zip(known.node, known.angle, strict=True):
            C[node + 1] = matrix(exp(angle * known.axis)) @ C[node] @ matrix(wobble[node])
    return C


@pytest.mark.parametrize("number", range(4))
def test_derivatives_are_those_of_differences(problem, number):
    rng = np.random.default_rng(number)
    known = kinds(rng)[number]
    own = replace(problem, known=(known,))
    p = own.room(first_values(own))
    size = own.layout.degrees - own.reported
    change = np.zeros(own.layout.degrees)
    change[own.reported :] = 1e-3 * rng.normal(size=size)
    p = own.changed(p, change)
    C = near(known, attitudes(rng, own.rests.count), rng)
    one = known.equations(own, p, C)
    for i in range(own.reported, own.layout.degrees):
        step = np.zeros(own.layout.degrees)
        step[i] = 1e-6
        after, before = (known.equations(own, own.changed(p, s * step), C).residual for s in (1.0, -1.0))
        found = (after - before) / 2e-6
        np.testing.assert_allclose(one.of_parameters[:, :, i], found, atol=0.02 * max(np.abs(found).max(), 1e-3))
    assert np.abs(one.of_parameters[:, :, own.reported :]).sum() > 0.1 or size == 0
    for node in range(own.rests.count):
        for k in range(3):
            moved = C.copy()
            moved[node] = C[node] @ matrix(exp(1e-6 * np.eye(3)[k]))
            expected = np.zeros_like(one.residual)
            expected[one.node == node] += one.of_node[one.node == node][:, :, ATTITUDE][:, :, k]
            if one.of_next is not None:
                expected[one.node + 1 == node] += one.of_next[one.node + 1 == node][:, :, ATTITUDE][:, :, k]
            found = (known.equations(own, p, moved).residual - one.residual) / 1e-6
            np.testing.assert_allclose(found, expected, atol=0.02)


def test_rows_without_a_share_say_nothing(problem):
    rng = np.random.default_rng(5)
    for known in kinds(rng):
        own = replace(problem, known=(known,))
        p = own.room(first_values(own))
        one = known.equations(own, p, attitudes(rng, own.rests.count))
        empty = known.share == 0.0
        assert known.white.shape == known.share.shape == one.residual.shape
        assert (known.white > 0.0).all()
        if not isinstance(known, WholeTurns):
            assert not one.residual[empty].any()
            assert not one.of_parameters[empty].any()


def test_a_part_counts_its_standstills_anew():
    rng = np.random.default_rng(6)
    faces, turns, table, hinge = kinds(rng)
    keep = np.arange(3, 7)
    assert faces.part(keep).node.tolist() == [0]
    assert faces.part(keep).axis.tolist() == [1]
    assert turns.part(keep).node.tolist() == [1]
    assert table.part(keep).node.tolist() == [0, 2]
    assert table.part(keep).angle.tolist() == [-9.0, 2.0]
    assert hinge.part(keep).node.tolist() == [1, 2]
    assert hinge.part(keep).mounting.tolist() == [1, 1]
    assert table.part(np.arange(3, 6)).node.tolist() == [0]  # the next one of the other is not among them


def test_a_level_axis_gives_the_heading():
    one = TableTurns(np.array([0]), np.array([1.0]), np.array([0.0, 0.0, 1.0]))
    assert not one.gives_heading
    assert replace(one, axis=np.array([1.0, 0.0, 0.0])).gives_heading
