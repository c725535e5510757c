"""The strapdown computation between two updates, for many parameter sets side by side.

Seen from the body's attitude at the first sample, the motion the IMU felt does not depend on where it
was, how it was turned, how fast it moved, or where gravity points. It is computed here once for every
distinct set of sensor parameters; `composition` puts it onto the navigation state.
"""

from __future__ import annotations

import numpy as np

from kreisel._kernels.compilation import kernel
from kreisel._kernels.quadrature import POINTS
from kreisel._kernels.rotation import turn

QUADRATIC = 9
"""Features of the motion the size effect is linear in: squares and products of rates, angular acceleration."""


@kernel
def rate_coefficients(K_omega, k_w, out):
    """Write what equation (1) is linear in: omega = sum_f out[f] * feature_f, (1 + 3 N, 3, m).

    Features are 1, and the powers 1 to N of the three raw rates.
    """
    for row in range(3):
        for s in range(out.shape[2]):
            out[0, row, s] = (
                K_omega[row, 0, s] * k_w[0, 0, s]
                + K_omega[row, 1, s] * k_w[0, 1, s]
                + K_omega[row, 2, s] * k_w[0, 2, s]
            )
        for axis in range(3):
            for s in range(out.shape[2]):
                out[1 + axis, row, s] = K_omega[row, axis, s]
            for i in range(1, k_w.shape[0]):
                for s in range(out.shape[2]):
                    out[1 + 3 * i + axis, row, s] = K_omega[row, axis, s] * k_w[i, axis, s]


@kernel
def force_coefficients(K_a, k_a, lever_arms, products, inside, out):
    """Write what equation (2) is linear in: f = sum_f out[f] * feature_f, (1 + 3 N + 9, 3, m).

    Features are 1, the powers 1 to N of the three raw readings, and xx, yy, zz, xy, xz, yz of the rate
    and the angular acceleration. products is 1, or 0 to leave out the products of two rates, as the
    printed equation (2) does; inside is True where e stands inside the parentheses.
    """
    rate_coefficients(K_a, k_a, out)
    at = 1 + 3 * k_a.shape[0]
    axes = np.zeros((3, 3))
    G = np.zeros((3, 3))
    for s in range(out.shape[2]):
        if inside:
            inverse(K_a[:, :, s], axes)
        for row in range(3):
            for i in range(3):
                for j in range(3):
                    if inside:
                        # K_a e = sum_ij G_ij ([alpha x] + [omega x]^2)_ij
                        G[i, j] = (
                            K_a[row, 0, s] * axes[0, i] * lever_arms[0, j, s]
                            + K_a[row, 1, s] * axes[1, i] * lever_arms[1, j, s]
                            + K_a[row, 2, s] * axes[2, i] * lever_arms[2, j, s]
                        )
                    else:
                        G[i, j] = lever_arms[row, j, s] if i == row else 0.0
            out[at, row, s] = G[1, 1] + G[2, 2]
            out[at + 1, row, s] = G[0, 0] + G[2, 2]
            out[at + 2, row, s] = G[0, 0] + G[1, 1]
            out[at + 3, row, s] = -products * (G[0, 1] + G[1, 0])
            out[at + 4, row, s] = -products * (G[0, 2] + G[2, 0])
            out[at + 5, row, s] = -products * (G[1, 2] + G[2, 1])
            out[at + 6, row, s] = G[1, 2] - G[2, 1]
            out[at + 7, row, s] = G[2, 0] - G[0, 2]
            out[at + 8, row, s] = G[0, 1] - G[1, 0]


@kernel
def inverse(A, out):
    """Write the inverse of a matrix (3, 3)."""
    a = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    b = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    c = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    scale = 1.0 / (A[0, 0] * a + A[0, 1] * b + A[0, 2] * c)
    out[0, 0] = scale * a
    out[1, 0] = scale * b
    out[2, 0] = scale * c
    out[0, 1] = scale * (A[0, 2] * A[2, 1] - A[0, 1] * A[2, 2])
    out[1, 1] = scale * (A[0, 0] * A[2, 2] - A[0, 2] * A[2, 0])
    out[2, 1] = scale * (A[0, 1] * A[2, 0] - A[0, 0] * A[2, 1])
    out[0, 2] = scale * (A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1])
    out[1, 2] = scale * (A[0, 2] * A[1, 0] - A[0, 0] * A[1, 2])
    out[2, 2] = scale * (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0])


