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

#if defined(__clang__) || __GNUC__ >= 12
#define SHUFFLED(a, b, i, j, k, l) Lanes(__builtin_shufflevector((a).four, (b).four, i, j, k, l))
#else
inline double of_both(Lanes a, Lanes b, Index i) { return i < LANES ? a[i] : b[i - LANES]; }
#define SHUFFLED(a, b, i, j, k, l) Lanes(Lanes::Four{of_both(a, b, i), of_both(a, b, j), of_both(a, b, k), of_both(a, b, l)})
#endif

/// The lanes moved up by one or by two; `fill` moves in.
inline Lanes up_by_one(Lanes a, Lanes fill) { return SHUFFLED(fill, a, 0, 4, 5, 6); }
inline Lanes up_by_two(Lanes a, Lanes fill) { return SHUFFLED(fill, a, 0, 1, 4, 5); }

/// The lanes moved down by one; the first of `next` moves in.
inline Lanes down_by_one(Lanes a, Lanes next) { return SHUFFLED(a, next, 1, 2, 3, 4); }

/// The last lane in all of them.
inline Lanes last_lane(Lanes a) { return SHUFFLED(a, a, 3, 3, 3, 3); }

/// Write a 4 x 4 matrix, given by its columns, row by row, `stride` apart.
inline void store_transposed(Lanes a, Lanes b, Lanes c, Lanes d, double *p, Index stride) {
    const Lanes low = SHUFFLED(a, b, 0, 4, 2, 6), high = SHUFFLED(a, b, 1, 5, 3, 7);
    const Lanes more = SHUFFLED(c, d, 0, 4, 2, 6), most = SHUFFLED(c, d, 1, 5, 3, 7);
    store(SHUFFLED(low, more, 0, 1, 4, 5), p);
    store(SHUFFLED(high, most, 0, 1, 4, 5), p + stride);
    store(SHUFFLED(low, more, 2, 3, 6, 7), p + 2 * stride);
    store(SHUFFLED(high, most, 2, 3, 6, 7), p + 3 * stride);
}

}  // namespace
