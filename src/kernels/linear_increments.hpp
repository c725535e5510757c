/// How the increments of a span change with the coefficients of the features, to first order.
///
/// What preintegration.hpp computes for sets beside the centre, block by block, is here one block that turns about the
/// span's first sample: its sums are the derivatives.
#pragma once

#include "preintegration.hpp"

namespace {

/// Derivatives of the centre's increments by the sensors' degrees of freedom, a column for each.
struct IncrementSlopes {
    Columns turn, dv, dp;    // (3, S): the turn stands on the left of dq, seen from the attitude at the first sample
    Columns omega, alpha;    // (3, S)
    Columns force;           // (9, S): see `Increments::u_end`
};

/// Derivatives of the coefficients by the sensors' degrees of freedom.
struct CoefficientSlopes {
    Columns rate, force;  // (3 P, S), (3 features, S)
};

/// Write the centre's increments, of the first column of the coefficients, and their derivatives.
template <bool Effects>
inline void linear_increments(
    Span span, const Samples &signal, const Coefficients &centre, const CoefficientSlopes &by, const Increments &out,
    const IncrementSlopes &slopes, Workspace &memory
) {
    const Path path = centre_path<Effects>(span, signal, centre, memory);
    const Features<Effects> of(centre.rate.rows / 3);
    const Index count = span.count(), P = of.P, Q = of.Q, features = path.psi.columns;
    const Index start = span.first - span.low, end = span.last - span.low;
    const Table units = {memory.numbers((count - 1) * 9 * Q), count - 1, 9 * Q};
    unit_turns<Effects>(span, signal, path.C, units, memory);
    const Table sums = {memory.numbers(18 * features), 18, features}, turns = {memory.numbers(54 * Q), 6, 9 * Q};
    double *carried = memory.numbers(2 * LANES * count), *lever = memory.numbers(9 * Q), *turned = memory.numbers(9 * Q);
    sum_products(0, count, path, sums);
    sum_turns(0, start, count, path, units, carried, turns);
    for (Index f = 0; f < 9 * Q; f += LANES) {
        Lanes total = 0.0;
        for (Index j = start; j < end; j++) total += load(units.row(j) + f);
        store(total, turned + f);
    }
    const Index columns = by.rate.columns;
    for (Index s = 0; s < columns; s += LANES) slopes.turn.set(s, contract<Effects>(turned, by.rate, s));
    for (Index which = 0; which < 2; which++) {
        const Table own = {sums.row(9 * which), 9, features};
        levers(turns, which, Q, lever);
        const Columns of_centre = which == 0 ? out.dv : out.dp, of_slopes = which == 0 ? slopes.dv : slopes.dp;
        of_centre.set(0, combine<Effects>(own, centre.force, 0));
        for (Index s = 0; s < columns; s += LANES) {
            of_slopes.set(s, combine<Effects>(own, by.force, s) + contract<Effects>(lever, by.rate, s));
        }
    }
    for (Index i = 0; i < 4; i++) out.dq(i, 0) = path.q(i, end);
    const auto rates = [&](Columns rate, Index s, Columns omega, Columns alpha) {
        Vector<Lanes> w = {0.0, 0.0, 0.0}, a = {0.0, 0.0, 0.0};
        for (Index f = 0; f < P; f++) {
            w += signal.rates(f, span.last) * rate.vector(3 * f, s);
            if (f < RATES) a += signal.slopes(f, span.last) * rate.vector(3 * f, s);
        }
        omega.set(s, w);
        alpha.set(s, a);
    };
    rates(centre.rate, 0, out.omega_end, out.alpha_end);
    for (Index s = 0; s < columns; s += LANES) rates(by.rate, s, slopes.omega, slopes.alpha);
    for (Index which = 0; which < 3; which++) {
        const Index j = end - 1 + which, row = 3 * which;
        if (j > span.high - span.low) {  // no sample beyond the last
            copy(out.u_end.rows_from(row - 3, 3), out.u_end.rows_from(row, 3), 3, 1);
            copy(slopes.force.rows_from(row - 3, 3), slopes.force.rows_from(row, 3), 3, columns);
            continue;
        }
        const Vector<double> u = vector_from(path.u.row(j));
        for (Index i = 0; i < 3; i++) out.u_end(row + i, 0) = path.u(j, i);
        for (Index s = 0; s < columns; s += LANES) {
            Vector<Lanes> theta = slopes.turn.vector(s);
            if (which == 0) theta -= contract<Effects>(units.row(end - 1), by.rate, s);
            if (which == 2) theta += contract<Effects>(units.row(end), by.rate, s);
            slopes.force.set(row, s, force_at<Effects>(j, path, by.force, s) + cross(theta, in_all_lanes(u)));
        }
    }
    copy(path.u, out.u_path, count, LANES);
    copy(path.q, out.q_path, 4, out.q_path.columns);
}

/// The same, with effects where there are any.
inline void linear_increments(
    Span span, const Samples &signal, const Coefficients &centre, const CoefficientSlopes &by, const Increments &out,
    const IncrementSlopes &slopes, Workspace &memory
) {
    if (signal.rates.rows == RATES && signal.forces.rows == 3) {
        linear_increments<false>(span, signal, centre, by, out, slopes, memory);
    } else {
        linear_increments<true>(span, signal, centre, by, out, slopes, memory);
    }
}

}  // namespace
