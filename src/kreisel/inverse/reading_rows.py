"""Raw readings less those that a smooth motion and the sensors' parameters predict, and their derivatives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kreisel.fitting.stored_state import parameters_of, stored_state
from kreisel.geometry.pose_spline import Motion, PoseSpline, motion_at
from kreisel.geometry.rotation import Array, Indices, matrix, skew
from kreisel.inertial.effects import EFFECTS, added, features_of, groups_of, places_of
from kreisel.inertial.strapdown import raw_readings
from kreisel.inverse.normal_equations import POINT, WIDTH, Rows
from kreisel.inverse.unknowns import Unknowns
from kreisel.model.problem import Problem
from kreisel.model.site import earth_rate_r, gravity_r

_CHUNK = 4096
"""Readings of which rows are made together: 40 MB."""

_STEP = 1e-6
"""Of the central differences of gravity and the Earth's rate by their parameters, which are nearly linear."""


@dataclass(frozen=True)
class RawSamples:
    """Readings of a stretch of time, with the features of all effects that are estimated.

    Attributes
    ----------
    seconds : (m,)
    rates, forces : (m, 3)
        Corrected for what is known of effects.
    gyro_features, accel_features : (E, m)
    gyro_places, accel_places : (E, 3)
        See `inertial.effects.places_of`.
    deviation : (6,)
        Of one reading's white noise.
    """

    seconds: Array
    rates: Array
    forces: Array
    gyro_features: Array
    accel_features: Array
    gyro_places: Indices
    accel_places: Indices
    deviation: Array

    def part(self, own: slice) -> RawSamples:
        """Return some of the readings."""
        features = (self.gyro_features[:, own], self.accel_features[:, own])
        places = (self.gyro_places, self.accel_places)
        return RawSamples(self.seconds[own], self.rates[own], self.forces[own], *features, *places, self.deviation)


