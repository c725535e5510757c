"""Positions of the IMUs of a rigid array from readings in motion, without a reference.

At every sample the acceleration of the first IMU, the angular acceleration, and how both change are unknowns of their
own: products of rates give the scale of positions. The rates' derivatives show the angular acceleration, too; by how
much the gyros' filter and the cubics make them smaller, and how well they are known, is found. Offsets of
accelerometers drift while units warm up; the mean of squared rates would take that for a position, so offset and drift
are estimated, too. Each IMU may read at a moment of its own, which its gyros show: the difference of its rates from the
mean, along the angular acceleration.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.array.hand_motion import HandMotion
from kreisel.geometry.rotation import Array, exp, lengths, matrix

_JERK, _ANGULAR_JERK = 5e3, 6e4
"""m/s^3 and rad/s^3: usual sizes of what changes within a sample, as a prior. Chosen: those of the quickest shaking by
hand."""

_PRIORS = {
    "position": 1.0,
    "turn": 1e-2,
    "arm": 1e-3,
    "matrix": 2e-3,
    "offset": 5e-2,
    "lag": 5e-3,
    "smoothing": 3e-5,
    "rate": 1e-3,
    "slope": 0.05,
    "filtering": 3e-5,
    "cubic": 5e-5,
    "late": 5e-3,
}
"""Standard deviations: position (m), turn against the first estimate (rad), position of one accelerometer against that
of its IMU (m), matrix, change of the offset since the standstills and half its drift (m/s^2), delay of the
accelerometers against the gyros (s), smoothing beyond the gyros' (s^2), mean offset of the gyros since the
standstills (rad/s), share by which the gyros' derivatives fall short, smoothing of the gyros (s^2; a filter of 30
Hz), cubic coefficients of each axis of theirs ((rad/s)^-2; 0.25 % at 7 rad/s), by how much an IMU's accelerometers
are ahead of its gyros beyond the first one's (s). The offsets: 5 mg and 200 deg/h, by which inexpensive units drift
when they warm up. Derivatives of 4 Hz are 3 % short by cubics at 62.5 Hz, and 2 % by a filter of 20 Hz."""

_UNKNOWN = {"offset": 0.6, "matrix": 5e-2, "rate": 0.1}
"""The same of an IMU that is not calibrated by standstills: those of usual devices, see `model.groups`; where none is,
the gyros' offsets are what they show in the quietest second, in a hand."""

_PASSES, _ROBUST, _SETTLED = 20, 3, 0.02
"""Passes at most, the one from which samples count by Student's distribution, and the change of every parameter, in
deviations, with which they end."""

_STUDENT = 3.0
"""Degrees of freedom of that distribution. Chosen: heavy tails of motion by hand."""

_BAD = 2.0
"""Noise of a unit's readings, over that of most units, from which they count less. Chosen: like units differ by a
tenth."""

_UNSURE, _USEFUL, _ENOUGH = 30.0, 2.0, 4
"""By what factor the gyros' derivatives are less certain than noise and cubics say, to begin with, so that they say
little, and up to which they count where there are so many IMUs that accelerometers alone determine the angular
acceleration. Chosen: in clean recordings it is 1; shaken with impacts, at 62.5 Hz, 6, and distances were 1 % off."""

_CHANGING = 6
"""IMUs from which on it is an unknown, too, how accelerations change within the differences of moments of reading.
Chosen: with four there are as many readings as unknowns."""

_CHUNK = 4096
"""Samples whose rows are in memory at once: 150 MB for eight IMUs."""

_BLOCK, _JOINED, _FEW = 1.0, (1, 4), 12
"""Seconds of the blocks whose scatter gives the deviations, how many are taken together, and the fewest parts that show
a scatter. Chosen: as for units of a tray."""


