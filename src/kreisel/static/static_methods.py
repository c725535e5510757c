"""Which static method the data allow: what is known of the attitudes, and the first values that follow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kreisel.errors import RecordingError, SettingsError, unknown_name
from kreisel.geometry.rotation import Array, Indices, Mask, lengths
from kreisel.inertial.counts import Counts
from kreisel.model.parameters import CellParameters
from kreisel.recording.recording import DataWarning, ImuSamples, TableAngles
from kreisel.static.first_values import MIN_ATTITUDES, first_values
from kreisel.static.known_attitudes import Faces, HingeTurns, TableTurns, WholeTurns
from kreisel.static.rest_equations import attitudes_by
from kreisel.static.rest_problem import RestProblem
from kreisel.static.spins import cut_off, leading, steps_of, uncounted
from kreisel.static.turns import turns_between
from kreisel.validation.stamp_checks import LONG_GAP, gaps

METHODS = ("multi-position", "six-position", "ferraris", "turntable", "hinge")
"""Names of the static methods, by what is known of the attitudes besides gravity: nothing, faces of a case, faces and
whole turns, turns of a table, that turns are about one axis in each mounting."""

SQUARENESS = 2e-3
"""rad; standard deviation of the angles between a case's faces. Chosen: a milled case has less, a printed one more."""

_ON_A_FACE, _NEAR = 0.26, 0.09
"""rad: largest tilt of a standstill that counts as one on a face if the method is stated, and if it is not."""

_FULL = 0.12
"""Share by which a whole turn by uncalibrated gyros may differ from one. Chosen: no device errs by more."""

_TURNED, _STILL = 0.02, 2e-3
"""rad: least turn of a table that is used, and most that it may move at a standstill. Chosen: below the first its
encoder and its bearing count too much; the second is beyond the noise of any encoder."""

_MOVED = 2e-4
"""rad; how far a table may seem to move at standstills, by its encoder's steps, and not by a wrong clock. Chosen."""

_RATE_SCALE = 1e-3
"""Deviation of the scale of a table's rates. Chosen: of usual rate tables; an encoder's angles close after a turn."""

_AGREEING, _STEP = 0.7, 0.02
"""Share of a table's turns that must agree with the gyros, the device being moved in none of them; and s, between two
values of the rates that are compared."""

_ONE_AXIS, _STRAIGHT, _LEAST_TURN, _MOST = 0.05, 0.97, 0.2, 0.6
"""rad between the axes of turns by uncalibrated gyros that are about one; share of a turn's way that leads along it;
rad, its least angle; and share of all turns that must be so, where the method is not stated. Chosen: nobody turns a
device by hand about one axis twice within three degrees."""

_PEAKS = 20
"""Shifts of a table's clock that are tried."""

_RATIOS = tuple(1.0 + 5e-4 * k for k in range(-40, 41) if k)
"""Other ratios of a table's seconds to the IMU's that are tried. Chosen: oscillators of cheap sensors are off by a
percent, and half a step moves a turn of ten minutes by less than it lasts."""

_SAME = 0.15
"""Share by which the way by the gyros may differ from the table's; otherwise the device was moved, too."""


@dataclass(frozen=True)
class Chosen:
    """A method, with what is known by it.

    Attributes
    ----------
    name
        Of the method.
    problem, start
        With what is known of the attitudes, and first values.
    attitudes
        First ones, (M, 3, 3), where something gives them.
    warnings
        What was found on the way.
    time_base_sd
        Deviation of the ratio of the IMU's seconds to true ones, where another clock differs.
    frame_sd
        rad: deviation of the reported body's attitude, the same in all attitudes.
    counts
        What a count of raw converter readings is, where they are calibrated.
    """

    name: str
    problem: RestProblem
    start: CellParameters
    attitudes: Array | None = None
    warnings: tuple[DataWarning, ...] = ()
    time_base_sd: float = 0.0
    frame_sd: float = 0.0
    counts: Counts | None = None