@kernel
def rates(coefficients, value, slope, integral, omega, alpha, step):
    """Write rate, angular acceleration and integrated rate (3, m) from powers of the readings, (N + 1, 3) each."""
    m = omega.shape[1]
    for row in range(3):
        for s in range(m):
            one = coefficients[0, row, s]
            x = coefficients[1, row, s]
            y = coefficients[2, row, s]
            z = coefficients[3, row, s]
            omega[row, s] = one + x * value[1, 0] + y * value[1, 1] + z * value[1, 2]
            alpha[row, s] = x * slope[1, 0] + y * slope[1, 1] + z * slope[1, 2]
            step[row, s] = one * integral[0, 0] + x * integral[1, 0] + y * integral[1, 1] + z * integral[1, 2]
        for i in range(2, value.shape[0]):
            for axis in range(3):
                f = 3 * i - 2 + axis
                for s in range(m):
                    c = coefficients[f, row, s]
                    omega[row, s] += c * value[i, axis]
                    alpha[row, s] += c * slope[i, axis]
                    step[row, s] += c * integral[i, axis]


@kernel
def specific_force(coefficients, value, omega, alpha, out):
    """Write f_b of equation (2), (3, m), from powers of the readings (N + 1, 3), rate and angular acceleration."""
    m = out.shape[1]
    at = coefficients.shape[0] - QUADRATIC
    for row in range(3):
        for s in range(m):
            x = omega[0, s]
            y = omega[1, s]
            z = omega[2, s]
            out[row, s] = (
                coefficients[0, row, s]
                + coefficients[1, row, s] * value[1, 0]
                + coefficients[2, row, s] * value[1, 1]
                + coefficients[3, row, s] * value[1, 2]
                + x * (coefficients[at, row, s] * x + coefficients[at + 3, row, s] * y)
                + y * (coefficients[at + 1, row, s] * y + coefficients[at + 5, row, s] * z)
                + z * (coefficients[at + 2, row, s] * z + coefficients[at + 4, row, s] * x)
                + coefficients[at + 6, row, s] * alpha[0, s]
                + coefficients[at + 7, row, s] * alpha[1, s]
                + coefficients[at + 8, row, s] * alpha[2, s]
            )
        for i in range(2, value.shape[0]):
            for axis in range(3):
                for s in range(m):
                    out[row, s] += coefficients[3 * i - 2 + axis, row, s] * value[i, axis]


@kernel
def rotation_step(step, omega, omega_next, alpha, alpha_next, dt, theta):
    """Write the rotation vector over one sampling interval, (3, m), to the sixth order in dt.

    `step` is the integrated rate; what its axis' motion within the interval adds follows from rate and
    angular acceleration at both ends. The leading term is the coning correction dt^2/12 omega_k x omega_k+1.
    Magnus' series as given by Blanes, Casas and Ros (2000), equation (4.12) there with the sign of a
    rotation composed on its right.
    """
    for s in range(theta.shape[1]):
        # moments of the rate about the middle, to the orders the series needs
        cx = 0.5 * dt * dt * (alpha_next[0, s] - alpha[0, s])
        cy = 0.5 * dt * dt * (alpha_next[1, s] - alpha[1, s])
        cz = 0.5 * dt * dt * (alpha_next[2, s] - alpha[2, s])
        bx = dt * (1.2 * (omega_next[0, s] - omega[0, s]) - 0.1 * dt * (alpha[0, s] + alpha_next[0, s]))
        by = dt * (1.2 * (omega_next[1, s] - omega[1, s]) - 0.1 * dt * (alpha[1, s] + alpha_next[1, s]))
        bz = dt * (1.2 * (omega_next[2, s] - omega[2, s]) - 0.1 * dt * (alpha[2, s] + alpha_next[2, s]))
        ax = step[0, s] - cx / 12.0
        ay = step[1, s] - cy / 12.0
        az = step[2, s] - cz / 12.0
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
        theta[0, s] = step[0, s] + (uy * vz - uz * vy) / 240.0
        theta[1, s] = step[1, s] + (uz * vx - ux * vz) / 240.0
        theta[2, s] = step[2, s] + (ux * vy - uy * vx) / 240.0


