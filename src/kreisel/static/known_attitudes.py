"""What is known of attitudes besides gravity: faces, whole turns on a table, turns by a turntable or on a hinge."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from kreisel._kernels.node_elimination import NODE
from kreisel.geometry.rotation import Array, Indices, Mask, exp, from_matrix, from_two_vectors, log, matrix, skew
from kreisel.model.parameters import CellParameters
from kreisel.static.rest_chain import ATTITUDE, Equations
from kreisel.static.rest_problem import Nuisance, RestProblem, nuisance

_CASE_TURNED = 0.3
"""rad: deviation of the accelerometers' axes from those of their case, and of a table's axis from the first one found.
Chosen: nobody mounts them worse, and data decide soon."""

_FACE, _HEADING, _TABLE, _HINGE = 1e-4, 1e-4, 1e-6, 1e-4
"""rad: what is always uncertain of a face's vertical, of the heading after a whole turn, of a turntable's turn, and of
a hinge's axis. The noise figure of each, found by evidence, begins at an eighth of it."""

_EXACT = 1e-6
"""rad; deviation of angles that are stated to be exact."""

_LEVEL = 0.02
"""rad; deviation of a table's tilt. Chosen: about a degree; nobody levels a desk."""

_SKEWED = np.array([
    [[0.0, 0.5, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 0.0]],
    [[0.0, 0.0, 0.5], [0.0, 0.0, 0.0], [0.5, 0.0, 0.0]],
    [[0.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.0, 0.5, 0.0]],
])  # fmt: skip
"""How much the normals of faces x, y, z (rows) move by a unit of the angles between x and y, x and z, y and z."""


@dataclass(frozen=True)
class Faces:
    """Standstills on the faces of a case, opposite faces parallel, their normals at right angles within some deviation.

    Attributes
    ----------
    node : (k,)
        Standstills.
    axis, sign : (k,)
        Axis of the case, 0 to 2, that points up, or down if the sign is -1.
    squareness
        Standard deviation of the angles between faces, rad.
    headed
        Whether gyros show the headings, so that the tilt of the table they all are laid on is seen.
    """

    node: Indices
    axis: Indices
    sign: Array
    squareness: float
    headed: bool = True

    kind = "face"
    gives_heading = False
    usual = 3e-3  # a table that is not quite level, and not quite flat

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """The case's rotation against the accelerometers' axes, the angles between its faces, and the table's tilt."""
        labels = (*(f"case.rotation[{i}]" for i in range(3)), *(f"case.angles[{i}]" for i in range(3)))
        case = Nuisance("case", labels, np.repeat([_CASE_TURNED, max(self.squareness, _EXACT)], 3))
        tilt = Nuisance("tilt", ("table.tilt[0]", "table.tilt[1]"), np.full(2, _LEVEL if self.headed else _EXACT))
        return case, tilt

    @property
    def white(self) -> Array:
        """See `rest_problem.Knowledge`."""
        return np.full((self.node.size, 3), _FACE**2)

    @property
    def share(self) -> Array:
        """See `rest_problem.Knowledge`: nothing along the normal, where no row says anything."""
        return 1.0 - np.eye(3)[self.axis]

    def equations(self, problem: RestProblem, p: CellParameters, C: Array) -> Equations:
        """Return that the normal of a face is that of the table, by equation (36) of docs/explanation/model.md."""
        rotation, angles = np.split(nuisance(p, "case", 6), 2)
        R = matrix(exp(rotation))
        normals = np.eye(3) + np.einsum("kij,k->ij", _SKEWED, angles)
        n = self.sign[:, None] * normals[self.axis]
        level = C[self.node]
        normal = nuisance(p, "tilt", 2) @ level[:, :2] - level[:, 2]
        seen = normal @ R.T
        across = self.share[:, :, None]
        of_node = np.zeros((self.node.size, 3, NODE))
        of_node[..., ATTITUDE] = across * (skew(n) @ R @ skew(normal))
        by_rotation = -skew(n) @ skew(seen) @ _left_jacobian(rotation)
        by_angles = -skew(seen) @ np.moveaxis(self.sign[:, None, None] * _SKEWED[:, self.axis].swapaxes(0, 1), 1, 2)
        by_tilt = skew(n) @ R @ level[:, :2].swapaxes(1, 2)
        columns = {"case": across * np.concatenate([by_rotation, by_angles], axis=2), "tilt": across * by_tilt}
        r = self.share * np.cross(n, seen)
        return Equations(r, self.node, of_node, None, problem.columns(columns, self.node.size))

    def part(self, keep: Indices) -> Self:
        """See `rest_problem.Knowledge`."""
        return self._chosen(np.isin(self.node, keep), keep[0])

    def laid_down(self) -> Self:
        """Return the first one of standstills in a row on the same face: turned on a table, all are tilted alike."""
        follows = (np.diff(self.node) == 1) & (np.diff(self.axis) == 0) & (np.diff(self.sign) == 0.0)
        return self._chosen(np.r_[True, ~follows], 0)

    def _chosen(self, own: Mask, first: int) -> Self:
        return replace(self, node=self.node[own] - first, axis=self.axis[own], sign=self.sign[own])


