/// Kinematics of a serial arm: pose, motion and derivatives of its tool for joint angles.
#pragma once

#include "arrays.hpp"

namespace {

/// A chain of joints, each turning about or moving along one axis. Python's side is `kreisel._kernels.joint_chain`.
struct Chain {
    ConstTable rotations;     // (joints + 1, 9): of each joint's placement on the link before, row by row; the last is the tool's
    ConstTable translations;  // (joints + 1, 3)
    ConstTable axes;          // (joints, 3): in the placement's own frame
    Mask turning;        // (joints,): whether it turns about its axis; else it moves along it
    ConstTable bodies;        // (joints, 4): mass of what moves with each joint, and its centre in the joint's frame
};

/// A frame and its motion against the base, all in the base's axes.
struct Frame {
    Matrix<double> C;
    Vector<double> p, v, a, omega, alpha;

    /// Move the origin by a vector that turns with the frame.
    void shift(Vector<double> r) {
        p += r;
        v += cross(omega, r);
        a += cross(alpha, r) + cross(omega, cross(omega, r));
    }
};

inline Matrix<double> matrix_from(const double *p) { return {{vector_from(p), vector_from(p + 3), vector_from(p + 6)}}; }

/// The rotation by an angle about a unit axis.
inline Matrix<double> turn_about(Vector<double> axis, double angle) {
    const double half = 0.5 * angle, s = std::sin(half);
    return direction_cosines(Quaternion<double>{std::cos(half), s * axis.x, s * axis.y, s * axis.z});
}

inline Frame base_frame() {
    const Vector<double> zero = {0.0, 0.0, 0.0};
    return {{{{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}}, zero, zero, zero, zero, zero};
}

/// Onto the placement of joint i, or of the tool if i is their number.
inline void place(const Chain &chain, Index i, Frame &frame) {
    frame.shift(frame.C * vector_from(chain.translations.row(i)));
    frame.C = frame.C * matrix_from(chain.rotations.row(i));
}

/// Through joint i at an angle, with its rate and acceleration.
inline void move(const Chain &chain, Index i, double angle, double rate, double acceleration, Frame &frame) {
    const Vector<double> own = vector_from(chain.axes.row(i)), axis = frame.C * own;
    const Vector<double> moving = rate * axis;
    if (chain.turning[i]) {
        frame.alpha += acceleration * axis + cross(frame.omega, moving);
        frame.omega += moving;
        frame.C = frame.C * turn_about(own, angle);
    } else {
        frame.shift(angle * axis);
        frame.v += moving;
        frame.a += acceleration * axis + 2.0 * cross(frame.omega, moving);
    }
}

inline void set_row(Table out, Index i, Vector<double> v) { out(i, 0) = v.x, out(i, 1) = v.y, out(i, 2) = v.z; }

/// Write the tool's attitudes (n, 4), without jumps of sign, and its position, velocity and acceleration in the base's axes, rate and
/// angular acceleration in its own, (n, 3) each, for joint angles, rates and accelerations (n, joints).
inline void chain_motion(
    const Chain &chain, ConstTable angles, ConstTable rates, ConstTable accelerations, Table q, Table p, Table v, Table a, Table omega,
    Table alpha
) {
    const Index joints = angles.columns;
    for (Index k = 0; k < angles.rows; k++) {
        Frame frame = base_frame();
        for (Index i = 0; i < joints; i++) {
            place(chain, i, frame);
            move(chain, i, angles(k, i), rates(k, i), accelerations(k, i), frame);
        }
        place(chain, joints, frame);
        const Matrix<double> back = transpose(frame.C);
        const Quaternion<double> attitude = quaternion_of(frame.C);
        const double *last = q.row(k > 0 ? k - 1 : 0);
        const double along = attitude.w * last[0] + attitude.x * last[1] + attitude.y * last[2] + attitude.z * last[3];
        const double sign = k > 0 && along < 0.0 ? -1.0 : 1.0;
        q(k, 0) = sign * attitude.w, q(k, 1) = sign * attitude.x, q(k, 2) = sign * attitude.y, q(k, 3) = sign * attitude.z;
        set_row(p, k, frame.p);
        set_row(v, k, frame.v);
        set_row(a, k, frame.a);
        set_row(omega, k, back * frame.omega);
        set_row(alpha, k, back * frame.alpha);
    }
}

constexpr Index MAX_JOINTS = 64;

/// Write the tool's pose differentiated by errors of the placements, (n, 6, 6 (joints + 1)), and by the joint angles,
/// (n, 6, joints): position in the base's axes, rotation in the tool's; and the torques or forces that hold the arm
/// against gravity, (n, joints). Gravity points down the base's z axis.
inline void chain_derivatives(
    const Chain &chain, ConstTable angles, double gravity, Stack regressor, Stack jacobian, Table torques
) {
    const Index joints = angles.columns;
    Matrix<double> placed[MAX_JOINTS + 1];
    Vector<double> origin[MAX_JOINTS + 1], axis[MAX_JOINTS], centre[MAX_JOINTS];
    for (Index k = 0; k < angles.rows; k++) {
        Frame frame = base_frame();
        for (Index i = 0; i < joints; i++) {
            place(chain, i, frame);
            placed[i] = frame.C;
            origin[i] = frame.p;
            axis[i] = frame.C * vector_from(chain.axes.row(i));
            move(chain, i, angles(k, i), 0.0, 0.0, frame);
            centre[i] = frame.p + frame.C * vector_from(chain.bodies.row(i) + 1);
        }
        place(chain, joints, frame);
        placed[joints] = frame.C;
        origin[joints] = frame.p;
        const Matrix<double> back = transpose(frame.C);
        const auto set = [](Table out, Index row, Index column, Vector<double> value) {
            out(row, column) = value.x, out(row + 1, column) = value.y, out(row + 2, column) = value.z;
        };
        const Vector<double> zero = {0.0, 0.0, 0.0};
        for (Index i = 0; i <= joints; i++) {
            const Vector<double> arm = frame.p - origin[i];
            const Matrix<double> columns = transpose(placed[i]);
            for (Index j = 0; j < 3; j++) {
                set(regressor[k], 0, 6 * i + j, columns.row[j]);
                set(regressor[k], 3, 6 * i + j, zero);
                set(regressor[k], 0, 6 * i + 3 + j, cross(columns.row[j], arm));
                set(regressor[k], 3, 6 * i + 3 + j, back * columns.row[j]);
            }
        }
        double mass = 0.0;
        Vector<double> moment = zero;  // of the masses beyond a joint
        for (Index i = joints - 1; i >= 0; i--) {
            mass += chain.bodies(i, 0);
            moment += chain.bodies(i, 0) * centre[i];
            const bool turning = chain.turning[i];
            set(jacobian[k], 0, i, turning ? cross(axis[i], frame.p - origin[i]) : axis[i]);
            set(jacobian[k], 3, i, turning ? back * axis[i] : zero);
            const Vector<double> raised = turning ? cross(axis[i], moment - mass * origin[i]) : mass * axis[i];
            torques(k, i) = gravity * raised.z;
        }
    }
}

}  // namespace
