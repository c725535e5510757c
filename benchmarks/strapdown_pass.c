/* One strapdown pass over readings (n, 3): sensor correction, attitude with the coning term, velocity and position. */

static void correct(const double *K, const double *offset, const double *reading, double *out) {
    for (int i = 0; i < 3; i++) {
        out[i] = 0.0;
        for (int j = 0; j < 3; j++) out[i] += K[3 * i + j] * (reading[j] + offset[j]);
    }
}

double strapdown_pass(
    const double *rates, const double *forces, long n, const double *K_omega, const double *k_w, const double *K_a,
    const double *k_a, const double *gravity, double dt
) {
    double q0 = 1, q1 = 0, q2 = 0, q3 = 0, v[3] = {0}, p[3] = {0}, before[3] = {0}, last[3] = {0};
    for (long k = 0; k < n; k++) {
        double w[3], f[3];
        correct(K_omega, k_w, rates + 3 * k, w);
        correct(K_a, k_a, forces + 3 * k, f);
        const double e = dt * dt / 12;
        const double x = 0.5 * (w[0] + before[0]) * dt + e * (before[1] * w[2] - before[2] * w[1]);
        const double y = 0.5 * (w[1] + before[1]) * dt + e * (before[2] * w[0] - before[0] * w[2]);
        const double z = 0.5 * (w[2] + before[2]) * dt + e * (before[0] * w[1] - before[1] * w[0]);
        const double square = x * x + y * y + z * z, s = 0.5 - square / 48, c = 1 - square / 8;
        const double a = s * x, b = s * y, d = s * z;
        const double r0 = q0 * c - q1 * a - q2 * b - q3 * d, r1 = q0 * a + q1 * c + q2 * d - q3 * b;
        const double r2 = q0 * b - q1 * d + q2 * c + q3 * a, r3 = q0 * d + q1 * b - q2 * a + q3 * c;
        q0 = r0, q1 = r1, q2 = r2, q3 = r3;
        const double u[3] = {
            (1 - 2 * (q2 * q2 + q3 * q3)) * f[0] + 2 * (q1 * q2 - q3 * q0) * f[1] + 2 * (q1 * q3 + q2 * q0) * f[2],
            2 * (q1 * q2 + q3 * q0) * f[0] + (1 - 2 * (q1 * q1 + q3 * q3)) * f[1] + 2 * (q2 * q3 - q1 * q0) * f[2],
            2 * (q1 * q3 - q2 * q0) * f[0] + 2 * (q2 * q3 + q1 * q0) * f[1] + (1 - 2 * (q1 * q1 + q2 * q2)) * f[2],
        };
        for (int i = 0; i < 3; i++) {
            const double now = u[i] + gravity[i], next = v[i] + 0.5 * dt * (now + last[i]);
            p[i] += 0.5 * dt * (v[i] + next);
            v[i] = next;
            last[i] = now;
            before[i] = w[i];
        }
    }
    return p[0] + p[1] + p[2] + q0;
}
