/// Orthogonal triangularisation of covariance factors, for states of which few change between updates.
#pragma once

#include "arrays.hpp"
#include "workspace.hpp"

namespace {

constexpr Index MOST_MEASURED = 9;  ///< numbers a measurement has: position, orientation, velocity

/// The product of two rows from `begin` to `end`.
inline double product(const double *a, const double *b, Index begin, Index end) {
    Lanes total = 0.0, more = 0.0;
    Index i = begin;
    for (; i + 2 * LANES <= end; i += 2 * LANES) {
        total += load(a + i) * load(b + i);
        more += load(a + i + LANES) * load(b + i + LANES);
    }
    for (; i < end; i += LANES) total += load(a + i, end - i) * load(b + i, end - i);
    return sum(total + more);
}

/// Make a matrix upper triangular, given by its columns (r, k), k >= r, by Householder's reflections.
///
/// Row i of `columns` is column i of the matrix, with `used` entries; below the diagonal it is not made zero. The
/// diagonal may come out negative.
inline void reflect(Table columns, Index used) {
    for (Index i = 0; i < columns.rows; i++) {
        double *own = columns.row(i);
        const double below = product(own, own, i + 1, used);
        if (below == 0.0) continue;
        const double pivot = own[i], length = std::sqrt(pivot * pivot + below);
        // reflected to the far side, so that nothing cancels
        const double head = pivot + (pivot >= 0.0 ? length : -length), scale = 2.0 / (head * head + below);
        for (Index j = i + 1; j < columns.rows; j++) {
            double *other = columns.row(j);
            const double share = scale * (head * other[i] + product(own, other, i + 1, used));
            other[i] -= share * head;
            Index a = i + 1;
            for (; a + LANES <= used; a += LANES) store(load(other + a) - Lanes(share) * load(own + a), other + a);
            for (; a < used; a++) other[a] -= share * own[a];
        }
        own[i] = pivot >= 0.0 ? -length : length;
    }
}

/// Replace rows (k, r), k >= r, by an upper triangular matrix above zeros, with the same rows^T rows; the diagonal comes
/// out positive.
inline void triangularise(Table rows, Workspace &memory) {
    const Table columns = memory.columns(rows.columns, rows.rows);
    for (Index i = 0; i < rows.columns; i++) {
        for (Index j = 0; j < rows.rows; j++) columns(i, j) = rows(j, i);
    }
    reflect(columns, rows.rows);
    fill(rows, 0.0);
    for (Index i = 0; i < rows.columns; i++) {
        const double sign = columns(i, i) < 0.0 ? -1.0 : 1.0;
        for (Index j = i; j < rows.columns; j++) rows(i, j) = sign * columns(j, i);
    }
}

/// The joint covariance of a measurement and of a state after its last c degrees of freedom moved, as the outer product
/// of the array of columns
///
///     [ seen  | seen_further  ]
///     [ held  |      0        ]
///     [ moved | moved_further ]
///
/// `held` is lower triangular: the first n - c rows, untransposed, of the factor before the step.
struct Joint {
    Columns first;    // (m + c, n): the columns of measurement and moved, one for each degree of freedom
    Columns upper;    // (n, n): lower triangular factor before the step, transposed; zeros below its diagonal
    Table further;    // (m + c, at least k)
    Index used;       // k: columns of `further` that count
};

/// What a measurement leaves.
struct Conditioned {
    Table innovation_factor;  // (m, m): of the innovation's covariance
    double *whitened;         // (m,): the innovation divided by it
    Columns gain;             // (m, n): cross-covariance times the factor's inverse transpose, transposed
    Columns posterior;        // (n, n): factor of the state's covariance once measured, transposed; may be the prior's
};

/// A rotation of two columns.
struct Rotation {
    double c, s;
};

/// Rotate a column (n,) into M pivots, (M, n), from the lane of row `begin` on.
inline void rotate_into(const Rotation *rotations, Index M, Columns pivots, double *column, Index begin) {
    for (Index r = begin / LANES * LANES; r < pivots.columns; r += LANES) {
        Lanes rest = load(column + r);
        for (Index i = 0; i < M; i++) {
            const Lanes c = rotations[i].c, s = rotations[i].s, pivot = load(pivots.row(i) + r);
            store(c * pivot + s * rest, pivots.row(i) + r);
            rest = c * rest - s * pivot;
        }
        store(rest, column + r);
    }
}

/// Write what a measurement leaves of a covariance after its last degrees of freedom moved: equation (19).
///
/// The array of `Joint` is made lower triangular by rotations of its columns; `held` is so already, and stays so all the
/// way. With m = 0 measurements the posterior is the predicted covariance.
inline void condition(Joint joint, Index n, Index m, const double *innovation, Conditioned out, Workspace &memory) {
    const Index changing = joint.first.rows - m, held = n - changing, r = m + changing;
    // What does not touch the held degrees of freedom is small, and triangularised alone.
    const Index k = changing + joint.used > r ? changing + joint.used : r;
    const Columns small = memory.zeros(r, k);
    for (Index i = 0; i < r; i++) {
        std::memcpy(small.row(i), joint.first.row(i) + held, changing * sizeof(double));
        std::memcpy(small.row(i) + changing, joint.further.row(i), joint.used * sizeof(double));
    }
    reflect(small, k);
    const auto triangular = [&](Index i, Index j) { return small(i, i) < 0.0 ? -small(j, i) : small(j, i); };
    double head[MOST_MEASURED][MOST_MEASURED] = {};
    const Columns pivots = out.gain;
    fill(pivots, 0.0);
    for (Index i = 0; i < m; i++) {
        for (Index j = i; j < m; j++) head[i][j] = triangular(i, j);
        for (Index j = 0; j < changing; j++) pivots(i, held + j) = triangular(i, m + j);
    }
    for (Index i = 0; i < changing; i++) {
        double *row = out.posterior.row(held + i);
        for (Index j = 0; j < held + i; j++) row[j] = 0.0;
        for (Index j = i; j < changing; j++) row[held + j] = triangular(m + i, m + j);
    }
    // Each column is rotated into the measurements' pivots, from the last to the first: a pivot then holds nothing above
    // the row where the column begins.
    for (Index j = held - 1; j >= 0; j--) {
        double *column = out.posterior.row(j), seen[MOST_MEASURED];
        if (column != joint.upper.row(j)) std::memcpy(column, joint.upper.row(j), held * sizeof(double));
        for (Index i = 0; i < changing; i++) column[held + i] = joint.first(m + i, j);
        for (Index i = 0; i < m; i++) seen[i] = joint.first(i, j);
        Rotation rotations[MOST_MEASURED];
        for (Index i = 0; i < m; i++) {
            const double length = std::sqrt(head[i][i] * head[i][i] + seen[i] * seen[i]);
            const Rotation by = seen[i] == 0.0 ? Rotation{1.0, 0.0} : Rotation{head[i][i] / length, seen[i] / length};
            for (Index x = i; x < m; x++) {
                const double pivot = head[i][x];
                head[i][x] = by.c * pivot + by.s * seen[x];
                seen[x] = by.c * seen[x] - by.s * pivot;
            }
            rotations[i] = by;
        }
        rotate_into(rotations, m, pivots, column, j);
    }
    for (Index i = 0; i < m; i++) {
        for (Index x = 0; x < m; x++) out.innovation_factor(x, i) = head[i][x];
    }
    for (Index i = 0; i < m; i++) {
        double left = innovation[i];
        for (Index x = 0; x < i; x++) left -= out.innovation_factor(i, x) * out.whitened[x];
        out.whitened[i] = left / out.innovation_factor(i, i);
    }
}

/// Add the square of a deviation to the variance of one degree of freedom, in place.
///
/// upper (n, n): a lower triangular factor, transposed. A row with one entry is rotated into it from the left; only the
/// rows from `index` on change. extra (n,) is scratch.
inline void inflate(Table upper, Index index, double deviation, double *extra) {
    const Index n = upper.rows;
    for (Index i = 0; i < n; i++) extra[i] = 0.0;
    extra[index] = deviation;
    for (Index j = index; j < n; j++) {
        double *row = upper.row(j);
        const double length = std::sqrt(row[j] * row[j] + extra[j] * extra[j]);
        const double c = row[j] / length, s = extra[j] / length;
        for (Index i = j; i < n; i++) {
            const double x = row[i];
            row[i] = c * x + s * extra[i];
            extra[i] = c * extra[i] - s * x;
        }
    }
}

}  // namespace