def raw_samples(unknowns: Unknowns, begin: float, end: float, spline: PoseSpline | None = None) -> RawSamples:
    """Return the readings of all segments between two times, corrected for the effects at the parameters' values.

    Effects are functions of readings. Those that the spline predicts have no noise, which derivatives of the readings
    themselves have in plenty, and which would pull at the effects; without a spline they are the readings.
    """
    problem, sensors = unknowns.problem, unknowns.known.sensors
    readings = problem.sensor.readings
    inside = np.zeros(readings.stamps.size, dtype=bool)
    for first, last in readings.segments:
        inside[first + 2 : last - 1] = True  # derivatives need two samples on either side
    inside &= (readings.stamps >= begin) & (readings.stamps <= end)
    own = np.flatnonzero(inside)
    rates, forces = readings.rates, readings.accelerations
    if spline is not None:
        rates, forces = rates.copy(), forces.copy()
        for part in np.array_split(own, max(1, own.size // _CHUNK)):
            predicted = _predicted(unknowns, motion_at(spline, readings.stamps[part]))
            rates[part] = predicted.rates - sensors.k_w[0]
            forces[part] = predicted.forces + predicted.size - sensors.k_a[0]
    raw = raw_readings(readings.stamps, rates, forces, temperature_difference=readings.temperature_difference)
    change = added(raw, sensors.effects)
    sizes = {g: problem.layout.whole(g) for g in EFFECTS if g in problem.layout}
    gyro, accel = (features_of(raw, sizes, sensor) for sensor in ("gyroscope", "accelerometer"))
    interval = float(np.median(np.diff(readings.stamps)))
    return RawSamples(
        readings.stamps[own], readings.rates[own] + change[0][own], readings.accelerations[own] + change[1][own],
        gyro[:, own], accel[:, own], places_of(sizes, "gyroscope"), places_of(sizes, "accelerometer"),
        _deviation(problem, interval),
    )  # fmt: skip


def _deviation(problem: Problem, interval: float) -> Array:
    return np.sqrt(np.concatenate([problem.sensor.readings.noise[0], problem.sensor.readings.noise[1]]) / interval)


def reading_rows(unknowns: Unknowns, spline: PoseSpline, samples: RawSamples) -> Iterator[Rows]:
    """Yield the rows of all readings, some at a time.

    Notes
    -----
    Residuals w' + k_w + d_w - K_w^-1 omega and a' + k_a + d_a - e - K_a^-1 f, over the noise of a reading: equations
    (1) to (3) solved for the readings. omega, its derivative and f are those of the spline.
    """
    inner = np.searchsorted(samples.seconds, unknowns.moments[1:-1])
    for begin, end in pairwise([0, *inner.tolist(), samples.seconds.size]):
        for at in range(begin, end, _CHUNK):
            yield _rows(unknowns, spline, samples.part(slice(at, min(at + _CHUNK, end))))


@dataclass(frozen=True)
class _Predicted:
    """What a motion makes the sensors measure, and what it is made of.

    Attributes
    ----------
    turned : (m, 3, 3)
        From r to the body.
    earth, seen_earth : (3,), (m, 3)
        The Earth's rate in r, and along the body's axes.
    omega, f : (m, 3)
        Rate against inertial space, and specific force.
    field : (m, 3, 3)
        Acceleration of a point of the body by where it is.
    arms, size : (m, 3, 3), (m, 3)
        Accelerations of the three accelerometers against the body's origin, and what these measure of them.
    gyro, accel : (3, 3)
        From true values to readings.
    rates, forces : (m, 3)
        Readings without offsets and size effect.
    """

    turned: Array
    earth: Array
    seen_earth: Array
    omega: Array
    f: Array
    field: Array
    arms: Array
    size: Array
    gyro: Array
    accel: Array
    rates: Array
    forces: Array


def _predicted(unknowns: Unknowns, motion: Motion) -> _Predicted:
    known, sensors = unknowns.known, unknowns.known.sensors
    g, earth = gravity_r(known), earth_rate_r(unknowns.problem.site, known)
    turned = np.swapaxes(matrix(motion.q), 1, 2)
    seen_earth = turned @ earth
    omega = motion.omega + seen_earth
    f = np.einsum("mij,mj->mi", turned, motion.a - g + 2.0 * np.cross(earth, motion.v))
    gyro, accel = (np.asarray(np.linalg.inv(K), dtype=float) for K in (sensors.K_omega, sensors.K_a))
    field = skew(motion.alpha) + skew(omega) @ skew(omega)
    arms = np.einsum("mxy,jy->mjx", field, sensors.lever_arms)
    size = np.einsum("jx,mjx->mj", accel, arms)
    return _Predicted(turned, earth, seen_earth, omega, f, field, arms, size, gyro, accel, omega @ gyro.T, f @ accel.T)


def _rows(unknowns: Unknowns, spline: PoseSpline, samples: RawSamples) -> Rows:
    sensors = unknowns.known.sensors
    motion = motion_at(spline, samples.seconds)
    predicted = _predicted(unknowns, motion)
    residual = np.concatenate(
        [
            samples.rates + sensors.k_w[0] - predicted.rates,
            samples.forces + sensors.k_a[0] - predicted.size - predicted.forces,
        ],
        axis=1,
    )
    interval = unknowns.interval_of(float(samples.seconds[0]))
    by = _by_parameters(unknowns, samples, predicted, motion.v)
    residual += np.einsum("mrn,mn->mr", by, unknowns.walked(interval, samples.seconds))
    scale = 1.0 / samples.deviation
    span, _ = spline.span_of(samples.seconds)
    return Rows(
        span,
        _by_points(motion, predicted, sensors.lever_arms) * scale[:, None],
        unknowns.spread(by, interval, samples.seconds) * -scale[:, None],
        residual * scale,
        unknowns.local(interval),
    )


def _by_points(motion: Motion, of: _Predicted, lever_arms: Array) -> Array:
    """Return by how much residuals fall with small moves of the control points, (m, 6, WIDTH)."""
    m, r = len(of.omega), lever_arms
    out = np.zeros((m, 6, WIDTH // POINT, POINT))
    of_rate = motion.of_omega + skew(of.seen_earth)[:, None] @ motion.turn
    out[:, :3, :, :3] = np.moveaxis(of.gyro @ of_rate, 1, 2)
    along = np.einsum("mx,jx->mj", of.omega, r)
    centripetal = of.omega[:, None, :, None] * r[:, None, :] + along[:, :, None, None] * np.eye(3)
    centripetal = centripetal - 2.0 * r[:, :, None] * of.omega[:, None, None, :]
    by_omega = np.einsum("jx,mjxy->mjy", of.accel, centripetal)
    by_alpha = np.einsum("jx,jxy->jy", of.accel, -skew(r))
    by_turn = of.accel @ skew(of.f)
    rotation = by_omega[:, None] @ of_rate + by_alpha @ motion.of_alpha + by_turn[:, None] @ motion.turn
    out[:, 3:, :, :3] = np.moveaxis(rotation, 1, 2)
    by_a = of.accel @ of.turned
    by_v = 2.0 * by_a @ skew(of.earth)
    w = motion.weights[:, :, :, None, None]
    out[:, 3:, :, 3:] = np.moveaxis(w[2] * by_a[:, None] + w[1] * by_v[:, None], 1, 2)
    return out.reshape(m, 6, WIDTH)


def _by_parameters(unknowns: Unknowns, samples: RawSamples, of: _Predicted, v: Array) -> Array:
    """Return the derivatives of the residuals by the problem's parameters, (m, 6, n)."""
    problem, layout = unknowns.problem, unknowns.problem.layout
    m, n = len(of.rates), len(problem.parameter_names)
    out = np.zeros((m, 6, n))

    def put(group: str, rows: slice, whole: Array) -> None:
        if group in layout:
            out[:, rows, layout[group]] = whole[..., layout.present(group)]

    rates, forces = slice(0, 3), slice(3, 6)
    eye = np.broadcast_to(np.eye(3), (m, 3, 3))
    put("gyro_cross_coupling", rates, np.einsum("ra,mb->mrab", of.gyro, of.rates).reshape(m, 3, 9))
    put("gyro_offset", rates, eye)
    by_K = np.einsum("ja,mb->mjab", of.accel, of.forces) + np.einsum("ja,bx,mjx->mjab", of.accel, of.accel, of.arms)
    put("accel_cross_coupling", forces, by_K.reshape(m, 3, 9))
    put("accel_offset", forces, eye)
    by_arm = np.einsum("jx,mxy->mjy", of.accel, of.field)
    put("lever_arms", forces, -np.einsum("mjy,ji->mjiy", by_arm, np.eye(3)).reshape(m, 3, 9))
    _put_effects(unknowns, "gyroscope", samples.gyro_features, samples.gyro_places, out[:, rates])
    _put_effects(unknowns, "accelerometer", samples.accel_features, samples.accel_places, out[:, forces])
    by_g, by_earth = _of_frame(unknowns)
    out[:, rates] -= of.gyro @ of.turned @ by_earth
    out[:, forces] += of.accel @ of.turned @ (by_g + 2.0 * skew(v) @ by_earth)
    return out


def _put_effects(unknowns: Unknowns, sensor: str, features: Array, places: Indices, out: Array) -> None:
    """Write the derivatives of a sensor's readings by its effects, (m, 3, n)."""
    layout = unknowns.problem.layout
    sizes = {g: layout.whole(g) for g in EFFECTS if g in layout}
    before = 0
    for group in groups_of(sizes, sensor):
        whole = np.zeros((out.shape[0], 3, sizes[group]))
        for e, axis in zip(*np.nonzero((places >= before) & (places < before + sizes[group])), strict=True):
            whole[:, axis, places[e, axis] - before] += features[e]
        out[:, :, layout[group]] = whole[..., layout.present(group)]
        before += sizes[group]


def _of_frame(unknowns: Unknowns) -> tuple[Array, Array]:
    """Return the derivatives (3, n) of gravity and the Earth's rate in r by the problem's parameters."""
    problem, known = unknowns.problem, unknowns.known
    layout, n = problem.layout, len(problem.parameter_names)
    state = stored_state(problem, known)
    by_g, by_earth = np.zeros((3, n)), np.zeros((3, n))
    for group in ("alignment", "north", "earth_down", "gravity"):
        if group not in layout:
            continue
        for i in range(layout[group].start, layout[group].stop):
            change = np.zeros((layout.degrees, 2))
            change[i] = (_STEP, -_STEP)
            after, before = (parameters_of(problem, known, x) for x in layout.plus(state, change).T)
            by_g[:, i] = (gravity_r(after) - gravity_r(before)) / (2.0 * _STEP)
            by_earth[:, i] = (earth_rate_r(problem.site, after) - earth_rate_r(problem.site, before)) / (2.0 * _STEP)
    return by_g, by_earth