@dataclass(frozen=True)
class WholeTurns:
    """Turns on a table, after which the heading is that from before, (k,): from these standstills to the next ones."""

    node: Indices

    kind = "whole turn"
    gives_heading = False
    usual = 5e-3  # half a millimetre at the end of an edge of ten centimetres
    nuisances: tuple[Nuisance, ...] = ()

    @property
    def white(self) -> Array:
        """See `rest_problem.Knowledge`."""
        return np.full((self.node.size, 3), _HEADING**2)

    @property
    def share(self) -> Array:
        """See `rest_problem.Knowledge`: only the last row says anything."""
        return np.tile([0.0, 0.0, 1.0], (self.node.size, 1))

    def equations(self, problem: RestProblem, _: CellParameters, C: Array) -> Equations:
        """Return that the heading is the same; of the tilt gravity says more."""
        r, own, following = _relative(C[self.node], C[self.node + 1])
        level = C[self.node + 1] * np.array([0.0, 0.0, 1.0])[:, None]
        none = np.zeros((self.node.size, 3, problem.layout.degrees))
        return Equations(np.einsum("kij,kj->ki", level, r), self.node, level @ own, level @ following, none)

    def part(self, keep: Indices) -> Self:
        """See `rest_problem.Knowledge`."""
        return replace(self, node=self.node[_inside(self.node, keep)] - keep[0])


@dataclass(frozen=True)
class TableTurns:
    """Turns by a turntable about an axis that is nearly known.

    Attributes
    ----------
    node : (k,)
        From these standstills to the next ones.
    angle : (k,)
        rad.
    axis : (3,)
        Of the table, in the local level, as first found; of unit length.
    scale_sd
        Deviation of the angles' scale; 0 where an encoder counts turns.
    reversed : (k,)
        Sign of a turn that goes the other way than the one before, else 0: there the play of a gear is missing.
    play_sd
        Deviation of that play, rad; 0 where there is none.
    waves : (k, 4)
        Changes of cos, sin of the encoder's angle, and of cos, sin of twice the angle, by a turn.
    waves_sd
        Deviation of the encoder's error as a sum of these, rad; 0 where there is none.
    """

    node: Indices
    angle: Array
    axis: Array
    scale_sd: float = 0.0
    reversed: Array = field(default_factory=lambda: np.zeros(0))
    play_sd: float = 0.0
    waves: Array = field(default_factory=lambda: np.zeros((0, 4)))
    waves_sd: float = 0.0

    kind = "table"
    usual = None

    @property
    def gives_heading(self) -> bool:
        """A level axis is where its heading is known."""
        return bool(abs(self.axis[2]) < np.sqrt(0.5))

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """The axis's misalignment against the first one, about the two axes across, and errors of the angles."""
        axis = Nuisance("table", ("table.axis[0]", "table.axis[1]"), np.full(2, _CASE_TURNED))
        scale = Nuisance("table_scale", ("table.scale",), np.array([self.scale_sd]))
        play = Nuisance("table_play", ("table.play",), np.array([self.play_sd]))
        labels = tuple(f"table.waves[{i}]" for i in range(4))
        waves = Nuisance("table_waves", labels, np.full(4, self.waves_sd))
        return axis, *(one for one in (scale, play, waves) if one.width[0])

    @property
    def white(self) -> Array:
        """See `rest_problem.Knowledge`."""
        return np.full((self.node.size, 3), _TABLE**2)

    @property
    def share(self) -> Array:
        """See `rest_problem.Knowledge`."""
        return np.ones((self.node.size, 3))

    def axis_by(self, p: CellParameters) -> tuple[Array, Array]:
        """Return the axis (3,), and its derivative by both nuisances (3, 2)."""
        across = matrix(from_two_vectors([0.0, 0.0, 1.0], self.axis))[:, :2]
        n = self.axis + across @ nuisance(p, "table", 2)
        length = np.linalg.norm(n)
        n = n / length
        return n, (np.eye(3) - np.outer(n, n)) @ across / length

    def equations(self, problem: RestProblem, p: CellParameters, C: Array) -> Equations:
        """Return that a turn is one about the axis by the angle, by equation (37) of docs/explanation/model.md."""
        n, J = self.axis_by(p)
        angle = (1.0 + nuisance(p, "table_scale", 1)[0]) * self.angle
        if self.play_sd:
            angle = angle - nuisance(p, "table_play", 1)[0] * self.reversed
        if self.waves_sd:
            angle = angle - self.waves @ nuisance(p, "table_waves", 4)
        vector = angle[:, None] * n
        T = matrix(exp(vector))
        before, after = T @ C[self.node], C[self.node + 1]
        r, own, following = _relative(before, after)
        # exp(v + dv) = exp(J_l dv) exp(v); seen from the next b
        turned = -np.swapaxes(after, 1, 2) @ np.stack([_left_jacobian(v) for v in vector])
        columns = {"table": angle[:, None, None] * (turned @ J)}
        if self.scale_sd:
            columns["table_scale"] = self.angle[:, None, None] * (turned @ n)[:, :, None]
        if self.play_sd:
            columns["table_play"] = -self.reversed[:, None, None] * (turned @ n)[:, :, None]
        if self.waves_sd:
            columns["table_waves"] = -self.waves[:, None, :] * (turned @ n)[:, :, None]
        return Equations(r, self.node, own, following, problem.columns(columns, self.node.size))

    def part(self, keep: Indices) -> Self:
        """See `rest_problem.Knowledge`."""
        own = _inside(self.node, keep)
        back = self.reversed[own] if self.reversed.size else self.reversed
        waves = self.waves[own] if self.waves.size else self.waves
        return replace(self, node=self.node[own] - keep[0], angle=self.angle[own], reversed=back, waves=waves)


