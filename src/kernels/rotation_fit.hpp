/// Rotations of a reference against those that gyro readings predict, for the fit of gyro parameters and clock.
#pragma once

#include "quadrature.hpp"

namespace {

/// Raw rates of a stretch of readings: as they are, as running means, and integrated from the first sample, (n, 3).
struct RateSignal {
    ConstNumbers stamps;  // (n,)
    ConstTable rates, smooth, integral;
};

/// What of the readings stands at a time between two samples.
struct AtTime {
    Quaternion<double> q;
    Vector<double> smooth, integral;
};

/// Attitude, mean rate and integrated reading at time t, of attitudes q (n, 4) at the samples; `k` is a sample before t,
/// and is moved on.
inline AtTime at_time(const RateSignal &signal, ConstTable q, Matrix<double> K, Vector<double> b, double t, Index &k) {
    const ConstNumbers stamps = signal.stamps;
    while (k > 0 && stamps[k] >= t) k--;
    while (k < stamps.count - 2 && stamps[k + 1] < t) k++;
    const double s = t - stamps[k], h = stamps[k + 1] - stamps[k], share = s / h;
    const Vector<double> omega = K * vector_from(signal.rates.row(k)) + b;
    const Vector<double> change = K * vector_from(signal.rates.row(k + 1)) + b - omega;
    const auto between = [&](ConstTable rows) {
        return (1.0 - share) * vector_from(rows.row(k)) + share * vector_from(rows.row(k + 1));
    };
    return {
        quaternion_from(q.row(k)) * rotation(s * omega + (0.5 * s * share) * change), K * between(signal.smooth) + b,
        between(signal.integral),
    };
}

/// Write for rotations (m, 3) between the times of t (m, 2), ascending, the integrated readings over them, by how much the
/// reference's rotation differs from the predicted one, and the predicted one's derivative with respect to a shift of the
/// clock, (m, 3) each.
///
/// K (3, 3), b (3,): omega = K w' + b; q (n, 4): the attitudes that follow.
inline void compare_rotations(
    const RateSignal &signal, ConstTable q, Matrix<double> K, Vector<double> b, ConstTable t, ConstTable rotations, Table turned,
    Table residual, Table slope
) {
    const auto set = [](Table out, Index i, Vector<double> v) { out(i, 0) = v.x, out(i, 1) = v.y, out(i, 2) = v.z; };
    Index first = 0, last = 0;
    for (Index i = 0; i < t.rows; i++) {
        const AtTime begin = at_time(signal, q, K, b, t(i, 0), first), end = at_time(signal, q, K, b, t(i, 1), last);
        const Quaternion<double> predicted = conjugate(begin.q) * end.q;
        set(turned, i, end.integral - begin.integral);
        set(residual, i, rotation_vector(conjugate(predicted) * rotation(vector_from(rotations.row(i)))));
        // the rate at the end, less the rate at the beginning turned by the rotation between them
        set(slope, i, end.smooth - rotate(conjugate(predicted), begin.smooth));
    }
}

}  // namespace