@dataclass(frozen=True)
class ArrayFit:
    """Where the IMUs lie.

    Attributes
    ----------
    positions : (N, 3)
        Of the middles of the accelerometers in the axes of the first IMU, m.
    axes : (N, 3, 3)
        Turn vectors of an IMU into those axes.
    covariance : (N, 6, 6)
        Of position and of a rotation vector in those axes.
    residual
        Of the accelerometers, m/s^2.
    delay
        Standard deviation of the moments of reading, s.
    lag, smoothing
        Of the accelerometers against the gyros, s and s^2, with deviations.
    ahead : (N,)
        Of each IMU's accelerometers to its gyros, beyond those of the first, s.
    scale_deviation
        Relative, common to all distances: it is that of the gyros' common scale and of bandwidths.
    """

    positions: Array
    axes: Array
    covariance: Array
    residual: float
    delay: float
    lag: tuple[float, float]
    smoothing: tuple[float, float]
    ahead: Array
    scale_deviation: float


class _Layout:
    """Where the parameters stand: position and turn of the further IMUs; arms, matrix, offsets of each; common ones."""

    def __init__(self, gyro: Array, calibrated: Sequence[bool]) -> None:
        self.count = count = len(calibrated)
        at = 3 * (count - 1)
        self.position = [slice(3 * (k - 1), 3 * k) if k else None for k in range(count)]
        self.turn = [slice(at + 3 * (k - 1), at + 3 * k) if k else None for k in range(count)]
        at *= 2
        self.arm = [[slice(at + 9 * k + 3 * j, at + 9 * k + 3 * j + 3) for j in range(3)] for k in range(count)]
        at += 9 * count
        self.matrix = [[slice(at + 9 * k + 3 * j, at + 9 * k + 3 * j + 3) for j in range(3)] for k in range(count)]
        at += 9 * count
        self.offset = [slice(at + 6 * k, at + 6 * k + 6) for k in range(count)]
        at += 6 * count
        self.gyro, self.lag, self.smoothing, self.rate = slice(at, at + 9), at + 9, at + 10, slice(at + 11, at + 14)
        self.slope, self.filtering, self.cubic = at + 14, at + 15, slice(at + 16, at + 16 + 3 * count)
        at += 16 + 3 * count
        self.late = [at + k - 1 if k else None for k in range(count)]
        self.size = at + count - 1
        sizes = [3 * (count - 1), 3 * (count - 1), 9 * count, 9 * count, 6 * count]
        names = ("position", "turn", "arm", "matrix", "offset")
        own = np.repeat([_PRIORS[name] for name in names], sizes)
        rate = (_UNKNOWN if not any(calibrated) else _PRIORS)["rate"]
        common = [_PRIORS["lag"], _PRIORS["smoothing"], *[rate] * 3, _PRIORS["slope"], _PRIORS["filtering"]]
        common += [_PRIORS["cubic"]] * 3 * count + [_PRIORS["late"]] * (count - 1)
        self.deviations = np.concatenate([own, gyro, common])
        for k in np.flatnonzero(~np.array(calibrated)):
            self.deviations[self.offset[k].start : self.offset[k].start + 3] = _UNKNOWN["offset"]
            for own_matrix in self.matrix[k]:
                self.deviations[own_matrix] = _UNKNOWN["matrix"]

    def arm_of(self, theta: Array, k: int, j: int) -> Array:
        """Return the position of accelerometer j of IMU k."""
        own = self.position[k]
        return np.asarray(theta[self.arm[k][j]] + (0.0 if own is None else theta[own]))

    def mixing(self, theta: Array) -> Array:
        """Return the matrices (N, 3, 3) from ideal accelerometers to those of each IMU."""
        own = [[np.eye(3)[j] - theta[self.matrix[k][j]] for j in range(3)] for k in range(self.count)]
        return np.array(own)

    def middle(self, k: int) -> Array:
        """Return the derivative (3, size) of the middle of an IMU's accelerometers against that of the first."""
        out = np.zeros((3, self.size))
        own = self.position[k]
        if own is not None:
            out[:, own] = np.eye(3)
            for j in range(3):
                out[:, self.arm[k][j]] += np.eye(3) / 3.0
                out[:, self.arm[0][j]] -= np.eye(3) / 3.0
        return out


@dataclass
class _Sums:
    """Sums of a pass over the samples; of the gyros' derivatives, of squares and of what is expected of them."""

    information: Array
    score: Array
    of_blocks: Array
    squares: Array
    of_units: Array
    of_slopes: Array

    @property
    def slope_misfit(self) -> float:
        """By how much the gyros' derivatives scatter more than was assumed (Helmert's estimate)."""
        squares, expected = self.of_slopes
        return float(np.sqrt(squares / expected))


