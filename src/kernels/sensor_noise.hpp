/// What white noise of the readings leaves in attitude, velocity and position along a path.
#pragma once

#include "samples.hpp"

namespace {

/// Symmetric covariance of attitude, velocity and position by its blocks; each lane a part of it.
struct NavigationCovariance {
    Matrix<Lanes> attitude, velocity, position;  // variances
    Matrix<Lanes> velocity_attitude, position_attitude, velocity_position;
};

/// The covariance C B diag(variance) B^T C^T.
inline Matrix<Lanes> turned_variance(const Matrix<Lanes> &C, Matrix<double> B, Vector<Lanes> variance) {
    Matrix<Lanes> G;
    for (Index i = 0; i < 3; i++) {
        const Vector<double> b = B.row[i];
        G.row[i] = {b.x, b.y, b.z};
    }
    G = C * G;
    Matrix<Lanes> scaled;
    for (Index i = 0; i < 3; i++) {
        scaled.row[i] = {variance.x * G.row[i].x, variance.y * G.row[i].y, variance.z * G.row[i].z};
    }
    return scaled * transpose(G);
}

/// What a step of some samples leaves at the end of the span, seen from its beginning: forces after it, summed.
struct StepNoise {
    Columns q;          // (4, k): attitude in the step's middle
    Columns V, S;       // (3, k): what an error of attitude after the step makes of velocity and position, -V x, -S x
    Columns rest, dt;   // (1, k): s from the step's end to the span's, and its own length
    Columns rate, force;  // (3, k): variances of the integrated noise
};

/// Write the covariance that sensor noise leaves in attitude, velocity and position, (9, 9): equation (10).
///
/// Seen from the body's attitude at the first sample; attitude errors as left perturbations in that frame. `every`
/// samples are taken together, with force and attitude in their middle: an error theta of attitude moves velocity by
/// -u x theta dt and position by -u x theta dt^2/2 in each step, and an error of velocity moves position.
///
/// White noise of a density, and where samples are missing what interpolating across a gap of length h leaves, about
/// h^3/12 times the second derivative the readings usually have.
inline void noise_covariance(
    Span span, Index every, const Samples &signal, Table u_path, Columns q_path, Matrix<double> K_omega,
    Matrix<double> K_a, Table Q, Workspace &memory
) {
    const Index samples = span.last - span.first, steps = (samples + every - 1) / every;
    const double missing = 1.6 * signal.usual;
    const ConstTable density = signal.noise;
    const StepNoise of = {
        memory.zeros(4, steps), memory.zeros(3, steps), memory.zeros(3, steps), memory.zeros(1, steps),
        memory.zeros(1, steps), memory.zeros(3, steps), memory.zeros(3, steps),
    };
    Vector<double> V = {0.0, 0.0, 0.0}, S = {0.0, 0.0, 0.0};
    double rest = 0.0;
    for (Index step = steps - 1; step >= 0; step--) {
        const Index start = span.first + step * every;
        const Index stop = start + every < span.last ? start + every : span.last;
        const Index middle = (start + stop) / 2 - span.low;
        const double dt = signal.stamps[stop] - signal.stamps[start];
        double bridged = 0.0;
        for (Index k = start; k < stop; k++) {
            const double h = signal.stamps[k + 1] - signal.stamps[k];
            if (h > missing) bridged += (h * h * h / 12.0) * (h * h * h / 12.0);
        }
        for (Index axis = 0; axis < 3; axis++) {
            of.rate(axis, step) = density(0, axis) * dt + density(2, axis) * density(2, axis) * bridged;
            of.force(axis, step) = density(1, axis) * dt + density(3, axis) * density(3, axis) * bridged;
        }
        of.q.set_at(step, q_path.quaternion_at(middle));
        of.V(0, step) = V.x, of.V(1, step) = V.y, of.V(2, step) = V.z;
        of.S(0, step) = S.x, of.S(1, step) = S.y, of.S(2, step) = S.z;
        of.rest(0, step) = rest;
        of.dt(0, step) = dt;
        const Vector<double> u = vector_from(u_path.row(middle));
        S += (0.5 * dt * dt + dt * rest) * u;
        V += dt * u;
        rest += dt;
    }
    const Matrix<Lanes> zero = {{{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}}};
    NavigationCovariance total = {zero, zero, zero, zero, zero, zero};
    for (Index s = 0; s < of.q.columns; s += LANES) {
        const Matrix<Lanes> C = direction_cosines(of.q.quaternion(s));
        const Matrix<Lanes> turn = turned_variance(C, K_omega, of.rate.vector(s));
        const Matrix<Lanes> force = turned_variance(C, K_a, of.force.vector(s));
        const Vector<Lanes> V_s = -of.V.vector(s), S_s = -of.S.vector(s);
        const Matrix<Lanes> v_theta = cross(V_s, turn), p_theta = cross(S_s, turn);
        const Lanes dt = load(of.dt.row(0) + s), T = load(of.rest.row(0) + s);
        total.attitude = total.attitude + turn;
        total.velocity_attitude = total.velocity_attitude + v_theta;
        total.position_attitude = total.position_attitude + p_theta;
        total.velocity = total.velocity + cross(V_s, transpose(v_theta)) + force;
        total.velocity_position = total.velocity_position + cross(V_s, transpose(p_theta)) + (0.5 * dt + T) * force;
        // the noise is white within the interval: variance of its integral is dt^2/3, not dt^2/4
        total.position =
            total.position + cross(S_s, transpose(p_theta)) + (dt * dt * (1.0 / 3.0) + T * dt + T * T) * force;
    }
    const auto set = [&](Index row, Index column, const Matrix<Lanes> &block, bool turned) {
        for (Index i = 0; i < 3; i++) {
            const double x[3] = {sum(block.row[i].x), sum(block.row[i].y), sum(block.row[i].z)};
            for (Index j = 0; j < 3; j++) (turned ? Q(row + j, column + i) : Q(row + i, column + j)) = x[j];
        }
    };
    set(0, 0, total.attitude, false);
    set(3, 3, total.velocity, false);
    set(6, 6, total.position, false);
    set(3, 0, total.velocity_attitude, false);
    set(0, 3, total.velocity_attitude, true);
    set(6, 0, total.position_attitude, false);
    set(0, 6, total.position_attitude, true);
    set(3, 6, total.velocity_position, false);
    set(6, 3, total.velocity_position, true);
}

/// The block of a matrix that begins at a row and column.
inline Matrix<double> block(Table Q, Index row, Index column) {
    return {{vector_from(Q.row(row) + column), vector_from(Q.row(row + 1) + column), vector_from(Q.row(row + 2) + column)}};
}

/// Write the lower triangular factor (9, 9) of noise in velocity, position and attitude, in r, r and b.
///
/// Q (9, 9): see `noise_covariance`. q_first: attitude at the first sample; dq: the turn from there to the last.
inline void navigation_noise(Table Q, Quaternion<double> q_first, Quaternion<double> dq, Table out) {
    const Matrix<double> C = direction_cosines(q_first), D = transpose(direction_cosines(dq));
    const Matrix<double> turn[3] = {C, C, D};
    const Index from[3] = {3, 6, 0};
    double P[81];
    const Table covariance = {P, 9, 9};
    for (Index a = 0; a < 3; a++) {
        for (Index b = 0; b < 3; b++) {
            const Matrix<double> turned = turn[a] * block(Q, from[a], from[b]) * transpose(turn[b]);
            for (Index i = 0; i < 3; i++) {
                covariance(3 * a + i, 3 * b) = turned.row[i].x;
                covariance(3 * a + i, 3 * b + 1) = turned.row[i].y;
                covariance(3 * a + i, 3 * b + 2) = turned.row[i].z;
            }
        }
    }
    fill(out, 0.0);
    for (Index j = 0; j < 9; j++) {
        double left = covariance(j, j);
        for (Index k = 0; k < j; k++) left -= out(j, k) * out(j, k);
        // velocity and position noise are nearly the same thing over one sample
        out(j, j) = std::sqrt(std::fmax(std::fmax(left, 1e-13 * covariance(j, j)), 1e-300));
        const double scale = 1.0 / out(j, j);
        for (Index i = j + 1; i < 9; i++) {
            double total = covariance(i, j);
            for (Index k = 0; k < j; k++) total -= out(i, k) * out(j, k);
            out(i, j) = total * scale;
        }
    }
}

}  // namespace
