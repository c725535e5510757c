/// Views of arrays that somebody else owns. Those that Python passes are contiguous: a pointer and the axes' lengths.
#pragma once

#include "rotation.hpp"

namespace {

/// What is only read: `const` in front of the element.
struct ConstNumbers {
    const double *data;
    Index count;

    double operator[](Index i) const { return data[i]; }
};

struct Indices {
    const Index *data;
    Index count;

    Index operator[](Index i) const { return data[i]; }
};

struct Mask {
    const std::uint8_t *data;
    Index count;

    std::uint8_t operator[](Index i) const { return data[i]; }
};

struct IndexTable {
    const Index *data;
    Index rows, columns;

    Index operator()(Index i, Index j) const { return data[i * columns + j]; }
};

struct ConstTable {
    const double *data;
    Index rows, columns;

    const double *row(Index i) const { return data + i * columns; }
    double operator()(Index i, Index j) const { return data[i * columns + j]; }
};

struct ConstStack {
    const double *data;
    Index tables, rows, columns;

    ConstTable operator[](Index i) const { return {data + i * rows * columns, rows, columns}; }
};

/// What is written, too.
struct Numbers {
    double *data;
    Index count;

    double &operator[](Index i) const { return data[i]; }
    operator ConstNumbers() const { return {data, count}; }
};

struct WrittenIndices {
    Index *data;
    Index count;

    Index &operator[](Index i) const { return data[i]; }
};

struct WrittenIndexTable {
    Index *data;
    Index rows, columns;
};

struct WrittenMask {
    std::uint8_t *data;
    Index count;

    std::uint8_t &operator[](Index i) const { return data[i]; }
};

struct Table {
    double *data;
    Index rows, columns;

    double *row(Index i) const { return data + i * columns; }
    double &operator()(Index i, Index j) const { return data[i * columns + j]; }
    operator ConstTable() const { return {data, rows, columns}; }
};

struct Stack {
    double *data;
    Index tables, rows, columns;

    Table operator[](Index i) const { return {data + i * rows * columns, rows, columns}; }
};

/// A table whose columns belong to sigma points, parameter sets or samples. Their number is a multiple of the lanes:
/// after those that count stand columns that do not, with finite numbers in them.
struct Columns : Table {
    Columns rows_from(Index i, Index size) const { return {{data + i * columns, size, columns}}; }
    Vector<Lanes> vector(Index i, Index s) const { return {load(row(i) + s), load(row(i + 1) + s), load(row(i + 2) + s)}; }
    Vector<Lanes> vector(Index s) const { return vector(0, s); }
    Quaternion<Lanes> quaternion(Index s) const {
        return {load(row(0) + s), load(row(1) + s), load(row(2) + s), load(row(3) + s)};
    }
    Vector<double> vector_at(Index j) const { return {(*this)(0, j), (*this)(1, j), (*this)(2, j)}; }
    Quaternion<double> quaternion_at(Index j) const { return {(*this)(0, j), (*this)(1, j), (*this)(2, j), (*this)(3, j)}; }
    void set(Index i, Index s, Vector<Lanes> a) const {
        store(a.x, row(i) + s);
        store(a.y, row(i + 1) + s);
        store(a.z, row(i + 2) + s);
    }
    void set(Index s, Vector<Lanes> a) const { set(0, s, a); }
    void set(Index s, Quaternion<Lanes> q) const {
        store(q.w, row(0) + s);
        set(1, s, q.imaginary());
    }
    void set_at(Index j, Quaternion<double> q) const {
        (*this)(0, j) = q.w;
        (*this)(1, j) = q.x;
        (*this)(2, j) = q.y;
        (*this)(3, j) = q.z;
    }
};

/// An order of numbers in an array: places by name, and the names as text for Python, which has no list of its own.
#define ORDER(name, ...) \
    enum { __VA_ARGS__ }; \
    constexpr char name##_order[] = #__VA_ARGS__

inline Vector<double> vector_from(const double *p) { return {p[0], p[1], p[2]}; }
inline Quaternion<double> quaternion_from(const double *p) { return {p[0], p[1], p[2], p[3]}; }

inline void fill(Table table, double value) {
    for (Index i = 0; i < table.rows * table.columns; i++) table.data[i] = value;
}

/// Write the first rows and columns of one table into another.
inline void copy(Table from, Table to, Index rows, Index columns) {
    for (Index i = 0; i < rows; i++) std::memcpy(to.row(i), from.row(i), columns * sizeof(double));
}

}  // namespace