def fit_array(motion: HandMotion, gyro_deviation: Array, calibrated: Sequence[bool]) -> ArrayFit:
    """Return where the IMUs lie.

    Parameters
    ----------
    gyro_deviation : (9,)
        Of the entries of the gyros' mean matrix.
    calibrated
        Whether each IMU's readings are corrected by what its standstills show.
    """
    layout = _Layout(gyro_deviation, calibrated)
    theta, prior = np.zeros(layout.size), np.diag(layout.deviations**-2)
    alpha, variance = motion.slope.copy(), 1.0
    weights: Array = np.ones(motion.seconds.size)
    trust = _trust_again(np.median(np.sum(np.diff(motion.forces, 3, axis=1) ** 2, axis=2), axis=1))  # one may vibrate
    rates, spread = _own_moments(motion)
    slope_factor = _UNSURE
    differences = _differences(motion)
    for number in range(_PASSES):
        delays = np.zeros(differences.shape[:2])
        if number > 1 and spread > 0.0:
            share = np.sum(alpha**2, axis=1) + (rates / spread) ** 2
            delays = np.einsum("kmj,mj->km", differences, alpha) / share
            delays -= delays.mean(axis=0)
        sums = _pass(motion, layout, theta, alpha, delays, weights / variance, variance, number, trust, slope_factor)
        if number and np.isfinite(slope_factor):
            slope_factor = max(1.0, slope_factor * sums.slope_misfit)
            if number == 2 * _ROBUST and slope_factor > _USEFUL and layout.count >= _ENOUGH:
                slope_factor = np.inf
        P = _inverse(sums.information, layout.deviations)
        change = P @ (sums.score - prior @ theta)
        theta = theta + change
        own = sums.squares
        if number >= _ROBUST:
            weights = (_STUDENT + 1.0) / (_STUDENT + own / variance)
            trust = trust * _trust_again(sums.of_units)
        variance = float(np.average(own, weights=weights))
        if number > 2 * _ROBUST and (np.abs(change) < _SETTLED * np.sqrt(np.diag(P))).all():
            break
    covariance = _covariance(sums, layout.deviations)
    return _concluded(motion, layout, theta, covariance, float(np.sqrt(variance)), spread)


def _trust_again(squares: Array) -> Array:
    """Return factors (N,) on the readings of units by squares of their noise: less than one for bad ones."""
    rms = np.sqrt(squares)
    ratio = rms / float(np.median(rms))
    return np.where(ratio > _BAD, 1.0 / ratio, 1.0)


def _inverse(information: Array, deviations: Array) -> Array:
    """Return the inverse of information with that of priors, computed in units of these."""
    scaled = deviations[:, None] * (0.5 * (information + information.T)) * deviations
    inverse = np.linalg.inv(scaled + np.eye(deviations.size))
    return np.asarray(deviations[:, None] * (0.5 * (inverse + inverse.T)) * deviations)


def _covariance(sums: _Sums, deviations: Array) -> Array:
    """Return the covariance, with deviations that follow the scatter of blocks where it exceeds the noise's."""
    inverse = _inverse(sums.information, deviations)
    of_blocks = sums.of_blocks[np.any(sums.of_blocks != 0.0, axis=1)]
    seen, of_prior = np.diag(inverse), np.sum((inverse / deviations) ** 2, axis=1)
    for together in _JOINED:
        edges = np.arange(0, len(of_blocks), together)
        if edges.size >= _FEW or together == 1:
            influence = np.add.reduceat(of_blocks, edges) @ inverse
            scattered = np.sum(influence**2, axis=0) * edges.size / max(edges.size - 1.0, 1.0)
            seen = np.maximum(seen, scattered + of_prior)
    factor = np.sqrt(seen / np.diag(inverse))
    return np.asarray(factor[:, None] * inverse * factor)


