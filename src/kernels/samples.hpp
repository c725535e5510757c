/// Readings with all that does not depend on the sensor parameters, and what preintegration makes of them.
#pragma once

#include "arrays.hpp"

namespace {

constexpr Index STENCIL = 6;  ///< samples each interpolating polynomial goes through

/// See `_kernels.filter_arguments.Samples`; P = 4 + E features of the rate, E of them the gyros' effects'.
struct Samples {
    ConstNumbers stamps;                  // (n,)
    Indices base;                    // (n - 1,)
    ConstTable single, twice;             // (n - 1, 6)
    ConstTable rates, slopes, integrals;  // (P, n), (4, n), (P, n - 1)
    ConstTable forces;                    // (3 + E, n)
    ConstTable noise;                     // (4, 3)
    double usual;                    // s
};

/// Samples of an increment: its first and last, and those that enter, two beyond either end where there are.
struct Span {
    Index first, last, low, high;

    Index count() const { return high - low + 1; }
};

inline Span span_between(const Samples &signal, Index first, Index last) {
    const Index low = signal.base[first] < last - 1 ? signal.base[first] : last - 1;
    const Index high = signal.base[last - 1] + STENCIL - 1;
    return {first, last, low, high > last ? high : last};
}

/// Sensor parameters as coefficients of the features: see coefficients.hpp. The columns of `shared` turn as the first
/// of `rate` does.
struct Coefficients {
    Columns rate, force, shared;  // (3 P, m), (3 features, m), (3 features, M - m)
    Index m, others;              // columns that count: m of rate and force, M - m of shared
};

/// Motion between two samples, seen from the body's attitude at the first; a column for each parameter set.
struct Increments {
    Columns dq, dv, dp;              // (4, M), (3, M), (3, M)
    Columns omega_end, alpha_end;    // (3, M): rate and angular acceleration at the last sample
    Columns u_end;                   // (9, M): specific force at the sample before the last, at it, and after it
    Table u_path;                    // (c, 4): specific force along the way, of the first column, and nothing
    Columns q_path;                  // (4, c): its attitude
};

}  // namespace
