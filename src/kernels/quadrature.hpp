/// Integrals and derivatives of sampled signals at arbitrary stamps, by local quintic and quartic polynomials.
#pragma once

#include "samples.hpp"

namespace {

/// Write for every sampling interval [t_k, t_k+1] the weights of its two integrals, (n - 1, 6) each.
///
/// sum_i single[k, i] u[base[k] + i] is the integral of u over the interval and sum_i twice[k, i] u[base[k] + i] that of
/// (t_k+1 - t) u, for u the quintic through the six samples from base[k] on.
inline void interval_weights(Numbers stamps, Indices base, Table single, Table twice) {
    for (Index k = 0; k < stamps.count - 1; k++) {
        const double h = stamps[k + 1] - stamps[k];
        double x[STENCIL];
        for (Index i = 0; i < STENCIL; i++) x[i] = (stamps[base[k] + i] - stamps[k]) / h;
        for (Index i = 0; i < STENCIL; i++) {
            // coefficients of the polynomial that is 1 at x_i and 0 at the other nodes
            double c[STENCIL] = {1.0, 0.0, 0.0, 0.0, 0.0, 0.0};
            Index degree = 0;
            for (Index m = 0; m < STENCIL; m++) {
                if (m == i) continue;
                const double scale = 1.0 / (x[i] - x[m]);
                degree++;
                for (Index j = degree; j >= 0; j--) c[j] = ((j > 0 ? c[j - 1] : 0.0) - x[m] * c[j]) * scale;
            }
            double once = 0.0, again = 0.0;
            for (Index j = 0; j < STENCIL; j++) {
                once += c[j] / static_cast<double>(j + 1);
                again += c[j] / static_cast<double>((j + 1) * (j + 2));
            }
            single(k, i) = h * once;
            twice(k, i) = h * h * again;
        }
    }
}

/// Write the integral of every row of values (c, n) over every sampling interval, (c, n - 1).
inline void integrate_intervals(Indices base, Table single, Table values, Table out) {
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
inline void differentiate(Numbers stamps, Indices first, Table values, Table out) {
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
/// Moments lie a share (m,) of the interval behind the samples `before` (m,), in ascending order. Values are taken as
/// linear between samples, and so is what is written.
inline void double_integral(Numbers stamps, Table values, Indices before, Numbers share, Table out) {
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

/// Write the attitudes q (n, 4) that start at the first and turn with the rate, coning included.
///
/// rates (P, n), integrals (P, n - 1): see `Samples`; coefficients (P, 3): see coefficients.hpp.
inline void integrate_attitude(Numbers stamps, Table rates, Table integrals, Table coefficients, Table q) {
    const auto rate = [&](Table features, Index k) {
        Vector<double> out = {0.0, 0.0, 0.0};
        for (Index f = 0; f < features.rows; f++) out += features(f, k) * vector_from(coefficients.row(f));
        return out;
    };
    Quaternion<double> now = quaternion_from(q.row(0));
    Vector<double> omega = rate(rates, 0);
    for (Index k = 1; k < stamps.count; k++) {
        const double dt = stamps[k] - stamps[k - 1];
        const Vector<double> ahead = rate(rates, k);
        now = now * small_rotation(rate(integrals, k - 1) + (dt * dt / 12.0) * cross(omega, ahead));
        omega = ahead;
        q(k, 0) = now.w, q(k, 1) = now.x, q(k, 2) = now.y, q(k, 3) = now.z;
    }
}

}  // namespace