_UNCOUNTED = (
    "turns of many revolutions that nothing counts, and that are not used: {count}; turn about one axis at a time, six "
    "degrees or more from upright"
)
"""What is said of turns that are left out for this."""

_CUT_OFF = (
    "turns in which a gyro is at the end of its range, or beyond, and that are not used: {count}; turn more slowly"
)
"""The same, of gyros that are saturated."""

_DETECTED = {
    "six-position": "six-position: all standstills are on the six faces of a case, taken to be at right angles "
    "(--squareness); --method multi-position does without that",
    "ferraris": "ferraris: all standstills are on the six faces of a case, taken to be at right angles (--squareness), "
    "with whole turns in between; --method multi-position does without that",
    "hinge": "hinge: turns are about one axis in each mounting, by angles that nobody states; --method multi-position "
    "does without that",
}
"""What is said where the data showed the method."""


def with_method(
    problem: RestProblem, stated: str | None, table: TableAngles | None, squareness: float = SQUARENESS
) -> Chosen:
    """Return the method with what is known by it.

    Parameters
    ----------
    stated
        One of `METHODS`; None for the one that the data show.
    squareness
        See `SQUARENESS`.

    Raises
    ------
    SettingsError
        For an unknown method.
    RecordingError
        If the recording is not one for the stated method.
    """
    if stated is not None and stated not in METHODS:
        raise SettingsError(unknown_name("method", stated, METHODS))
    if stated == "turntable" and table is None:
        raise RecordingError("no table0/data.csv; the turntable's angle or rate is needed", file=problem.imu.source)
    if table is not None and stated in (None, "turntable"):
        chosen = _on_turntable(problem, table)
        return _without(chosen, cut_off(chosen.problem), _CUT_OFF)
    start = first_values(problem)
    chosen = _without(_by_hand(problem, start, stated, squareness), uncounted(problem, start.sensors), _UNCOUNTED)
    return _without(chosen, cut_off(problem), _CUT_OFF)


def _without(chosen: Chosen, turns: Indices, said: str) -> Chosen:
    """Return a method without some turns, and with what is said of them."""
    if not turns.size:
        return chosen
    left = tuple(np.union1d(chosen.problem.unused, turns).astype(int).tolist())
    warning = DataWarning("turns", said.format(count=turns.size))
    return replace(chosen, problem=replace(chosen.problem, unused=left), warnings=(*chosen.warnings, warning))


def _by_hand(problem: RestProblem, start: CellParameters, stated: str | None, squareness: float) -> Chosen:
    """Return the method without a turntable."""
    if stated == "multi-position":
        return Chosen(stated, problem, start)
    if stated == "hinge":
        return _on_hinge(problem, start, stated)
    faces = _faces(problem, start, _NEAR if stated is None else _ON_A_FACE, squareness)
    found = {(int(a), float(s)) for a, s in zip(faces.axis, faces.sign, strict=True)}
    if stated is None and (len(found) < 6 or faces.node.size < problem.rests.count):
        return _on_hinge(problem, start, stated)
    if len(found) < 6:
        missing = ", ".join(f"{s}{'xyz'[a]}" for a in range(3) for s in "+-" if (a, float(f"{s}1")) not in found)
        raise RecordingError(
            f"no standstill has the axis {missing} up; {stated} needs all six faces, laid down one after the other",
            file=problem.imu.source,
        )
    turns = _whole_turns(problem, start, faces)
    about = set(faces.axis[np.isin(faces.node, turns.node)].tolist())
    if stated == "six-position" or (stated is None and len(about) < 3):
        return _chosen("six-position", replace(problem, known=(faces.laid_down(),)), start, stated)
    if len(about) < 3:
        missing = ", ".join("xyz"[a] for a in range(3) if a not in about)
        raise RecordingError(
            f"no whole turn about the axis {missing} is found between two standstills on one face; ferraris needs one "
            "about each axis: lay the device down, turn it on the table by 360 deg, and leave it again",
            file=problem.imu.source,
        )
    return _chosen("ferraris", replace(problem, known=(faces.laid_down(), turns)), start, stated)


