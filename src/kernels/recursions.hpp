/// Recursions over time that simulation needs.
#pragma once

#include "arrays.hpp"

namespace {

/// Write the states x (2, n, m) of m oscillators driven by u (n, m), from standstill.
///
/// x_k+1 = step x_k + now u_k + later u_k+1, with step (2, 2), now and later (2,).
inline void drive_oscillators(ConstTable step, ConstNumbers now, ConstNumbers later, Table u, Stack x) {
    const Table a = x[0], b = x[1];
    for (Index k = 0; k < u.rows - 1; k++) {
        for (Index j = 0; j < u.columns; j++) {
            a(k + 1, j) = step(0, 0) * a(k, j) + step(0, 1) * b(k, j) + now[0] * u(k, j) + later[0] * u(k + 1, j);
            b(k + 1, j) = step(1, 0) * a(k, j) + step(1, 1) * b(k, j) + now[1] * u(k, j) + later[1] * u(k + 1, j);
        }
    }
}

/// Write a stationary Gauss-Markov process of unit variance, (n, m), from white noise (n, m) and keep (n - 1,).
inline void gauss_markov(ConstNumbers keep, ConstTable white, Table out) {
    for (Index j = 0; j < white.columns; j++) out(0, j) = white(0, j);
    for (Index k = 0; k < keep.count; k++) {
        const double fresh = std::sqrt(1.0 - keep[k] * keep[k]);
        for (Index j = 0; j < white.columns; j++) out(k + 1, j) = keep[k] * out(k, j) + fresh * white(k + 1, j);
    }
}

}  // namespace
