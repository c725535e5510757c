/// The strapdown computation between two updates, for many parameter sets along one path.
///
/// Seen from the body's attitude at the first sample, the motion that the IMU measured does not depend on where it was,
/// how it was turned, how fast it moved, or where gravity points. It is computed here once for every distinct set of
/// sensor parameters; composition.hpp puts it onto the navigation state.
///
/// The first set, the centre, is integrated sample by sample (centre_path.hpp), the others relative to it
/// (relative_motion.hpp).
#pragma once

#include "relative_motion.hpp"

namespace {

/// The specific force of sample j, seen from the attitude at the first, before a set's own turn.
template <bool Effects>
inline Vector<Lanes> force_at(Index j, const Path &path, Columns coefficients, Index s) {
    const Index features = Effects ? coefficients.rows / 3 : FEATURES;
    Vector<Lanes> force = {0.0, 0.0, 0.0};
    for (Index f = 0; f < features; f++) force += path.psi(j, f) * coefficients.vector(3 * f, s);
    return Matrix<Lanes>{{
        {path.C(0, j), path.C(1, j), path.C(2, j)},
        {path.C(3, j), path.C(4, j), path.C(5, j)},
        {path.C(6, j), path.C(7, j), path.C(8, j)},
    }} * force;
}

/// Write columns from the m-th on: those of `values` (rows, others), which begin at column m of `out`.
inline void set_others(Columns values, Index m, Index others, Columns out) {
    for (Index i = 0; i < out.rows; i++) std::memcpy(out.row(i) + m, values.row(i), others * sizeof(double));
}

/// Write what lets the motion be carried on by less than a sampling interval.
template <bool Effects>
inline void finish(
    Span span, const Samples &signal, const Coefficients &coefficients, const Path &path, const Relative &relative,
    const Increments &out, Workspace &memory
) {
    const Columns rate = coefficients.rate;
    const Index P = Features<Effects>(rate.rows / 3).P, m = coefficients.m, others = coefficients.others, end = span.last - span.low;
    const Quaternion<double> q = path.q.quaternion_at(end);
    const Quaternion<Lanes> turned = {q.w, q.x, q.y, q.z};
    for (Index s = 0; s < rate.columns; s += LANES) {
        Vector<Lanes> omega = {0.0, 0.0, 0.0}, alpha = {0.0, 0.0, 0.0};
        for (Index f = 0; f < P; f++) {
            omega += signal.rates(f, span.last) * rate.vector(3 * f, s);
            if (f < RATES) alpha += signal.slopes(f, span.last) * rate.vector(3 * f, s);
        }
        out.omega_end.set(s, omega);
        out.alpha_end.set(s, alpha);
        out.dq.set(s, relative.q.quaternion(s) * turned);
    }
    for (Index which = 0; which < 3; which++) {
        const Columns u = out.u_end.rows_from(3 * which, 3);
        const Index j = end - 1 + which;
        if (j > span.high - span.low) {  // no sample beyond the last
            copy(out.u_end.rows_from(3 * which - 3, 3), u, 3, u.columns);
            continue;
        }
        for (Index s = 0; s < rate.columns; s += LANES) {
            Quaternion<Lanes> there = relative.q.quaternion(s);
            if (which != 1) there = there * small_rotation(relative.neighbours[which / 2].vector(s));
            u.set(s, rotate(there, force_at<Effects>(j, path, coefficients.force, s)));
        }
        const Columns shared = memory.columns(3, others);
        for (Index s = 0; s < shared.columns; s += LANES) shared.set(s, force_at<Effects>(j, path, coefficients.shared, s));
        set_others(shared, m, others, u);
    }
    // The others turn as the first does.
    for (Index s = m; s < m + others; s++) {
        for (Index i = 0; i < 3; i++) {
            out.omega_end(i, s) = out.omega_end(i, 0);
            out.alpha_end(i, s) = out.alpha_end(i, 0);
        }
        for (Index i = 0; i < 4; i++) out.dq(i, s) = out.dq(i, 0);
    }
}

/// Write the increments over a span: equation (8). Effects: whether the sensors' effects have features.
template <bool Effects>
inline void preintegrate(
    Span span, const Samples &signal, const Coefficients &coefficients, const Increments &out, Workspace &memory
) {
    const Index m = coefficients.m, others = coefficients.others;
    const Path path = centre_path<Effects>(span, signal, coefficients, memory);
    Relative relative = {
        memory.zeros(4, m), {memory.zeros(3, m), memory.zeros(3, m)},
        {memory.numbers(18 * path.psi.columns), 18, path.psi.columns},
    };
    for (Index s = 0; s < relative.q.columns; s++) relative.q(0, s) = 1.0;
    fill(relative.total, 0.0);
    relative_motion<Effects>(span, signal, coefficients, path, relative, out, memory);
    const Columns shared = memory.columns(3, others);
    for (Index which = 0; which < 2; which++) {
        const Table total = {relative.total.row(9 * which), 9, relative.total.columns};
        for (Index s = 0; s < shared.columns; s += LANES) shared.set(s, combine<Effects>(total, coefficients.shared, s));
        set_others(shared, m, others, which == 0 ? out.dv : out.dp);
    }
    finish<Effects>(span, signal, coefficients, path, relative, out, memory);
    copy(path.u, out.u_path, span.count(), LANES);
    copy(path.q, out.q_path, 4, out.q_path.columns);
}

/// The same, with effects where there are any.
inline void preintegrate(
    Span span, const Samples &signal, const Coefficients &coefficients, const Increments &out, Workspace &memory
) {
    if (signal.rates.rows == RATES && signal.forces.rows == 3) {
        preintegrate<false>(span, signal, coefficients, out, memory);
    } else {
        preintegrate<true>(span, signal, coefficients, out, memory);
    }
}

}  // namespace
