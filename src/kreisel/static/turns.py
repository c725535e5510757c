"""How far the device turns between two standstills, by its gyros, and what that depends on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, Mask, conjugate, matrix, multiply
from kreisel.inertial.effects import EFFECTS, RawReadings, added
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.inertial.strapdown import integrate_attitude, prepare, rate_coefficients
from kreisel.recording.recording import ImuSamples
from kreisel.static.rests import Rests
from kreisel.validation.stamp_checks import LONG_GAP, gaps


@dataclass(frozen=True)
class Turns:
    """Rotations from the end of each standstill to the beginning of the next one, against inertial space.

    Attributes
    ----------
    rotations : (M - 1, 3, 3)
        C of the next one's b seen from the first one's.
    derivatives : by group, (M - 1, 3, n)
        Rotation vector in the next one's b, by the group's parameters.
    seconds, agitation : (M - 1,)
        Duration, s, and the integral of the squared rate, rad^2/s.
    whole : (M - 1,)
        Whether no samples are missing, and all three gyros work.
    """

    rotations: Array
    derivatives: dict[str, Array]
    seconds: Array
    agitation: Array
    whole: Mask


def turns_between(imu: ImuSamples, raw: RawReadings, rests: Rests, sensors: SensorParameters) -> Turns:
    """Return the turns by readings and parameters.

    Notes
    -----
    By equation (33), an error d_omega(t) of the rate turns the next b by the integral of C(t) d_omega, with C from b at
    t to the next b.
    """
    own = {group: value for group, value in sensors.effects.items() if EFFECTS[group].sensor == "gyroscope"}
    signal = prepare(imu.seconds, imu.rates, imu.accelerations, applied=own,
                     temperature_difference=raw.temperature_difference)  # fmt: skip
    q = integrate_attitude(signal, rate_coefficients(sensors))
    y = imu.rates + added(raw, own)[0] + sensors.k_w[0]
    begin, end = rests.last[:-1] - 1, rests.first[1:]
    broken = gaps(imu.stamps_ns, LONG_GAP)
    sizes = {group: value.size for group, value in own.items()}
    features = np.vstack([np.ones(len(y)), y.T, *(EFFECTS[g].features(raw, n) for g, n in sizes.items())])
    seconds, agitation = imu.seconds[end] - imu.seconds[begin], np.empty(end.size)
    sums = np.empty((end.size, len(features), 3, 3))
    square = np.sum((y @ sensors.K_omega.T) ** 2, axis=1)
    for m, (a, b) in enumerate(zip(begin.tolist(), end.tolist(), strict=True)):
        h = np.diff(imu.seconds[a : b + 1])
        C = matrix(multiply(conjugate(q[b]), q[a : b + 1]))
        weight = np.zeros(b + 1 - a)  # of the trapezoidal rule
        weight[:-1] += 0.5 * h
        weight[1:] += 0.5 * h
        sums[m] = np.einsum("k,fk,kij->fij", weight, features[:, a : b + 1], C)
        agitation[m] = weight @ square[a : b + 1]
    whole = np.array([not np.any((broken >= a) & (broken < b)) for a, b in zip(begin, end, strict=True)], dtype=bool)
    if not np.ptp(imu.rates, axis=0).all():
        whole[:] = False  # a gyro that is dead, or not there
    derivatives = _derivatives(sums, sizes, sensors.K_omega)
    return Turns(matrix(multiply(conjugate(q[begin]), q[end])), derivatives, seconds, agitation, whole)


def _derivatives(sums: Array, sizes: dict[str, int], K: Array) -> dict[str, Array]:
    """Return the derivatives by group, from integrals of C times each feature, (M - 1, F, 3, 3)."""
    count = len(sums)
    out = {
        # by K_jl: column j of the integral of C y_l
        "gyro_cross_coupling": np.moveaxis(sums[:, 1:4], 1, 3).reshape(count, 3, 9),
        "gyro_offset": sums[:, 0] @ K,
    }
    at = 4
    for group, size in sizes.items():
        effect = EFFECTS[group]
        until = at + len(effect.places(size))
        out[group] = effect.by_parameter(sums[:, at:until] @ K, size)
        at = until
    return out
