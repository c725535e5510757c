/// The path that all parameter sets share: attitude, specific force and its features at every sample.
#pragma once

#include "coefficients.hpp"
#include "samples.hpp"
#include "workspace.hpp"

namespace {

/// What all sets share along the c samples of a span.
struct Path {
    Columns weights;   // (2, c): of the samples in the integral of velocity and of position
    Columns weighted;  // (18, c): direction cosines times the weights, a pair for each
    Columns q, C;      // (4, c), (9, c): attitude of the centre and its direction cosines
    Table u;           // (c, 4): specific force of the centre, and nothing
    Table psi;         // (c, features): features of the specific force
};

/// A row of a signal from a sample on: beyond the signal's end it is zero.
struct From {
    const double *data;
    Index left;

    From(const double *row, Index begin, Index end) : data(row + begin), left(end - begin) {}
    Lanes operator[](Index s) const { return load(data + s, left - s); }
};

/// Six sums that belong to six neighbouring samples, and move along them.
struct Window {
    Lanes first = 0.0, rest = 0.0;

    void add(Lanes four, Lanes two) {
        first += four;
        rest += two;
    }
    /// Give out the sum of the first sample, which no interval after reaches.
    double move_on() {
        const double out = first[0];
        first = down_by_one(first, rest);
        rest = down_by_one(rest, 0.0);
        return out;
    }
};

/// Write the weights (2, c) of the samples in the integrals of velocity and position.
inline void outer_weights(Span span, const Samples &signal, Columns weights) {
    fill(weights, 0.0);
    if (span.first == span.last) return;
    Window velocity, position;
    Index at = signal.base[span.first] - span.low;
    const auto move_on = [&] {
        weights(0, at) += velocity.move_on();
        weights(1, at) += position.move_on();
        at++;
    };
    for (Index k = span.first; k < span.last; k++) {
        while (at < signal.base[k] - span.low) move_on();
        const Lanes rest = signal.stamps[span.last] - signal.stamps[k + 1];
        const double *once = signal.single.row(k), *twice = signal.twice.row(k);
        const Lanes four = load(once), two = load(once + LANES, STENCIL - LANES);
        velocity.add(four, two);
        position.add(load(twice) + rest * four, load(twice + LANES, STENCIL - LANES) + rest * two);
    }
    for (Index i = 0; i < STENCIL; i++) move_on();
}

/// The sum of the features (P, n) of samples s to s + 3, each times the first column of its coefficients (3 P, m).
template <bool Effects>
inline Vector<Lanes> weighted(Columns coefficients, ConstTable features, Index s) {
    Vector<Lanes> out = {0.0, 0.0, 0.0};
    for (Index f = 0; f < (Effects ? features.rows : RATES); f++) {
        const Lanes feature = From(features.row(f), s, features.columns)[0];
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
template <bool Effects>
inline void centre_attitude(Span span, const Samples &signal, Columns rate, Columns q, Workspace &memory) {
    const Index count = span.count(), start = span.first - span.low;
    const Columns omega = memory.columns(3, count + LANES), alpha = memory.columns(3, count + LANES);
    const Columns turns = memory.columns(4, count + LANES);
    for (Index k = 0; k < count; k += LANES) {
        omega.set(k, weighted<Effects>(rate, signal.rates, span.low + k));
        alpha.set(k, weighted<false>(rate, signal.slopes, span.low + k));
    }
    const From stamps(signal.stamps.data, span.low, signal.stamps.count), next(signal.stamps.data, span.low + 1, signal.stamps.count);
    for (Index k = 0; k < count - 1; k += LANES) {
        const Vector<Lanes> step = weighted<Effects>(rate, signal.integrals, span.low + k);
        turns.set(k, small_rotation(rotation_step(
            step, omega.vector(k), omega.vector(k + 1), alpha.vector(k), alpha.vector(k + 1), next[k] - stamps[k])));
    }
    q.set_at(start, {1.0, 0.0, 0.0, 0.0});
    Quaternion<Lanes> last = {1.0, 0.0, 0.0, 0.0};
    for (Index j = start; j < count - 1; j += LANES) {
        const Quaternion<Lanes> along = products_from(last, turns.quaternion(j));
        q.set(j + 1, along);
        last = last_lane(along);
    }
    Quaternion<double> now = {1.0, 0.0, 0.0, 0.0};
    for (Index j = start - 1; j >= 0; j--) {
        now = now * conjugate(turns.quaternion_at(j));
        q.set_at(j, now);
    }
    for (Index j = count; j < q.columns; j++) q.set_at(j, {1.0, 0.0, 0.0, 0.0});
}

/// Write rows (features, 4 samples) into the rows of a table (samples, features) from a sample on, padded with zeros.
inline void set_features(const Lanes *features, Index count, Table out, Index sample) {
    const Lanes none = 0.0;
    for (Index f = 0; f < count; f += LANES) {
        const auto at = [&](Index i) { return f + i < count ? features[f + i] : none; };
        store_transposed(at(0), at(1), at(2), at(3), out.row(sample) + f, out.columns);
    }
}

constexpr Index MAX_FEATURES = 128;  ///< of the force or the rate, with those of all effects

/// Write the features of the specific force (c, features), and the force of the first column turned by C, (c, 4).
template <bool Effects>
inline void force_along(Span span, const Samples &signal, Columns force, const Path &path) {
    const Index readings = Effects ? signal.forces.rows : 3;
    const Index count = span.count(), n = signal.stamps.count;
    if (force.rows > 3 * MAX_FEATURES) throw Mismatch();
    for (Index k = 0; k < count; k += LANES) {
        const auto samples = [&](ConstTable rows, Index f) { return From(rows.row(f), span.low + k, n)[0]; };
        // in the order of `force_coefficients`
        Lanes features[MAX_FEATURES];
        Index at = 0;
        for (Index f = 0; f < RATES; f++) {
            const Lanes rate = samples(signal.rates, f);
            for (Index g = f; g < RATES; g++) features[at++] = rate * samples(signal.rates, g);
        }
        for (Index f = 1; f < RATES; f++) features[at++] = samples(signal.slopes, f);
        for (Index f = 0; f < readings; f++) features[at++] = samples(signal.forces, f);
        if (3 * at != force.rows) throw Mismatch();
        Vector<Lanes> u = {0.0, 0.0, 0.0};
        for (Index f = 0; f < at; f++) u += features[f] * in_all_lanes(force.rows_from(3 * f, 3).vector_at(0));
        u = matrix(path.C, 0, k) * u;
        set_features(features, at, path.psi, k);
        store_transposed(u.x, u.y, u.z, 0.0, path.u.row(k), path.u.columns);
    }
}

/// The path of the first parameter set.
template <bool Effects>
inline Path centre_path(Span span, const Samples &signal, const Coefficients &coefficients, Workspace &memory) {
    const Index count = span.count(), features = coefficients.force.rows / 3;
    const Path path = {
        memory.columns(2, count + 1), memory.columns(18, count), memory.columns(4, count + 2 * LANES), memory.columns(9, count + LANES),
        {memory.numbers(padded(count) * LANES), padded(count), LANES},
        {memory.numbers(padded(count) * padded(features)), padded(count), padded(features)},
    };
    outer_weights(span, signal, path.weights);
    centre_attitude<Effects>(span, signal, coefficients.rate, path.q, memory);
    for (Index k = 0; k < path.C.columns; k += LANES) {
        const Matrix<Lanes> C = direction_cosines(path.q.quaternion(k));
        for (Index i = 0; i < 3; i++) path.C.set(3 * i, k, C.row[i]);
    }
    for (Index i = 0; i < 18; i++) {
        for (Index k = 0; k < count; k += LANES) {
            store(load(path.weights.row(i % 2) + k) * load(path.C.row(i / 2) + k), path.weighted.row(i) + k);
        }
    }
    force_along<Effects>(span, signal, coefficients.force, path);
    return path;
}

}  // namespace