def _chosen(name: str, problem: RestProblem, start: CellParameters, stated: str | None) -> Chosen:
    said = () if stated else (DataWarning("method", _DETECTED[name]),)
    return Chosen(name, problem, start, warnings=said)


def _faces(problem: RestProblem, start: CellParameters, near: float, squareness: float) -> Faces:
    """Return the standstills on a face, its normal within an angle of the vertical."""
    up = (problem.rests.forces + start.sensors.k_a[0]) @ start.sensors.K_a.T
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    axis: Indices = np.argmax(np.abs(up), axis=1)
    largest = np.take_along_axis(up, axis[:, None], axis=1)[:, 0]
    node = np.flatnonzero(np.abs(largest) > np.cos(near))
    imu = problem.imu
    headed = bool(np.ptp(imu.rates, axis=0).all()) and not len(gaps(imu.stamps_ns, LONG_GAP))
    return Faces(node, axis[node], np.sign(largest[node]), squareness, headed)


def _whole_turns(problem: RestProblem, start: CellParameters, faces: Faces) -> WholeTurns:
    """Return the turns that leave a face up and go round about it, once or several times."""
    way = _sums(problem, start)
    face = np.zeros((problem.rests.count, 3))
    face[faces.node, faces.axis] = faces.sign
    same = np.einsum("mi,mi->m", face[:-1], face[1:]) > 0.5
    about = np.einsum("mi,mi->m", way, face[:-1]) / (2.0 * np.pi)
    size = lengths(way) / (2.0 * np.pi)
    number = np.round(np.abs(about))
    whole = (number >= 1.0) & (np.abs(np.abs(about) - number) < _FULL * number) & (np.abs(about) > 0.95 * size)
    return WholeTurns(np.flatnonzero(same & whole))


def _sums(problem: RestProblem, start: CellParameters) -> Array:
    """Return the integral of the rates between standstills by first values, (M - 1, 3), rad."""
    return _between(problem, steps_of(problem, start.sensors))


def _between(problem: RestProblem, steps: Array) -> Array:
    """Return sums of steps (n - 1, k) between standstills, (M - 1, k)."""
    whole = np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
    return np.asarray(whole[problem.rests.first[1:]] - whole[problem.rests.last[:-1] - 1])


def _on_turntable(problem: RestProblem, table: TableAngles) -> Chosen:
    """Return the method with the turns of a table.

    Notes
    -----
    Of the clocks that are possible that one is taken with which most turns of the table agree with the gyros, and with
    which the table does not move where the device stands still; of those that are alike, the first.
    """
    clocks = (_agreeing(problem, table, seconds, ratio) for seconds, ratio in _clocks(problem.imu, table))
    found = [one for one in clocks if one is not None]
    most = max((one.share * one.node.size for one in found), default=0.0)
    found = [one for one in found if one.share * one.node.size == most]
    least = min((one.moved for one in found), default=0.0)
    best = next((one for one in found if one.moved <= 2.0 * least + _MOVED), None)
    if best is None:
        raise RecordingError(
            "the turntable never stands still long enough: let it rest for two seconds between two rates, or angles",
            file=table.source,
        )
    if best.share < _AGREEING:
        raise RecordingError(
            f"{100.0 * best.share:.0f} % of the table's turns agree with the gyros: are its angle in rad or deg as its "
            "header says, and its stamps those of the same motion?", file=table.source,
        )  # fmt: skip
    problem, start, node, angle, way = best.problem, best.start, best.node, best.angle, best.way
    C = attitudes_by(problem, start, turns_between(problem.imu, problem.raw, problem.rests, start.sensors))
    axes = np.einsum("kij,kj->ki", C[node], way[node] / angle[node, None])
    axis = np.median(axes / np.linalg.norm(axes, axis=1, keepdims=True), axis=0)
    axis /= np.linalg.norm(axis)
    multiples = best.place[:, None] * np.array([1.0, 2.0])
    waves = np.diff(np.stack([np.cos(multiples), np.sin(multiples)], axis=2).reshape(-1, 4), axis=0)[node]
    scale_sd = _RATE_SCALE if table.by_rate else 0.0
    turns = TableTurns(node, angle[node], axis, scale_sd, _reversed(angle)[node], waves=waves)
    begun = _with_turns(start, way[node], turns, C[node])
    off = best.ratio - 1.0
    said = (_differing_clocks(off),) if off else ()
    return Chosen("turntable", replace(problem, known=(turns,)), begun, warnings=said, time_base_sd=abs(off))


