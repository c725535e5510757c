/// Sensor parameters as factors of a few features of the readings, for many parameter sets side by side.
///
/// Features of the readings:
///
/// - of the rate: 1, the three rates, and the features of the gyros' effects; `rate` holds what they are multiplied by in
///   equation (1);
/// - of the specific force: the products of two of the first four (f <= g), the slopes of the rates, the accelerometers'
///   readings, and the features of their effects; `force` likewise for equation (2).
///
/// Row 3 f + i of a table of coefficients is what feature f is multiplied by in component i. The effects' features are
/// computed by Python (`inertial.effects`), which has corrected the readings by their values so far: what they still
/// change enters the lever arms' products in second order only, and is left out there.
#pragma once

#include "arrays.hpp"

namespace {

constexpr Index RATES = 4;                          ///< 1 and the three rates
constexpr Index SLOPES = RATES * (RATES + 1) / 2;   ///< place of the slopes among the features of the force
constexpr Index FORCES = SLOPES + RATES - 1;        ///< place of the accelerometers' readings
constexpr Index FEATURES = FORCES + 3;              ///< of the force, without effects

/// Numbers of features: known to the compiler without effects, else taken from the arrays.
template <bool Effects>
struct Features {
    Index P, Q;  // of the rate, and padded

    explicit Features(Index rates) : P(Effects ? rates : RATES), Q(padded(P)) {}
};

inline Matrix<Lanes> matrix(Columns rows, Index first, Index s) {
    return {{rows.vector(first, s), rows.vector(first + 3, s), rows.vector(first + 6, s)}};
}

/// Column `axis` of a matrix: what the reading of one axis adds to all three components.
inline Vector<Lanes> column(const Matrix<Lanes> &A, Index axis) {
    if (axis == 0) return {A.row[0].x, A.row[1].x, A.row[2].x};
    if (axis == 1) return {A.row[0].y, A.row[1].y, A.row[2].y};
    return {A.row[0].z, A.row[1].z, A.row[2].z};
}

/// Write what equation (1) multiplies the features by, (3 P, m), from K_omega (9, m) and k_w0 (3, m).
///
/// effects (3 E, m): what feature e of the effects adds to the reading of each axis.
inline void rate_coefficients(Columns K_omega, Columns k_w0, Columns effects, Columns out) {
    for (Index s = 0; s < out.columns; s += LANES) {
        const Matrix<Lanes> K = matrix(K_omega, 0, s);
        out.set(0, s, K * k_w0.vector(0, s));
        for (Index axis = 0; axis < 3; axis++) out.set(3 + 3 * axis, s, column(K, axis));
        for (Index row = 0; row < effects.rows; row += 3) out.set(3 * RATES + row, s, K * effects.vector(row, s));
    }
}

/// The matrix F with (K_a e)_row = sum_ij F_ij ([alpha x] + [omega x]^2)_ij: equation (3).
inline Matrix<Lanes> size_effect_field(
    Index row, const Matrix<Lanes> &K_a, const Matrix<Lanes> &axes, const Matrix<Lanes> &arms, bool printed
) {
    if (printed) {
        Matrix<Lanes> field = {{{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}}};
        field.row[row] = arms.row[row];
        return field;
    }
    const Vector<Lanes> k = K_a.row[row];
    Matrix<Lanes> field;
    for (Index i = 0; i < 3; i++) {
        const Vector<Lanes> along = column(axes, i);
        field.row[i] = k.x * along.x * arms.row[0] + k.y * along.y * arms.row[1] + k.z * along.z * arms.row[2];
    }
    return field;
}

/// Write what equation (2) multiplies the features by, (3 features, m).
///
/// rate (3 P, m), or its first column for all where it is `common`; K_a and arms (9, m), k_a0 (3, m); effects (3 E, m):
/// see `rate_coefficients`. printed: as the paper prints equation (2), without products of two rates and with e outside the
/// parentheses.
inline void force_coefficients(
    Columns rate, bool common, Columns K_a, Columns k_a0, Columns arms, Columns effects, bool printed, Columns out
) {
    for (Index s = 0; s < out.columns; s += LANES) {
        const Matrix<Lanes> K = matrix(K_a, 0, s), e = matrix(arms, 0, s);
        const Matrix<Lanes> axes = printed ? K : inverse(K);
        const auto W = [&](Index f) {
            return common ? in_all_lanes(rate.rows_from(3 * f, 3).vector_at(0)) : rate.vector(3 * f, s);
        };
        for (Index row = 0; row < 3; row++) {
            const Matrix<Lanes> F = size_effect_field(row, K, axes, e, printed);
            const Lanes xx = F.row[0].x, yy = F.row[1].y, zz = F.row[2].z, half = printed ? 0.0 : -0.5;
            const Lanes xy = half * (F.row[0].y + F.row[1].x), xz = half * (F.row[0].z + F.row[2].x);
            const Lanes yz = half * (F.row[1].z + F.row[2].y);
            const Matrix<Lanes> symmetric = {{{yy + zz, xy, xz}, {xy, xx + zz, yz}, {xz, yz, xx + yy}}};
            const Vector<Lanes> skew = {F.row[1].z - F.row[2].y, F.row[2].x - F.row[0].z, F.row[0].y - F.row[1].x};
            Index at = 0;
            for (Index f = 0; f < RATES; f++) {
                const Vector<Lanes> x = symmetric * W(f);
                for (Index g = f; g < RATES; g++, at++) {
                    const Lanes once = dot(x, W(g));
                    store(f == g ? once : once + once, out.row(3 * at + row) + s);
                }
                if (f > 0) store(dot(skew, W(f)), out.row(3 * (SLOPES + f - 1) + row) + s);
            }
            double *constant = out.row(row) + s;
            store(load(constant) + dot(K.row[row], k_a0.vector(0, s)), constant);
        }
        for (Index axis = 0; axis < 3; axis++) out.set(3 * (FORCES + axis), s, column(K, axis));
        for (Index row = 0; row < effects.rows; row += 3) out.set(3 * FEATURES + row, s, K * effects.vector(row, s));
    }
}

}  // namespace
