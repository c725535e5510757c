/// The path that all parameter sets share: attitude, specific force and its features at every sample.
#pragma once

#include "coefficients.hpp"
#include "samples.hpp"
#include "workspace.hpp"

namespace {

/// What all sets share along the c samples of a span.
struct Path {
    Columns weights;   // (2, c): of the samples in the integral of velocity and of position
    Columns q, C, u;   // (4, c), (9, c), (3, c): attitude, direction cosines, specific force of the centre
    Table psi;         // (c, features): features of the specific force
};

/// Columns of a signal from sample `low` on, padded with zeros: (rows, c).
inline Columns samples_from(Table signal, Index low, Index count, Workspace &memory) {
    const Columns out = memory.columns(signal.rows, count);
    for (Index f = 0; f < signal.rows; f++) {
        for (Index k = 0; k < out.columns; k += LANES) store(load(signal.row(f) + low + k, count - k), out.row(f) + k);
    }
    return out;
}

/// Write the weights (2, c) of the samples in the integrals of velocity and position.
inline void outer_weights(Span span, const Samples &signal, Columns weights) {
    fill(weights, 0.0);
    double *velocity = weights.row(0), *position = weights.row(1);
    for (Index k = span.first; k < span.last; k++) {
        const double rest = signal.stamps[span.last] - signal.stamps[k + 1];
        const double *once = signal.single.row(k), *twice = signal.twice.row(k);
        const Index at = signal.base[k] - span.low;
        for (Index i = 0; i < STENCIL; i++) {
            velocity[at + i] += once[i];
            position[at + i] += twice[i] + rest * once[i];
        }
    }
}

/// The sum of the features (P, c) of samples s to s + 3, each times the first column of its coefficients (3 P, m).
inline Vector<Lanes> weighted(Columns coefficients, Columns features, Index s) {
    Vector<Lanes> out = {0.0, 0.0, 0.0};
    for (Index f = 0; f < features.rows; f++) {
        const Lanes feature = load(features.row(f) + s);
        out += feature * in_all_lanes(coefficients.rows_from(3 * f, 3).vector_at(0));
    }
    return out;
}

/// The rotation vector over a sampling interval h, to the sixth order in its length.
///
/// `step` is the integrated rate; what its axis' motion within the interval adds follows from rate and angular
/// acceleration at both ends. The leading term is the coning correction h^2/12 omega_k x omega_k+1. Magnus' series as
/// given by Blanes, Casas and Ros (2000), equation (4.12) there with the sign of a rotation composed on its right.
template <class T>
inline Vector<T> rotation_step(Vector<T> step, Vector<T> omega, Vector<T> next, Vector<T> alpha, Vector<T> alpha_next, T h) {
    // moments of the rate about the middle, to the orders the series needs
    const Vector<T> c = (0.5 * h * h) * (alpha_next - alpha);
    const Vector<T> b = h * (T(1.2) * (next - omega) - (0.1 * h) * (alpha + alpha_next));
    const Vector<T> a = step - T(1.0 / 12.0) * c;
    const Vector<T> ab = cross(a, b);
    const Vector<T> u = T(20.0) * a + c + ab;
    const Vector<T> v = b - T(1.0 / 60.0) * cross(a, ab - T(2.0) * c);
    return step + T(1.0 / 240.0) * cross(u, v);
}

/// Write the attitude (4, c) of the first column of `rate` at the samples of a span, seen from the span's first.
inline void centre_attitude(Span span, const Samples &signal, Columns rate, Columns q, Workspace &memory) {
    const Index count = span.count(), start = span.first - span.low;
    const Columns values = samples_from(signal.rates, span.low, count, memory);
    const Columns slopes = samples_from(signal.slopes, span.low, count, memory);
    const Columns integrals = samples_from(signal.integrals, span.low, count - 1, memory);
    const Columns omega = memory.columns(3, count + LANES), alpha = memory.columns(3, count + LANES);
    const Columns turns = memory.columns(4, count);
    for (Index k = 0; k < values.columns; k += LANES) {
        omega.set(k, weighted(rate, values, k));
        alpha.set(k, weighted(rate, slopes, k));
    }
    for (Index k = 0; k < integrals.columns; k += LANES) {
        const double *stamps = signal.stamps.data + span.low + k;
        const Lanes h = load(stamps + 1, count - 1 - k) - load(stamps, count - 1 - k);
        const Vector<Lanes> step = weighted(rate, integrals, k);
        turns.set(k, small_rotation(rotation_step(
            step, omega.vector(k), omega.vector(k + 1), alpha.vector(k), alpha.vector(k + 1), h)));
    }
    Quaternion<double> now = {1.0, 0.0, 0.0, 0.0};
    q.set_at(start, now);
    for (Index j = start; j < count - 1; j++) {
        now = now * turns.quaternion_at(j);
        q.set_at(j + 1, now);
    }
    now = {1.0, 0.0, 0.0, 0.0};
    for (Index j = start - 1; j >= 0; j--) {
        now = now * conjugate(turns.quaternion_at(j));
        q.set_at(j, now);
    }
    for (Index j = count; j < q.columns; j++) q.set_at(j, {1.0, 0.0, 0.0, 0.0});
}

/// Write the four lanes of a feature into column f of the rows from j on, as many as there are.
inline void set_feature(Lanes value, Table psi, Index j, Index f) {
    for (Index i = 0; i < LANES; i++) psi(j + i, f) = value[i];
}

/// Write the features of the specific force (c, features), and the force of the first column turned by C, (3, c).
inline void force_along(Span span, const Samples &signal, Columns force, const Path &path, Workspace &memory) {
    const Columns values = samples_from(signal.rates, span.low, span.count(), memory);
    const Columns slopes = samples_from(signal.slopes, span.low, span.count(), memory);
    const Columns readings = samples_from(signal.forces, span.low, span.count(), memory);
    const Index P = values.rows;
    for (Index k = 0; k < path.u.columns; k += LANES) {
        Vector<Lanes> u = {0.0, 0.0, 0.0};
        Index at = 0;
        const auto take = [&](Lanes feature) {
            u += feature * in_all_lanes(force.rows_from(3 * at, 3).vector_at(0));
            set_feature(feature, path.psi, k, at++);
        };
        for (Index f = 0; f < P; f++) {
            const Lanes rate = load(values.row(f) + k);
            for (Index g = f; g < P; g++) take(rate * load(values.row(g) + k));
        }
        for (Index f = 1; f < P; f++) take(load(slopes.row(f) + k));
        for (Index f = 0; f < readings.rows; f++) take(load(readings.row(f) + k));
        path.u.set(k, matrix(path.C, 0, k) * u);
    }
}

/// The path of the first parameter set.
inline Path centre_path(Span span, const Samples &signal, const Coefficients &coefficients, Workspace &memory) {
    const Index count = span.count(), features = coefficients.force.rows / 3;
    Path path = {
        memory.columns(2, count + 1), memory.columns(4, count), memory.columns(9, count), memory.columns(3, count),
        {memory.numbers(padded(count) * padded(features)), padded(count), padded(features)},
    };
    fill(path.psi, 0.0);
    outer_weights(span, signal, path.weights);
    centre_attitude(span, signal, coefficients.rate, path.q, memory);
    for (Index k = 0; k < path.q.columns; k += LANES) {
        const Matrix<Lanes> C = direction_cosines(path.q.quaternion(k));
        for (Index i = 0; i < 3; i++) path.C.set(3 * i, k, C.row[i]);
    }
    force_along(span, signal, coefficients.force, path, memory);
    return path;
}

}  // namespace