def _differing_clocks(off: float) -> DataWarning:
    """Return the warning about a table's seconds, whose ratio to the IMU's is off by so much."""
    text = (
        f"the clocks of table and IMU differ by {100.0 * off:+.1f} %, and it is not known which is right: the gyros' "
        "scale factors are uncertain by as much"
    )
    return DataWarning("clocks", text)


def _reversed(angle: Array) -> Array:
    """Return the sign of each turn (k,) that goes the other way than the one before, of others zero."""
    out, way = np.zeros(angle.size), 0.0
    for k, one in enumerate(angle):
        if abs(one) > _TURNED:
            out[k] = np.sign(one) if np.sign(one) == -way else 0.0
            way = float(np.sign(one))
    return out


@dataclass(frozen=True)
class _Agreement:
    """Standstills by a clock of the table, its turns between them (M - 1,), and those that the gyros confirm.

    `place`: its angles at them (M,); `way`: integrals of the rates (M - 1, 3); `share`: of the turns, those that are
    confirmed; `moved`: by how much the table moves from beginning to end of a standstill, rad, on average; `ratio`: of
    its seconds to the IMU's.
    """

    problem: RestProblem
    start: CellParameters
    place: Array
    angle: Array
    way: Array
    node: Indices
    share: float
    moved: float
    ratio: float


def _agreeing(problem: RestProblem, table: TableAngles, seconds: Array, ratio: float) -> _Agreement | None:
    """Return how a table's turns agree with the gyros; None where it stands still too seldom.

    seconds: the table's, at every sample of the IMU; ratio: of these to the IMU's.
    """
    rests = problem.rests
    # clocks may drift apart: well inside a standstill the table stands still by either
    quarter = (rests.last - rests.first) // 4
    inside = (rests.first + quarter, rests.last - 1 - quarter)
    begin, end = (np.interp(seconds[at], table.seconds, table.angles) for at in inside)
    recorded = (seconds[rests.first] >= table.seconds[0]) & (seconds[rests.last - 1] <= table.seconds[-1])
    still: Mask = recorded & (np.abs(end - begin) < _STILL)
    if np.count_nonzero(still) < MIN_ATTITUDES:
        return None
    problem = replace(problem, rests=rests.part(still))
    place = 0.5 * (begin + end)[still]
    angle = np.diff(place)
    start = first_values(problem)
    way = _sums(problem, start)
    turned = np.abs(angle) > _TURNED
    agrees = turned & (np.abs(lengths(way) - np.abs(angle)) < _SAME * np.abs(angle))
    share = float(np.count_nonzero(agrees)) / max(float(np.count_nonzero(turned)), 1.0)
    edges = (np.interp(seconds[at], table.seconds, table.angles)[still] for at in (rests.first, rests.last - 1))
    moved = float(np.mean(np.abs(np.subtract(*edges))))
    return _Agreement(problem, start, place, angle, way, np.flatnonzero(agrees), share, moved, ratio)


