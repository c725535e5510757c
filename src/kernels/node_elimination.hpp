/// Least squares over a chain: unknowns of every node, joined to those of the next one, and parameters common to all.
///
/// The chain is eliminated from its beginning to its end, which costs as much as there are nodes; for several sets of
/// weights, since noise figures are found by comparing them.
#pragma once

#include "arrays.hpp"
#include "products.hpp"
#include "workspace.hpp"

namespace {

constexpr Index NODE = 9;  ///< unknowns of a node

/// Rows, three of each of t: residual + of_node x_node + of_next x_next + of_parameters p = noise.
struct ChainRows {
    ConstTable residual;   // (t, 3)
    Indices node, next;    // (t,): -1 for no next one
    ConstStack of_node, of_next, of_parameters;  // (t, 3, NODE), (t, 3, NODE), (t, 3, P)
};

/// Make the upper triangle of a symmetric matrix (n, n) its factor R, of R^T R. False where it is not positive definite.
inline bool factorise(Table A, Index n) {
    for (Index j = 0; j < n; j++) {
        double *own = A.row(j);
        if (!(own[j] > 0.0)) return false;
        own[j] = std::sqrt(own[j]);
        const double scale = 1.0 / own[j];
        for (Index k = j + 1; k < n; k++) own[k] *= scale;
        for (Index i = j + 1; i < n; i++) {
            double *row = A.row(i);
            const double factor = own[i];
            for (Index k = i; k < n; k++) row[k] -= factor * own[k];
        }
    }
    return true;
}

/// Divide columns (NODE, q) by the transpose of a factor, in place.
inline void divide_by_transpose(ConstTable R, Columns x) {
    double scale[NODE];
    for (Index k = 0; k < NODE; k++) scale[k] = 1.0 / R(k, k);
    for (Index j = 0; j < x.columns; j += LANES) {
        Lanes own[NODE];
        for (Index i = 0; i < NODE; i++) own[i] = load(x.row(i) + j);
        for (Index k = 0; k < NODE; k++) {
            own[k] *= scale[k];
            store(own[k], x.row(k) + j);
            for (Index i = k + 1; i < NODE; i++) own[i] -= R(k, i) * own[k];
        }
    }
}

/// Divide numbers (n,) by a factor, in place.
inline void divide(ConstTable R, Index n, double *x) {
    for (Index i = n - 1; i >= 0; i--) {
        for (Index k = i + 1; k < n; k++) x[i] -= R(i, k) * x[k];
        x[i] /= R(i, i);
    }
}

inline double log_of_diagonal(ConstTable R, Index n) {
    double out = 0.0;
    for (Index i = 0; i < n; i++) out += std::log(R(i, i));
    return out;
}

/// Normal equations: of the parameters, with the right hand side as a last column (P, P + 1); of all nodes about
/// themselves (M NODE, NODE), about the next ones (M NODE, NODE), and about parameters and the right hand side (M NODE, P + 1).
struct ChainNormal {
    Columns parameters, own, next, others;
    double log_evidence;

    static ChainNormal zeros(Index M, Index P, Workspace &memory) {
        const Index n = M * NODE;
        return {memory.zeros(P, P + 1), memory.zeros(n, NODE), memory.zeros(n, NODE), memory.zeros(n, P + 1), 0.0};
    }

    Columns own_of(Index m) const { return own.rows_from(m * NODE, NODE); }
    Columns next_of(Index m) const { return next.rows_from(m * NODE, NODE); }
    Columns others_of(Index m) const { return others.rows_from(m * NODE, NODE); }

    void set(const ChainNormal &from) {
        copy(from.parameters, parameters, parameters.rows, parameters.columns);
        copy(from.own, own, own.rows, own.columns);
        copy(from.next, next, next.rows, next.columns);
        copy(from.others, others, others.rows, others.columns);
        log_evidence = from.log_evidence;
    }
};

/// Rows as they are added: derivatives by parameters and the negative residual, (3 t, P + 1), and room for them weighted.
struct WeightedRows {
    const ChainRows &rows;
    Columns wide, weighted, by_node, by_next;

    WeightedRows(const ChainRows &rows, Workspace &memory)
        : rows(rows), wide(memory.zeros(3 * rows.node.count, rows.of_parameters.columns + 1)), weighted(memory.columns(wide.rows, wide.columns)),
          by_node(memory.zeros(3, NODE)), by_next(memory.zeros(3, NODE)) {
        const Index P = rows.of_parameters.columns;
        for (Index t = 0; t < rows.node.count; t++) {
            for (Index i = 0; i < 3; i++) {
                std::memcpy(wide.row(3 * t + i), rows.of_parameters[t].row(i), P * sizeof(double));
                wide(3 * t + i, P) = -rows.residual(t, i);
            }
        }
    }