def _concluded(
    motion: HandMotion, layout: _Layout, theta: Array, covariance: Array, residual: float, delay: float
) -> ArrayFit:
    count = layout.count
    positions, axes, spreads = np.zeros((count, 3)), motion.axes.copy(), np.zeros((count, 6, 6))
    for k in range(1, count):
        turn = layout.turn[k]
        axes[k] = motion.axes[k] @ matrix(exp(theta[turn]))
        J = np.zeros((6, layout.size))
        J[:3] = layout.middle(k)
        J[3:, turn] = axes[k]
        positions[k], spreads[k] = J[:3] @ theta, J @ covariance @ J.T
    sd = np.sqrt(np.diag(covariance))
    lag, smoothing = layout.lag, layout.smoothing
    whole = positions.ravel()
    J = np.vstack([layout.middle(k) for k in range(count)])
    size = float(whole @ whole)
    scale = float(np.sqrt(whole @ J @ covariance @ J.T @ whole)) / max(size, 1e-300)
    return ArrayFit(
        positions, axes, spreads, residual, delay, (float(theta[lag]), float(sd[lag])),
        (float(theta[smoothing]), float(sd[smoothing])),
        np.array([0.0 if at is None else theta[at] for at in layout.late]), scale,
    )  # fmt: skip


def _differences(motion: HandMotion) -> Array:
    """Return differences (N, n, 3) of rates from their mean, without what the IMUs' matrices err by."""
    mean = motion.mean
    out = motion.rates - mean
    for k in range(len(out)):
        out[k] -= mean @ np.linalg.lstsq(mean, out[k], rcond=None)[0]
    return np.asarray(out)


def _own_moments(motion: HandMotion) -> tuple[float, float]:
    """Return the noise of differences of rates, rad/s, and by how much moments of reading differ, s (deviations)."""
    d, size = _differences(motion), lengths(motion.slope)
    along = np.einsum("kmj,mj->km", d, motion.slope) / np.maximum(size, 1e-12)
    low, high = np.quantile(size, [0.25, 0.75])
    # across the angular acceleration there is noise alone
    across = np.sqrt(np.maximum(np.sum(d**2, axis=2) - along**2, 0.0) / 2.0)
    noise = float(np.sqrt(np.median(across[:, size <= low] ** 2) / 0.693)) + 1e-12
    fast = size >= high
    beyond = float(np.median((along[:, fast]) ** 2)) / 0.455 - float(np.median(across[:, fast] ** 2)) / 0.693
    return noise, float(np.sqrt(max(beyond, 0.0) / np.median(size[fast] ** 2)))


