/// The filter over many updates: predict, measure, update, record.
///
/// The recursion itself, which knows nothing of a cell, stands in sigma_points.hpp; the cell's in process_model.hpp and
/// measurement_model.hpp.
#pragma once

#include <utility>

#include "measurement_model.hpp"

namespace {

/// Write into the record what update i leaves.
inline void note(const Record &record, Index i, const double *mean, const double *innovation, Table factor, const Updated &done) {
    const Index m = factor.rows;
    record.used[i] = done.used;
    std::memcpy(record.mean.row(i), mean, record.mean.columns * sizeof(double));
    for (Index r = 0; r < m; r++) {
        record.innovation(i, r) = innovation[r];
        record.whitened(i, r) = done.whitened[r];
        for (Index j = 0; j < m; j++) {
            double variance = 0.0;
            for (Index e = 0; e < factor.columns; e++) variance += factor(r, e) * factor(j, e);
            record.noise[i](r, j) = variance;
            record.factor[i](r, j) = done.factor(r, j);
        }
    }
}

/// Write the rows of the gain that change velocity and attitude: the first and the last three of the last nine.
inline void note_gain(Table record, Columns gain, Index n) {
    for (Index r = 0; r < gain.rows; r++) {
        for (Index j = 0; j < 3; j++) {
            record(j, r) = gain(r, n - 9 + j);
            record(3 + j, r) = gain(r, n - 3 + j);
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
    Workspace lasting, memory;
    Columns upper = lasting.zeros(n, n), posterior = lasting.zeros(n, n);
    const Columns points = lasting.columns(size, order.points());
    double *walked = lasting.numbers(model.walking.count);
    copy(belief.upper, upper, n, n);
    Index i = begin;
    for (bool going = true; going && i < end; i++) {
        memory.clear();
        const double duration = signal.stamps[steps.last[i]] - signal.stamps[steps.first[i]];
        for (Index j = 0; j < model.walking.count; j++) walked[j] = model.walk[j] * std::sqrt(duration);
        inflate(upper, model.walking, walked, memory);
        if (steps.new_standstill[i]) renew_standstill(model, belief.mean.data, upper, memory);
        draw(model.drawn, order, belief.mean.data, upper, model.weights[SPREAD], points, memory);
        const IntegratedMotion motion = propagate(model, order, signal, steps.first[i], steps.last[i], points, memory);
        const Table noise = process_noise(model, motion.noise, duration, points, memory);
        const Prediction predicted = predict_measurement(
            model, order, signal, steps, i, motion, belief.mean.data, upper, points, noise, memory);
        const Vector<double> velocity = points.rows_from(model.stored[VELOCITY], 3).vector_at(0);
        const Table factor = measurement_noise(model, steps, i, velocity, motion.omega.vector_at(0), memory);
        const Updated done = update(
            model.parts, model.tail, order, model.weights, belief.mean.data, upper, posterior,
            {points, noise, predicted.seen, predicted.seen_noise}, predicted.innovation, factor,
            gate.bounds[factor.rows], memory);
        std::swap(upper, posterior);
        gate.rejected[0] = done.used ? 0 : gate.rejected[0] + 1;
        note(record, i, belief.mean.data, predicted.innovation, factor, done);
        note_gain(record.gain[i], done.gain, n);
        deviations(upper, record.deviation.columns, record.deviation.row(i));
        going = std::isfinite(done.nis) && gate.rejected[0] < gate.most;
    }
    copy(upper, belief.upper, n, n);
    return i;
}

}  // namespace
