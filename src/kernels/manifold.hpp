/// Small changes of a state made of vectors and rotations, and the way back.
#pragma once

#include "arrays.hpp"
#include "workspace.hpp"

namespace {

/// Columns of a table of parts: first degree of freedom, how many, first stored number, whether a rotation. Rotations
/// are stored as quaternions and changed on their right.
enum { DEGREE, DEGREES, STORED, ROTATION };

/// How many stored numbers a table of parts has.
inline Index stored_of(IndexTable parts) {
    const Index last = parts.rows - 1;
    return parts(last, STORED) + (parts(last, ROTATION) ? 4 : parts(last, DEGREES)) - parts(0, STORED);
}

/// How many degrees of freedom a table of parts has.
inline Index degrees_of(IndexTable parts) {
    const Index last = parts.rows - 1;
    return parts(last, DEGREE) + parts(last, DEGREES) - parts(0, DEGREE);
}

/// The degree of freedom of a stored number that is not part of a rotation.
inline Index degree_of(IndexTable parts, Index stored) {
    Index i = parts.rows - 1;
    while (parts(i, STORED) > stored) i--;
    return parts(i, DEGREE) + stored - parts(i, STORED);
}

/// Where a degree of freedom that is not one of a rotation is stored.
inline Index stored_at(IndexTable parts, Index degree) {
    Index i = parts.rows - 1;
    while (parts(i, DEGREE) > degree) i--;
    return parts(i, STORED) + degree - parts(i, DEGREE);
}

/// Whether all columns of rows (3, m) are shorter than a bound.
inline bool all_below(Columns rows, double bound) {
    Lanes beyond = 0.0;
    for (Index s = 0; s < rows.columns; s += LANES) {
        const Vector<Lanes> v = rows.vector(s);
        const Lanes square = dot(v, v);
        for (Index i = 0; i < LANES; i++) beyond.four[i] = square[i] < bound * bound ? beyond[i] : 1.0;
    }
    return sum(beyond) == 0.0;
}

/// Turn every column of q (4, m) on its right by exp(theta), theta (3, m) of any length.
inline void turn_each(Columns q, Columns theta) {
    if (!all_below(theta, 1.0)) {
        for (Index s = 0; s < theta.columns; s++) q.set_at(s, q.quaternion_at(s) * rotation(theta.vector_at(s)));
        return;
    }
    for (Index s = 0; s < theta.columns; s += LANES) q.set(s, q.quaternion(s) * small_rotation(theta.vector(s)));
}

/// Write q exp(theta) for columns theta (3, m) of any length; out (4, m).
inline void turn_by(Quaternion<double> q, Columns theta, Columns out) {
    for (Index s = 0; s < out.columns; s++) out.set_at(s, q);
    turn_each(out, theta);
}

/// Write log(origin^-1 q) for columns q (4, m), at most pi long; out (3, m).
inline void turn_between(Quaternion<double> origin, Columns q, Columns out) {
    const Quaternion<double> back = conjugate(origin);
    const Quaternion<Lanes> all = {back.w, back.x, back.y, back.z};
    bool small = true;
    for (Index s = 0; s < q.columns; s += LANES) {
        const Quaternion<Lanes> turn = all * q.quaternion(s);
        const Vector<Lanes> v = turn.imaginary();
        const Lanes h = dot(v, v);
        // the series of arcsine, whose next term is below 2e-16 where |v| < 0.1
        const Lanes far = 35.0 / 576.0 + h * (63.0 / 1408.0 + h * (231.0 / 6656.0 + h * (143.0 / 5120.0)));
        Lanes k = 2.0 + h * (1.0 / 3.0 + h * (3.0 / 20.0 + h * (5.0 / 56.0 + h * far)));
        for (Index i = 0; i < LANES; i++) {
            k.four[i] = turn.w[i] < 0.0 ? -k[i] : k[i];
            small = small && h[i] < 0.01;
        }
        out.set(s, k * v);
    }
    if (small) return;
    for (Index s = 0; s < q.columns; s++) {
        const Vector<double> v = rotation_vector(back * q.quaternion_at(s));
        out(0, s) = v.x, out(1, s) = v.y, out(2, s) = v.z;
    }
}

/// Write the states (size, m) that lie changes (degrees, m) away from the state x.
inline void plus(IndexTable parts, const double *x, Columns change, Columns out, Workspace &memory) {
    for (Index i = 0; i < parts.rows; i++) {
        const Index d = parts(i, DEGREE), at = parts(i, STORED);
        if (!parts(i, ROTATION)) {
            for (Index j = 0; j < parts(i, DEGREES); j++) {
                for (Index s = 0; s < out.columns; s += LANES) {
                    store(Lanes(x[at + j]) + load(change.row(d + j) + s), out.row(at + j) + s);
                }
            }
            continue;
        }
        Columns theta = change.rows_from(d, 3);
        if (parts(i, DEGREES) < 3) {
            theta = memory.zeros(3, change.columns);
            copy(change.rows_from(d, parts(i, DEGREES)), theta, parts(i, DEGREES), change.columns);
        }
        turn_by(quaternion_from(x + at), theta, out.rows_from(at, 4));
    }
}

/// Write the changes (degrees, m) that lead from the state x to states (size, m).
inline void minus(IndexTable parts, Columns states, const double *x, Columns out, Workspace &memory) {
    for (Index i = 0; i < parts.rows; i++) {
        const Index d = parts(i, DEGREE), at = parts(i, STORED);
        if (!parts(i, ROTATION)) {
            for (Index j = 0; j < parts(i, DEGREES); j++) {
                for (Index s = 0; s < out.columns; s += LANES) {
                    store(load(states.row(at + j) + s) - Lanes(x[at + j]), out.row(d + j) + s);
                }
            }
            continue;
        }
        const Columns theta = memory.columns(3, states.columns);
        turn_between(quaternion_from(x + at), states.rows_from(at, 4), theta);
        copy(theta, out.rows_from(d, parts(i, DEGREES)), parts(i, DEGREES), states.columns);
    }
}

}  // namespace
