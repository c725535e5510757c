"""Attitudes at standstills by reported poses, with the errors of the robot that reports them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kreisel._kernels.node_elimination import NODE
from kreisel.geometry.rotation import Array, Indices, exp, from_matrix, log, matrix, multiply
from kreisel.model.parameters import CellParameters
from kreisel.static.rest_chain import ATTITUDE, Equations
from kreisel.static.rest_problem import Nuisance, RestProblem, nuisance

_POSE = 1e-5
"""rad: what is always uncertain of a reported attitude. Its noise figure, found by evidence, begins at an eighth."""

_TILTED = 0.1
"""rad: deviation of the reference frame's first tilt. Chosen: that of first values is known far better."""


@dataclass(frozen=True)
class PoseAttitudes:
    """Attitudes of b by the reference at standstills.

    Attributes
    ----------
    node : (k,)
        Standstills.
    quaternions : (k, 4)
        q_rb, as reported.
    q_rn : (4,)
        First values of the reference frame's rotation against the local level.
    effect : (k, 3, e)
        Rotation of b (in b) by errors of the robot; e is 0 where they are not known.
    width : (e,)
        Their deviations before any look at the data.
    """

    node: Indices
    quaternions: Array
    q_rn: Array
    effect: Array
    width: Array

    kind = "pose"
    usual = None
    gives_heading = True

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Tilt of the reference frame, and errors of the robot."""
        tilt = Nuisance("reference", ("reference.tilt[0]", "reference.tilt[1]"), np.full(2, _TILTED))
        if not self.width.size:
            return (tilt,)
        return tilt, Nuisance("robot", tuple(f"robot.error[{i}]" for i in range(self.width.size)), self.width)

    @property
    def white(self) -> Array:
        """See `rest_problem.Knowledge`."""
        return np.full((self.node.size, 3), _POSE**2)

    @property
    def share(self) -> Array:
        """See `rest_problem.Knowledge`."""
        return np.ones((self.node.size, 3))

    def frame(self, p: CellParameters) -> Array:
        """Return the rotation from the local level to the reference frame, (3, 3)."""
        return matrix(multiply(self.q_rn, exp([*-nuisance(p, "reference", 2), 0.0])))

    def attitudes(self, p: CellParameters) -> Array:
        """Return the attitudes from b to the local level by the poses, (k, 3, 3)."""
        own = self.quaternions
        if self.width.size:
            own = multiply(own, exp(self.effect @ nuisance(p, "robot", self.width.size)))
        return self.frame(p).T @ matrix(own)

    def equations(self, problem: RestProblem, p: CellParameters, C: Array) -> Equations:
        """Return that an attitude is the reported one, by equation (38) of docs/explanation/model.md."""
        E, after = self.attitudes(p), C[self.node]
        A = np.swapaxes(E, 1, 2) @ after
        of_node = np.zeros((self.node.size, 3, NODE))
        of_node[..., ATTITUDE] = np.eye(3)
        columns = {"reference": -np.swapaxes(after, 1, 2)[:, :, :2]}
        if self.width.size:
            columns["robot"] = -np.swapaxes(A, 1, 2) @ self.effect
        return Equations(log(from_matrix(A)), self.node, of_node, None, problem.columns(columns, self.node.size))

    def part(self, keep: Indices) -> Self:
        """See `rest_problem.Knowledge`."""
        own = np.isin(self.node, keep)
        return replace(self, node=self.node[own] - keep[0], quaternions=self.quaternions[own], effect=self.effect[own])
