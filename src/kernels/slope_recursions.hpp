/// What many small changes of a filter's state do over recorded updates, and the adjoint of that.
#pragma once

#include "arrays.hpp"
#include "products.hpp"
#include "workspace.hpp"

namespace {

/// Keep of each row of a state what its factor says.
inline void keep_rows(const double *factors, Columns state) {
    for (Index i = 0; i < state.rows; i++) {
        if (factors[i] == 1.0) continue;
        for (Index j = 0; j < state.columns; j++) state(i, j) *= factors[i];
    }
}

/// Slopes of updates: transition (u, c, n), design and gain (u, q, n), and what is kept before each update (u, n).
struct SlopeTables {
    ConstStack transition, design, gain;
    ConstTable keep;

    Index count() const { return keep.rows; }
    Index degrees() const { return keep.columns; }
};

/// Terms: functions (u, f) and double integrals (u or 0, f) of them; which function a term has, and what it adds to: a
/// degree of freedom while the update lasts, a direction of poses, an accelerometer's axis; -1 for nothing. A unit of a
/// direction changes the whitened prediction by `seen` (u, q, d), one of an axis the position by `axes` (u, 3, 3), which is
/// seen as `axes_seen` (u, q, 3).
struct SlopeTerms {
    ConstTable functions, moments;
    Indices function, place, direction, axis;
    ConstStack seen, axes, axes_seen;
    Index position;
};

/// Add the amounts of terms to what they change while an update lasts, or subtract them.
inline void add_during(const SlopeTerms &terms, const double *values, double sign, Columns state) {
    for (Index j = 0; j < terms.place.count; j++) {
        if (terms.place[j] >= 0) state(terms.place[j], j) += sign * values[terms.function[j]];
    }
}

/// Carry derivatives of the state by terms, (n, m), over updates; write those of the whitened predictions (u, q, m).
inline void carry_terms(const SlopeTables &slopes, const SlopeTerms &terms, Table state, Stack predictions, Workspace &memory) {
    const Index n = slopes.degrees(), c = slopes.transition.rows, q = slopes.design.rows, m = state.columns;
    const Columns own = memory.zeros(n, m), moved = memory.columns(c, m), seen = memory.columns(q, m);
    copy(state, own, n, m);
    for (Index k = 0; k < slopes.count(); k++) {
        const double *values = terms.functions.row(k);
        keep_rows(slopes.keep.row(k), own);
        add_during(terms, values, 1.0, own);
        fill(moved, 0.0);
        fill(seen, 0.0);
        add_product(slopes.transition[k], 1.0, own, moved);
        add_product(slopes.design[k], 1.0, own, seen);
        add_during(terms, values, -1.0, own);
        copy(moved, own.rows_from(n - c, c), c, moved.columns);
        for (Index j = 0; j < m; j++) {
            if (terms.direction[j] >= 0) {
                const ConstTable by = terms.seen[k];
                for (Index r = 0; r < q; r++) seen(r, j) += by(r, terms.direction[j]) * values[terms.function[j]];
            }
            if (terms.axis[j] >= 0 && terms.moments.rows) {
                const ConstTable axes = terms.axes[k], by = terms.axes_seen[k];
                const double moment = terms.moments(k, terms.function[j]);
                for (Index r = 0; r < 3; r++) own(terms.position + r, j) += axes(r, terms.axis[j]) * moment;
                for (Index r = 0; r < q; r++) seen(r, j) += by(r, terms.axis[j]) * moment;
            }
        }
        copy(seen, predictions[k], q, m);
        add_transposed_product(slopes.gain[k], -1.0, seen, own);
    }
    copy(own, state, n, m);
}

/// Carry what whitened innovations (u, q, m) make of the state, (n, m), over updates.
inline void carry_innovations(const SlopeTables &slopes, Stack innovations, Table state, Workspace &memory) {
    const Index n = slopes.degrees(), c = slopes.transition.rows, q = slopes.gain.rows, m = state.columns;
    const Columns own = memory.zeros(n, m), moved = memory.columns(c, m), given = memory.zeros(q, m);
    copy(state, own, n, m);
    for (Index k = 0; k < slopes.count(); k++) {
        keep_rows(slopes.keep.row(k), own);
        fill(moved, 0.0);
        add_product(slopes.transition[k], 1.0, own, moved);
        copy(moved, own.rows_from(n - c, c), c, moved.columns);
        copy(innovations[k], given, q, m);
        add_transposed_product(slopes.gain[k], 1.0, given, own);
    }
    copy(own, state, n, m);
}

/// Rows of a state that are written down at each update.
inline void note_rows(Columns state, Indices rows, Table out) {
    for (Index i = 0; i < rows.count; i++) std::memcpy(out.row(i), state.row(rows[i]), out.columns * sizeof(double));
}

/// Carry derivatives of m quantities by the state, (n, m), back over updates: those after the last become those before the
/// first.
///
/// weights (u, q, m), written: in, the quantities' derivatives by the whitened innovations alone; out, by the whitened
/// predictions, with all that follows. after, before (u, r, m): rows of the derivatives after and before each update.
inline void carry_back(
    const SlopeTables &slopes, Stack weights, Indices rows_after, Stack after, Indices rows_before, Stack before, Table state,
    Workspace &memory
) {
    const Index n = slopes.degrees(), c = slopes.transition.rows, q = slopes.gain.rows, m = state.columns;
    const Columns own = memory.zeros(n, m), moving = memory.columns(c, m), seen = memory.zeros(q, m);
    copy(state, own, n, m);
    for (Index k = slopes.count() - 1; k >= 0; k--) {
        note_rows(own, rows_after, after[k]);
        copy(weights[k], seen, q, m);
        add_product(slopes.gain[k], -1.0, own, seen);
        copy(seen, weights[k], q, m);
        const Columns last = own.rows_from(n - c, c);
        copy(last, moving, c, own.columns);
        fill(last, 0.0);
        add_transposed_product(slopes.transition[k], 1.0, moving, own);
        add_transposed_product(slopes.design[k], 1.0, seen, own);
        note_rows(own, rows_before, before[k]);
        keep_rows(slopes.keep.row(k), own);
    }
    copy(own, state, n, m);
}

}  // namespace
