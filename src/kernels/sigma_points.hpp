/// A step of the sigma-point Kalman filter: drawing points, putting them together again, using a measurement.
///
/// Nothing here knows what is filtered: the models of the cell stand in process_model.hpp and measurement_model.hpp.
/// Factors are kept transposed, because their rows are then the columns that are rotated.
#pragma once

#include <algorithm>

#include "manifold.hpp"
#include "triangular.hpp"

namespace {

/// Places of the figures of `estimation.sigma_points.SigmaWeights`.
ORDER(Weights, SPREAD, MEAN, SECOND, SHIFT, CENTRE);

/// Share of a deviation whose square is lost beside it in rounding.
constexpr double ROUNDING = 1e-9;

/// Sigma points of some neighbouring degrees of freedom: all in plus direction, then all in minus direction.
struct SigmaGroup {
    Index degree, degrees;  // the first and how many
    Index column;           // of the first point in plus direction

    Index plus(Index j) const { return column + j - degree; }
    Index minus(Index j) const { return column + degrees + j - degree; }
};

/// In which columns sigma points stand: the centre, then group by group.
///
/// Points of the first group are the only ones with gyro parameters of their own, those of the second have accelerometer
/// parameters of their own: what only these have is computed for the first columns alone.
struct SigmaOrder {
    SigmaGroup group[3];

    SigmaOrder(Index gyro, Index sensors, Index n)
        : group{{0, gyro, 1}, {gyro, sensors - gyro, 1 + 2 * gyro}, {sensors, n - sensors, 1 + 2 * sensors}} {}