@kernel
def outer_weights(first, last, stamps, base, single, double, low, weights):
    """Write the weights (2, count) of the samples from `low` on in the velocity and position integrals."""
    weights[:] = 0.0
    for k in range(first, last):
        rest = stamps[last] - stamps[k + 1]
        for i in range(POINTS):
            j = base[k] + i - low
            weights[0, j] += single[k, i]
            weights[1, j] += double[k, i] + rest * single[k, i]


@kernel
def add_turned(q, u, weight_v, weight_p, dv, dp):
    """Turn u (3, m) by q in place, and add it to dv and dp with their weights."""
    for s in range(q.shape[1]):
        w = q[0, s]
        x = q[1, s]
        y = q[2, s]
        z = q[3, s]
        a = u[0, s]
        b = u[1, s]
        c = u[2, s]
        tx = 2.0 * (y * c - z * b)
        ty = 2.0 * (z * a - x * c)
        tz = 2.0 * (x * b - y * a)
        a += w * tx + (y * tz - z * ty)
        b += w * ty + (z * tx - x * tz)
        c += w * tz + (x * ty - y * tx)
        u[0, s] = a
        u[1, s] = b
        u[2, s] = c
        dv[0, s] += weight_v * a
        dv[1, s] += weight_v * b
        dv[2, s] += weight_v * c
        dp[0, s] += weight_p * a
        dp[1, s] += weight_p * b
        dp[2, s] += weight_p * c


@kernel
def preintegrate(
    first,
    last,
    low,
    high,
    stamps,
    weights,
    rate_powers,
    rate_slopes,
    rate_integrals,
    force_powers,
    rate_coefficients,
    force_coefficients,
    dq,
    dv,
    dp,
    omega_end,
    alpha_end,
    u_end,
    u_path,
    q_path,
    turning,
):
    """Write attitude, velocity and position increments from sample `first` to `last`.

    Samples from `low` to `high` enter (two beyond either end where there are). All increments are
    seen from the body's inertial attitude at `first`.

    Parameters
    ----------
    weights : (2, high - low + 1)
        See `outer_weights`.
    rate_powers, force_powers : (n, N + 1, 3)
        Powers 0 to N of the raw readings; rate_slopes their time derivatives, and rate_integrals
        (n - 1, N + 1, 3) their integrals over each sampling interval.
    rate_coefficients, force_coefficients : (1 + 3 N, 3, m), (10 + 3 N, 3, m)
    dq, dv, dp : (4, M), (3, M), (3, M)
        The first m columns are written; M may be larger.
    omega_end, alpha_end : (3, M)
        Rate and angular acceleration at `last`.
    u_end : (3, 3, M)
        Specific force at the samples last - 1, last, last + 1, seen from the attitude at `first`.
    u_path, q_path, turning : (high - low + 1, 3), (high - low + 1, 4), (high - low + 1, 6)
        Specific force, attitude, and rate and angular acceleration along the way, of the first column.
    """
    m = rate_coefficients.shape[2]
    q = np.zeros((4, m))
    q_last = np.empty((4, m))
    v = np.zeros((3, m))
    p = np.zeros((3, m))
    omega = np.empty((3, m))
    omega_next = np.empty((3, m))
    alpha = np.empty((3, m))
    alpha_next = np.empty((3, m))
    step = np.empty((3, m))
    theta = np.empty((3, m))
    u = np.empty((3, m))
    q[0] = 1.0
    # Backwards over the samples before `first`, then forwards; the former are two or three.
    rates(rate_coefficients, rate_powers[first], rate_slopes[first], rate_integrals[low], omega, alpha, step)
    for k in range(first - 1, low - 1, -1):
        omega, omega_next = omega_next, omega
        alpha, alpha_next = alpha_next, alpha
        rates(rate_coefficients, rate_powers[k], rate_slopes[k], rate_integrals[k], omega, alpha, step)
        rotation_step(step, omega, omega_next, alpha, alpha_next, stamps[k + 1] - stamps[k], theta)
        turn(q, theta, -1.0)
    for k in range(low, high + 1):
        j = k - low
        specific_force(force_coefficients, force_powers[k], omega, alpha, u)
        add_turned(q, u, weights[0, j], weights[1, j], v, p)
        for i in range(3):
            u_path[j, i] = u[i, 0]
            turning[j, i] = omega[i, 0]
            turning[j, 3 + i] = alpha[i, 0]
        for i in range(4):
            q_path[j, i] = q[i, 0]
        if k == last:
            for i in range(3):
                for s in range(m):
                    omega_end[i, s] = omega[i, s]
                    alpha_end[i, s] = alpha[i, s]
            q_last[:] = q
        if last - 1 <= k <= last + 1:
            for i in range(3):
                for s in range(m):
                    u_end[k - last + 1, i, s] = u[i, s]
        if k < high:
            rates(
                rate_coefficients, rate_powers[k + 1], rate_slopes[k + 1], rate_integrals[k],
                omega_next, alpha_next, step,
            )  # fmt: skip
            rotation_step(step, omega, omega_next, alpha, alpha_next, stamps[k + 1] - stamps[k], theta)
            turn(q, theta, 1.0)
            omega, omega_next = omega_next, omega
            alpha, alpha_next = alpha_next, alpha
    for s in range(m):
        for i in range(3):
            dv[i, s] = v[i, s]
            dp[i, s] = p[i, s]
        for i in range(4):
            dq[i, s] = q_last[i, s]
    for k in range(high + 1, last + 2):  # no sample beyond `last`
        u_end[k - last + 1] = u_end[k - last]


