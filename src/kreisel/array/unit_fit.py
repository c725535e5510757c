"""One unit's parameters by a known common motion: least squares of its raw readings.

The readings are predicted from the motion, so that noise of the unit is in what is explained, and not in what explains
it. Noise of the motion itself, of which the unit's is a part, has the same covariance with the unit's readings as with
itself where units count by their noise: it does not pull matrices towards zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kreisel.array.common_motion import BodyMotion, MeanMotion, MotionErrors, averaged
from kreisel.array.mount_watch import RowParts, Turn, turn_of
from kreisel.array.resampled import Resampled, resampled
from kreisel.array.unit_effects import BENDING, OF_BENDING, bending, candidates, limit, products, shown_effects
from kreisel.array.unit_solution import LENGTHS, Axis, Solved, excess, excess_by_rounding, parted, products_over, solve
from kreisel.errors import EstimationError
from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.inertial.correction import Block
from kreisel.inertial.effects import EFFECTS, RawReadings, features_of, groups_of, places_of
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.inertial.slopes import local_cubics
from kreisel.preparation.imu_noise import rounding_step
from kreisel.recording.recording import ImuSamples
from kreisel.synchronization.clock import Clock

_SAME_MOMENT = 1e-7
"""Seconds by which a clock may move without its readings being taken at new moments."""

_ROUNDS, _SETTLED = 4, 1e-2
"""Times that the fit is repeated at most, and changes in deviations after which it is not. Chosen: accelerometers are
bilinear in axes and positions, and clocks begin within milliseconds; the next round would move a thousandth of that."""

_NEW_FEATURES = 2
"""Rounds in which features of effects are taken anew. Chosen: effects are thousandths of the readings, and the second
round's parameters are right to a thousandth."""

_COARSE = 4
"""Rows that are joined where further effects are looked for. Chosen: 0.16 s, in which an arm's rates hardly change."""


@dataclass(frozen=True)
class UnitFit:
    """A unit's parameters.

    Attributes
    ----------
    sensors
        From its readings to the motion of b.
    clock
        Against the clock of the motion's times, with its deviations.
    names
        Columns of what follows: parameters of the sensors by name, and `clock.shift` (s) and `clock.stretch`, what the
        clock gains from the middle of the recording to its end (s).
    covariance : (p, p)
        Of errors that are the unit's own, against the mean.
    by_motion : (p, q)
        Change by each parameter of the calibration that the motion is from.
    noise, rough : (2, 3)
        Standard deviations of rows of the gyros, rad/s, and of the accelerometers, m/s^2; and with those that are far
        off, which are not used.
    far
        For how long one of the axes is far off, s.
    excess : (p,)
        Factors by which deviations exceed those by the noise alone; the covariance contains them.
    turn
        Of the unit on its mount during the recording, if the readings show one.
    shown
        Effects that the readings show beyond those that were estimated, and by how much; see `shown_effects`.
    bending, bending_sd : (3, 3)
        Rotation of the unit against the mean of all for a force beyond the mean one, rad per m/s^2, and its deviation;
        zero where readings show none.
    """

    sensors: SensorParameters
    clock: Clock
    names: tuple[str, ...]
    covariance: Array
    by_motion: Array
    noise: Array
    rough: Array
    far: float
    excess: Array
    turn: Turn | None
    shown: dict[str, float]
    bending: Array
    bending_sd: Array


@dataclass(frozen=True)
class Common:
    """The motion of all units, its means, and what errors of its calibration do to it."""

    motion: BodyMotion
    mean: MeanMotion
    coarse: MeanMotion
    errors: MotionErrors

    @classmethod
    def of(
        cls, raw: Block, sensors: SensorParameters, moved: Callable[[Array], SensorParameters], count: int
    ) -> Common:
        """Return the motion that raw readings show with a calibration; `moved` and `count` as for `MotionErrors.of`."""
        motion = BodyMotion.of(raw, sensors)
        mean = MeanMotion.of(motion)
        return cls(motion, mean, mean.joined(_COARSE), MotionErrors.of(raw, moved, count, mean.width))


