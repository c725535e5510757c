"""The strapdown computation between two updates, for many parameter sets side by side.

Seen from the body's attitude at the first sample, the motion the IMU felt does not depend on where it
was, how it was turned, how fast it moved, or where gravity points. It is computed here once for every
distinct set of sensor parameters; `composition` puts it onto the navigation state.
"""

from __future__ import annotations

import numpy as np

from kreisel._kernels.compilation import kernel
from kreisel._kernels.quadrature import POINTS
from kreisel._kernels.rotation import rotate, turn


@kernel
def affine(matrix, powers, coefficients, out):
    """Write matrix * (x + k_0 x^0 + k_2 x^2 + ...), the polynomial in parentheses of equations (1) and (2).

    matrix (3, 3, m); powers (N + 1, 3) with row i the i-th power of x (or its integral or derivative);
    coefficients (N, 3, m) with row 0 k_0 and row i k_(i+1); out (3, m).
    """
    m = out.shape[1]
    x = np.empty((3, m))
    for axis in range(3):
        for s in range(m):
            x[axis, s] = powers[1, axis] + powers[0, axis] * coefficients[0, axis, s]
        for i in range(1, coefficients.shape[0]):
            for s in range(m):
                x[axis, s] += powers[i + 1, axis] * coefficients[i, axis, s]
    for s in range(m):
        out[0, s] = matrix[0, 0, s] * x[0, s] + matrix[0, 1, s] * x[1, s] + matrix[0, 2, s] * x[2, s]
        out[1, s] = matrix[1, 0, s] * x[0, s] + matrix[1, 1, s] * x[1, s] + matrix[1, 2, s] * x[2, s]
        out[2, s] = matrix[2, 0, s] * x[0, s] + matrix[2, 1, s] * x[1, s] + matrix[2, 2, s] * x[2, s]


@kernel
def size_effect(omega, alpha, axes, lever_arms, products, out):
    """Write e_j = s_j . ([alpha x] + [omega x]^2) r_j for the three accelerometers, (3, m).

    axes (3, 3, m): row j is s_j; lever_arms (3, 3, m): row j is r_j. products is 1, or 0 to leave out
    the products of two rates, as the printed equation (2) does.
    """
    for s in range(omega.shape[1]):
        x = omega[0, s]
        y = omega[1, s]
        z = omega[2, s]
        xy = products * x * y
        xz = products * x * z
        yz = products * y * z
        xx = x * x
        yy = y * y
        zz = z * z
        a = alpha[0, s]
        b = alpha[1, s]
        c = alpha[2, s]
        for j in range(3):
            r0 = lever_arms[j, 0, s]
            r1 = lever_arms[j, 1, s]
            r2 = lever_arms[j, 2, s]
            out[j, s] = (
                axes[j, 0, s] * (-(yy + zz) * r0 + (xy - c) * r1 + (xz + b) * r2)
                + axes[j, 1, s] * ((xy + c) * r0 - (xx + zz) * r1 + (yz - a) * r2)
                + axes[j, 2, s] * ((xz - b) * r0 + (yz + a) * r1 - (xx + yy) * r2)
            )


@kernel
def specific_force(powers, omega, alpha, K_a, k_a, axes, lever_arms, products, inside, out):
    """Write f_b of equation (2), (3, m); inside is True where e stands inside the parentheses."""
    m = out.shape[1]
    e = np.empty((3, m))
    size_effect(omega, alpha, axes, lever_arms, products, e)
    affine(K_a, powers, k_a, out)
    for i in range(3):
        if inside:
            for s in range(m):
                out[i, s] -= K_a[i, 0, s] * e[0, s] + K_a[i, 1, s] * e[1, s] + K_a[i, 2, s] * e[2, s]
        else:
            for s in range(m):
                out[i, s] -= e[i, s]


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
def outer_weights(first, last, stamps, base, single, double, low, weight_v, weight_p):
    """Write the weights of the samples from `low` on in the velocity and position integrals."""
    weight_v[:] = 0.0
    weight_p[:] = 0.0
    for k in range(first, last):
        rest = stamps[last] - stamps[k + 1]
        for i in range(POINTS):
            j = base[k] + i - low
            weight_v[j] += single[k, i]
            weight_p[j] += double[k, i] + rest * single[k, i]


