/// Unit quaternions, of numbers or of lanes. They turn vectors from the frame on their right to that on their left.
#pragma once

#include "vector.hpp"

namespace {

template <class T>
struct Quaternion {
    T w, x, y, z;

    Vector<T> imaginary() const { return {x, y, z}; }
};

template <class T>
inline Quaternion<T> operator*(Quaternion<T> a, Quaternion<T> b) {
    return {
        a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
        a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
        a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
        a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
    };
}

template <class T>
inline Quaternion<T> conjugate(Quaternion<T> q) { return {q.w, -q.x, -q.y, -q.z}; }

/// The vector turned by q.
template <class T>
inline Vector<T> rotate(Quaternion<T> q, Vector<T> v) {
    const Vector<T> u = q.imaginary(), half = cross(u, v), t = half + half;
    return v + q.w * t + cross(u, t);
}

template <class T>
inline Matrix<T> direction_cosines(Quaternion<T> q) {
    const T w = q.w, x = q.x, y = q.y, z = q.z;
    return {{
        {1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)},
        {2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)},
        {2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)},
    }};
}

/// The unit quaternion of a rotation matrix, by its largest component (Shepperd 1978); its sign is either.
inline Quaternion<double> quaternion_of(Matrix<double> C) {
    const double xx = C.row[0].x, yy = C.row[1].y, zz = C.row[2].z, trace = xx + yy + zz;
    const double zy = C.row[2].y - C.row[1].z, xz = C.row[0].z - C.row[2].x, yx = C.row[1].x - C.row[0].y;
    const double xy = C.row[0].y + C.row[1].x, zx = C.row[0].z + C.row[2].x, yz = C.row[1].z + C.row[2].y;
    Quaternion<double> q = {1.0 + trace, zy, xz, yx};
    if (xx > trace && xx >= yy && xx >= zz) {
        q = {zy, 1.0 + 2.0 * xx - trace, xy, zx};
    } else if (yy > trace && yy >= zz) {
        q = {xz, xy, 1.0 + 2.0 * yy - trace, yz};
    } else if (zz > trace) {
        q = {yx, zx, yz, 1.0 + 2.0 * zz - trace};
    }
    const double scale = 1.0 / std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    return {scale * q.w, scale * q.x, scale * q.y, scale * q.z};
}

/// exp(theta) for |theta| below one radian: cosine and sinc as series to the twelfth power of the half angle, which
/// leaves less than the rounding error and needs no branch.
template <class T>
inline Quaternion<T> small_rotation(Vector<T> theta) {
    const Vector<T> half = T(0.5) * theta;
    const T h = dot(half, half);
    const T c = 1.0 - h * (1.0 / 2.0) *
        (1.0 - h * (1.0 / 12.0) * (1.0 - h * (1.0 / 30.0) * (1.0 - h * (1.0 / 56.0) * (1.0 - h * (1.0 / 90.0) * (1.0 - h * (1.0 / 132.0))))));
    const T k = 1.0 - h * (1.0 / 6.0) *
        (1.0 - h * (1.0 / 20.0) * (1.0 - h * (1.0 / 42.0) * (1.0 - h * (1.0 / 72.0) * (1.0 - h * (1.0 / 110.0) * (1.0 - h * (1.0 / 156.0))))));
    return {c, k * half.x, k * half.y, k * half.z};
}

/// exp(theta) for an angle of any size.
inline Quaternion<double> rotation(Vector<double> theta) {
    const double half = 0.5 * std::sqrt(dot(theta, theta));
    const double k = half == 0.0 ? 0.5 : 0.5 * std::sin(half) / half;
    return {std::cos(half), k * theta.x, k * theta.y, k * theta.z};
}

/// The products of the turns up to each lane, begun with `before`.
inline Quaternion<Lanes> products_from(Quaternion<Lanes> before, Quaternion<Lanes> turn) {
    const Lanes one = 1.0, zero = 0.0;
    turn = Quaternion<Lanes>{up_by_one(turn.w, one), up_by_one(turn.x, zero), up_by_one(turn.y, zero), up_by_one(turn.z, zero)} * turn;
    turn = Quaternion<Lanes>{up_by_two(turn.w, one), up_by_two(turn.x, zero), up_by_two(turn.y, zero), up_by_two(turn.z, zero)} * turn;
    return before * turn;
}

inline Quaternion<Lanes> last_lane(Quaternion<Lanes> q) {
    return {last_lane(q.w), last_lane(q.x), last_lane(q.y), last_lane(q.z)};
}

/// log(q), at most pi long.
inline Vector<double> rotation_vector(Quaternion<double> q) {
    const Vector<double> v = q.imaginary();
    const double length = std::sqrt(dot(v, v));
    const double k = length == 0.0 ? 2.0 : 2.0 * std::atan2(length, std::fabs(q.w)) / length;
    return (q.w < 0.0 ? -k : k) * v;
}

}  // namespace