def fit_unit(
    imu: ImuSamples,
    clock: Clock,
    common: Common,
    start: SensorParameters,
    sizes: Mapping[str, int],
    usual_temperature: float | None = None,
) -> UnitFit:
    """Return the parameters of a unit.

    Parameters
    ----------
    clock
        That of the unit against the motion's times, to some milliseconds.
    start
        Start values.
    sizes
        Effects to be estimated, and how many parameters each has.
    usual_temperature
        At which temperature effects are zero, degrees Celsius.

    Raises
    ------
    EstimationError
        If the readings do not determine the parameters.
    """
    fit = _fit(imu, clock, common, start, _Layout.of(sizes), usual_temperature)
    if BENDING not in fit.shown:
        return fit
    if fit.turn is not None and fit.turn.weight > fit.shown[BENDING] * limit(OF_BENDING):
        return replace(fit, shown={name: weight for name, weight in fit.shown.items() if name != BENDING})
    return _fit(imu, fit.clock, common, fit.sensors, _Layout.of(sizes, bends=True), usual_temperature)


def _fit(
    imu: ImuSamples,
    clock: Clock,
    common: Common,
    start: SensorParameters,
    layout: _Layout,
    usual_temperature: float | None,
) -> UnitFit:
    """Return the parameters of a unit; see `fit_unit`."""
    sensors, mean, moved = start, common.mean, True
    seconds = common.motion.seconds
    for number in range(_ROUNDS):
        if moved:
            readings = resampled(imu, clock, seconds, smooth=True)
            raw, whole = _mean_readings(readings, mean.width)
        if number < _NEW_FEATURES:
            features = _features(readings, common, sensors, layout, usual_temperature)
        axes = _rows(raw, features, mean, sensors, layout)
        solved = solve(axes, whole, layout.count)
        moved = float(np.abs(solved.change[-2:]).max()) > _SAME_MOMENT
        sensors = layout.moved(sensors, solved.change)
        clock = _clock_moved(clock, mean.seconds, solved.change[-2:])
        settled = np.abs(solved.change) <= _SETTLED * np.sqrt(np.diag(np.linalg.inv(solved.information)))
        if np.delete(settled, layout.bending).all():
            break
    J = layout.as_parameters(sensors)
    step = rounding_step(imu.accelerations)
    factor = np.maximum(excess(solved, mean.row), excess_by_rounding(solved, raw, step))
    P = factor[:, None] * np.linalg.inv(solved.information) * factor
    by_motion = -np.linalg.solve(*_response(solved, common.errors, sensors))
    deviation = np.sqrt(np.diag(P)[-2:])
    half = 0.5 * float(mean.seconds[-1] - mean.seconds[0])
    return UnitFit(
        sensors,
        replace(clock, start_sd=float(np.linalg.norm([*deviation, imu.lateness])), skew_sd=float(deviation[1]) / half),
        layout.names,
        J @ P @ J.T,
        J @ by_motion,
        solved.noise.reshape(2, 3),
        solved.rough.reshape(2, 3),
        float(np.count_nonzero(whole & ~(solved.weights > 0.0).all(axis=0))) * mean.row,
        factor,
        turn_of(_parts(solved, mean, sensors)),
        _shown(raw, whole, common, sensors, layout, rounded=step > 0.0),
        *(layout.as_matrix(values) for values in (solved.change, np.sqrt(np.diag(P)))),
    )


def _mean_readings(readings: Resampled, width: int) -> tuple[Array, Mask]:
    """Return means of the six readings over rows, (m, 6), and which rows are whole, (m,)."""
    whole = averaged(readings.known.astype(float), width) == 1.0
    return averaged(np.hstack([readings.rates, readings.forces]), width), whole


