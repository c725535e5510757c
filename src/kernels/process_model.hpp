/// The process model of the cell: sigma points carried from one update to the next, and the noise on the way.
#pragma once

#include <initializer_list>

#include "cell.hpp"
#include "composition.hpp"
#include "preintegration.hpp"
#include "sensor_noise.hpp"
#include "sigma_points.hpp"

namespace {

/// The motion to an update: what carries sigma points on to the reference's own time, and its noise.
struct IntegratedMotion {
    Columns q_first;             // (4, 2 n + 1): attitudes before
    Columns omega, alpha, force; // (3, M), (3, M), (9, M): see `Increments`
    Columns gravity, earth_rate; // (3, 2 n + 1), in r
    Columns around;              // (10, 2 n + 1): alignment, north, gravity, time offset and skew, Earth rate downward
    Table noise;                 // (9, 9): factor of noise in velocity, position and attitude
};

/// Write some numbers of the model, (e, m), for m columns of the points from `first` on; the rest are those of the last.
inline Columns rows_of(const ParameterRows &rows, Columns points, Index first, Index m, Workspace &memory) {
    const Columns out = memory.columns(rows.source.count, m);
    for (Index e = 0; e < out.rows; e++) {
        const Index source = rows.source[e];
        double *row = out.row(e);
        if (source >= 0) std::memcpy(row, points.row(source) + first, m * sizeof(double));
        for (Index s = source < 0 ? 0 : m; s < out.columns; s++) row[s] = source < 0 ? rows.known[e] : row[m - 1];
    }
    return out;
}

/// What each feature of the effects adds to the reading of each axis, (3 E, m), from their parameters (e, m).
///
/// places (E, 3): the parameter of each feature for each axis, or -1; applied (e,): values by which the readings have been
/// corrected before.
inline Columns effects_of(IndexTable places, ConstNumbers applied, Columns parameters, Workspace &memory) {
    const Columns out = memory.zeros(3 * places.rows, parameters.columns);
    for (Index row = 0; row < out.rows; row++) {
        const Index e = places(row / 3, row % 3);
        if (e < 0) continue;
        for (Index s = 0; s < out.columns; s += LANES) store(load(parameters.row(e) + s) - Lanes(applied[e]), out.row(row) + s);
    }
    return out;
}

/// The coefficients of sigma points (size, 2 n + 1).
inline Coefficients sensor_coefficients(const Model &model, const SigmaOrder &order, Columns points, Workspace &memory) {
    const Index turning = 1 + 2 * order.group[0].degrees, sharing = 2 * order.group[1].degrees;
    const Index P = RATES + model.gyro_effects.rows, features = FEATURES + model.accel_effects.rows;
    const bool printed = model.printed != 0;
    const Columns gyro = rows_of(model.gyro, points, 0, turning, memory);
    const Columns own = rows_of(model.accel, points, 0, turning, memory);
    const Columns others = rows_of(model.accel, points, turning, sharing, memory);
    const Coefficients out = {
        memory.columns(3 * P, turning), memory.columns(3 * features, turning), memory.columns(3 * features, sharing),
        turning, sharing,
    };
    const auto force = [&](Columns accel, bool common, Columns to) {
        const Columns effects = effects_of(model.accel_effects, model.accel_applied, accel.rows_from(ACCEL_EFFECTS, accel.rows - ACCEL_EFFECTS), memory);
        force_coefficients(
            out.rate, common, accel.rows_from(ACCEL_CROSS_COUPLING, 9), accel.rows_from(ACCEL_OFFSET, 3), accel.rows_from(LEVER_ARMS, 9), effects, printed, to);
    };
    const Columns effects = effects_of(model.gyro_effects, model.gyro_applied, gyro.rows_from(GYRO_EFFECTS, gyro.rows - GYRO_EFFECTS), memory);
    rate_coefficients(gyro.rows_from(GYRO_CROSS_COUPLING, 9), gyro.rows_from(GYRO_OFFSET, 3), effects, out.rate);
    force(own, false, out.force);
    force(others, true, out.shared);
    return out;
}

/// Gravity in r: equation (6), and the Earth rate in r: equation (7).
inline void environment(const Model &model, Columns around, Columns gravity, Columns earth_rate) {
    for (Index s = 0; s < gravity.columns; s += LANES) {
        const Quaternion<Lanes> q_rn = around.rows_from(ALIGNMENT, 4).quaternion(s);
        const Lanes level = model.level, down = model.down;
        gravity.set(s, rotate(q_rn, Vector<Lanes>{0.0, 0.0, load(around.row(GRAVITY) + s)}));
        earth_rate.set(s, rotate(q_rn, Vector<Lanes>{
            level * load(around.row(NORTH) + s), level * load(around.row(NORTH + 1) + s),
            down * load(around.row(EARTH_DOWN) + s)}));
    }
}

/// The matrix of row-wise coefficients from row `first` on, column 0: reading of axis j in component i.
inline Matrix<double> first_matrix(Columns coefficients, Index first) {
    Matrix<double> columns;
    for (Index axis = 0; axis < 3; axis++) columns.row[axis] = coefficients.rows_from(3 * (first + axis), 3).vector_at(0);
    return transpose(columns);
}

/// Carry sigma points (size, 2 n + 1) from sample `first` to `last`, in place.
inline IntegratedMotion propagate(
    const Model &model, const SigmaOrder &order, const Samples &signal, Index first, Index last, Columns points,
    Workspace &memory
) {
    const Coefficients coefficients = sensor_coefficients(model, order, points, memory);
    const Span span = span_between(signal, first, last);
    const Index sigma = order.points(), moving = coefficients.m + coefficients.others;
    const Increments motion = {
        memory.columns(4, sigma), memory.columns(3, sigma), memory.columns(3, sigma), memory.columns(3, sigma),
        memory.columns(3, sigma), memory.columns(9, sigma),
        {memory.numbers(span.count() * LANES), span.count(), LANES}, memory.columns(4, span.count()),
    };
    preintegrate(span, signal, coefficients, motion, memory);
    // All other sigma points have the centre's sensor parameters.
    for (const Columns &rows : {motion.dq, motion.dv, motion.dp, motion.omega_end, motion.alpha_end, motion.u_end}) {
        for (Index i = 0; i < rows.rows; i++) {
            for (Index s = moving; s < rows.columns; s++) rows(i, s) = rows(i, 0);
        }
    }
    const IntegratedMotion out = {
        memory.columns(4, sigma), motion.omega_end, motion.alpha_end, motion.u_end, memory.columns(3, sigma),
        memory.columns(3, sigma), rows_of(model.around, points, 0, sigma, memory), {memory.numbers(81), 9, 9},
    };
    environment(model, out.around, out.gravity, out.earth_rate);
    const Columns q = points.rows_from(model.stored[ATTITUDE], 4), v = points.rows_from(model.stored[VELOCITY], 3);
    const Columns p = points.rows_from(model.stored[POSITION], 3);
    copy(q, out.q_first, 4, q.columns);
    const double duration = signal.stamps[last] - signal.stamps[first];
    for (Index s = 0; s < points.columns; s += LANES) {
        const Navigation moved = compose(
            duration, {q.quaternion(s), v.vector(s), p.vector(s)}, motion.dq.quaternion(s), motion.dv.vector(s),
            motion.dp.vector(s), out.gravity.vector(s), out.earth_rate.vector(s));
        q.set(s, moved.q);
        v.set(s, moved.v);
        p.set(s, moved.p);
    }

    const double each = duration > 0.0 ? model.noise_step * static_cast<double>(last - first) / duration : 1.0;
    const Table covariance = {memory.numbers(81), 9, 9};
    noise_covariance(
        span, each >= 1.0 ? static_cast<Index>(each) : 1, signal, motion.u_path, motion.q_path,
        first_matrix(coefficients.rate, 1), first_matrix(coefficients.force, FORCES), covariance, memory);
    navigation_noise(covariance, out.q_first.quaternion_at(0), motion.dq.quaternion_at(0), out.noise);
    return out;
}

/// Columns of noise (c, c) of all that changes; coloured noise of the reference decays in the points: equation (15).
inline Table process_noise(const Model &model, Table navigation, double duration, Columns points, Workspace &memory) {
    Index rows = 9;
    for (Index part : {PATH_POSITION, PATH_ORIENTATION}) rows += model.stored[part] >= 0 ? 3 : 0;
    const Table out = {memory.numbers(rows * rows), rows, rows};
    fill(out, 0.0);
    for (Index i = 0; i < 9; i++) std::memcpy(out.row(rows - 9 + i) + rows - 9, navigation.row(i), 9 * sizeof(double));
    Index row = 0;
    for (Index part : {PATH_POSITION, PATH_ORIENTATION}) {
        if (model.stored[part] < 0) continue;
        const double kept = std::exp(-duration / model.coloured[COLOURED_TIME]);
        const double fresh = model.coloured[COLOURED_POSITION + part - PATH_POSITION] * std::sqrt(1.0 - kept * kept);
        for (Index axis = 0; axis < 3; axis++, row++) {
            double *numbers = points.row(model.stored[part] + axis);
            for (Index s = 0; s < points.columns; s += LANES) store(Lanes(kept) * load(numbers + s), numbers + s);
            out(row, row) = fresh;
        }
    }
    return out;
}

}  // namespace