    Index degrees() const { return group[2].degree + group[2].degrees; }
    Index points() const { return 1 + 2 * degrees(); }
};

/// Write the lower triangle of upper's transpose, times a factor: rows of the state, columns of directions.
inline void transpose_scaled(Table upper, double factor, Columns lower) {
    const Index n = upper.rows;
    fill(lower, 0.0);
    for (Index i = 0; i < n; i += LANES) {
        for (Index j = 0; j <= i; j += LANES) {
            Lanes row[LANES];
            for (Index x = 0; x < LANES; x++) {
                row[x] = j + x < n ? Lanes(factor) * load(upper.row(j + x) + i, n - i) : Lanes(0.0);
            }
            if (i + LANES <= n) {
                store_transposed(row[0], row[1], row[2], row[3], lower.row(i) + j, lower.columns);
                continue;
            }
            for (Index y = 0; i + y < n; y++) {
                for (Index x = 0; x < LANES; x++) lower(i + y, j + x) = row[x][y];
            }
        }
    }
}

/// Write the sigma points (size, 2 n + 1): equation (17). Only the rows of the given parts are written.
inline void sample(
    IndexTable parts, const SigmaOrder &order, const double *mean, Table upper, double spread, Columns points,
    Workspace &memory
) {
    const Columns change = memory.columns(upper.rows, upper.rows + LANES);
    transpose_scaled(upper, spread, change);
    // A row of the state: about `at`, changed by its row of `change` in plus and in minus direction.
    const auto set = [&](Index degree, double at, double *row) {
        row[0] = at;
        for (const SigmaGroup &group : order.group) {
            const double *by = change.row(degree) + group.degree;
            double *plus = row + group.column, *minus = plus + group.degrees;
            Index j = 0;
            for (; j + LANES <= group.degrees; j += LANES) {
                store(Lanes(at) + load(by + j), plus + j);
                store(Lanes(at) - load(by + j), minus + j);
            }
            for (; j < group.degrees; j++) {
                plus[j] = at + by[j];
                minus[j] = at - by[j];
            }
        }
        for (Index s = order.points(); s < points.columns; s++) row[s] = at;
    };
    for (Index k = 0; k < parts.rows; k++) {
        const Index d = parts(k, DEGREE), at = parts(k, STORED), degrees = parts(k, DEGREES);
        if (!parts(k, ROTATION)) {
            for (Index i = 0; i < degrees; i++) set(d + i, mean[at + i], points.row(at + i));
            continue;
        }
        const Columns theta = memory.zeros(3, points.columns);
        for (Index i = 0; i < degrees; i++) set(d + i, 0.0, theta.row(i));
        turn_by(quaternion_from(mean + at), theta, points.rows_from(at, 4));
    }
}

/// Moments of numbers of which sigma points are known.
struct Moments {
    Columns first;    // (r, n): columns of the covariance, one for each degree of freedom
    Table further;    // (r, at least n + 2): further columns
    Index used;       // of `further`: only those whose squares are not lost in rounding
    double *shift;    // (r,): mean, as distance from the centre
};

/// Write mean and columns of the covariance from distances of sigma points (r, 2 n + 1): equation (18).
inline void unscented_moments(
    Columns distance, const SigmaOrder &order, ConstNumbers w, Moments &out, Workspace &memory
) {
    const Index r = distance.rows, n = order.degrees();
    const Columns curved = memory.columns(r, n + LANES), excess = memory.zeros(1, n + LANES);
    const double halved = 1.0 / (2.0 * w[SPREAD]);
    for (Index i = 0; i < r; i++) {
        Lanes total = 0.0, square = 0.0;
        for (const SigmaGroup &group : order.group) {
            const double *plus = distance.row(i) + group.column, *minus = plus + group.degrees;
            for (Index j = 0; j < group.degrees; j += LANES) {
                const Lanes p = load(plus + j, group.degrees - j), m = load(minus + j, group.degrees - j);
                const Lanes slope = halved * (p - m), both = p + m;
                store(slope, out.first.row(i) + group.degree + j);
                store(both, curved.row(i) + group.degree + j);
                square += slope * slope;
                total += both;
            }
        }
        out.shift[i] = w[MEAN] * sum(total);
        const Lanes least = ROUNDING * std::sqrt(sum(square)), less = 2.0 * w[SHIFT] * out.shift[i];
        for (Index j = 0; j < n; j += LANES) {
            const Lanes bend = Lanes(w[SECOND]) * (load(curved.row(i) + j) - less);
            store(bend, curved.row(i) + j);
            store(larger(load(excess.row(0) + j), absolute(bend) - least), excess.row(0) + j);
        }
    }
    out.used = 0;
    for (Index j = 0; j < n && w[SECOND] > 0.0; j++) {
        if (excess(0, j) == 0.0) continue;
        for (Index i = 0; i < r; i++) out.further(i, out.used) = curved(i, j);
        out.used++;
    }
    if (w[CENTRE] > 0.0) {
        for (Index i = 0; i < r; i++) out.further(i, out.used) = w[CENTRE] * out.shift[i];
        out.used++;
    }
}

/// Write the standard deviations of the first degrees of freedom into out (k,), from upper (n, n).
inline void deviations(Table upper, Index k, double *out) {
    for (Index j = 0; j < k; j++) out[j] = 0.0;
    for (Index r = 0; r < k; r++) {
        const double *row = upper.row(r);
        for (Index j = r; j < k; j++) out[j] += row[j] * row[j];
    }
    for (Index j = 0; j < k; j++) out[j] = std::sqrt(out[j]);
}

/// Sigma points carried to an update, and the measurements they predict.
struct Predicted {
    Columns points;        // (size, 2 n + 1): at the update; of these the rows of what has moved are used
    Table noise;           // (c, k): columns of noise of the degrees of freedom that have moved
    Columns prediction;          // (m, 2 n + 1): predictions of the points, as distances from the centre's
    Columns prediction_noise;    // (m, 2 k): of the centre with noise put in, plus and minus
};

/// Write numbers (m,) divided by the transpose of a lower triangular factor (m, m).
inline void divide_transposed(Table factor, const double *numbers, double *out) {
    for (Index r = factor.rows - 1; r >= 0; r--) {
        out[r] = numbers[r];
        for (Index x = r + 1; x < factor.rows; x++) out[r] -= factor(x, r) * out[x];
        out[r] /= factor(r, r);
    }
}

/// What an update did.
struct Updated {
    bool used;                // whether the measurement was used
    double nis;               // its normalised innovation squared
    Table factor;             // (m, m): of the innovation's covariance
    double *whitened;         // (m,): the innovation divided by it
    Columns gain;             // (m, n): on what is so divided, transposed
    Columns slopes;           // (m + c, n): of the prediction and of what has moved, along the columns of the factor before
};

/// Condition a belief on a measurement, unless that lies beyond the gate, and on what has moved; see `update`.
///
/// mean (size,): with what has moved. further: columns of noise, of which the last e are the measurement's alone.
inline Updated conclude(
    IndexTable parts, Index size, double *mean, Columns upper, Columns posterior, Columns first, Table further, Index used,
    Index e, Index m, double *innovation, double gate, Workspace &memory
) {
    const Index n = upper.rows, c = first.rows - m;
    Updated done = {true, 0.0, {memory.numbers(m * m), m, m}, memory.numbers(m), memory.columns(m, n), first};
    condition({first, upper, further, used}, n, m, innovation, {done.factor, done.whitened, done.gain, posterior}, memory);  // equation (19)
    for (Index i = 0; i < m; i++) done.nis += done.whitened[i] * done.whitened[i];
    done.used = done.nis <= gate;
    if (done.used) {
        const Columns change = memory.zeros(n, 1), corrected = memory.columns(size, 1);
        for (Index j = 0; j < n; j++) {
            double total = 0.0;
            for (Index i = 0; i < m; i++) total += done.gain(i, j) * done.whitened[i];
            change(j, 0) = total;
        }
        plus(parts, mean, change, corrected, memory);
        for (Index i = 0; i < size; i++) mean[i] = corrected(i, 0);
        return done;
    }
    const Table of_state = {further.row(m), c, further.columns};
    const Joint unmeasured = {first.rows_from(m, c), upper, of_state, used - e};
    condition(unmeasured, n, 0, nullptr, {{nullptr, 0, 0}, nullptr, {{nullptr, 0, upper.columns}}, posterior}, memory);
    return done;
}

/// Predict and update: change a belief by a measurement that sigma points predict, the mean in place; the factor of its
/// covariance, upper (n, n), is written to `posterior`.
///
/// parts, tail: tables of the state and of its last parts, which have moved. innovation (m,): the measurement's distance
/// from the centre's prediction; from the mean prediction on return. factor (m, e): of the measurement's noise. gate: bound
/// of the normalised innovation squared, beyond which only the prediction is taken over: equation (20).
inline Updated update(
    IndexTable parts, IndexTable tail, const SigmaOrder &order, ConstNumbers w, double *mean, Columns upper,
    Columns posterior, const Predicted &predicted, double *innovation, Table factor, double gate, Workspace &memory
) {
    const Index n = order.degrees(), m = predicted.prediction.rows, size = predicted.points.rows, e = factor.columns;
    const Index c = predicted.noise.rows, k = predicted.noise.columns, at = size - stored_of(tail), r = m + c;
    const Columns points = predicted.points, distance = memory.columns(r, order.points());
    copy(predicted.prediction, distance, m, distance.columns);
    double *centre = memory.numbers(size - at);
    for (Index i = at; i < size; i++) centre[i - at] = points(i, 0);
    minus(tail, points.rows_from(at, size - at), centre, distance.rows_from(m, c), memory);
    const Table further = memory.columns(r, n + 2 + k + e);
    Moments moments = {memory.columns(r, n + LANES), further, 0, memory.numbers(r)};
    unscented_moments(distance, order, w, moments, memory);
    const Index curved = moments.used;
    for (Index i = 0; i < m; i++) {
        for (Index j = 0; j < k; j++) {
            further(i, curved + j) = 0.5 * (predicted.prediction_noise(i, j) - predicted.prediction_noise(i, k + j));
        }
        for (Index j = 0; j < e; j++) further(i, curved + k + j) = factor(i, j);
        innovation[i] -= moments.shift[i];
    }
    for (Index i = 0; i < c; i++) {
        for (Index j = 0; j < k; j++) further(m + i, curved + j) = predicted.noise(i, j);
        for (Index j = 0; j < e; j++) further(m + i, curved + k + j) = 0.0;
    }
    const Columns shift = memory.zeros(c, 1), moved = memory.columns(size - at, 1);
    for (Index i = 0; i < c; i++) shift(i, 0) = moments.shift[m + i];
    plus(tail, centre, shift, moved, memory);
    for (Index i = at; i < size; i++) mean[i] = moved(i - at, 0);

    return conclude(parts, size, mean, upper, posterior, moments.first, further, curved + k + e, e, m, innovation, gate, memory);
}

/// The same by derivatives about another state: what it predicts is carried over to the mean to first order.
///
/// about (size,): the state. moved (tail,): what has moved of it. slopes (m + c, n): of measurement and of what has moved, by
/// the degrees of freedom. noise (c, k), noise_seen (m, k): columns of noise, and what they do to the measurement. innovation
/// (m,): of the state; of the mean on return.
inline Updated linear_update(
    IndexTable parts, IndexTable tail, double *mean, const double *about, Columns upper, Columns posterior, const double *moved,
    Columns slopes, Table noise, Table noise_seen, double *innovation, Table factor, double gate, Workspace &memory
) {
    const Index n = upper.rows, m = noise_seen.rows, c = noise.rows, k = noise.columns, e = factor.columns;
    const Index size = stored_of(parts), at = size - stored_of(tail);
    const Columns states = memory.columns(size, 1), distance = memory.zeros(n, 1), shift = memory.zeros(c, 1);
    for (Index i = 0; i < size; i++) states(i, 0) = mean[i];
    minus(parts, states, about, distance, memory);
    for (Index i = 0; i < m + c; i++) {
        double total = 0.0;
        for (Index j = 0; j < n; j++) total += slopes(i, j) * distance(j, 0);
        if (i < m) innovation[i] -= total;
        else shift(i - m, 0) = total;
    }
    const Columns carried = memory.columns(size - at, 1);
    plus(tail, moved, shift, carried, memory);
    for (Index i = at; i < size; i++) mean[i] = carried(i - at, 0);
    const Columns first = memory.zeros(m + c, n);
    for (Index j = 0; j < n; j++) {  // times column j of the factor, which begins at row j
        const double *column = upper.row(j);
        for (Index i = 0; i < m + c; i++) {
            Lanes total = 0.0;
            for (Index x = j / LANES * LANES; x < n; x += LANES) total += load(slopes.row(i) + x) * load(column + x);
            first(i, j) = sum(total);
        }
    }
    const Table further = {memory.numbers((m + c) * (k + e)), m + c, k + e};
    for (Index i = 0; i < m + c; i++) {
        for (Index j = 0; j < k; j++) further(i, j) = i < m ? noise_seen(i, j) : noise(i - m, j);
        for (Index j = 0; j < e; j++) further(i, k + j) = i < m ? factor(i, j) : 0.0;
    }
    return conclude(parts, size, mean, upper, posterior, first, further, k + e, e, m, innovation, gate, memory);
}

/// Change of the state before an update, in deviations, below which another linearisation about it does not pay.
constexpr double SETTLED = 0.02;

/// Write the most likely state before an update, given its measurement; return whether it has moved.
///
/// upper (n, n): the factor before. change (n,): the distance from the mean before, along the factor; that of the last
/// linearisation before.
inline bool state_before(
    IndexTable parts, const double *mean, Columns upper, const Updated &done, double *change, double *about, Workspace &memory
) {
    const Index n = upper.rows, m = done.factor.rows, size = stored_of(parts);
    double *solved = memory.numbers(m), largest = 0.0;
    divide_transposed(done.factor, done.whitened, solved);
    const Columns distance = memory.zeros(n, 1), states = memory.columns(size, 1);
    for (Index j = 0; j < n; j++) {
        double along = 0.0;
        for (Index r = 0; r < m; r++) along += done.slopes(r, j) * solved[r];
        largest = std::max(largest, std::abs(along - change[j]));
        change[j] = along;
        const double *column = upper.row(j);
        for (Index x = j; x < n; x++) distance(x, 0) += column[x] * along;
    }
    plus(parts, mean, distance, states, memory);
    for (Index i = 0; i < size; i++) about[i] = states(i, 0);
    return largest > SETTLED;
}

}  // namespace