@dataclass(frozen=True)
class _Layout:
    """Where parameters stand: of gyro axes g_j, k_j; of accelerometers s_j, k_j, r_j; effects; bending; clock.

    g_j and s_j are rows of the inverses of K_omega and K_a: readings are linear in them.
    """

    sizes: Mapping[str, int]
    bends: bool = False

    @classmethod
    def of(cls, sizes: Mapping[str, int], *, bends: bool = False) -> _Layout:
        return cls({group: sizes[group] for group in EFFECTS if group in sizes}, bends)

    @property
    def bending(self) -> Indices:
        """Where the parameters of a mount that bends stand; none if it does not."""
        return 33 + sum(self.sizes.values()) + np.arange(OF_BENDING if self.bends else 0)

    @property
    def count(self) -> int:
        return 33 + sum(self.sizes.values()) + self.bending.size + 2

    def as_matrix(self, values: Array) -> Array:
        """Return those of all values (p,) that are of the bending, (3, 3)."""
        return values[self.bending].reshape(3, 3) if self.bends else np.zeros((3, 3))

    def begin(self, sensor: str) -> int:
        """Return where the effects of a sensor begin."""
        return 33 + (0 if sensor == "gyroscope" else sum(self.sizes[g] for g in groups_of(self.sizes, "gyroscope")))

    @cached_property
    def places(self) -> dict[str, Indices]:
        """Where the parameters of each effect stand."""
        out, at = {}, 33
        for sensor in ("gyroscope", "accelerometer"):
            for group in groups_of(self.sizes, sensor):
                out[group] = np.arange(at, at + self.sizes[group])
                at += self.sizes[group]
        return out

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters after `as_parameters`."""
        from kreisel.calibration.device_axes import NAMES
        from kreisel.model.parameters import parameter_names

        effects: list[str] = []
        for sensor in ("gyroscope", "accelerometer"):
            for group in groups_of(self.sizes, sensor):
                order = 1 + self.sizes[group] // 3 if group.endswith("polynomial") else 1
                effects += parameter_names(group, order)
        bent = [f"mount.bending[{i},{j}]" for i in range(3) for j in range(3)] if self.bends else []
        return (*NAMES, *effects, *bent, "clock.shift", "clock.stretch")

    def values(self, p: SensorParameters, sensor: str) -> Array:
        """Return the values of a sensor's effects, flat."""
        own, parts = p.effects, [np.zeros(0)]
        for group in groups_of(self.sizes, sensor):
            stored = np.ravel(own.get(group, 0.0))  # of a polynomial, perhaps of a lower order
            parts.append(np.zeros(self.sizes[group]))
            parts[-1][: stored.size] = stored
        return np.concatenate(parts)

    def moved(self, p: SensorParameters, change: Array) -> SensorParameters:
        """Return parameters moved by changes of what readings are linear in."""
        G, S = _inverse(p.K_omega), _inverse(p.K_a)
        gyro, accel = change[:12].reshape(3, 4), change[12:33].reshape(3, 7)
        k_w, k_a, others = p.k_w.copy(), p.k_a.copy(), dict(p.others)
        k_w[0] += gyro[:, 3]
        k_a[0] += accel[:, 3]
        for group, own in self.places.items():
            step = change[own]
            if group == "gyro_polynomial":
                k_w[1:] += step.reshape(-1, 3)
            elif group == "accel_polynomial":
                k_a[1:] += step.reshape(-1, 3)
            else:
                others[group] = np.asarray(others.get(group, 0.0)) + step
        K_omega, K_a = (_inverse(M) for M in (G + gyro[:, :3], S + accel[:, :3]))
        return SensorParameters(K_omega, k_w, K_a, k_a, p.lever_arms + accel[:, 4:], others)

    def as_parameters(self, p: SensorParameters) -> Array:
        """Return the derivative of the parameters, in the order of `names`, by what readings are linear in."""
        out = np.zeros((self.count, self.count))
        out[33:, 33:] = np.eye(self.count - 33)
        for j in range(3):
            for row in range(3):
                for column in range(3):  # dK = -K dG K
                    out[3 * row + column, 4 * j : 4 * j + 3] = -p.K_omega[row, j] * p.K_omega[:, column]
                    at = 12 + 7 * j
                    out[12 + 3 * row + column, at : at + 3] = -p.K_a[row, j] * p.K_a[:, column]
            out[9 + j, 4 * j + 3] = 1.0
            out[21 + j, 12 + 7 * j + 3] = 1.0
            out[24 + 3 * j : 27 + 3 * j, 12 + 7 * j + 4 : 12 + 7 * j + 7] = np.eye(3)
        return out


def _inverse(M: Array) -> Array:
    return np.asarray(np.linalg.inv(M), dtype=float)


def _features(
    readings: Resampled, common: Common, p: SensorParameters, layout: _Layout, usual_temperature: float | None
) -> dict[str, Array]:
    """Return means of the features of effects, (m, E), by sensor: of the readings that are predicted."""
    motion, width = common.motion, common.mean.width
    if not layout.sizes:
        return dict.fromkeys(("gyroscope", "accelerometer"), np.zeros((common.mean.seconds.size, 0)))
    G, S = _inverse(p.K_omega), _inverse(p.K_a)
    warm = np.zeros(motion.seconds.size)
    if readings.temperature is not None and usual_temperature is not None:
        warm = readings.temperature - usual_temperature
    shown = RawReadings(
        motion.seconds, motion.rates @ G.T - p.k_w[0], _along(motion.forces, motion.field, S, p) - p.k_a[0],
        motion.cubics.slopes, motion.cubics.curvatures, warm,
    )  # fmt: skip
    return {
        sensor: averaged(features_of(shown, layout.sizes, sensor).T, width) for sensor in ("gyroscope", "accelerometer")
    }


