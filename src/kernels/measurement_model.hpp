/// The measurement model of the cell: the pose the reference should show, and the velocity at standstill.
#pragma once

#include "process_model.hpp"

namespace {

/// Numbers an update measures.
inline Index measured_numbers(const Steps &steps, Index i) {
    return 3 * (steps.given[0] + steps.given[1] + (steps.at_standstill[i] ? 1 : 0));
}

/// How b moves at an update: what an error of its stamp does to position and orientation.
struct Passing {
    Vector<double> velocity, omega;

    double operator[](Index at) const {
        const Vector<double> &v = at < 3 ? velocity : omega;
        return at % 3 == 0 ? v.x : at % 3 == 1 ? v.y : v.z;
    }
};

/// The factor (m, m + 1) of the measurement noise of update i; the last column is that of the stamps.
inline Table measurement_noise(const Model &model, const Steps &steps, Index i, Passing passing, Workspace &memory) {
    const bool still = steps.at_standstill[i];
    const Index m = measured_numbers(steps, i);
    const Table out = {memory.numbers(m * (m + 1)), m, m + 1};
    fill(out, 0.0);
    Index at = 0;
    for (Index kind = 0; kind < 2; kind++) {
        if (!steps.given[kind]) continue;
        for (Index axis = 0; axis < 3; axis++, at++) {
            out(at, at) = model.noise[(still ? JITTER_POSITION : AT_POSITION) + kind];
            out(at, m) = still ? 0.0 : steps.stamp[i] * passing[3 * kind + axis];
        }
    }
    for (; at < m; at++) out(at, at) = model.noise[STANDSTILL_VELOCITY];
    return out;
}

/// When and between which samples poses are predicted.
struct Moment {
    Columns t;                      // (1, 2 n + 1): seconds after the last sample, for each sigma point
    double dt_before, dt_after;     // sampling intervals on either side of the last sample, s
    Columns robot;                  // (6, 2 n + 1): what its errors add to the nominal arm's pose; no columns without
    bool at_standstill;
};

/// What the robot's errors, (e,), add to the pose of the nominal arm, of each sigma point: the regressor (6, e) times them.
///
/// They enter linearly and are not rotations, so the points themselves are not needed: in direction j they differ from the
/// mean by `spread` times row j of the factor, which is as many products for all of them.
inline Columns robot_motion(
    const Model &model, const SigmaOrder &order, ConstTable regressor, const double *mean, Columns upper, Workspace &memory
) {
    const Index errors = regressor.columns, n = upper.rows;
    if (errors == 0) return {{nullptr, 6, 0}};
    const Columns by = memory.zeros(6, n), out = memory.zeros(6, order.points());
    double at_mean[6] = {};
    Index first = n, last = 0;
    for (Index e = 0; e < errors; e++) {
        const Index row = model.robot.source[e];
        const double error = row >= 0 ? mean[row] : model.robot.known[e];
        for (Index i = 0; i < 6; i++) at_mean[i] += regressor(i, e) * error;
        if (row < 0) continue;
        const Index degree = degree_of(model.parts, row);
        for (Index i = 0; i < 6; i++) by(i, degree) = regressor(i, e);
        first = degree < first ? degree : first;
        last = degree + 1 > last ? degree + 1 : last;
    }
    const double spread = model.weights[SPREAD];
    for (Index i = 0; i < 6; i++) {
        for (Index s = 0; s < out.columns; s++) out(i, s) = at_mean[i];
    }
    for (const SigmaGroup &group : order.group) {
        for (Index j = group.degree; j < group.degree + group.degrees && j < last; j++) {
            Lanes moved[6];
            for (Lanes &lanes : moved) lanes = 0.0;
            for (Index x = (first > j ? first : j) / LANES * LANES; x < last; x += LANES) {
                const Lanes along = load(upper.row(j) + x);
                for (Index i = 0; i < 6; i++) moved[i] += load(by.row(i) + x) * along;
            }
            for (Index i = 0; i < 6; i++) {
                const double d = spread * sum(moved[i]);
                out(i, group.plus(j)) += d;
                out(i, group.minus(j)) -= d;
            }
        }
    }
    return out;
}

/// Columns of what belongs to a sigma point: each its own, or all the centre's.
struct Whose {
    bool centre;

