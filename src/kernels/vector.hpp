/// Vectors and 3 x 3 matrices, of numbers or of lanes.
#pragma once

#include "lanes.hpp"

namespace {

template <class T>
struct Vector {
    T x, y, z;
};

template <class T>
inline Vector<T> operator+(Vector<T> a, Vector<T> b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
template <class T>
inline Vector<T> operator-(Vector<T> a, Vector<T> b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
template <class T>
inline Vector<T> operator-(Vector<T> a) { return {-a.x, -a.y, -a.z}; }
template <class T>
inline Vector<T> operator*(T c, Vector<T> a) { return {c * a.x, c * a.y, c * a.z}; }
inline Vector<Lanes> operator*(double c, Vector<Lanes> a) { return Lanes(c) * a; }
template <class T>
inline Vector<T> &operator+=(Vector<T> &a, Vector<T> b) { return a = a + b; }
template <class T>
inline Vector<T> &operator-=(Vector<T> &a, Vector<T> b) { return a = a - b; }

template <class T>
inline T dot(Vector<T> a, Vector<T> b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

template <class T>
inline Vector<T> cross(Vector<T> a, Vector<T> b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/// The same vector in all lanes.
inline Vector<Lanes> in_all_lanes(Vector<double> a) { return {a.x, a.y, a.z}; }

/// A matrix, given by its rows.
template <class T>
struct Matrix {
    Vector<T> row[3];
};

template <class T>
inline Matrix<T> operator+(Matrix<T> A, Matrix<T> B) {
    return {{A.row[0] + B.row[0], A.row[1] + B.row[1], A.row[2] + B.row[2]}};
}
template <class T>
inline Matrix<T> operator*(T c, Matrix<T> A) { return {{c * A.row[0], c * A.row[1], c * A.row[2]}}; }
template <class T>
inline Vector<T> operator*(Matrix<T> A, Vector<T> x) { return {dot(A.row[0], x), dot(A.row[1], x), dot(A.row[2], x)}; }

template <class T>
inline Matrix<T> transpose(Matrix<T> A) {
    return {{{A.row[0].x, A.row[1].x, A.row[2].x}, {A.row[0].y, A.row[1].y, A.row[2].y}, {A.row[0].z, A.row[1].z, A.row[2].z}}};
}

template <class T>
inline Matrix<T> operator*(Matrix<T> A, Matrix<T> B) {
    const Matrix<T> columns = transpose(B);
    return transpose(Matrix<T>{{A * columns.row[0], A * columns.row[1], A * columns.row[2]}});
}

/// The matrix whose columns are a x (columns of B): the product of [a x] and B.
template <class T>
inline Matrix<T> cross(Vector<T> a, Matrix<T> B) {
    return {{a.y * B.row[2] - a.z * B.row[1], a.z * B.row[0] - a.x * B.row[2], a.x * B.row[1] - a.y * B.row[0]}};
}

template <class T>
inline Matrix<T> inverse(Matrix<T> A) {
    const Vector<T> a = cross(A.row[1], A.row[2]), b = cross(A.row[2], A.row[0]), c = cross(A.row[0], A.row[1]);
    const T scale = 1.0 / dot(A.row[0], a);
    return transpose(Matrix<T>{{scale * a, scale * b, scale * c}});
}

}  // namespace
