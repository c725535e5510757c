/// The cell's models, linearised about one state: what moves, what is measured, and their derivatives by all of it.
///
/// The derivatives follow from equations (8) to (14). Turns of an attitude stand on its right.
#pragma once

#include "linear_increments.hpp"
#include "measurement_model.hpp"

namespace {

/// Step of the central differences of coefficients, which are of the second degree in almost all parameters.
constexpr double COEFFICIENT_STEP = 1e-4;

/// An update, linearised about a state before it.
struct LinearUpdate {
    double *moved;        // (tail,): stored numbers of what moves, at the update
    Columns slopes;       // (m + c, n): of the measurement, above those of what has moved, by the degrees of freedom
    Table noise;          // (c, k): columns of noise in what has moved
    Table noise_seen;     // (m, k): what they do to the measurement
    double *innovation;   // (m,): of the state
    Passing passing;
    Table factor;         // (m, e): of the measurement's noise
};

inline Matrix<double> skew(Vector<double> a) { return {{{0.0, -a.z, a.y}, {a.z, 0.0, -a.x}, {-a.y, a.x, 0.0}}}; }
inline Matrix<double> identity() { return {{{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}}; }

/// The matrix J with exp(theta + d) = exp(theta) exp(J d), to the fourth order in theta.
inline Matrix<double> right_jacobian(Vector<double> theta) {
    const Matrix<double> S = skew(theta), SS = S * S;
    return identity() + (-0.5) * S + (1.0 / 6.0) * SS + (-1.0 / 24.0) * (SS * S) + (1.0 / 120.0) * (SS * SS);
}

/// Add A times rows x (3, n) to rows from `row` on.
inline void add(Columns out, Index row, Matrix<double> A, Columns x) {
    const Vector<Lanes> a = in_all_lanes(A.row[0]), b = in_all_lanes(A.row[1]), c = in_all_lanes(A.row[2]);
    for (Index s = 0; s < x.columns; s += LANES) {
        const Vector<Lanes> v = x.vector(s);
        out.set(row, s, out.vector(row, s) + Vector<Lanes>{dot(a, v), dot(b, v), dot(c, v)});
    }
}

/// Add a matrix, some of its columns, to rows from `row` and columns from `column` on.
inline void add_block(Columns out, Index row, Index column, Matrix<double> A, Index columns = 3) {
    for (Index i = 0; i < 3; i++) {
        const double own[3] = {A.row[i].x, A.row[i].y, A.row[i].z};
        for (Index j = 0; j < columns; j++) out(row + i, column + j) += own[j];
    }
}

inline void add_vector(Columns out, Index row, Index column, Vector<double> a) {
    out(row, column) += a.x, out(row + 1, column) += a.y, out(row + 2, column) += a.z;
}

/// The degree of freedom of stored number `row`, or -1.
inline Index degree_or_none(IndexTable parts, Index row) { return row < 0 ? -1 : degree_of(parts, row); }

/// The coefficients of a state (size,) and their derivatives.
inline Coefficients coefficient_slopes(
    const Model &model, const SigmaOrder &order, const double *state, Index size, CoefficientSlopes &by, Workspace &memory
) {
    const Index sensors = model.sensor_degrees;
    const Columns points = memory.columns(size, 1 + 2 * sensors);
    for (Index i = 0; i < size; i++) {
        for (Index s = 0; s < points.columns; s++) points(i, s) = state[i];
    }
    for (const SigmaGroup &group : {order.group[0], order.group[1]}) {
        for (Index j = group.degree; j < group.degree + group.degrees; j++) {
            const Index row = stored_at(model.parts, j);
            points(row, group.plus(j)) += COEFFICIENT_STEP;
            points(row, group.minus(j)) -= COEFFICIENT_STEP;
        }
    }
    const Coefficients all = sensor_coefficients(model, order, points, memory);
    by = {memory.zeros(all.rate.rows, sensors), memory.zeros(all.force.rows, sensors)};
    const double halved = 1.0 / (2.0 * COEFFICIENT_STEP);
    for (const SigmaGroup &group : {order.group[0], order.group[1]}) {
        const bool turning = group.degree == 0;
        const Columns force = turning ? all.force : all.shared;
        const Index before = turning ? 0 : all.m;
        for (Index j = group.degree; j < group.degree + group.degrees; j++) {
            const Index plus = group.plus(j), minus = group.minus(j);
            for (Index i = 0; turning && i < all.rate.rows; i++) by.rate(i, j) = halved * (all.rate(i, plus) - all.rate(i, minus));
            for (Index i = 0; i < force.rows; i++) by.force(i, j) = halved * (force(i, plus - before) - force(i, minus - before));
        }
    }
    return {all.rate, all.force, all.shared, 1, 0};
}

/// Gravity and Earth rate of a state, with their derivatives (3, n): equations (6) and (7).
struct Surroundings {
    Vector<double> g, Omega;
    Columns by_g, by_Omega;
    double start, skew;
    Index of_start, of_skew;  // degrees of freedom, or -1
};

inline Surroundings surroundings(const Model &model, const double *state, Index n, Workspace &memory) {
    double x[10];
    Index degree[10];
    for (Index e = 0; e < 10; e++) {
        const Index row = model.around.source[e];
        x[e] = row >= 0 ? state[row] : model.around.known[e];
        degree[e] = degree_or_none(model.parts, row);
    }
    const Matrix<double> C = direction_cosines(quaternion_from(x + ALIGNMENT));
    const Vector<double> g_n = {0.0, 0.0, x[GRAVITY]};
    const Vector<double> rate_n = {model.level * x[NORTH], model.level * x[NORTH + 1], model.down * x[EARTH_DOWN]};
    Surroundings out = {
        C * g_n, C * rate_n, memory.zeros(3, n), memory.zeros(3, n), x[TIME_OFFSET], x[TIME_SKEW], degree[TIME_OFFSET],
        degree[TIME_SKEW],
    };
    if (degree[ALIGNMENT] >= 0) {  // a tilt: two degrees of freedom
        add_block(out.by_g, 0, degree[ALIGNMENT], -1.0 * (C * skew(g_n)), 2);
        add_block(out.by_Omega, 0, degree[ALIGNMENT], -1.0 * (C * skew(rate_n)), 2);
    }
    const auto along = [&](Columns rows, Index e, Vector<double> unit) {
        if (degree[e] >= 0) add_vector(rows, 0, degree[e], C * unit);
    };
    along(out.by_g, GRAVITY, {0.0, 0.0, 1.0});
    along(out.by_Omega, NORTH, {model.level, 0.0, 0.0});
    along(out.by_Omega, NORTH + 1, {0.0, model.level, 0.0});
    along(out.by_Omega, EARTH_DOWN, {0.0, 0.0, model.down});
    return out;
}

/// The navigation state carried to an update, with derivatives (3, n): equation (9).
struct MovedNavigation {
    Navigation all;            // every lane the same
    Columns turn, v, p;        // (3, n)
    Columns first;             // (3, n): turn of the attitude before the update, in its own frame
};

inline MovedNavigation moved_navigation(
    double T, const Navigation &before, const Increments &motion, const IncrementSlopes &by, const Surroundings &around,
    Index at, Index n, Workspace &memory
) {
    const auto number = [](Vector<Lanes> a) { return Vector<double>{a.x[0], a.y[0], a.z[0]}; };
    const Matrix<double> R = direction_cosines(Quaternion<double>{before.q.w[0], before.q.x[0], before.q.y[0], before.q.z[0]});
    const Vector<double> g = around.g, Omega = around.Omega, v0 = number(before.v);
    const Vector<double> dv = motion.dv.vector_at(0), dp = motion.dp.vector_at(0);
    const Matrix<double> W = skew(Omega), WW = W * W, I = identity();
    const Matrix<double> E = direction_cosines(rotation(-T * Omega)), J = right_jacobian(-T * Omega);
    const Vector<double> Og = cross(Omega, g), OOg = cross(Omega, Og);
    const Vector<double> y = R * dp + T * (v0 + (0.5 * T) * (g + (T / 3.0) * (Og + (0.25 * T) * OOg)));
    const Vector<double> y_dot = R * dv + v0 + T * (g + (0.5 * T) * (Og + (T / 3.0) * OOg));
    const Matrix<double> og = -1.0 * skew(g), oog = -1.0 * skew(Og) + -1.0 * (W * skew(g));  // of Og, OOg by Omega
    MovedNavigation out = {
        compose(
            T, before, motion.dq.quaternion(0), motion.dv.vector(0), motion.dp.vector(0), in_all_lanes(g), in_all_lanes(Omega)),
        memory.zeros(3, n), memory.zeros(3, n), memory.zeros(3, n), memory.zeros(3, n),
    };
    const Columns rising = memory.zeros(3, n), displaced = memory.zeros(3, n);  // of y_dot and y
    const Columns turn = out.first;
    add_block(turn, 0, at + 6, I);
    add(turn, 0, I, by.turn);
    add_block(rising, 0, at + 6, -1.0 * (R * skew(dv)));
    add_block(displaced, 0, at + 6, -1.0 * (R * skew(dp)));
    add(rising, 0, R, by.dv);
    add(displaced, 0, R, by.dp);
    add_block(rising, 0, at, I);
    add_block(displaced, 0, at, T * I);
    add(rising, 0, T * (I + (0.5 * T) * (W + (T / 3.0) * WW)), around.by_g);
    add(displaced, 0, (0.5 * T * T) * (I + (T / 3.0) * (W + (0.25 * T) * WW)), around.by_g);
    add(rising, 0, (0.5 * T * T) * (og + (T / 3.0) * oog), around.by_Omega);
    add(displaced, 0, (T * T * T / 6.0) * (og + (0.25 * T) * oog), around.by_Omega);
    // v = E (y_dot - Omega x y), p = p_0 + E y, q = E q_0 dq; E turns by -T Omega
    const Vector<double> inner = y_dot - cross(Omega, y);
    add(out.v, 0, E, rising);
    add(out.v, 0, -1.0 * (E * W), displaced);
    add(out.v, 0, E * (skew(y) + T * (skew(inner) * J)), around.by_Omega);
    add_block(out.p, 0, at + 3, I);
    add(out.p, 0, E, displaced);
    add(out.p, 0, T * (E * (skew(y) * J)), around.by_Omega);
    const Matrix<double> D = transpose(direction_cosines(motion.dq.quaternion_at(0)));
    add(out.turn, 0, D, turn);
    add(out.turn, 0, (-T) * (D * (transpose(R) * J)), around.by_Omega);
    return out;
}

/// Whose degrees of freedom the errors of the robot and the reference are, and what they add to the pose, (6,).
inline void pose_errors(const Model &model, ConstTable regressor, const double *state, double *sum, Index *degree) {
    for (Index i = 0; i < 6; i++) sum[i] = 0.0;
    for (Index e = 0; e < regressor.columns; e++) {
        const Index row = model.robot.source[e];
        degree[e] = degree_or_none(model.parts, row);
        const double error = row >= 0 ? state[row] : model.robot.known[e];
        for (Index i = 0; i < 6; i++) sum[i] += regressor(i, e) * error;
    }
}

/// Linearise update i about a state (size,).
inline LinearUpdate linearise(
    const Model &model, const SigmaOrder &order, const Samples &signal, const Steps &steps, Index i, const double *state,
    Index size, Workspace &memory
) {
    const Index n = order.degrees(), first = steps.first[i], last = steps.last[i], sensors = model.sensor_degrees;
    const Index m = measured_numbers(steps, i), c = degrees_of(model.tail), at = n - 9;
    const bool still = steps.at_standstill[i] != 0;
    const Span span = span_between(signal, first, last);
    CoefficientSlopes by = {};
    const Coefficients centre = coefficient_slopes(model, order, state, size, by, memory);
    const Increments motion = {
        memory.zeros(4, 1), memory.zeros(3, 1), memory.zeros(3, 1), memory.zeros(3, 1), memory.zeros(3, 1),
        memory.zeros(9, 1), {memory.numbers(span.count() * LANES), span.count(), LANES}, memory.columns(4, span.count()),
    };
    const IncrementSlopes slopes = {
        memory.zeros(3, sensors), memory.zeros(3, sensors), memory.zeros(3, sensors), memory.zeros(3, sensors),
        memory.zeros(3, sensors), memory.zeros(9, sensors),
    };
    linear_increments(span, signal, centre, by, motion, slopes, memory);
    const Surroundings around = surroundings(model, state, n, memory);
    const Quaternion<double> q0 = quaternion_from(state + model.stored[ATTITUDE]);
    const Navigation before = {
        {q0.w, q0.x, q0.y, q0.z}, in_all_lanes(vector_from(state + model.stored[VELOCITY])),
        in_all_lanes(vector_from(state + model.stored[POSITION])),
    };
    const double T = signal.stamps[last] - signal.stamps[first];
    const MovedNavigation moved = moved_navigation(T, before, motion, slopes, around, at, n, memory);

    // What has moved: the reference's coloured noise fades, navigation is carried along.
    LinearUpdate out = {
        memory.numbers(stored_of(model.tail)), memory.zeros(m + c, n), {}, {memory.numbers(m * c), m, c}, memory.numbers(m), {}, {},
    };
    const Index tail = size - stored_of(model.tail);
    for (Index x = tail; x < size; x++) out.moved[x - tail] = state[x];
    const Table covariance = {memory.numbers(81), 9, 9}, of_navigation = {memory.numbers(81), 9, 9};
    const double each = T > 0.0 ? model.noise_step * static_cast<double>(last - first) / T : 1.0;
    noise_covariance(
        span, each >= 1.0 ? static_cast<Index>(each) : 1, signal, motion.u_path, motion.q_path, first_matrix(centre.rate, 1),
        first_matrix(centre.force, FORCES), covariance, memory);
    navigation_noise(covariance, q0, motion.dq.quaternion_at(0), of_navigation);
    const Columns path = memory.columns(size, 1);
    for (Index x = 0; x < size; x++) path(x, 0) = state[x];
    out.noise = process_noise(model, of_navigation, T, path, memory);
    const double kept = model.coloured[COLOURED_TIME] > 0.0 ? std::exp(-T / model.coloured[COLOURED_TIME]) : 0.0;
    Index row = m;
    for (Index part : {PATH_POSITION, PATH_ORIENTATION}) {
        const Index stored = model.stored[part];
        if (stored < 0) continue;
        add_block(out.slopes, row, degree_of(model.parts, stored), kept * identity());
        for (Index axis = 0; axis < 3; axis++) out.moved[stored - tail + axis] = path(stored + axis, 0);
        row += 3;
    }
    const auto number = [](Vector<Lanes> a) { return Vector<double>{a.x[0], a.y[0], a.z[0]}; };
    const Vector<double> v = number(moved.all.v), p = number(moved.all.p);
    const Quaternion<double> q1 = {moved.all.q.w[0], moved.all.q.x[0], moved.all.q.y[0], moved.all.q.z[0]};
    const double navigation[10] = {v.x, v.y, v.z, p.x, p.y, p.z, q1.w, q1.x, q1.y, q1.z};
    std::memcpy(out.moved + stored_of(model.tail) - 10, navigation, sizeof navigation);
    add(out.slopes, row, identity(), moved.v);
    add(out.slopes, row + 3, identity(), moved.p);
    add(out.slopes, row + 6, identity(), moved.turn);

    // The pose at the reference's own time: equations (11) to (13).
    const ConstNumbers stamps = signal.stamps;
    const double before_it = stamps[last] - stamps[last - 1], after_it = stamps[last + 1] - stamps[last];
    const double t = around.start + (1.0 + around.skew) * steps.tau[i] - stamps[last];
    const Matrix<double> R0 = direction_cosines(q0), R1 = direction_cosines(q1), I = identity();
    const auto force = [&](Index which) { return motion.u_end.rows_from(3 * which, 3).vector_at(0); };
    const Vector<double> u[3] = {force(0), force(1), force(2)};
    const Vector<double> Omega = around.Omega, omega = motion.omega_end.vector_at(0), alpha = motion.alpha_end.vector_at(0);
    // weights of the three forces in their slope at the last sample
    const double whole = 1.0 / (before_it + after_it);
    const double share[3] = {
        -whole * after_it / before_it, whole * (after_it / before_it - before_it / after_it), whole * before_it / after_it};
    const Vector<double> rising = share[0] * u[0] + share[1] * u[1] + share[2] * u[2];
    const Vector<double> a = R0 * u[1] + around.g - 2.0 * cross(Omega, v), jerk = R0 * rising;
    const Vector<double> seen_earth = transpose(R1) * Omega, omega_rb = omega - seen_earth;
    const Vector<double> theta = t * (omega_rb + (0.5 * t) * alpha);
    Vector<double> position = p + t * (v + (0.5 * t) * (a + (t / 3.0) * jerk));
    const Index of_position = model.stored[still ? STANDSTILL_POSITION : PATH_POSITION];
    const Index of_attitude = model.stored[still ? STANDSTILL_ORIENTATION : PATH_ORIENTATION];
    const auto error = [&](Index stored) { return vector_from(stored >= tail ? out.moved + stored - tail : state + stored); };
    if (of_position >= 0) position += error(of_position);
    const ConstTable regressor = steps.regressor[i];
    double reported[6];
    Index *whose = regressor.columns > 0 ? reinterpret_cast<Index *>(memory.numbers(regressor.columns)) : nullptr;
    pose_errors(model, regressor, state, reported, whose);
    position -= vector_from(reported);
    const Vector<double> turned = -vector_from(reported + 3);
    const Vector<double> off = of_attitude >= 0 ? error(of_attitude) : Vector<double>{0.0, 0.0, 0.0};
    const Quaternion<double> attitude = q1 * rotation(theta) * rotation(off) * rotation(turned);
    const Matrix<double> last_turn = transpose(direction_cosines(rotation(turned)));
    const Matrix<double> after_theta = last_turn * transpose(direction_cosines(rotation(off)));
    const Matrix<double> of_off = last_turn * right_jacobian(off), of_theta = after_theta * right_jacobian(theta);

    // Rows of position and orientation: by what has moved, then by all else.
    const Columns by_moved = memory.zeros(6, c), direct = memory.zeros(6, n);
    const Index v_at = c - 9, p_at = c - 6, q_at = c - 3;
    add_block(by_moved, 0, p_at, I);
    add_block(by_moved, 0, v_at, t * I + (-t * t) * skew(Omega));
    add_block(by_moved, 3, q_at, after_theta * transpose(direction_cosines(rotation(theta))) + (-t) * (of_theta * skew(seen_earth)));
    const auto of_error = [&](Index stored, Index to, Matrix<double> A) {
        if (stored < 0) return;
        const Index degree = degree_of(model.parts, stored);
        if (stored >= tail) add_block(by_moved, to, degree - (n - c), A);
        else add_block(direct, to, degree, A);
    };
    of_error(of_position, 0, I);
    of_error(of_attitude, 3, of_off);
    const Vector<double> position_by_t = v + t * (a + (0.5 * t) * jerk), theta_by_t = of_theta * (omega_rb + t * alpha);
    const auto of_time = [&](Index degree, double factor) {
        if (degree < 0) return;
        add_vector(direct, 0, degree, factor * position_by_t);
        add_vector(direct, 3, degree, factor * theta_by_t);
    };
    of_time(around.of_start, 1.0);
    of_time(around.of_skew, steps.tau[i]);
    const double half = 0.5 * t * t, sixth = t * t * t / 6.0;
    add_block(direct, 0, at + 6, -1.0 * (R0 * (half * skew(u[1]) + sixth * skew(rising))));
    for (Index which = 0; which < 3; which++) {
        add(direct, 0, (sixth * share[which] + (which == 1 ? half : 0.0)) * R0, slopes.force.rows_from(3 * which, 3));
    }
    add(direct, 0, half * I, around.by_g);
    add(direct, 0, (t * t) * skew(v), around.by_Omega);
    add(direct, 3, t * of_theta, slopes.omega);
    add(direct, 3, half * of_theta, slopes.alpha);
    add(direct, 3, (-t) * (of_theta * transpose(R1)), around.by_Omega);
    const Matrix<double> of_turned = right_jacobian(turned);
    for (Index e = 0; e < regressor.columns; e++) {
        if (whose[e] < 0) continue;
        add_vector(direct, 0, whose[e], -Vector<double>{regressor(0, e), regressor(1, e), regressor(2, e)});
        add_vector(direct, 3, whose[e], of_turned * -Vector<double>{regressor(3, e), regressor(4, e), regressor(5, e)});
    }
    const auto see = [&](Index to, Index kind) {
        for (Index axis = 0; axis < 3; axis++) {
            double *design = out.slopes.row(to + axis);
            const double *by_tail = by_moved.row(3 * kind + axis), *others = direct.row(3 * kind + axis);
            for (Index s = 0; s < out.slopes.columns; s += LANES) store(load(others + s), design + s);
            for (Index j = 0; j < c; j++) {
                const Lanes factor = by_tail[j];
                if (by_tail[j] == 0.0) continue;
                for (Index s = 0; s < out.slopes.columns; s += LANES) store(load(design + s) + factor * load(out.slopes.row(m + j) + s), design + s);
            }
            for (Index k = 0; k < c; k++) {
                double total = 0.0;
                for (Index j = 0; j < c; j++) total += by_tail[j] * out.noise(j, k);
                out.noise_seen(to + axis, k) = total;
            }
        }
    };
    Index to = 0;
    if (steps.given[0]) {
        const double by_axis[3] = {position.x, position.y, position.z};
        for (Index axis = 0; axis < 3; axis++) out.innovation[axis] = steps.position(i, axis) - by_axis[axis];
        see(to, 0);
        to += 3;
    }
    if (steps.given[1]) {
        const Vector<double> turn = rotation_vector(conjugate(attitude) * quaternion_from(steps.quaternion.row(i)));
        out.innovation[to] = turn.x, out.innovation[to + 1] = turn.y, out.innovation[to + 2] = turn.z;
        see(to, 1);
        to += 3;
    }
    if (still) {
        fill(by_moved, 0.0);
        fill(direct, 0.0);
        add_block(by_moved, 0, v_at, I);
        const double velocity[3] = {v.x, v.y, v.z};
        for (Index axis = 0; axis < 3; axis++) out.innovation[to + axis] = -velocity[axis];  // equation (14)
        see(to, 0);
    }
    out.passing = {v, omega};
    out.factor = measurement_noise(model, steps, i, out.passing, memory);
    return out;
}

}  // namespace