    /// Add the rows of [first, last), three of each, with their inverse variances (t, 3) to normal equations.
    void add(Index first, Index last, ConstTable weights, ChainNormal &to) const {
        for (Index t = first; t < last; t++) add_to_nodes(t, weights.row(t), to);
        const Index count = 3 * (last - first);
        const Columns part = weighted.rows_from(3 * first, count);
        add_product(wide.rows_from(3 * first, count).data, 1, wide.columns, 1.0, part, to.parameters);
    }

private:
    void add_to_nodes(Index t, const double *w, ChainNormal &to) const {
        const Index P = rows.of_parameters.columns, at = rows.node[t], after = rows.next[t];
        const Columns own = wide.rows_from(3 * t, 3), part = weighted.rows_from(3 * t, 3);
        const ConstTable J = rows.of_node[t], N = rows.of_next[t];
        for (Index i = 0; i < 3; i++) {
            for (Index j = 0; j < own.columns; j++) part(i, j) = w[i] * own(i, j);
            for (Index j = 0; j < NODE; j++) by_node(i, j) = w[i] * J(i, j);
            to.log_evidence += 0.5 * (std::log(w[i]) - w[i] * own(i, P) * own(i, P));
        }
        add_transposed_product(J, 1.0, part, to.others_of(at));
        add_transposed_product(J, 1.0, by_node, to.own_of(at));
        if (after < 0) return;
        for (Index i = 0; i < 3; i++) {
            for (Index j = 0; j < NODE; j++) by_next(i, j) = w[i] * N(i, j);
        }
        add_transposed_product(J, 1.0, by_next, to.next_of(at));
        add_transposed_product(N, 1.0, part, to.others_of(after));
        add_transposed_product(N, 1.0, by_next, to.own_of(after));
    }
};

/// Eliminate the nodes: what is left are the equations of the parameters. False where something is not positive definite.
///
/// Of each node its factor stands in `own` then, and the other numbers are divided by its transpose.
inline bool eliminate_nodes(ChainNormal &normal) {
    const Index M = normal.own.rows / NODE, P = normal.parameters.rows;
    for (Index m = 0; m < M; m++) {
        const Columns own = normal.own_of(m), next = normal.next_of(m), others = normal.others_of(m);
        if (!factorise(own, NODE)) return false;
        divide_by_transpose(own, next);
        divide_by_transpose(own, others);
        normal.log_evidence -= log_of_diagonal(own, NODE);
        for (Index i = 0; i < NODE; i++) normal.log_evidence += 0.5 * others(i, P) * others(i, P);
        if (m + 1 == M) break;
        add_product(next.data, 1, next.columns, -1.0, next, normal.own_of(m + 1));
        add_product(next.data, 1, next.columns, -1.0, others, normal.others_of(m + 1));
    }
    add_product(normal.others.data, 1, normal.others.columns, -1.0, normal.others, normal.parameters);
    return true;
}

/// Write the unknowns of the nodes (M, NODE), once the parameters (P,) are known.
inline void solve_nodes(const ChainNormal &normal, const double *parameters, Table out) {
    const Index P = normal.parameters.rows;
    for (Index m = out.rows - 1; m >= 0; m--) {
        const Columns next = normal.next_of(m), others = normal.others_of(m);
        double *x = out.row(m);
        for (Index i = 0; i < NODE; i++) {
            x[i] = others(i, P);
            for (Index p = 0; p < P; p++) x[i] -= others(i, p) * parameters[p];
            for (Index j = 0; j < NODE && m + 1 < out.rows; j++) x[i] -= next(i, j) * out(m + 1, j);
        }
        divide(normal.own_of(m), NODE, x);
    }
}

/// Solve for S sets of inverse variances (S, t, 3), of which the first `alike` rows have those of the first set in all.
///
/// of_nodes (M NODE, NODE), of_parameters (P, P + 1): information before, about zero, and times what it expects as a last column.
/// Written: changes of parameters (S, P), their information (S, P, P), the logarithm of the evidence (S,), -inf where
/// nothing is found, and changes of nodes (S, M, NODE).
inline void eliminate(
    const ChainRows &rows, ConstStack weights, Index alike, ConstTable of_nodes, ConstTable of_parameters, Table parameters,
    Stack information, Numbers log_evidence, Stack nodes, Workspace &memory
) {
    const Index M = nodes.rows, P = parameters.columns;
    const WeightedRows all(rows, memory);
    ChainNormal common = ChainNormal::zeros(M, P, memory), normal = ChainNormal::zeros(M, P, memory);
    for (Index i = 0; i < of_nodes.rows; i++) std::memcpy(common.own.row(i), of_nodes.row(i), NODE * sizeof(double));
    for (Index i = 0; i < P; i++) std::memcpy(common.parameters.row(i), of_parameters.row(i), (P + 1) * sizeof(double));
    all.add(0, alike, weights[0], common);
    for (Index s = 0; s < weights.tables; s++) {
        normal.set(common);
        all.add(alike, rows.node.count, weights[s], normal);
        double *x = parameters.row(s);
        const Columns left = normal.parameters;
        bool found = eliminate_nodes(normal);
        copy(left, information[s], P, P);
        found = found && factorise(left, P);
        log_evidence[s] = -HUGE_VAL;
        if (!found) continue;
        // the right hand side, divided by the factor's transpose
        for (Index i = 0; i < P; i++) {
            x[i] = left(i, P);
            for (Index k = 0; k < i; k++) x[i] -= left(k, i) * x[k];
            x[i] /= left(i, i);
            normal.log_evidence += 0.5 * x[i] * x[i];
        }
        log_evidence[s] = normal.log_evidence - log_of_diagonal(left, P);
        divide(left, P, x);
        solve_nodes(normal, x, nodes[s]);
    }
}

}  // namespace
