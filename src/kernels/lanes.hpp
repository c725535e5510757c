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

}  // namespace
