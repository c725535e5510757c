/// Four numbers computed together: the same quantity of four neighbouring columns or samples.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

namespace {

using Index = std::int64_t;

constexpr Index LANES = 4;

/// The least multiple of the lanes that is not below n.
inline Index padded(Index n) { return (n + LANES - 1) / LANES * LANES; }

struct Lanes {
    typedef double Four __attribute__((vector_size(LANES * sizeof(double))));
    Four four;

    Lanes() = default;
    Lanes(double x) : four{x, x, x, x} {}
    Lanes(Four x) : four(x) {}

    double operator[](Index i) const { return four[i]; }
};

inline Lanes operator+(Lanes a, Lanes b) { return a.four + b.four; }
inline Lanes operator-(Lanes a, Lanes b) { return a.four - b.four; }
inline Lanes operator*(Lanes a, Lanes b) { return a.four * b.four; }
inline Lanes operator/(Lanes a, Lanes b) { return a.four / b.four; }
inline Lanes operator-(Lanes a) { return -a.four; }
inline Lanes &operator+=(Lanes &a, Lanes b) { return a = a + b; }
inline Lanes &operator-=(Lanes &a, Lanes b) { return a = a - b; }
inline Lanes &operator*=(Lanes &a, Lanes b) { return a = a * b; }

inline Lanes larger(Lanes a, Lanes b) { return a.four > b.four ? a.four : b.four; }
inline Lanes absolute(Lanes a) { return larger(a, -a); }

inline double largest(Lanes a) { return std::fmax(std::fmax(a[0], a[1]), std::fmax(a[2], a[3])); }
inline double sum(Lanes a) { return (a[0] + a[1]) + (a[2] + a[3]); }

/// Four numbers from p on; the pointer need not be aligned.
inline Lanes load(const double *p) {
    Lanes a;
    std::memcpy(&a, p, sizeof a);
    return a;
}

/// Numbers from p on, zero in place of all after the first `left`.
inline Lanes load(const double *p, Index left) {
    if (left >= LANES) return load(p);
    Lanes a = 0.0;
    for (Index i = 0; i < left; i++) a.four[i] = p[i];
    return a;
}

inline void store(Lanes a, double *p) { std::memcpy(p, &a, sizeof a); }

/// Write a 4 x 4 matrix, given by its columns, row by row, `stride` apart.
inline void store_transposed(Lanes a, Lanes b, Lanes c, Lanes d, double *p, Index stride) {
#if defined(__clang__) || __GNUC__ >= 12
    const auto low = __builtin_shufflevector(a.four, b.four, 0, 4, 2, 6), high = __builtin_shufflevector(a.four, b.four, 1, 5, 3, 7);
    const auto more = __builtin_shufflevector(c.four, d.four, 0, 4, 2, 6), most = __builtin_shufflevector(c.four, d.four, 1, 5, 3, 7);
    store(__builtin_shufflevector(low, more, 0, 1, 4, 5), p);
    store(__builtin_shufflevector(high, most, 0, 1, 4, 5), p + stride);
    store(__builtin_shufflevector(low, more, 2, 3, 6, 7), p + 2 * stride);
    store(__builtin_shufflevector(high, most, 2, 3, 6, 7), p + 3 * stride);
#else
    for (Index i = 0; i < LANES; i++) store(Lanes::Four{a[i], b[i], c[i], d[i]}, p + i * stride);
#endif
}

}  // namespace