def _shown(
    raw: Array, whole: Mask, common: Common, p: SensorParameters, layout: _Layout, *, rounded: bool
) -> dict[str, float]:  # fmt: skip
    """Return the effects that a unit's readings show beyond those of the layout; features are of mean readings.

    rounded: whether accelerometers are rounded so coarsely that each attitude at rest has an error of its own, which
    is like products of accelerations.
    """
    mean, raw, whole = common.coarse, averaged(raw, _COARSE), averaged(whole.astype(float), _COARSE) == 1.0
    more = candidates(layout.sizes)
    wide = _Layout.of({**layout.sizes, **more}, bends=True)
    cubics = local_cubics(mean.seconds, mean.row)
    G, S = _inverse(p.K_omega), _inverse(p.K_a)
    readings = RawReadings(
        mean.seconds, mean.rates @ G.T - p.k_w[0], _along(mean.forces, mean.field, S, p) - p.k_a[0],
        cubics.slopes, cubics.curvatures, np.zeros(mean.seconds.size),
    )  # fmt: skip
    # temperatures are not in the means, and their effects are in what is left
    features = {sensor: features_of(readings, wide.sizes, sensor).T for sensor in ("gyroscope", "accelerometer")}
    places = {group: wide.places[group] for group in more} | ({} if layout.bends else {BENDING: wide.bending})
    base = np.setdiff1d(np.arange(wide.count), np.concatenate([np.zeros(0, dtype=np.int64), *places.values()]))
    axes, count = _rows(raw, features, mean, p, wide), wide.count
    late = (mean.seconds - mean.seconds[0]) / float(mean.seconds[-1] - mean.seconds[0])
    late = np.column_stack([late, late**2])
    drift, of_products = count + np.arange(12).reshape(6, 2), count + 12 + np.arange(12).reshape(3, 4)
    for k, axis in enumerate(axes):
        more_columns, at = [late], [drift[k]]
        if k >= 3:
            more_columns.append(products(readings.accelerations, k % 3))
            at.append(of_products[k % 3])
        axes[k] = replace(
            axis, columns=np.hstack([axis.columns, *more_columns]), places=np.concatenate([axis.places, *at])
        )
    count += drift.size + of_products.size
    try:
        solved = solve(axes, whole, count)
    except EstimationError:
        return {}
    target = solved.information @ solved.change

    def fitted(used: Indices) -> tuple[Array, Array]:
        A = solved.information[np.ix_(used, used)]
        x = np.asarray(np.linalg.solve(A, target[used]), dtype=float)
        change = np.zeros(count)
        change[used] = x
        factor = excess(replace(solved, change=change), mean.row, used)
        return x, factor[:, None] * _inverse(A) * factor

    return shown_effects(fitted, base, places, of_products.ravel()[: 0 if rounded else None], drift.ravel())


def _along(forces: Array, field: Array, S: Array, p: SensorParameters) -> Array:
    """Return forces (n, 3) along the rows of S, each at the place of its accelerometer."""
    return np.asarray(forces @ S.T + field.reshape(-1, 9) @ (S[:, :, None] * p.lever_arms[:, None, :]).reshape(3, 9).T)


