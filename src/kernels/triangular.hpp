/// Orthogonal triangularisation of covariance factors, for states of which few change between updates.
#pragma once

#include "arrays.hpp"
#include "workspace.hpp"

namespace {

constexpr Index MAX_MEASURED = 9;  ///< numbers a measurement has: position, orientation, velocity

/// Subtract from rows of length k, from `begin` on, scale times their product with the mirror times the mirror.
template <int ROWS>
inline void reflect_rows(const double *mirror, double scale, Index begin, Index k, double *rows) {
    Lanes product[ROWS];
    for (Lanes &lanes : product) lanes = 0.0;
    for (Index a = begin; a < k; a += LANES) {
        for (int j = 0; j < ROWS; j++) product[j] += load(mirror + a) * load(rows + j * k + a);
    }
    for (Lanes &lanes : product) lanes = scale * sum(lanes);
    for (Index a = begin; a < k; a += LANES) {
        for (int j = 0; j < ROWS; j++) {
            double *row = rows + j * k + a;
            store(load(row) - product[j] * load(mirror + a), row);
        }
    }
}

/// Make a matrix upper triangular, given by its columns (r, k), k >= r, by Householder's reflections.
///
/// Row i of `columns` is column i of the matrix; those after it, up to a multiple of the lanes, are zero. What stands below
/// the diagonal is not made zero. The diagonal may come out negative. mirror (k,) is scratch.
inline void reflect(Columns columns, double *mirror) {
    const Index r = columns.rows, k = columns.columns;
    for (Index i = 0; i < r; i++) {
        // Zeros before entry i: whole lanes may be used from `begin` on.
        const Index begin = i / LANES * LANES;
        double *own = columns.row(i);
        Lanes squares = 0.0;
        std::memcpy(mirror + begin, own + begin, (k - begin) * sizeof(double));
        for (Index a = begin; a <= i; a++) mirror[a] = 0.0;
        for (Index a = begin; a < k; a += LANES) squares += load(mirror + a) * load(mirror + a);
        const double below = sum(squares);
        if (below == 0.0) continue;
        const double pivot = own[i], length = std::sqrt(pivot * pivot + below);
        // reflected to the far side, so that nothing cancels
        const double head = pivot + (pivot >= 0.0 ? length : -length), scale = 2.0 / (head * head + below);
        mirror[i] = head;
        Index j = i + 1;
        for (; j + 4 <= r; j += 4) reflect_rows<4>(mirror, scale, begin, k, columns.row(j));
        for (; j < r; j++) reflect_rows<1>(mirror, scale, begin, k, columns.row(j));
        own[i] = pivot >= 0.0 ? -length : length;
    }
}

/// Replace rows (k, r), k >= r, by an upper triangular matrix above zeros, with the same rows^T rows; the diagonal comes
/// out positive.
inline void triangularise(Table rows, Workspace &memory) {
    const Columns columns = memory.zeros(rows.columns, rows.rows);
    for (Index i = 0; i < rows.columns; i++) {
        for (Index j = 0; j < rows.rows; j++) columns(i, j) = rows(j, i);
    }
    reflect(columns, memory.numbers(columns.columns));
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
    Columns posterior;        // (n, n): factor of the state's covariance once measured, transposed
};

/// A rotation of two columns.
struct Rotation {
    double c, s;
};

/// Rotations of columns that carry numbers (m, n) into a triangular head (m, m), from the last column to the first: the
/// i-th number of column j into row i of the head. head[i][x], x >= i, is changed; numbers are used up.
///
/// Rows are taken one after another: along a row the lengths are sums of squares, and only the rows after it depend on
/// the rotations.
inline void rotate_head(Columns numbers, Index n, double head[][MAX_MEASURED], Rotation *rotations, double *lengths) {
    const Index m = numbers.rows;
    for (Index i = 0; i < m; i++) {
        const double *own = numbers.row(i);
        double square = head[i][i] * head[i][i];
        lengths[n] = square;
        for (Index j = n - 1; j >= 0; j--) lengths[j] = square += own[j] * own[j];
        for (Index j = 0; j <= n; j++) lengths[j] = std::sqrt(lengths[j]);
        for (Index j = 0; j < n; j++) {
            const bool nothing = own[j] == 0.0;
            const double scale = 1.0 / (nothing ? 1.0 : lengths[j]);
            rotations[j * m + i] = {nothing ? 1.0 : lengths[j + 1] * scale, own[j] * scale};
        }
        head[i][i] = lengths[0];
        for (Index x = i + 1; x < m; x++) {
            double *other = numbers.row(x), pivot = head[i][x];
            for (Index j = n - 1; j >= 0; j--) {
                const Rotation by = rotations[j * m + i];
                const double number = other[j];
                other[j] = by.c * number - by.s * pivot;
                pivot = by.c * pivot + by.s * number;
            }
            head[i][x] = pivot;
        }
    }
}

/// Rotate a column (n,) into M pivots, (M, n), from the lane of row `begin` on.
template <Index M>
inline void rotate_into(const Rotation *rotations, Columns pivots, double *column, Index begin) {
    for (Index r = begin / LANES * LANES; r < pivots.columns; r += LANES) {
        Lanes rest = load(column + r);
        for (Index i = 0; i < M; i++) {
            double *row = pivots.row(i) + r;
            const Lanes c = rotations[i].c, s = rotations[i].s, pivot = load(row);
            store(c * pivot + s * rest, row);
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
    reflect(small, memory.numbers(small.columns));
    const auto triangular = [&](Index i, Index j) { return small(i, i) < 0.0 ? -small(j, i) : small(j, i); };
    double head[MAX_MEASURED][MAX_MEASURED] = {};
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
    const Columns seen = memory.columns(m, held);
    copy(joint.first, seen, m, held);
    auto *rotations = reinterpret_cast<Rotation *>(memory.numbers(2 * held * m));
    rotate_head(seen, held, head, rotations, memory.numbers(held + 1));
    for (Index j = held - 1; j >= 0; j--) {
        double *column = out.posterior.row(j);
        const Index begin = j / LANES * LANES;
        for (Index i = 0; i < begin; i++) column[i] = 0.0;
        std::memcpy(column + begin, joint.upper.row(j) + begin, (held - begin) * sizeof(double));
        for (Index i = 0; i < changing; i++) column[held + i] = joint.first(m + i, j);
        const Rotation *by = rotations + j * m;
        if (m == 3) rotate_into<3>(by, pivots, column, j);
        if (m == 6) rotate_into<6>(by, pivots, column, j);
        if (m == 9) rotate_into<9>(by, pivots, column, j);
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

/// Rotate W rows into an upper triangular factor from above, in place: the sum of outer products of all rows stays.
///
/// rows (W, n) are used up. Before entry `begin` they are zero.
template <Index W>
inline void absorb(Columns upper, Columns rows, Index begin) {
    for (Index j = begin; j < upper.rows; j++) {
        double *own = upper.row(j), square = own[j] * own[j];
        Rotation rotations[W];
        for (Index i = 0; i < W; i++) {
            const double before = std::sqrt(square), entry = rows(i, j);
            square += entry * entry;
            const double scale = 1.0 / (entry == 0.0 ? 1.0 : std::sqrt(square));
            rotations[i] = {entry == 0.0 ? 1.0 : before * scale, -entry * scale};
        }
        own[j] = std::fabs(own[j]);  // as `before` above
        rotate_into<W>(rotations, rows, own, j);
        for (Index i = 0; i < W; i++) rows(i, j) = 0.0;
    }
}

/// Add the squares of deviations to the variances of some degrees of freedom, in place.
///
/// upper (n, n): a lower triangular factor, transposed, with a diagonal that is not negative.
inline void inflate(Columns upper, Indices degrees, const double *deviations, Workspace &memory) {
    constexpr Index TOGETHER = 3;
    for (Index first = 0; first < degrees.count; first += TOGETHER) {
        const Columns rows = memory.zeros(TOGETHER, upper.rows);
        Index begin = upper.rows;
        for (Index i = 0; i < TOGETHER && first + i < degrees.count; i++) {
            const Index degree = degrees[first + i];
            rows(i, degree) = deviations[first + i];
            begin = degree < begin ? degree : begin;
        }
        absorb<TOGETHER>(upper, rows, begin);
    }
}

/// Replace three degrees of freedom by new ones, with a deviation and independent of all others, in place.
///
/// upper (n, n): as for `inflate`.
inline void renew(Columns upper, Index first, double deviation, Workspace &memory) {
    Index degrees[3];
    double deviations[3];
    for (Index i = 0; i < 3; i++) {
        for (Index j = 0; j < upper.rows; j++) upper(j, first + i) = 0.0;
        degrees[i] = first + i;
        deviations[i] = deviation;
    }
    inflate(upper, {degrees, 3}, deviations, memory);
}

}  // namespace
