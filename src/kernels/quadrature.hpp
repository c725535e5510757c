/// Integrals, derivatives and values of sampled signals at arbitrary stamps, by local polynomials.
#pragma once

#include "samples.hpp"

namespace {

/// Integrals from 0 to 1 of the polynomials through six nodes x that are 1 at one of them and 0 at the others: once, and
/// times 1 - t.
template <class T>
inline void cardinal_integrals(const T *x, T *once, T *again) {
    for (Index i = 0; i < STENCIL; i++) {
        T c[STENCIL] = {1.0, 0.0, 0.0, 0.0, 0.0, 0.0}, scale = 1.0;
        Index degree = 0;
        for (Index m = 0; m < STENCIL; m++) {
            if (m == i) continue;
            scale *= x[i] - x[m];
            degree++;
            for (Index j = degree; j > 0; j--) c[j] = c[j - 1] - x[m] * c[j];
            c[0] = -x[m] * c[0];
        }
        scale = 1.0 / scale;
        once[i] = again[i] = 0.0;
        for (Index j = 0; j < STENCIL; j++) {
            once[i] += c[j] * T(1.0 / static_cast<double>(j + 1));
            again[i] += c[j] * T(1.0 / static_cast<double>((j + 1) * (j + 2)));
        }
        once[i] *= scale;
        again[i] *= scale;
    }
}

/// Write for every sampling interval [t_k, t_k+1] the weights of its two integrals, (n - 1, 6) each.
///
/// sum_i single[k, i] u[base[k] + i] is the integral of u over the interval and sum_i twice[k, i] u[base[k] + i] that of
/// (t_k+1 - t) u, for u the quintic through the six samples from base[k] on.
inline void interval_weights(ConstNumbers stamps, Indices base, Table single, Table twice) {
    const Index intervals = stamps.count - 1;
    for (Index k = 0; k < intervals; k += LANES) {
        Lanes h, x[STENCIL], once[STENCIL], again[STENCIL];
        const auto interval = [&](Index lane) { return k + lane < intervals ? k + lane : intervals - 1; };
        for (Index lane = 0; lane < LANES; lane++) {
            const Index at = interval(lane);
            h.four[lane] = stamps[at + 1] - stamps[at];
            for (Index i = 0; i < STENCIL; i++) x[i].four[lane] = stamps[base[at] + i] - stamps[at];
        }
        for (Lanes &node : x) node = node / h;
        cardinal_integrals(x, once, again);
        for (Index lane = 0; lane < LANES; lane++) {
            const Index at = interval(lane);
            for (Index i = 0; i < STENCIL; i++) {
                single(at, i) = h[lane] * once[i][lane];
                twice(at, i) = h[lane] * h[lane] * again[i][lane];
            }
        }
    }
}

/// Write the integral of every row of values (c, n) over every sampling interval, (c, n - 1).
inline void integrate_intervals(Indices base, ConstTable single, ConstTable values, Table out) {
    for (Index row = 0; row < values.rows; row++) {
        for (Index k = 0; k < base.count; k++) {
            double total = 0.0;
            for (Index i = 0; i < STENCIL; i++) total += single(k, i) * values(row, base[k] + i);
            out(row, k) = total;
        }
    }
}

/// Write the derivative, (n, 3), of every column of values (n, 3): of the quartic through the five samples from first[k]
/// on.
inline void differentiate(ConstNumbers stamps, Indices first, ConstTable values, Table out) {
    for (Index k = 0; k < stamps.count; k++) {
        const Index centre = k - first[k];
        const double *t = stamps.data + first[k];
        double weight[5];
        weight[centre] = 0.0;
        for (Index i = 0; i < 5; i++) {
            if (i == centre) continue;
            double numerator = 1.0, denominator = t[i] - stamps[k];
            for (Index m = 0; m < 5; m++) {
                if (m == i || m == centre) continue;
                numerator *= stamps[k] - t[m];
                denominator *= t[i] - t[m];
            }
            weight[i] = numerator / denominator;
            weight[centre] -= weight[i];
        }
        for (Index axis = 0; axis < 3; axis++) {
            double total = 0.0;
            for (Index i = 0; i < 5; i++) total += weight[i] * values(first[k] + i, axis);
            out(k, axis) = total;
        }
    }
}

/// Write the double integral (m, k) of values (n, k) from the first stamp to chosen moments.
///
/// Moments lie a share (m,) of the interval after the samples `before` (m,), in ascending order. Values are taken as
/// linear between samples, and so is what is written.
inline void double_integral(ConstNumbers stamps, ConstTable values, Indices before, ConstNumbers share, Table out) {
    for (Index axis = 0; axis < values.columns; axis++) {
        double once = 0.0, twice = 0.0;
        Index at = 0;
        for (Index k = 0; k < stamps.count - 1; k++) {
            const double dt = stamps[k + 1] - stamps[k];
            const double once_next = once + 0.5 * dt * (values(k, axis) + values(k + 1, axis));
            const double twice_next = twice + 0.5 * dt * (once + once_next);
            for (; at < before.count && before[at] == k; at++) out(at, axis) = twice + share[at] * (twice_next - twice);
            once = once_next;
            twice = twice_next;
        }
    }
}

/// Write the value of every column of values (n, c) at ascending moments (m,) by the cubic through the four samples around
/// each, (m, c), and the place of the sample after it, (m,): the second to the last.
inline void interpolate(ConstNumbers stamps, ConstTable values, ConstNumbers moments, WrittenIndices after, Table out) {
    constexpr Index NODES = 4;
    const Index n = stamps.count;
    Index next = 1;
    for (Index i = 0; i < moments.count; i++) {
        while (next < n - 1 && stamps[next] <= moments[i]) next++;
        after[i] = next;
        const Index first = next < 2 ? 0 : next > n - 2 ? n - NODES : next - 2;
        double x[NODES];
        for (Index k = 0; k < NODES; k++) x[k] = stamps[first + k] - moments[i];
        for (Index c = 0; c < values.columns; c++) out(i, c) = 0.0;
        for (Index k = 0; k < NODES; k++) {
            double above = 1.0, below = 1.0;
            for (Index j = 0; j < NODES; j++) {
                if (j == k) continue;
                above *= x[j];
                below *= x[j] - x[k];
            }
            const double weight = above / below;  // Lagrange's
            for (Index c = 0; c < values.columns; c++) out(i, c) += weight * values(first + k, c);
        }
    }
}

/// Write the attitudes q (n, 4) that start at the first and turn with the rate, coning included.
///
/// rates (P, n), integrals (P, n - 1): see `Samples`; coefficients (P, 3): see coefficients.hpp. A step of more than one
/// radian lies over a gap, where the rates are not known: it is shortened, so that the quaternion stays one of a rotation.
inline void integrate_attitude(ConstNumbers stamps, ConstTable rates, ConstTable integrals, ConstTable coefficients, Table q) {
    const Index n = stamps.count;
    const auto rate = [&](ConstTable features, Index k) {
        Vector<Lanes> out = {0.0, 0.0, 0.0};
        for (Index f = 0; f < features.rows; f++) {
            out += load(features.row(f) + k, features.columns - k) * in_all_lanes(vector_from(coefficients.row(f)));
        }
        return out;
    };
    const Quaternion<double> begin = quaternion_from(q.row(0));
    Quaternion<Lanes> now = {begin.w, begin.x, begin.y, begin.z};
    for (Index k = 0; k < n - 1; k += LANES) {
        const Lanes dt = load(stamps.data + k + 1, n - 1 - k) - load(stamps.data + k, n - 1 - k);
        const Vector<Lanes> coning = (dt * dt * (1.0 / 12.0)) * cross(rate(rates, k), rate(rates, k + 1));
        Vector<Lanes> theta = rate(integrals, k) + coning;
        theta = (1.0 / larger(1.0, dot(theta, theta))) * theta;
        now = products_from(now, small_rotation(theta));
        if (k + LANES < n) {
            store_transposed(now.w, now.x, now.y, now.z, q.row(k + 1), 4);
        } else {
            for (Index i = 0; i < n - 1 - k; i++) {
                q(k + 1 + i, 0) = now.w[i], q(k + 1 + i, 1) = now.x[i], q(k + 1 + i, 2) = now.y[i], q(k + 1 + i, 3) = now.z[i];
            }
        }
        now = last_lane(now);
    }
}

}  // namespace