def _pass(
    motion: HandMotion, layout: _Layout, theta: Array, alpha: Array, delays: Array, weights: Array, variance: float,
    number: int, trust: Array, slope_factor: float,
) -> _Sums:  # fmt: skip
    """Return sums over all samples; `alpha` becomes what they show.

    trust: (N,), factors on the readings of units; slope_factor: factor on the deviation of the gyros' derivatives.
    """
    n, p = motion.seconds.size, layout.size
    block = np.floor((motion.seconds - motion.seconds[0]) / _BLOCK).astype(int)
    sums = _Sums(
        np.zeros((p, p)), np.zeros(p), np.zeros((int(block[-1]) + 1, p)), np.zeros(n), np.zeros(layout.count),
        np.zeros(2),
    )  # fmt: skip
    changing = number > 1 and layout.count >= _CHANGING and bool(delays.any())
    mixed = trust[:, None, None] * layout.mixing(theta)
    for part in _chunks(n):
        ideal, known, J = _rows(motion, layout, theta, alpha[part], delays[:, part], part, changing=changing)
        H, y = _mixed(mixed, ideal), np.repeat(trust, 3) * _readings(motion, part)
        y -= _mixed(mixed, known[..., None])[..., 0]
        if number == 0:  # the angular acceleration is taken as known
            y, H = y - (H[:, :, 3:] @ alpha[part][..., None])[..., 0], H[:, :, :3]
        else:
            slopes = _slopes(motion, layout, theta, alpha[part], part, np.sqrt(variance) / slope_factor, H.shape[2])
            H, y = np.concatenate([H, slopes[0]], axis=1), np.concatenate([y, slopes[1]], axis=1)
        N, b = np.swapaxes(H, 1, 2) @ H, np.swapaxes(H, 1, 2) @ y[..., None]
        N[:, 6:, 6:] += variance * np.eye(max(0, H.shape[2] - 6))
        x = np.linalg.solve(N, b)
        left = y - (H @ x)[..., 0]
        if number:
            alpha[part] = x[:, 3:6, 0]
            predicted = (ideal @ x)[..., 0] + known
        else:
            predicted = (ideal[:, :, :3] @ x)[..., 0] + (ideal[:, :, 3:6] @ alpha[part][..., None])[..., 0] + known
        J = _mixed(mixed, _with_predicted(J, predicted, layout))
        if number:
            J = np.concatenate([J, slopes[2]], axis=1)
        projected = J - H @ np.linalg.solve(N, np.swapaxes(H, 1, 2) @ J)
        w = weights[part]
        sums.information += (J * w[:, None, None]).reshape(-1, p).T @ projected.reshape(-1, p)
        scores = np.einsum("mij,mi->mj", J, left) * w[:, None]
        sums.score += scores.sum(axis=0)
        np.add.at(sums.of_blocks, block[part], scores)
        rows = 3 * layout.count
        if number:
            free = 1.0 - np.einsum("mij,mjk,mik->mi", H[:, -3:], np.linalg.inv(N), H[:, -3:])
            sums.of_slopes += w @ np.column_stack([np.sum(left[:, -3:] ** 2, axis=1), variance * free.sum(axis=1)])
        left = left[:, :rows]
        sums.of_units += np.sum(left**2, axis=0).reshape(-1, 3).sum(axis=1)
        sums.squares[part] = np.mean(left**2, axis=1) * rows / (rows - min(9, rows - 1))
    return sums


def _slopes(
    motion: HandMotion, layout: _Layout, theta: Array, alpha: Array, part: slice, weight: float, unknowns: int
) -> tuple[Array, Array, Array]:
    """Return rows for the derivatives of the gyros' rates: of the unknowns, what is seen, and of the parameters.

    A derivative is that of another moment than the accelerometers', and the gyros' filter and the cubics make it
    smaller: by how much is a parameter.

    Parameters
    ----------
    weight
        Of a derivative that is as uncertain as `slope_deviation` says.
    """
    size = (weight / motion.slope_deviation[part])[:, None]
    H, J = np.zeros((len(size), 3, unknowns)), np.zeros((len(size), 3, layout.size))
    H[:, [0, 1, 2], [3, 4, 5]] = (1.0 + theta[layout.slope]) * size
    gyro = np.eye(3) + theta[layout.gyro].reshape(3, 3)
    seen = motion.slope[part] + theta[layout.lag] * motion.bend[part]
    by_cubic = _by_cubics(motion, 3.0 * motion.in_axes(motion.mean[part]) ** 2 * motion.in_axes(motion.slope[part]))
    J[:, :, layout.slope], J[:, :, layout.lag] = size * alpha, -size * motion.bend[part] @ gyro.T
    for i in range(3):
        J[:, i, layout.gyro.start + 3 * i : layout.gyro.start + 3 * i + 3] = -size * seen
    J[:, :, layout.cubic] = -size[:, :, None] * by_cubic
    return H, size * (seen @ gyro.T + by_cubic @ theta[layout.cubic]), J


def _by_cubics(motion: HandMotion, cubes: Array) -> Array:
    """Return what cubes of rates about the axes of each IMU, (N, m, 3), do to the mean rate, (m, 3, 3 N)."""
    out = np.einsum("kij,kmj->mikj", motion.axes, cubes) / len(motion.axes)
    return np.asarray(out.reshape(out.shape[0], 3, -1))


def _mixed(mixing: Array, rows: Array) -> Array:
    """Return rows (m, 3 N, c) of accelerometers from those of ideal ones, by each IMU's matrix (N, 3, 3)."""
    m, _, c = rows.shape
    out = np.einsum("kij,mkjc->mkic", mixing, rows.reshape(m, len(mixing), 3, c))
    return np.asarray(out.reshape(m, -1, c))