def _rows(
    raw: Array, features: Mapping[str, Array], mean: MeanMotion, p: SensorParameters, layout: _Layout
) -> list[Axis]:
    """Return the rows of all six axes."""
    G, S, m = _inverse(p.K_omega), _inverse(p.K_a), mean.seconds.size
    predicted = {
        "gyroscope": mean.rates @ G.T - p.k_w[0],
        "accelerometer": _along(mean.forces, mean.field, S, p) - p.k_a[0],
    }
    slopes = {
        "gyroscope": mean.rate_slopes @ G.T,
        "accelerometer": _along(mean.force_slopes, mean.field_slopes, S, p),
    }
    middle = 0.5 * (mean.seconds[0] + mean.seconds[-1])
    along = (mean.seconds - middle) / (0.5 * float(mean.seconds[-1] - mean.seconds[0]))
    one, clock, out = -np.ones((m, 1)), np.array([layout.count - 2, layout.count - 1]), []
    for k in range(6):
        sensor, j = ("gyroscope", "accelerometer")[k // 3], k % 3
        places, values = places_of(layout.sizes, sensor), layout.values(p, sensor)
        own = places[:, j] >= 0
        of_effects = features[sensor][:, own]
        late = slopes[sensor][:, j, None] * np.column_stack([np.ones(m), along])
        if sensor == "gyroscope":
            first, begin = np.hstack([mean.rates, one]), np.arange(4 * j, 4 * j + 4)
        else:  # s_j . (Omega r) = r . (Omega' s_j)
            at = mean.forces + mean.field @ p.lever_arms[j]
            by_arm = np.swapaxes(mean.field, 1, 2) @ S[j]
            first, begin = np.hstack([at, one, by_arm]), 12 + np.arange(7 * j, 7 * j + 7)
        bent = np.zeros((m, 0))
        if layout.bends:
            load = mean.forces - mean.forces.mean(axis=0)
            turns = (
                (G[j], mean.rates, load, G[j], mean.force_slopes)
                if k < 3
                else (S[j], mean.forces, load, np.cross(p.lever_arms[j], S[j]), mean.force_curvatures)
            )
            bent = bending(*turns)
        out.append(
            Axis(
                np.hstack([first, -of_effects, bent, late]),
                np.concatenate([begin, layout.begin(sensor) + places[own, j], layout.bending, clock]),
                raw[:, k] - predicted[sensor][:, j] + of_effects @ values[places[own, j]],
            )
        )
    return out


def _clock_moved(clock: Clock, seconds: Array, change: Array) -> Clock:
    """Return a clock moved by a shift in the middle, and by what it gains until the end."""
    middle, half = 0.5 * float(seconds[0] + seconds[-1]), 0.5 * float(seconds[-1] - seconds[0])
    rate = float(change[1]) / half
    start = clock.start + float(change[0]) + rate * (clock.start - middle)
    return Clock(start, (1.0 + clock.skew) * (1.0 + rate) - 1.0)


def _response(solved: Solved, errors: MotionErrors, p: SensorParameters) -> tuple[Array, Array]:
    """Return information, and the sums of what errors of the motion do to the readings, over an excerpt."""
    rows, q = errors.rows, errors.rates.shape[2]
    G, S = _inverse(p.K_omega), _inverse(p.K_a)
    A, B = np.zeros((solved.change.size,) * 2), np.zeros((solved.change.size, q))
    for k, axis in enumerate(solved.axes):
        j = k % 3
        if k < 3:
            moved = np.einsum("mkp,k->mp", errors.rates, G[j])
        else:
            at = errors.forces + np.einsum("mklp,l->mkp", errors.field, p.lever_arms[j])
            moved = np.einsum("mkp,k->mp", at, S[j])
        X = axis.columns[rows] * solved.weights[k][rows, None]
        A[np.ix_(axis.places, axis.places)] += X.T @ axis.columns[rows]
        B[axis.places] += X.T @ moved
    return A, B


def _parts(solved: Solved, mean: MeanMotion, p: SensorParameters) -> RowParts:
    """Return sums over parts."""
    n, size = mean.seconds.size, solved.change.size
    length = max(1, min(round(LENGTHS[1] / mean.row), n // 40))
    G, S, count = np.linalg.inv(p.K_omega), np.linalg.inv(p.K_a), n // length
    info, score, cross = np.zeros((2, count, 6, 6)), np.zeros((2, count, 6)), np.zeros((2, count, 6, size))
    for k, axis in enumerate(solved.axes):
        triad, j = divmod(k, 3)
        # a turn phi of the unit: raw change g_j . (omega x phi) = phi . (g_j x omega)
        turned = np.cross(G[j], mean.rates) if triad == 0 else np.cross(S[j], mean.forces)
        Z = np.hstack([turned, np.zeros((n, 3))])
        Z[:, 3 + j] = -1.0
        w = solved.weights[k][:, None]
        left = (axis.left - axis.columns @ solved.change[axis.places])[:, None]
        info[triad] += products_over(Z * w, Z, length)
        score[triad] += parted(Z * w * left, length)
        cross[triad][:, :, axis.places] += products_over(Z * w, axis.columns, length)
    edges = mean.seconds[0] + mean.row * length * np.arange(count + 1)
    return RowParts(edges, info, score, cross, solved.information)