@kernel
def preintegrate(
    first,
    last,
    low,
    high,
    stamps,
    base,
    single,
    double,
    rate_powers,
    rate_slopes,
    rate_integrals,
    force_powers,
    K_omega,
    k_w,
    K_a,
    k_a,
    axes,
    lever_arms,
    products,
    inside,
    dq,
    dv,
    dp,
    omega_end,
    alpha_end,
    u_end,
    u_path,
    q_path,
):
    """Write attitude, velocity and position increments from sample `first` to `last`.

    Samples from `low` to `high` enter (two beyond either end where there are). All increments are
    seen from the body's inertial attitude at `first`.

    Parameters
    ----------
    rate_powers, force_powers : (n, N + 1, 3)
        Powers 0 to N of the raw readings; rate_slopes their time derivatives, and rate_integrals
        (n - 1, N + 1, 3) their integrals over each sampling interval.
    K_omega, K_a, axes, lever_arms : (3, 3, m)
    k_w, k_a : (N, 3, m)
    dq : (4, m)
    dv, dp : (3, m)
    omega_end, alpha_end : (3, m)
        Rate and angular acceleration at `last`.
    u_end : (3, 3, m)
        Specific force at the samples last - 1, last, last + 1, seen from the attitude at `first`.
    u_path, q_path : (high - low + 1, 3), (high - low + 1, 4)
        Specific force and attitude along the way, of the first column.
    """
    m = dq.shape[1]
    count = high - low + 1
    weight_v = np.empty(count)
    weight_p = np.empty(count)
    outer_weights(first, last, stamps, base, single, double, low, weight_v, weight_p)
    omega = np.empty((3, m))
    omega_next = np.empty((3, m))
    alpha = np.empty((3, m))
    alpha_next = np.empty((3, m))
    dq_last = np.empty((4, m))
    step = np.empty((3, m))
    theta = np.empty((3, m))
    u = np.empty((3, m))

    dv[:] = 0.0
    dp[:] = 0.0
    u_end[:] = 0.0
    dq[:] = 0.0
    dq[0] = 1.0
    # Backwards over the samples before `first`, then forwards; the former are two or three.
    affine(K_omega, rate_powers[first], k_w, omega_next)
    affine(K_omega, rate_slopes[first], k_w, alpha_next)
    for k in range(first - 1, low - 1, -1):
        affine(K_omega, rate_powers[k], k_w, omega)
        affine(K_omega, rate_slopes[k], k_w, alpha)
        affine(K_omega, rate_integrals[k], k_w, step)
        rotation_step(step, omega, omega_next, alpha, alpha_next, stamps[k + 1] - stamps[k], theta)
        turn(dq, theta, -1.0)
        omega, omega_next = omega_next, omega
        alpha, alpha_next = alpha_next, alpha
    omega, omega_next = omega_next, omega
    alpha, alpha_next = alpha_next, alpha
    for k in range(low, high + 1):
        specific_force(force_powers[k], omega, alpha, K_a, k_a, axes, lever_arms, products, inside, u)
        rotate(dq, u, u)
        for i in range(3):
            u_path[k - low, i] = u[i, 0]
        for i in range(4):
            q_path[k - low, i] = dq[i, 0]
        wv = weight_v[k - low]
        wp = weight_p[k - low]
        for i in range(3):
            for s in range(m):
                dv[i, s] += wv * u[i, s]
                dp[i, s] += wp * u[i, s]
        if k == last:
            omega_end[:] = omega
            alpha_end[:] = alpha
            dq_last[:] = dq
        if last - 1 <= k <= last + 1:
            u_end[k - last + 1] = u
        if k < high:
            affine(K_omega, rate_powers[k + 1], k_w, omega_next)
            affine(K_omega, rate_slopes[k + 1], k_w, alpha_next)
            affine(K_omega, rate_integrals[k], k_w, step)
            rotation_step(step, omega, omega_next, alpha, alpha_next, stamps[k + 1] - stamps[k], theta)
            turn(dq, theta, 1.0)
            omega, omega_next = omega_next, omega
            alpha, alpha_next = alpha_next, alpha
    dq[:] = dq_last


@kernel
def noise_covariance(first, last, low, stamps, u_path, q_path, rate_variance, force_variance, K_omega, K_a, Q):
    """Write the covariance that sensor noise leaves in attitude, velocity and position, (9, 9).

    Seen from the body's attitude at `first`; attitude errors as left perturbations in that frame.

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
    Q[:] = 0.0
    for k in range(first, last):
        dt = stamps[k + 1] - stamps[k]
        advance_covariance(u_path[k - low, 0], u_path[k - low, 1], u_path[k - low, 2], dt, Q)
        direction_cosines(q_path[k - low], C)
        product(C, K_omega, G)
        add_noise(G, rate_variance[k], 1.0, 0.0, 0, 0, Q)
        product(C, K_a, G)
        add_noise(G, force_variance[k], 1.0, 0.5 * dt, 3, 6, Q)


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