@dataclass(frozen=True)
class HingeTurns:
    """Turns by unknown angles about axes that stand still in the device and in the world, one axis for each mounting.

    Attributes
    ----------
    node : (k,)
        From these standstills to the next ones.
    mounting : (k,)
        Number of the mounting each belongs to.
    axes : (m, 3)
        Of the mountings, in b, as first found; of unit length.
    """

    node: Indices
    mounting: Indices
    axes: Array

    kind = "hinge"
    gives_heading = False
    usual = 1e-3  # the play of a bearing

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Every axis's direction against the first one, about two axes across."""
        labels = tuple(f"hinge.axes[{m},{i}]" for m in range(len(self.axes)) for i in range(2))
        return (Nuisance("hinge", labels, np.full(len(labels), _CASE_TURNED)),)

    @property
    def white(self) -> Array:
        """See `rest_problem.Knowledge`."""
        return np.full((self.node.size, 3), _HINGE**2)

    @property
    def share(self) -> Array:
        """See `rest_problem.Knowledge`: nothing along the axis, where no row says anything."""
        return np.tile([1.0, 1.0, 0.0], (self.node.size, 1))

    def equations(self, problem: RestProblem, p: CellParameters, C: Array) -> Equations:
        """Return that the axis has the same direction after a turn, by equation (39) of docs/explanation/model.md."""
        frames = np.stack([matrix(from_two_vectors([0.0, 0.0, 1.0], axis)) for axis in self.axes])
        moved = nuisance(p, "hinge", 2 * len(self.axes)).reshape(-1, 2)
        n = self.axes + np.einsum("mij,mj->mi", frames[..., :2], moved)
        length = np.linalg.norm(n, axis=1, keepdims=True)
        n = n / length
        by_axis = (np.eye(3) - n[:, :, None] * n[:, None]) @ frames[..., :2] / length[..., None]
        own, across = n[self.mounting], np.swapaxes(frames[self.mounting], 1, 2)
        across[:, 2] = 0.0  # along the axis nothing is said
        A = np.swapaxes(C[self.node + 1], 1, 2) @ C[self.node]
        seen = np.einsum("kij,kj->ki", A, own)
        of_node, of_next = np.zeros((2, self.node.size, 3, NODE))
        of_node[..., ATTITUDE] = -across @ A @ skew(own)
        of_next[..., ATTITUDE] = across @ skew(seen)
        columns = np.zeros((self.node.size, 3, len(self.axes), 2))
        columns[np.arange(self.node.size), :, self.mounting] = across @ (A - np.eye(3)) @ by_axis[self.mounting]
        by_group = {"hinge": columns.reshape(self.node.size, 3, -1)}
        r = np.einsum("kij,kj->ki", across, seen - own)
        return Equations(r, self.node, of_node, of_next, problem.columns(by_group, self.node.size))

    def part(self, keep: Indices) -> Self:
        """See `rest_problem.Knowledge`."""
        own = _inside(self.node, keep)
        return replace(self, node=self.node[own] - keep[0], mounting=self.mounting[own])


def _inside(node: Indices, keep: Indices) -> Mask:
    """Return which turns from standstills (k,) to the next ones lie within some in a row."""
    return np.asarray((node >= keep[0]) & (node < keep[-1]))


def _relative(before: Array, after: Array) -> tuple[Array, Array, Array]:
    """Return log(before^T after) (k, 3), and its derivatives by the unknowns of both standstills, (k, 3, NODE)."""
    A = np.swapaxes(before, 1, 2) @ after
    own, following = np.zeros((len(A), 3, NODE)), np.zeros((len(A), 3, NODE))
    own[..., ATTITUDE] = -np.swapaxes(A, 1, 2)
    following[..., ATTITUDE] = np.eye(3)
    return log(from_matrix(A)), own, following


def _left_jacobian(v: Array) -> Array:
    """Return J (3, 3) with exp(v + dv) = exp(J dv) exp(v)."""
    angle = float(np.linalg.norm(v))
    S = skew(v)
    if angle < 1e-6:
        return np.eye(3) + 0.5 * S
    return np.asarray(np.eye(3) + (1.0 - np.cos(angle)) / angle**2 * S + (angle - np.sin(angle)) / angle**3 * S @ S)