def _clocks(imu: ImuSamples, table: TableAngles) -> list[tuple[Array, float]]:
    """Return the table's seconds at every sample of the IMU, (n,), by every clock that is possible, with its ratio.

    By the stamps as they are, and by the shifts with which both rates are most alike: turns of a device that is laid
    down anew may be larger than the table's. Then the same by the ratio of both clocks with which they are most alike.
    """
    stamped = (imu.stamps_ns - table.stamps_ns[0]) * 1e-9
    out = [(stamped, 1.0)] if stamped[-1] > 0.0 and stamped[0] < table.seconds[-1] else []
    tau = np.arange(0.0, float(table.seconds[-1]), _STEP)
    turning = np.abs(np.gradient(np.interp(tau, table.seconds, table.angles), _STEP)) if tau.size > 1 else np.zeros(1)
    rate = lengths(imu.rates - np.median(imu.rates, axis=0))

    def seconds_alike(ratio: float) -> tuple[float, list[tuple[Array, float]]]:
        own = ratio * imu.seconds
        turned = np.interp(np.arange(0.0, float(own[-1]), _STEP), own, rate)
        height, shifts = _shifts(turned, turning)
        return height, [(own - _STEP * shift, ratio) for shift in shifts]

    same = seconds_alike(1.0)
    other = max((seconds_alike(ratio) for ratio in _RATIOS), key=lambda one: one[0])
    return [*out, *same[1], *(other[1] if other[0] > same[0] else [])]


def _shifts(x: Array, y: Array) -> tuple[float, Indices]:
    """Return how alike two series are at most, and the shifts, in steps, with which they are most alike."""
    size = x.size + y.size
    alike = np.fft.irfft(np.fft.rfft(x - x.mean(), size) * np.conj(np.fft.rfft(y - y.mean(), size)), size)
    peaks = np.flatnonzero((alike > np.roll(alike, 1)) & (alike >= np.roll(alike, -1)))
    best = np.union1d(peaks[np.argsort(-alike[peaks])[:_PEAKS]], np.argmax(alike))
    return float(alike.max()), np.where(best < x.size, best, best - size)


def _with_turns(start: CellParameters, way: Array, turns: TableTurns, C: Array) -> CellParameters:
    """Return first values with a gyro matrix by which integrals of rates (k, 3) are the table's turns."""
    meant = turns.angle[:, None] * np.einsum("kji,j->ki", C, turns.axis)
    return replace(start, sensors=replace(start.sensors, K_omega=leading(way, meant) @ start.sensors.K_omega))


def _on_hinge(problem: RestProblem, start: CellParameters, stated: str | None) -> Chosen:
    """Return the method with turns about one axis in each mounting, or without that where there are too few."""
    steps = steps_of(problem, start.sensors)
    way = _between(problem, steps)
    length = _between(problem, np.linalg.norm(steps, axis=1, keepdims=True))[:, 0]
    size = lengths(way)
    turned = size > _LEAST_TURN
    straight = turned & (size > _STRAIGHT * length)
    axes = way / np.maximum(size, 1e-9)[:, None]
    node: list[int] = []
    mounting: list[int] = []
    found: list[Array] = []
    for m in range(size.size):
        if not straight[m]:
            continue
        same = bool(node) and node[-1] == m - 1 and abs(axes[m] @ found[-1]) > np.cos(_ONE_AXIS)
        if not same:
            found.append(axes[m])
        node.append(m)
        mounting.append(len(found) - 1)
    count = np.bincount(mounting, minlength=len(found))
    kept = np.flatnonzero(count > 1)  # of a single turn, any axis is its own
    own = np.isin(mounting, kept)
    if not own.any() or (stated is None and own.sum() < _MOST * np.count_nonzero(turned)):
        if stated is None:
            return Chosen("multi-position", problem, start)
        raise RecordingError(
            "no two turns in a row are about one axis of the device; hinge needs two or more in each mounting, with a "
            "standstill of two seconds before and after each", file=problem.imu.source,
        )  # fmt: skip
    turns = HingeTurns(np.array(node)[own], np.searchsorted(kept, np.array(mounting)[own]), np.array(found)[kept])
    return _chosen("hinge", replace(problem, known=(turns,)), start, stated)
