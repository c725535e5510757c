"""The strapdown computation between two updates, for many parameter sets along one path.

Seen from the body's attitude at the first sample, the motion that the IMU measured does not depend on where it
was, how it was turned, how fast it moved, or where gravity points. It is computed here once for every
distinct set of sensor parameters; `composition` puts it onto the navigation state.

The first set, the centre, is integrated sample by sample. The others differ from it little, and what they
differ by is the same few products of the raw readings for all of them. These are summed over blocks of
samples once. Each set then turns against the centre by one small rotation a block, and its specific force
is a combination of the block's sums: the cost of a set depends on the number of blocks, not of samples.
Blocks are as long as the second order of the turn within them stays below rounding of the readings.

Features of the raw readings, and what they are multiplied by: see `coefficients`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kreisel._kernels.arrays import Array, PreparedReadings
from kreisel._kernels.blocks import place
from kreisel._kernels.compilation import kernel, part_of_kernel
from kreisel._kernels.increments import Coefficients, Increments, Span
from kreisel._kernels.quadrature import POINTS
from kreisel._kernels.rotation import direction_cosines, rotate, turn

SMALL_TURN = 1.5e-5
"""rad; how far a parameter set may turn against the centre within a block. Its square is what is neglected."""


class Path(NamedTuple):
    """What all parameter sets share along the samples: outer weights, direction cosines, features of the force.

    weights (2, c), C (c, 9), psi (c, features).
    """

    weights: Array
    C: Array
    psi: Array


class Relative(NamedTuple):
    """The parameter sets against the centre.

    Attributes
    ----------
    total : (2, 9, features)
        Sums of `sum_products` over all samples.
    q : (4, m)
        How the sets have turned against the centre at the last sample, seen from the attitude at the first.
    neighbours : (2, 3, m)
        How they turn on from there to the samples before and behind.
    """

    total: Array
    q: Array
    neighbours: Array


@part_of_kernel
def rotation_step(step: Array, omega: Array, alpha: Array, stamps: Array, theta: Array) -> None:
    """Write the rotation vectors over sampling intervals, (3, c - 1), to the sixth order in their length.

    `step` (3, c - 1) is the integrated rate; what its axis' motion within the interval adds follows from rate
    and angular acceleration (3, c) at both ends, at stamps (c,). The leading term is the coning correction
    dt^2/12 omega_k x omega_k+1. Magnus' series as given by Blanes, Casas and Ros (2000), equation (4.12)
    there with the sign of a rotation composed on its right.
    """
    for k in range(step.shape[1]):
        h = stamps[k + 1] - stamps[k]
        # moments of the rate about the middle, to the orders the series needs
        cx = 0.5 * h * h * (alpha[0, k + 1] - alpha[0, k])
        cy = 0.5 * h * h * (alpha[1, k + 1] - alpha[1, k])
        cz = 0.5 * h * h * (alpha[2, k + 1] - alpha[2, k])
        bx = h * (1.2 * (omega[0, k + 1] - omega[0, k]) - 0.1 * h * (alpha[0, k] + alpha[0, k + 1]))
        by = h * (1.2 * (omega[1, k + 1] - omega[1, k]) - 0.1 * h * (alpha[1, k] + alpha[1, k + 1]))
        bz = h * (1.2 * (omega[2, k + 1] - omega[2, k]) - 0.1 * h * (alpha[2, k] + alpha[2, k + 1]))
        ax = step[0, k] - cx / 12.0
        ay = step[1, k] - cy / 12.0
        az = step[2, k] - cz / 12.0
        abx = ay * bz - az * by
        aby = az * bx - ax * bz
        abz = ax * by - ay * bx
        ux = 20.0 * ax + cx + abx
        uy = 20.0 * ay + cy + aby
        uz = 20.0 * az + cz + abz
        ex = abx - 2.0 * cx
        ey = aby - 2.0 * cy
        ez = abz - 2.0 * cz
        vx = bx - (ay * ez - az * ey) / 60.0
        vy = by - (az * ex - ax * ez) / 60.0
        vz = bz - (ax * ey - ay * ex) / 60.0
        theta[0, k] = step[0, k] + (uy * vz - uz * vy) / 240.0
        theta[1, k] = step[1, k] + (uz * vx - ux * vz) / 240.0
        theta[2, k] = step[2, k] + (ux * vy - uy * vx) / 240.0


@part_of_kernel
def outer_weights(first: int, last: int, low: int, signal: PreparedReadings, weights: Array) -> None:
    """Write the weights (2, count) of the samples from `low` on in the velocity and position integrals."""
    stamps, base, single, double = signal.stamps, signal.base, signal.single, signal.double
    weights[:] = 0.0
    for k in range(first, last):
        rest = stamps[last] - stamps[k + 1]
        at = base[k] - low
        for i in range(POINTS):
            weights[0, at + i] += single[k, i]
            weights[1, at + i] += double[k, i] + rest * single[k, i]


@kernel
def weighted(coefficients: Array, features: Array, out: Array) -> None:
    """Write sum_f coefficients[f, i] features[f, k], (3, c), for coefficients (P, 3) and features (P, c)."""
    for i in range(3):
        a, b, c, d = coefficients[0, i], coefficients[1, i], coefficients[2, i], coefficients[3, i]
        for k in range(out.shape[1]):
            out[i, k] = a * features[0, k] + b * features[1, k] + c * features[2, k] + d * features[3, k]
        for f in range(4, features.shape[0], 3):
            a, b, c = coefficients[f, i], coefficients[f + 1, i], coefficients[f + 2, i]
            for k in range(out.shape[1]):
                out[i, k] += a * features[f, k] + b * features[f + 1, k] + c * features[f + 2, k]


@kernel
def centre_path(first: int, low: int, high: int, signal: PreparedReadings, rate: Array, q: Array) -> None:
    """Write the attitude (c, 4) at the samples from `low` to `high`, for rate coefficients (P, 3)."""
    count = high - low + 1
    step = np.empty((3, count - 1))
    theta = np.empty((3, count - 1))
    omega = np.empty((3, count))
    alpha = np.empty((3, count))
    weighted(rate, signal.rates[:, low : high + 1], omega)
    weighted(rate, signal.slopes[:, low : high + 1], alpha)
    weighted(rate, signal.integrals[:, low:high], step)
    rotation_step(step, omega, alpha, signal.stamps[low : high + 1], theta)
    turns = np.zeros((4, count - 1))
    turns[0] = 1.0
    turn(turns, theta, 1.0)
    start = first - low
    q[start] = 0.0
    q[start, 0] = 1.0
    a, b, c, d = 1.0, 0.0, 0.0, 0.0
    for j in range(start, count - 1):
        w, x, y, z = turns[0, j], turns[1, j], turns[2, j], turns[3, j]
        a, b, c, d = (
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        )
        q[j + 1, 0] = a
        q[j + 1, 1] = b
        q[j + 1, 2] = c
        q[j + 1, 3] = d
    a, b, c, d = 1.0, 0.0, 0.0, 0.0
    for j in range(start - 1, -1, -1):
        w, x, y, z = turns[0, j], -turns[1, j], -turns[2, j], -turns[3, j]
        a, b, c, d = (
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        )
        q[j, 0] = a
        q[j, 1] = b
        q[j, 2] = c
        q[j, 3] = d


@part_of_kernel
def features_along(low: int, signal: PreparedReadings, psi: Array) -> None:
    """Write the features of the specific force at the samples from `low` on, (c, features)."""
    rates, slopes, forces = signal.rates, signal.slopes, signal.forces
    P = rates.shape[0]
    at = 0
    for f in range(P):
        for g in range(f, P):
            for j in range(psi.shape[0]):
                psi[j, at] = rates[f, low + j] * rates[g, low + j]
            at += 1
    for f in range(1, P):
        for j in range(psi.shape[0]):
            psi[j, at] = slopes[f, low + j]
        at += 1
    for f in range(forces.shape[0]):
        for j in range(psi.shape[0]):
            psi[j, at] = forces[f, low + j]
        at += 1


@part_of_kernel
def force_along(psi: Array, C: Array, force: Array, u: Array) -> None:
    """Write the specific force of the first column at every sample, turned by C (c, 9), (c, 3).

    psi (c, features), force (features, 3, m).
    """
    for j in range(psi.shape[0]):
        x, y, z = 0.0, 0.0, 0.0
        for f in range(psi.shape[1]):
            x += force[f, 0, 0] * psi[j, f]
            y += force[f, 1, 0] * psi[j, f]
            z += force[f, 2, 0] * psi[j, f]
        for i in range(3):
            u[j, i] = C[j, 3 * i] * x + C[j, 3 * i + 1] * y + C[j, 3 * i + 2] * z


@part_of_kernel
def block_length(first: int, last: int, signal: PreparedReadings, difference: Array) -> int:
    """Return how many samples a block may have for sets whose coefficients differ by `difference` (P, 3, m)."""
    rates = signal.rates
    P = rates.shape[0]
    largest = np.zeros(P)
    for f in range(P):
        most = 0.0
        for k in range(first, last + 1):
            most = max(most, abs(rates[f, k]))
        largest[f] = most
    fastest = 0.0
    for s in range(difference.shape[2]):
        square = 0.0
        for row in range(3):
            total = 0.0
            for f in range(P):
                total += abs(difference[f, row, s]) * largest[f]
            square += total * total
        fastest = max(fastest, square)
    turned = math.sqrt(fastest) * (signal.stamps[last] - signal.stamps[first])
    return max(1, last - first if turned <= SMALL_TURN else int(SMALL_TURN / turned * (last - first)))


@kernel
def combine(sums: Array, coefficients: Array, out: Array) -> None:
    """Write sum_jf sums[3 i + j, f] coefficients[f, j, s] to out[i, s].

    sums (9, features), coefficients (features, 3, m), out (3, m).
    """
    out[:] = 0.0
    for f in range(coefficients.shape[0]):
        a, b, c = sums[0, f], sums[1, f], sums[2, f]
        d, e, g = sums[3, f], sums[4, f], sums[5, f]
        h, k, n = sums[6, f], sums[7, f], sums[8, f]
        for s in range(out.shape[1]):
            x, y, z = coefficients[f, 0, s], coefficients[f, 1, s], coefficients[f, 2, s]
            out[0, s] += a * x + b * y + c * z
            out[1, s] += d * x + e * y + g * z
            out[2, s] += h * x + k * y + n * z


@kernel
def contract(rows: Array, difference: Array, out: Array) -> None:
    """Add sum_fr rows[9 f + 3 i + r] difference[f, r, s] to out[i, s].

    rows (9 P,), difference (P, 3, m), out (3, m).
    """
    for i in range(3):
        for f in range(difference.shape[0]):
            x, y, z = rows[9 * f + 3 * i], rows[9 * f + 3 * i + 1], rows[9 * f + 3 * i + 2]
            for s in range(out.shape[1]):
                out[i, s] += x * difference[f, 0, s] + y * difference[f, 1, s] + z * difference[f, 2, s]


@kernel
def add_coning(before: Array, theta: Array, share: float, out: Array) -> None:
    """Write theta plus share * before x theta, for columns (3, m)."""
    for s in range(theta.shape[1]):
        out[0, s] = theta[0, s] + share * (before[1, s] * theta[2, s] - before[2, s] * theta[1, s])
        out[1, s] = theta[1, s] + share * (before[2, s] * theta[0, s] - before[0, s] * theta[2, s])
        out[2, s] = theta[2, s] + share * (before[0, s] * theta[1, s] - before[1, s] * theta[0, s])


@kernel
def preintegrate(span: Span, signal: PreparedReadings, coefficients: Coefficients, out: Increments) -> None:
    """Write the increments over a span: equation (8)."""
    force, shared = coefficients.force, coefficients.shared
    m, features, count = coefficients.rate.shape[2], force.shape[0], span.high - span.low + 1
    path = Path(np.empty((2, count)), np.empty((count, 9)), np.empty((count, features)))
    outer_weights(span.first, span.last, span.low, signal, path.weights)
    centre_path(span.first, span.low, span.high, signal, coefficients.rate[:, :, 0], out.q_path)
    direction_cosines(out.q_path, path.C)
    features_along(span.low, signal, path.psi)
    force_along(path.psi, path.C, force, out.u_path)
    relative = Relative(np.zeros((2, 9, features)), np.zeros((4, m)), np.zeros((2, 3, m)))
    relative.q[0] = 1.0
    relative_motion(span, signal, coefficients, path, relative, out)
    others = np.empty((3, shared.shape[2]))
    combine(relative.total[0], shared, others)
    place(others, 0, m, out.dv)
    combine(relative.total[1], shared, others)
    place(others, 0, m, out.dp)
    finish(span, signal, coefficients, path, relative, out)


@part_of_kernel
def relative_motion(
    span: Span, signal: PreparedReadings, coefficients: Coefficients, path: Path, relative: Relative, out: Increments
) -> None:
    """Write the increments of the sets with gyro parameters of their own, block by block; fill `relative`."""
    rate, force = coefficients.rate, coefficients.force
    weights, C, psi, u_path = path.weights, path.C, path.psi, out.u_path
    q, dv, dp, low = relative.q, out.dv, out.dp, span.low
    count, features = psi.shape
    P, m = rate.shape[0], rate.shape[2]
    difference = np.empty((P, 3, m))
    for f in range(P):
        for row in range(3):
            for s in range(m):
                difference[f, row, s] = rate[f, row, s] - rate[f, row, 0]
    length = block_length(span.first, span.last, signal, difference)
    blocks = (count + length - 1) // length
    units = np.empty((count - 1, 9 * P))
    unit_turns(low, signal, C, units)
    sums = np.empty((2, 9, features))
    turns = np.empty((6, 9 * P))
    lever = np.empty((2, 9 * P))
    theta = np.zeros((3, m))
    before = np.zeros((3, m))
    part = np.empty((3, m))
    dv[:, :m] = 0.0
    dp[:, :m] = 0.0
    at, span_before = span.first - low, 0.0
    for b in range(blocks):
        begin, end = b * count // blocks, (b + 1) * count // blocks
        centre = (begin + end) // 2
        sum_products(begin, end, weights, C, psi, sums)
        for which in range(2):
            for i in range(9):
                for f in range(features):
                    relative.total[which, i, f] += sums[which, i, f]
        sum_turns(begin, centre, end, weights, units, u_path, turns)
        span_before = advance(signal, low, at, centre, span_before, units, difference, before, theta, q)
        at = centre
        for which in range(2):
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                for f in range(0, 9 * P, 9):
                    for r in range(3):  # turn x force
                        lever[which, f + 3 * i + r] = (
                            turns[3 * which + k, f + 3 * j + r] - turns[3 * which + j, f + 3 * k + r]
                        )
            combine(sums[which], force, part)
            contract(lever[which], difference, part)
            rotate(q, part)
            increment = dv if which == 0 else dp
            for i in range(3):
                for s in range(m):
                    increment[i, s] += part[i, s]
    end = span.last - low
    advance(signal, low, at, end, span_before, units, difference, before, theta, q)
    contract(-units[end - 1], difference, relative.neighbours[0])
    if end < count - 1:
        contract(units[end], difference, relative.neighbours[1])


@kernel
def sum_products(start: int, stop: int, weights: Array, C: Array, psi: Array, sums: Array) -> None:
    """Write the weighted sums of C_ij times every feature of the force over some samples, (2, 9, features).

    weights (2, c), C (c, 9), psi (c, features).
    """
    sums[:] = 0.0
    features = psi.shape[1]
    for j in range(start, stop):
        for i in range(9):
            v = weights[0, j] * C[j, i]
            p = weights[1, j] * C[j, i]
            for f in range(features):
                sums[0, i, f] += v * psi[j, f]
                sums[1, i, f] += p * psi[j, f]


@part_of_kernel
def unit_turns(low: int, signal: PreparedReadings, C: Array, turns: Array) -> None:
    """Write how far a unit of difference in each rate coefficient turns a set over each interval, (c - 1, 9 P).

    C (c, 9). Entry 9 f + 3 i + r is the integral of C_ir times feature f, about axis i: the mean of C (of the cubic
    through four samples, of a line at either end) times the feature's integral, and what both change together.
    """
    stamps, slopes, integrals = signal.stamps, signal.slopes, signal.integrals
    count, P = C.shape[0], slopes.shape[0]
    for j in range(count - 1):
        k = low + j
        h = stamps[k + 1] - stamps[k]
        inside = 1.0 / 24.0 if 0 < j < count - 2 else 0.0
        before, after = max(j - 1, 0), min(j + 2, count - 1)
        for f in range(P):
            integral, slope = integrals[f, k], h * h / 24.0 * (slopes[f, k] + slopes[f, k + 1])
            for i in range(9):
                both = C[j, i] + C[j + 1, i]
                mean = 0.5 * both - inside * (C[after, i] - both + C[before, i])
                turns[j, 9 * f + i] = mean * integral + slope * (C[j + 1, i] - C[j, i])


@part_of_kernel
def sum_turns(begin: int, centre: int, end: int, weights: Array, units: Array, u_path: Array, turns: Array) -> None:
    """Write the sums of `unit_turns` I_k, `units` (c - 1, 9 P), times R_k over a block, (6, 9 P).

    R_k is the sum of weights (2, c) times forces u_path (c, 3) of the samples that the turn I_k moves: those after k,
    or those up to k and with a minus, as k lies after the block's centre or before it. The first three rows are its
    components with the weights of the velocity, the others with those of the position.
    """
    carried = np.zeros((end - begin + 1, 6))
    for j in range(begin, centre):
        for i in range(3):
            carried[j - begin + 1, i] = carried[j - begin, i] - weights[0, j] * u_path[j, i]
            carried[j - begin + 1, 3 + i] = carried[j - begin, 3 + i] - weights[1, j] * u_path[j, i]
    for j in range(begin, centre):
        for x in range(6):
            carried[j - begin, x] = carried[j - begin + 1, x]
    carried[centre - begin :] = 0.0
    for j in range(end - 2, centre - 1, -1):
        for i in range(3):
            carried[j - begin, i] = carried[j + 1 - begin, i] + weights[0, j + 1] * u_path[j + 1, i]
            carried[j - begin, 3 + i] = carried[j + 1 - begin, 3 + i] + weights[1, j + 1] * u_path[j + 1, i]
    turns[:] = 0.0
    for j in range(begin, end - 1):
        for x in range(6):
            c = carried[j - begin, x]
            for f in range(turns.shape[1]):
                turns[x, f] += c * units[j, f]


@kernel
def advance(
    signal: PreparedReadings,
    low: int,
    begin: int,
    end: int,
    span_before: float,
    units: Array,
    difference: Array,
    before: Array,
    theta: Array,
    q: Array,
) -> float:
    """Turn q (4, m) against the centre from one sample to another, and return the time between them.

    theta (3, m): the turn of the step before, and on return of this one; before (3, m): on return, that of the step
    before. units (c - 1, 9 P): see `unit_turns`; difference (P, 3, m): see `relative_motion`.
    """
    span = signal.stamps[low + end] - signal.stamps[low + begin]
    turns = np.zeros(units.shape[1])
    sign = 1.0 if end > begin else -1.0
    for j in range(min(begin, end), max(begin, end)):
        for f in range(turns.size):
            turns[f] += sign * units[j, f]
    place(theta, 0, 0, before)
    theta[:] = 0.0
    contract(turns, difference, theta)
    # The classic two-interval form: what the change of the turn's axis adds to it.
    share = span * span / (6.0 * span_before * (span + span_before)) if span_before > 0.0 and span > 0.0 else 0.0
    turned = np.empty_like(theta)
    add_coning(before, theta, share, turned)
    turn(q, turned, 1.0)
    return span


@part_of_kernel
def finish(
    span: Span, signal: PreparedReadings, coefficients: Coefficients, path: Path, relative: Relative, out: Increments
) -> None:
    """Write the attitude at the last sample, and what lets it be carried on by less than a sampling interval."""
    rate, q, u_end = coefficients.rate, relative.q, out.u_end
    P, m, M = rate.shape[0], rate.shape[2], out.dq.shape[1]
    end = span.last - span.low
    omega = np.zeros((3, m))
    alpha = np.zeros((3, m))
    for row in range(3):
        for f in range(P):
            value, slope = signal.rates[f, span.last], signal.slopes[f, span.last]
            for s in range(m):
                omega[row, s] += rate[f, row, s] * value
                alpha[row, s] += rate[f, row, s] * slope
    a, b, c, d = out.q_path[end, 0], out.q_path[end, 1], out.q_path[end, 2], out.q_path[end, 3]
    for s in range(M):
        j = s if s < m else 0
        w, x, y, z = q[0, j], q[1, j], q[2, j], q[3, j]
        out.dq[0, s] = w * a - x * b - y * c - z * d
        out.dq[1, s] = w * b + x * a + y * d - z * c
        out.dq[2, s] = w * c - x * d + y * a + z * b
        out.dq[3, s] = w * d + x * c - y * b + z * a
        for i in range(3):
            out.omega_end[i, s] = omega[i, j]
            out.alpha_end[i, s] = alpha[i, j]
    turned = np.empty((4, m))
    part, others = np.empty((3, m)), np.empty((3, M - m))
    for which in range(3):
        k = span.last - 1 + which
        if k > span.high:  # no sample beyond `last`
            place(u_end[which - 1], 0, 0, u_end[which])
            continue
        force_at(k - span.low, path.psi, path.C, coefficients.force, part)
        place(q, 0, 0, turned)
        if which != 1:
            turn(turned, relative.neighbours[which // 2], 1.0)
        rotate(turned, part)
        place(part, 0, 0, u_end[which])
        force_at(k - span.low, path.psi, path.C, coefficients.shared, others)
        place(others, 0, m, u_end[which])


@kernel
def force_at(j: int, psi: Array, C: Array, coefficients: Array, out: Array) -> None:
    """Write the specific force (3, m) of sample j, turned by its direction cosines.

    psi (c, features), C (c, 9), coefficients (features, 3, m).
    """
    force = np.zeros(out.shape)
    for f in range(psi.shape[1]):
        c = psi[j, f]
        for s in range(out.shape[1]):
            force[0, s] += c * coefficients[f, 0, s]
            force[1, s] += c * coefficients[f, 1, s]
            force[2, s] += c * coefficients[f, 2, s]
    for i in range(3):
        for s in range(out.shape[1]):
            out[i, s] = C[j, 3 * i] * force[0, s] + C[j, 3 * i + 1] * force[1, s] + C[j, 3 * i + 2] * force[2, s]
