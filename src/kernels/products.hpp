/// Products of matrices, added to what is there.
#pragma once

#include "arrays.hpp"

namespace {

/// Add to WIDE lanes of ROWS rows of `out` a sign times rows of `a` times `x`: strides say where numbers of `a` lie.
template <int ROWS, int WIDE>
inline void add_block(
    const double *a, Index by_row, Index by_inner, Index inner, double sign, const double *x, double *out, Index stride
) {
    Lanes sums[ROWS][WIDE];
    for (auto &row : sums) {
        for (Lanes &lanes : row) lanes = 0.0;
    }
    for (Index k = 0; k < inner; k++) {
        Lanes own[WIDE];
        for (int w = 0; w < WIDE; w++) own[w] = load(x + k * stride + w * LANES);
        for (int i = 0; i < ROWS; i++) {
            const Lanes factor = a[i * by_row + k * by_inner];
            for (int w = 0; w < WIDE; w++) sums[i][w] += factor * own[w];
        }
    }
    for (int i = 0; i < ROWS; i++) {
        for (int w = 0; w < WIDE; w++) {
            double *at = out + i * stride + w * LANES;
            store(load(at) + sign * sums[i][w], at);
        }
    }
}

template <int ROWS>
inline void add_rows(const double *a, Index by_row, Index by_inner, double sign, Columns x, double *out) {
    const Index stride = x.columns;
    Index s = 0;
    for (; s + 2 * LANES <= stride; s += 2 * LANES) {
        add_block<ROWS, 2>(a, by_row, by_inner, x.rows, sign, x.data + s, out + s, stride);
    }
    if (s < stride) add_block<ROWS, 1>(a, by_row, by_inner, x.rows, sign, x.data + s, out + s, stride);
}

/// Add to `out` a sign times the matrix of which entry (i, k) is a[i * by_row + k * by_inner] times `x`.
inline void add_product(const double *a, Index by_row, Index by_inner, double sign, Columns x, Columns out) {
    Index i = 0;
    for (; i + 6 <= out.rows; i += 6) add_rows<6>(a + i * by_row, by_row, by_inner, sign, x, out.row(i));
    for (; i + 3 <= out.rows; i += 3) add_rows<3>(a + i * by_row, by_row, by_inner, sign, x, out.row(i));
    for (; i < out.rows; i++) add_rows<1>(a + i * by_row, by_row, by_inner, sign, x, out.row(i));
}

inline void add_product(ConstTable a, double sign, Columns x, Columns out) {
    add_product(a.data, a.columns, 1, sign, x, out);
}

inline void add_transposed_product(ConstTable a, double sign, Columns x, Columns out) {
    add_product(a.data, 1, a.columns, sign, x, out);
}

}  // namespace
