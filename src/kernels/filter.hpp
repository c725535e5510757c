/// The filter over many updates: predict, measure, update, record.
///
/// The recursion itself, which knows nothing of a cell, stands in sigma_points.hpp; the cell's in process_model.hpp and
/// measurement_model.hpp.
#pragma once

#include <utility>

#include "linear_model.hpp"

namespace {

/// What an update leaves of a measurement with m numbers: see `Record`.
struct Measured {
    const double *innovation;  // (m,)
    Passing passing;
    Table noise;               // (m, e): factor of its noise
    Table factor;              // (m, m): of the innovation's covariance, lower triangular
    const double *whitened;    // (m,)
    Columns gain;              // (m, n), transposed
};

/// Write what update i leaves of its measurement, number r of which stands at place[r] of position, orientation and velocity.
inline void record_update(const Record &record, Index i, const Measured &of, const Index *place, Index n, bool used) {
    const Index m = of.factor.rows;
    const double nan = std::nan("");
    for (Table rows : {record.whitened, record.innovation, record.residual, record.noise_variance}) {
        for (Index x = 0; x < MAX_MEASURED; x++) rows(i, x) = nan;
    }
    // residual: the noise's covariance times the inverse of the innovation's, times the innovation
    double solved[MAX_MEASURED];
    record.nis[i] = record.log_likelihood[i] = record.turn_information[i] = 0.0;
    divide_transposed(of.factor, of.whitened, solved);
    for (Index r = m - 1; r >= 0; r--) {
        record.nis[i] += of.whitened[r] * of.whitened[r];
        record.log_likelihood[i] -= std::log(of.factor(r, r));
    }
    record.log_likelihood[i] -= 0.5 * record.nis[i];
    for (Index r = 0; r < m; r++) {
        double residual = 0.0, variance = 0.0;
        for (Index e = 0; e < of.noise.columns; e++) {
            double along = 0.0;
            for (Index x = 0; x < m; x++) along += of.noise(x, e) * solved[x];
            residual += of.noise(r, e) * along;
            variance += of.noise(r, e) * of.noise(r, e);
        }
        record.whitened(i, place[r]) = of.whitened[r];
        record.innovation(i, place[r]) = of.innovation[r];
        record.residual(i, place[r]) = residual;
        record.noise_variance(i, place[r]) = variance;
        if (!used || place[r] < 3 || place[r] > 5) continue;
        double inverse[MAX_MEASURED];  // column r of the factor's inverse
        for (Index x = r; x < m; x++) {
            inverse[x] = x == r ? 1.0 : 0.0;
            for (Index y = r; y < x; y++) inverse[x] -= of.factor(x, y) * inverse[y];
            inverse[x] /= of.factor(x, x);
            record.turn_information[i] += inverse[x] * inverse[x];
        }
    }
    // the error of the stamp by least squares: of the innovation along the motion, m' S^-1 d / (m' S^-1 m)
    double along[MAX_MEASURED], seen = 0.0, weight = 0.0;
    for (Index r = 0; r < m; r++) along[r] = place[r] < 6 ? of.passing[place[r]] : 0.0;
    for (Index r = 0; r < m; r++) {
        for (Index x = 0; x < r; x++) along[r] -= of.factor(r, x) * along[x];
        along[r] /= of.factor(r, r);
        seen += along[r] * of.whitened[r];
        weight += along[r] * along[r];
    }
    record.late(i, 0) = weight > 0.0 ? seen / weight : nan;
    record.late(i, 1) = weight > 0.0 ? 1.0 / std::sqrt(weight) : nan;
    for (Index j = 0; j < 6; j++) record.passing(i, j) = of.passing[j];
    // velocity and attitude are the first and the last three of the last nine degrees of freedom
    for (Index j = 0; j < 6; j++) {
        const Index degree = n - (j < 3 ? 9 - j : 6 - j);
        double change = 0.0, variance = 0.0;
        for (Index r = 0; r < m; r++) {
            change += of.gain(r, degree) * of.whitened[r];
            variance += of.gain(r, degree) * of.gain(r, degree);
        }
        record.correction(i, j) = change;
        record.correction_variance(i, j) = variance;
    }
}

/// Write which components of position, orientation and velocity the numbers of update i are.
inline void places_of(const Steps &steps, Index i, Index *place) {
    const bool present[3] = {steps.given[0] != 0, steps.given[1] != 0, steps.at_standstill[i] != 0};
    for (Index kind = 0; kind < 3; kind++) {
        for (Index axis = 0; present[kind] && axis < 3; axis++) *place++ = 3 * kind + axis;
    }
}

/// Write rows of slopes (r, n) along the columns of a factor as rows along the degrees of freedom; upper: the factor, transposed.
///
/// All rows are solved for together, so that the inner loop runs along them.
inline void along_degrees(Columns slopes, Index first, Table upper, Table out, Workspace &memory) {
    const Index n = upper.rows, width = padded(out.rows);
    double *all = memory.numbers(n * width);
    for (Index j = 0; j < n; j++) {
        for (Index i = 0; i < width; i++) all[j * width + i] = i < out.rows ? slopes(first + i, j) : 0.0;
    }
    for (Index j = n - 1; j >= 0; j--) {
        double *own = all + j * width;
        for (Index x = j + 1; x < n; x++) {
            const double share = upper(j, x), *other = all + x * width;
            if (share == 0.0) continue;
            for (Index i = 0; i < width; i += LANES) store(load(own + i) - share * load(other + i), own + i);
        }
        const double scale = upper(j, j) != 0.0 ? 1.0 / upper(j, j) : 0.0;
        for (Index i = 0; i < out.rows; i++) out(i, j) = own[i] *= scale;
    }
}

/// Write what small changes of the state before update i do: see `Record`.
///
/// slopes: along the degrees of freedom, or, where `upper`, the factor before the step, is given, along its columns.
inline void record_slopes(
    const Record &record, Index i, const Updated &done, Columns slopes, const Columns *upper, const Index *place, Workspace &memory
) {
    if (record.transition.tables == 0) return;
    const Table transition = record.transition[i], design = record.design[i], gain = record.gain[i], whitening = record.whitening[i];
    const Index n = design.columns, m = done.factor.rows, c = transition.rows;
    const Table measured = {memory.numbers(m * n), m, n};
    if (upper) {
        along_degrees(slopes, 0, *upper, measured, memory);
        along_degrees(slopes, m, *upper, transition, memory);
    } else {
        copy(slopes, measured, m, n);
        copy(slopes.rows_from(m, c), transition, c, n);
    }
    for (Table table : {design, gain, whitening}) fill(table, 0.0);
    for (Index r = 0; r < m; r++) {
        for (Index x = 0; x <= r; x++) {  // row r of the factor's inverse, by rows before it
            double inverse = x == r ? 1.0 : 0.0;
            for (Index y = x; y < r; y++) inverse -= done.factor(r, y) * whitening(place[y], place[x]);
            whitening(place[r], place[x]) = inverse / done.factor(r, r);
        }
        for (Index j = 0; j < n; j++) {
            for (Index x = 0; x <= r; x++) design(place[r], j) += whitening(place[r], place[x]) * measured(x, j);
            gain(place[r], j) = done.used ? done.gain(r, j) : 0.0;
        }
    }
}

/// Write the products of some columns (n, k) of a factor, packed, with all its columns, so far as the rows before `end` go.
template <Index K>
inline void add_products(const double *packed, Index stride, Columns upper, Index x, Index end, double *const *out) {
    Lanes total[K][2];
    for (Index k = 0; k < K; k++) total[k][0] = total[k][1] = 0.0;
    for (Index j = 0; j < end; j++) {
        const Lanes first = load(upper.row(j) + x), second = load(upper.row(j) + x + LANES);
        for (Index k = 0; k < K; k++) {
            const Lanes factor = packed[j * stride + k];
            total[k][0] += factor * first;
            total[k][1] += factor * second;
        }
    }
    for (Index k = 0; k < K; k++) store(total[k][0], out[k] + x), store(total[k][1], out[k] + x + LANES);
}

/// Write the mean before update i, and what of the covariance is asked for: see `Record`.
inline void record_before(const Model &model, const Record &record, Index i, const double *mean, Columns upper, Workspace &memory) {
    if (record.before.rows == 0) return;
    std::memcpy(record.before.row(i), mean, record.before.columns * sizeof(double));
    const Table covariance = record.covariance[i];
    constexpr Index TOGETHER = 4;
    const Index n = upper.rows, count = padded(model.varying.count), whole = upper.columns / (2 * LANES) * (2 * LANES);
    double *packed = memory.numbers(n * count);
    for (Index j = 0; j < n; j++) {
        for (Index v = 0; v < count; v++) packed[j * count + v] = v < model.varying.count ? upper(j, model.varying[v]) : 0.0;
    }
    double *rows[TOGETHER];
    for (double *&row : rows) row = memory.numbers(upper.columns + 2 * LANES);
    for (Index v = 0; v < model.varying.count; v += TOGETHER) {
        const Index together = std::min(TOGETHER, model.varying.count - v), most = model.varying[v + together - 1] + 1;
        for (Index x = 0; x < whole; x += 2 * LANES) {  // column j of the factor begins at its row j
            add_products<TOGETHER>(packed + v, count, upper, x, std::min(most, x + 2 * LANES), rows);
        }
        for (Index k = 0; k < together; k++) {
            std::memcpy(covariance.row(v + k), rows[k], std::min(n, whole) * sizeof(double));
            for (Index x = whole; x < n; x++) {
                double total = 0.0;
                for (Index j = 0; j <= std::min(x, model.varying[v + k]); j++) total += packed[j * count + v + k] * upper(j, x);
                covariance(v + k, x) = total;
            }
        }
    }
}

/// At the beginning of a standstill the reference's error is a new one, independent of all earlier ones.
inline void renew_standstill(const Model &model, double *mean, Columns upper, Workspace &memory) {
    for (Index kind = 0; kind < 2; kind++) {
        const Index at = model.stored[STANDSTILL_POSITION + kind];
        if (at < 0) continue;
        for (Index axis = 0; axis < 3; axis++) mean[at + axis] = 0.0;
        renew(upper, degree_of(model.parts, at), model.standstill[kind], memory);
    }
}

/// Let degrees of freedom walk for some seconds: equation (25). What fades is a Gauss-Markov process.
inline void walk(const Model &model, double seconds, double *mean, Columns upper, Workspace &memory) {
    double *fresh = memory.numbers(model.walking.count);
    for (Index i = 0; i < model.walking.count; i++) {
        const double rate = model.fading[i];
        fresh[i] = model.walk[i] * std::sqrt(rate > 0.0 ? -0.5 * std::expm1(-2.0 * rate * seconds) / rate : seconds);
        if (rate == 0.0) continue;
        const Index degree = model.walking[i];
        const double kept = std::exp(-rate * seconds);
        mean[stored_at(model.parts, degree)] *= kept;
        for (Index j = 0; j <= degree; j++) upper(j, degree) *= kept;
    }
    inflate(upper, model.walking, fresh, memory);
}

/// What an update did, and what of it is recorded.
struct Step {
    Updated done;
    double *innovation;   // (m,)
    Passing passing;
    Table factor;         // (m, e): of the measurement's noise
    Columns slopes;       // (m + c, n)
};

/// Predict and update by sigma points.
inline Step step_by_points(
    const Model &model, const SigmaOrder &order, const Samples &signal, const Steps &steps, Index i, ConstNumbers bounds,
    double *mean, Columns upper, Columns posterior, Columns points, Workspace &memory
) {
    const double duration = signal.stamps[steps.last[i]] - signal.stamps[steps.first[i]];
    sample(model.sampled, order, mean, upper, model.weights[SPREAD], points, memory);
    const IntegratedMotion motion = propagate(model, order, signal, steps.first[i], steps.last[i], points, memory);
    const Table noise = process_noise(model, motion.noise, duration, points, memory);
    const Prediction predicted = predict_measurement(model, order, signal, steps, i, motion, mean, upper, points, noise, memory);
    const Passing passing = {points.rows_from(model.stored[VELOCITY], 3).vector_at(0), motion.omega.vector_at(0)};
    const Table factor = measurement_noise(model, steps, i, passing, memory);
    const Updated done = update(
        model.parts, model.tail, order, model.weights, mean, upper, posterior,
        {points, noise, predicted.prediction, predicted.prediction_noise}, predicted.innovation, factor,
        bounds[factor.rows], memory);
    return {done, predicted.innovation, passing, factor, done.slopes};
}

/// Predict and update by derivatives.
///
/// They are taken about `steps.about`, or about the mean. With more than one linearisation the further ones are about what
/// the update makes of the state before it, until that moves by less than `SETTLED` of its deviations: Gauss and Newton's
/// method on one update.
inline Step step_by_slopes(
    const Model &model, const SigmaOrder &order, const Samples &signal, const Steps &steps, Index i, ConstNumbers bounds,
    double *mean, Columns upper, Columns posterior, Workspace &memory
) {
    const Index size = stored_of(model.parts), n = upper.rows;
    double *about = memory.numbers(size), *moved = memory.numbers(size), *change = memory.numbers(n);
    std::memcpy(about, mean, size * sizeof(double));
    if (steps.about.columns > 0) std::memcpy(about, steps.about.row(i), steps.about.columns * sizeof(double));
    std::fill(change, change + n, 0.0);
    for (Index pass = 1;; pass++) {
        const LinearUpdate at = linearise(model, order, signal, steps, i, about, size, memory);
        std::memcpy(moved, mean, size * sizeof(double));
        const Updated done = linear_update(
            model.parts, model.tail, moved, about, upper, posterior, at.moved, at.slopes, at.noise, at.noise_seen, at.innovation,
            at.factor, bounds[at.factor.rows], memory);
        if (pass >= model.linear || !done.used || !state_before(model.parts, mean, upper, done, change, about, memory)) {
            std::memcpy(mean, moved, size * sizeof(double));
            return {done, at.innovation, at.passing, at.factor, at.slopes};
        }
    }
}

/// Carry a belief over the updates from `begin` to `end`, in place.
///
/// Returns the update it stopped before: less than `end` if too many measurements were rejected in a row, or the state is
/// no longer finite.
inline Index run(
    const Model &model, const Samples &signal, const Steps &steps, Index begin, Index end, const Gate &gate,
    const Gaussian &belief, const Record &record
) {
    const Index n = belief.upper.rows, size = belief.mean.count;
    const SigmaOrder order(model.gyro_degrees, model.sensor_degrees, n);
    const bool linear = model.linear != 0;
    Workspace lasting, memory;
    Columns upper = lasting.zeros(n, n), posterior = lasting.zeros(n, n);
    const Columns points = linear ? Columns{{nullptr, size, 0}} : lasting.columns(size, order.points());
    copy(belief.upper, upper, n, n);
    double *mean = belief.mean.data;
    Index i = begin;
    for (bool going = true; going && i < end; i++) {
        memory.clear();
        walk(model, signal.stamps[steps.last[i]] - signal.stamps[steps.first[i]], mean, upper, memory);
        if (steps.new_standstill[i]) renew_standstill(model, mean, upper, memory);
        record_before(model, record, i, mean, upper, memory);
        const Step step = linear
            ? step_by_slopes(model, order, signal, steps, i, gate.bounds, mean, upper, posterior, memory)
            : step_by_points(model, order, signal, steps, i, gate.bounds, mean, upper, posterior, points, memory);
        const Updated &done = step.done;
        Index place[MAX_MEASURED];
        places_of(steps, i, place);
        record_slopes(record, i, done, step.slopes, linear ? nullptr : &upper, place, memory);
        std::swap(upper, posterior);
        gate.rejected[0] = done.used ? 0 : gate.rejected[0] + 1;
        record_update(record, i, {step.innovation, step.passing, step.factor, done.factor, done.whitened, done.gain}, place, n, done.used);
        record.used[i] = done.used;
        std::memcpy(record.mean.row(i), mean, record.mean.columns * sizeof(double));
        deviations(upper, record.deviation.columns, record.deviation.row(i));
        going = std::isfinite(done.nis) && gate.rejected[0] < gate.most;
    }
    copy(upper, belief.upper, n, n);
    return i;
}

}  // namespace