@kernel
def share_path(
    first_column,
    last,
    low,
    weights,
    force_powers,
    q_path,
    turning,
    force_coefficients,
    dq,
    dv,
    dp,
    omega_end,
    alpha_end,
    u_end,
):
    """Write increments of columns that turn as the first column does, from column `first_column` on.

    Along one path of attitude, rate and angular acceleration the specific force is linear in
    `force_coefficients` (10 + 3 N, 3, m). What they are multiplied by is summed over the samples once, for
    all columns; the rest costs as much as a few samples.
    """
    features = force_coefficients.shape[0]
    feature = np.empty(features)
    turned = np.empty((9, features))
    moments = np.zeros((2, 9, features))
    C = np.empty((3, 3))
    for j in range(q_path.shape[0]):
        force_features(force_powers[low + j], turning[j], feature)
        direction_cosines(q_path[j], C)
        for i in range(9):
            c = C[i // 3, i % 3]
            for f in range(features):
                turned[i, f] = c * feature[f]
        for which in range(2):
            weight = weights[which, j]
            for i in range(9):
                for f in range(features):
                    moments[which, i, f] += weight * turned[i, f]
        at = low + j - last + 1
        if 0 <= at < 3:
            combine(turned, force_coefficients, first_column, u_end[at])
    combine(moments[0], force_coefficients, first_column, dv)
    combine(moments[1], force_coefficients, first_column, dp)
    if low + q_path.shape[0] - 1 == last:
        u_end[2, :, first_column:] = u_end[1, :, first_column:]
    for s in range(first_column, first_column + force_coefficients.shape[2]):
        for i in range(4):
            dq[i, s] = dq[i, 0]
        for i in range(3):
            omega_end[i, s] = omega_end[i, 0]
            alpha_end[i, s] = alpha_end[i, 0]


@kernel
def force_features(value, turning, out):
    """Write the features of `force_coefficients` for one sample: powers (N + 1, 3), rate and its derivative (6,)."""
    at = out.size - QUADRATIC
    out[0] = 1.0
    for i in range(1, value.shape[0]):
        for axis in range(3):
            out[3 * i - 2 + axis] = value[i, axis]
    x = turning[0]
    y = turning[1]
    z = turning[2]
    out[at] = x * x
    out[at + 1] = y * y
    out[at + 2] = z * z
    out[at + 3] = x * y
    out[at + 4] = x * z
    out[at + 5] = y * z
    for axis in range(3):
        out[at + 6 + axis] = turning[3 + axis]


@kernel
def combine(moments, coefficients, first_column, out):
    """Write sum_jf moments[3 i + j, f] coefficients[f, j, s] to out[i, first_column + s]."""
    total = np.empty(coefficients.shape[2])
    for i in range(3):
        total[:] = 0.0
        for j in range(3):
            for f in range(coefficients.shape[0]):
                c = moments[3 * i + j, f]
                for s in range(total.size):
                    total[s] += c * coefficients[f, j, s]
        for s in range(total.size):
            out[i, first_column + s] = total[s]


@kernel
def noise_covariance(first, last, low, every, stamps, u_path, q_path, rate_variance, force_variance, K_omega, K_a, Q):
    """Write the covariance that sensor noise leaves in attitude, velocity and position, (9, 9).

    Seen from the body's attitude at `first`; attitude errors as left perturbations in that frame.
    `every` samples are taken together, with force and attitude in their middle.

    Parameters
    ----------
    u_path, q_path
        As `preintegrate` writes them, from sample `low` on.
    rate_variance, force_variance : (n - 1, 3)
        Variance of the noise's integral over each interval.
    K_omega, K_a : (3, 3)
    """
    C = np.empty((3, 3))
    G = np.empty((3, 3))
    rate = np.empty(3)
    force = np.empty(3)
    Q[:] = 0.0
    for start in range(first, last, every):
        stop = min(start + every, last)
        rate[:] = 0.0
        force[:] = 0.0
        for k in range(start, stop):
            for axis in range(3):
                rate[axis] += rate_variance[k, axis]
                force[axis] += force_variance[k, axis]
        middle = (start + stop) // 2 - low
        dt = stamps[stop] - stamps[start]
        advance_covariance(u_path[middle, 0], u_path[middle, 1], u_path[middle, 2], dt, Q)
        direction_cosines(q_path[middle], C)
        product(C, K_omega, G)
        add_noise(G, rate, 1.0, 0.0, 0, 0, Q)
        product(C, K_a, G)
        add_noise(G, force, 1.0, 0.5 * dt, 3, 6, Q)


@kernel
def direction_cosines(q, C):
    """Write the matrix (3, 3) of a unit quaternion (4,)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    C[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    C[0, 1] = 2.0 * (x * y - w * z)
    C[0, 2] = 2.0 * (x * z + w * y)
    C[1, 0] = 2.0 * (x * y + w * z)
    C[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    C[1, 2] = 2.0 * (y * z - w * x)
    C[2, 0] = 2.0 * (x * z - w * y)
    C[2, 1] = 2.0 * (y * z + w * x)
    C[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@kernel
def product(A, B, out):
    """Write the product of two matrices (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@kernel
def advance_covariance(ux, uy, uz, dt, Q):
    """Replace Q (9, 9) by F Q F^T for errors that move as v += -u x theta dt, p += v dt - u x theta dt^2/2.

    theta, v and p are attitude error (left), velocity and position error; u the specific force.
    """
    h = 0.5 * dt
    for j in range(9):
        x = -dt * (uy * Q[2, j] - uz * Q[1, j])
        y = -dt * (uz * Q[0, j] - ux * Q[2, j])
        z = -dt * (ux * Q[1, j] - uy * Q[0, j])
        Q[6, j] += dt * Q[3, j] + h * x
        Q[7, j] += dt * Q[4, j] + h * y
        Q[8, j] += dt * Q[5, j] + h * z
        Q[3, j] += x
        Q[4, j] += y
        Q[5, j] += z
    for i in range(9):
        x = -dt * (uy * Q[i, 2] - uz * Q[i, 1])
        y = -dt * (uz * Q[i, 0] - ux * Q[i, 2])
        z = -dt * (ux * Q[i, 1] - uy * Q[i, 0])
        Q[i, 6] += dt * Q[i, 3] + h * x
        Q[i, 7] += dt * Q[i, 4] + h * y
        Q[i, 8] += dt * Q[i, 5] + h * z
        Q[i, 3] += x
        Q[i, 4] += y
        Q[i, 5] += z


@kernel
def add_noise(G, variance, gain, gain_below, row, row_below, Q):
    """Add G diag(variance) G^T to Q at `row`, and with its integral at `row_below` where gain_below > 0."""
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += G[i, k] * variance[k] * G[j, k]
            Q[row + i, row + j] += gain * gain * total
            if gain_below > 0.0:
                Q[row_below + i, row + j] += gain_below * gain * total
                Q[row + i, row_below + j] += gain * gain_below * total
                # the noise is white within the interval: variance of its integral is dt^2/3, not dt^2/4
                Q[row_below + i, row_below + j] += 4.0 / 3.0 * gain_below * gain_below * total
