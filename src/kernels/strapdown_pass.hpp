/// One plain strapdown pass over readings: the unit in which run times are quoted.
#pragma once

#include "arrays.hpp"

namespace {

/// Sensor correction, attitude with the coning term, velocity and position over readings (n, 3), dt apart. K_omega, K_a
/// (3, 3); k_w, k_a, gravity (3,).
///
/// It is what any strapdown navigation must do, one sample after another, with sums in any order: no filter is faster.
#if defined(__GNUC__) && !defined(__clang__)
__attribute__((optimize("fast-math")))
#endif
inline double strapdown_pass(
    ConstTable rates, ConstTable forces, ConstTable K_omega, ConstNumbers k_w, ConstTable K_a, ConstNumbers k_a, ConstNumbers gravity,
    double dt
) {
#if defined(__clang__)
#pragma clang fp reassociate(on) contract(fast)
#endif
    double q0 = 1.0, q1 = 0.0, q2 = 0.0, q3 = 0.0, v[3] = {0.0}, p[3] = {0.0}, before[3] = {0.0}, last[3] = {0.0};
    const double *K = K_omega.data, *L = K_a.data, *b = k_w.data, *d = k_a.data, *g = gravity.data;
    for (Index k = 0; k < rates.rows; k++) {
        const double *rate = rates.row(k), *force = forces.row(k);
        double w[3], f[3];
        for (Index i = 0; i < 3; i++) {
            w[i] = K[3 * i] * (rate[0] + b[0]) + K[3 * i + 1] * (rate[1] + b[1]) + K[3 * i + 2] * (rate[2] + b[2]);
            f[i] = L[3 * i] * (force[0] + d[0]) + L[3 * i + 1] * (force[1] + d[1]) + L[3 * i + 2] * (force[2] + d[2]);
        }
        const double e = dt * dt / 12.0;
        const double x = 0.5 * (w[0] + before[0]) * dt + e * (before[1] * w[2] - before[2] * w[1]);
        const double y = 0.5 * (w[1] + before[1]) * dt + e * (before[2] * w[0] - before[0] * w[2]);
        const double z = 0.5 * (w[2] + before[2]) * dt + e * (before[0] * w[1] - before[1] * w[0]);
        const double square = x * x + y * y + z * z, s = 0.5 - square / 48.0, c = 1.0 - square / 8.0;
        const double s1 = s * x, s2 = s * y, s3 = s * z;
        const double r0 = q0 * c - q1 * s1 - q2 * s2 - q3 * s3, r1 = q0 * s1 + q1 * c + q2 * s3 - q3 * s2;
        const double r2 = q0 * s2 - q1 * s3 + q2 * c + q3 * s1, r3 = q0 * s3 + q1 * s2 - q2 * s1 + q3 * c;
        q0 = r0, q1 = r1, q2 = r2, q3 = r3;
        const double u[3] = {
            (1.0 - 2.0 * (q2 * q2 + q3 * q3)) * f[0] + 2.0 * (q1 * q2 - q3 * q0) * f[1] + 2.0 * (q1 * q3 + q2 * q0) * f[2],
            2.0 * (q1 * q2 + q3 * q0) * f[0] + (1.0 - 2.0 * (q1 * q1 + q3 * q3)) * f[1] + 2.0 * (q2 * q3 - q1 * q0) * f[2],
            2.0 * (q1 * q3 - q2 * q0) * f[0] + 2.0 * (q2 * q3 + q1 * q0) * f[1] + (1.0 - 2.0 * (q1 * q1 + q2 * q2)) * f[2],
        };
        for (Index i = 0; i < 3; i++) {
            const double now = u[i] + g[i], next = v[i] + 0.5 * dt * (now + last[i]);
            p[i] += 0.5 * dt * (v[i] + next);
            v[i] = next;
            last[i] = now;
            before[i] = w[i];
        }
    }
    return p[0] + p[1] + p[2] + q0;
}

}  // namespace
