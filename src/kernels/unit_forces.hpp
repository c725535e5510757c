/// Specific force predicted for a unit of each parameter of the accelerometers, integrated twice along a motion.
#pragma once

#include "arrays.hpp"

namespace {

/// Nine couplings, row by row, three offsets, and a lever arm all three have in common.
constexpr Index UNITS = 15;

/// Write the specific force in r predicted for a unit of each parameter, (45,): x for all, then y, then z.
///
/// q: attitude q_rb; reading, omega, alpha: raw acceleration, rate and angular acceleration of one sample.
inline void unit_forces(
    Quaternion<double> q, Vector<double> reading, Vector<double> omega, Vector<double> alpha, double *out
) {
    const Matrix<double> C = direction_cosines(q);
    const double xx = omega.x * omega.x, yy = omega.y * omega.y, zz = omega.z * omega.z;
    const double xy = omega.x * omega.y, xz = omega.x * omega.z, yz = omega.y * omega.z;
    // minus ([alpha x] + [omega x]^2), by columns
    const Vector<double> arm[3] = {
        {yy + zz, -alpha.z - xy, alpha.y - xz}, {alpha.z - xy, xx + zz, -alpha.x - yz}, {-alpha.y - xz, alpha.x - yz, xx + yy}};
    for (Index i = 0; i < 3; i++, out += UNITS) {
        const Vector<double> c = C.row[i];
        const double turned[3] = {c.x, c.y, c.z};
        for (Index k = 0; k < 3; k++) {
            out[3 * k] = turned[k] * reading.x;
            out[3 * k + 1] = turned[k] * reading.y;
            out[3 * k + 2] = turned[k] * reading.z;
            out[9 + k] = turned[k];
            out[12 + k] = dot(c, arm[k]);
        }
    }
}

/// Write double integrals of what `unit_forces` writes from the first stamp to chosen moments, (m, 45).
///
/// q (n, 4), readings, omega and alpha (n, 3). before and share (m,) give the moments: see quadrature.hpp,
/// `double_integral`, also for the values between samples.
inline void integrate_unit_forces(
    ConstNumbers stamps, ConstTable q, ConstTable readings, ConstTable omega, ConstTable alpha, Indices before, ConstNumbers share, Table out
) {
    constexpr Index ALL = 3 * UNITS, SIZE = 48;
    double once[SIZE] = {}, twice[SIZE] = {}, rise[SIZE] = {}, here[SIZE] = {}, ahead[SIZE] = {};
    const auto forces = [&](Index k, double *to) {
        unit_forces(
            quaternion_from(q.row(k)), vector_from(readings.row(k)), vector_from(omega.row(k)),
            vector_from(alpha.row(k)), to);
    };
    forces(0, ahead);
    Index at = 0;
    for (Index k = 0; k < stamps.count - 1; k++) {
        std::memcpy(here, ahead, sizeof here);
        forces(k + 1, ahead);
        const Lanes half = 0.5 * (stamps[k + 1] - stamps[k]);
        for (Index c = 0; c < SIZE; c += LANES) {
            const Lanes step = half * (load(here + c) + load(ahead + c)), sum = load(once + c);
            store(half * (sum + sum + step), rise + c);
            store(sum + step, once + c);
        }
        for (; at < before.count && before[at] == k; at++) {
            for (Index c = 0; c < ALL; c++) out(at, c) = twice[c] + share[at] * rise[c];
        }
        for (Index c = 0; c < SIZE; c += LANES) store(load(twice + c) + load(rise + c), twice + c);
    }
}

}  // namespace