def _readings(motion: HandMotion, part: slice) -> Array:
    """Return the readings of all accelerometers, (m, 3 N)."""
    forces = motion.forces[:, part]
    return np.asarray(np.swapaxes(forces, 0, 1).reshape(forces.shape[1], -1))


def _with_predicted(J: Array, predicted: Array, layout: _Layout) -> Array:
    """Return rows with what turns and matrices do to them: by the predicted readings, whose noise is not theirs."""
    for k in range(layout.count):
        own, turn = predicted[:, 3 * k : 3 * k + 3], layout.turn[k]
        for j in range(3):
            J[:, 3 * k + j, layout.matrix[k][j]] = -own
            if turn is not None:
                J[:, 3 * k + j, turn] = np.cross(np.eye(3)[j], own)
    return J


def _chunks(n: int) -> Iterator[slice]:
    return (slice(start, min(start + _CHUNK, n)) for start in range(0, n, _CHUNK))


def _rows(
    motion: HandMotion, layout: _Layout, theta: Array, alpha: Array, delays: Array, part: slice, *, changing: bool
) -> tuple[Array, Array, Array]:
    """Return what every sample's unknowns, the motion, and the parameters do to ideal accelerometers."""
    read, cubes = motion.mean[part], _by_cubics(motion, motion.in_axes(motion.mean[part]) ** 3)
    mean = read @ (np.eye(3) + theta[layout.gyro].reshape(3, 3)).T + theta[layout.rate] + cubes @ theta[layout.cubic]
    samples = mean.shape[0]
    H = np.zeros((samples, 3 * layout.count, 12 if changing else 6))
    J = np.zeros((samples, 3 * layout.count, layout.size))
    known = np.zeros((samples, 3 * layout.count))
    late = np.interp(motion.seconds[part], motion.seconds[[0, -1]], [-1.0, 1.0])
    for k in range(layout.count):
        turn = layout.turn[k]
        offset, drift = theta[layout.offset[k]].reshape(2, 3)
        axes = motion.axes[k] @ (np.eye(3) if turn is None else matrix(exp(theta[turn])))
        omega = mean + (delays[k] + theta[layout.lag])[:, None] * alpha - theta[layout.filtering] * motion.bend[part]
        for j in range(3):
            row, s, r = 3 * k + j, axes[:, j], layout.arm_of(theta, k, j)
            across = np.cross(r, s)
            H[:, row, :3], H[:, row, 3:6] = s, across
            if changing:
                H[:, row, 6:9] = delays[k][:, None] * s * _JERK
                H[:, row, 9:] = delays[k][:, None] * across * _ANGULAR_JERK
            centripetal = (omega @ s)[:, None] * omega - np.sum(omega**2, axis=1)[:, None] * s
            bent = motion.curvature[part] @ s
            known[:, row] = (centripetal + theta[layout.smoothing] * bent) @ r + offset[j] + late * drift[j]
            if layout.late[k] is not None:  # by gyros that a filter delays, clocks are late, and accelerometers are not
                J[:, row, layout.late[k]] = motion.force_slopes[k, part, j]
                known[:, row] += theta[layout.late[k]] * motion.force_slopes[k, part, j]
            J[:, row, layout.offset[k].start + j], J[:, row, layout.offset[k].start + 3 + j] = 1.0, late
            by_position = np.cross(s, alpha) + centripetal
            J[:, row, layout.arm[k][j]] = by_position
            if layout.position[k] is not None:
                J[:, row, layout.position[k]] = by_position
            by_rate = (omega @ r)[:, None] * s + (omega @ s)[:, None] * r - 2.0 * (r @ s) * omega
            J[:, row, layout.lag] = np.sum(by_rate * alpha, axis=1)
            J[:, row, layout.gyro] = (by_rate[:, :, None] * omega[:, None, :]).reshape(samples, 9)
            J[:, row, layout.smoothing] = bent @ r
            J[:, row, layout.rate], J[:, row, layout.cubic] = by_rate, np.einsum("mi,mic->mc", by_rate, cubes)
            J[:, row, layout.filtering] = -np.sum(by_rate * motion.bend[part], axis=1)
    return H, known, J