    Lanes number(Columns rows, Index i, Index s) const { return centre ? Lanes(rows(i, 0)) : load(rows.row(i) + s); }
    Vector<Lanes> vector(Columns rows, Index i, Index s) const {
        return {number(rows, i, s), number(rows, i + 1, s), number(rows, i + 2, s)};
    }
    Quaternion<Lanes> quaternion(Columns rows, Index s) const {
        return {number(rows, 0, s), number(rows, 1, s), number(rows, 2, s), number(rows, 3, s)};
    }
};

/// Write attitude (4, m) and position (3, m) the reference should show, for states (size, m) at the last sample:
/// equation (13).
inline void predict_poses(
    const Model &model, const IntegratedMotion &motion, const Moment &moment, Whose own, Columns states, Columns q,
    Columns p, Workspace &memory
) {
    const Indices at = model.stored;
    const Columns velocity = states.rows_from(at[VELOCITY], 3), position = states.rows_from(at[POSITION], 3);
    const Columns attitude = states.rows_from(at[ATTITUDE], 4);
    const Index of_position = at[moment.at_standstill ? STANDSTILL_POSITION : PATH_POSITION];
    const Index of_attitude = at[moment.at_standstill ? STANDSTILL_ORIENTATION : PATH_ORIENTATION];
    const Columns turned = memory.columns(3, states.columns);
    const bool robot = moment.robot.columns > 0;
    for (Index s = 0; s < states.columns; s += LANES) {
        const End end = {
            own.quaternion(motion.q_first, s), own.vector(motion.omega, 0, s), own.vector(motion.alpha, 0, s),
            own.vector(motion.force, 0, s), own.vector(motion.force, 3, s), own.vector(motion.force, 6, s),
            own.vector(motion.gravity, 0, s), own.vector(motion.earth_rate, 0, s),
        };
        const Navigation here = {attitude.quaternion(s), velocity.vector(s), position.vector(s)};
        Pose pose = pose_at(own.number(moment.t, 0, s), moment.dt_before, moment.dt_after, end, here);
        if (of_position >= 0) pose.p += states.vector(of_position, s);
        q.set(s, pose.q);
        if (robot) {  // the reported pose is the nominal arm's: the tool's own, less what the arm's errors add to it
            pose.p -= own.vector(moment.robot, 0, s);
            turned.set(s, -own.vector(moment.robot, 3, s));
        }
        p.set(s, pose.p);
    }
    if (of_attitude >= 0) turn_each(q, states.rows_from(of_attitude, 3));
    if (robot) turn_each(q, turned);
}

/// Write three rows of points from `at` on, less the first column of centre's from `centre_at` on, to `out`.
inline void distances(Columns points, Index at, Columns centre, Index centre_at, Columns out) {
    for (Index axis = 0; axis < 3; axis++) {
        const Lanes from = centre(centre_at + axis, 0);
        for (Index s = 0; s < out.columns; s += LANES) store(load(points.row(at + axis) + s) - from, out.row(axis) + s);
    }
}

/// The centre with columns of noise (c, k) added, (size, 2 k): all in plus, then all in minus.
///
/// Of what does not move only the rows of the reference's error at standstill are written.
inline Columns disturbed(const Model &model, Columns points, Table noise, Workspace &memory) {
    const Index size = points.rows, c = noise.rows, k = noise.columns, at = size - stored_of(model.tail);
    const Columns change = memory.zeros(c, 2 * k), out = memory.columns(size, 2 * k);
    double *centre = memory.numbers(size - at);
    for (Index i = at; i < size; i++) centre[i - at] = points(i, 0);
    for (Index i = 0; i < c; i++) {
        for (Index j = 0; j < k; j++) {
            change(i, j) = noise(i, j);
            change(i, k + j) = -noise(i, j);
        }
    }
    plus(model.tail, centre, change, out.rows_from(at, size - at), memory);
    for (Index part : {STANDSTILL_POSITION, STANDSTILL_ORIENTATION}) {
        for (Index i = model.stored[part]; 0 <= i && i < model.stored[part] + 3; i++) {
            for (Index s = 0; s < out.columns; s++) out(i, s) = points(i, 0);
        }
    }
    return out;
}

/// What update i measures and what is predicted of it, as distances from the centre's prediction.
struct Prediction {
    Columns prediction;         // (m, 2 n + 1): of the sigma points
    Columns prediction_noise;   // (m, 2 k): of the centre with noise added
    double *innovation;   // (m,): the measurement
};

/// Predict the measurement of update i from points (size, 2 n + 1), and from the centre with columns of noise added.
///
/// mean, upper: the belief before the step.
inline Prediction predict_measurement(
    const Model &model, const SigmaOrder &order, const Samples &signal, const Steps &steps, Index i,
    const IntegratedMotion &motion, const double *mean, Columns upper, Columns points, Table noise, Workspace &memory
) {
    const Index last = steps.last[i], m = measured_numbers(steps, i);
    const Columns others = disturbed(model, points, noise, memory);
    const ConstNumbers stamps = signal.stamps;
    const Moment moment = {
        memory.columns(1, points.columns), stamps[last] - stamps[last - 1], stamps[last + 1] - stamps[last],
        robot_motion(model, order, steps.regressor[i], mean, upper, memory), steps.at_standstill[i] != 0,
    };
    for (Index s = 0; s < points.columns; s += LANES) {
        const Lanes start = load(motion.around.row(TIME_OFFSET) + s), skew = load(motion.around.row(TIME_SKEW) + s);
        store(start + (1.0 + skew) * steps.tau[i] - stamps[last], moment.t.row(0) + s);  // equation (11)
    }
    const Columns q = memory.columns(4, points.columns), p = memory.columns(3, points.columns);
    const Columns q_others = memory.columns(4, others.columns), p_others = memory.columns(3, others.columns);
    predict_poses(model, motion, moment, {false}, points, q, p, memory);
    predict_poses(model, motion, moment, {true}, others, q_others, p_others, memory);
    const Prediction out = {memory.columns(m, points.columns), memory.columns(m, others.columns), memory.numbers(m)};
    Index row = 0;
    if (steps.given[0]) {
        for (Index axis = 0; axis < 3; axis++) out.innovation[axis] = steps.position(i, axis) - p(axis, 0);
        distances(p, 0, p, 0, out.prediction.rows_from(0, 3));
        distances(p_others, 0, p, 0, out.prediction_noise.rows_from(0, 3));
        row = 3;
    }
    if (steps.given[1]) {
        const Quaternion<double> centre = q.quaternion_at(0), reported = quaternion_from(steps.quaternion.row(i));
        turn_between(centre, q, out.prediction.rows_from(row, 3));
        turn_between(centre, q_others, out.prediction_noise.rows_from(row, 3));
        const Vector<double> turn = rotation_vector(conjugate(centre) * reported);
        out.innovation[row] = turn.x, out.innovation[row + 1] = turn.y, out.innovation[row + 2] = turn.z;
        row += 3;
    }
    if (steps.at_standstill[i]) {
        const Index at = model.stored[VELOCITY];
        for (Index axis = 0; axis < 3; axis++) out.innovation[row + axis] = -points(at + axis, 0);  // equation (14)
        distances(points, at, points, at, out.prediction.rows_from(row, 3));
        distances(others, at, points, at, out.prediction_noise.rows_from(row, 3));
    }
    return out;
}

}  // namespace
