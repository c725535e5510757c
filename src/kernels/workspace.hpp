/// Memory of a computation: taken piece by piece, given back all at once, kept for the next time.
#pragma once

#include <cstdlib>
#include <new>

#include "arrays.hpp"

namespace {

/// What is thrown, inside the library alone, when there is no more memory.
struct OutOfMemory {};

/// What is thrown, inside the library alone, if two parts of it do not fit together.
struct Mismatch {};

class Workspace {
public:
    Workspace() = default;
    Workspace(const Workspace &) = delete;
    Workspace &operator=(const Workspace &) = delete;
    ~Workspace() { release(); }

    /// Give back all that was taken. If more than one piece was needed, the next time one is enough.
    void clear() {
#if defined(__SANITIZE_ADDRESS__)
        release();
#endif
        if (newest && newest->before) grow(release());
        used = 0;
    }

#if defined(__SANITIZE_ADDRESS__)
    /// Every piece by itself, so that the sanitizer sees what is read or written beside it.
    double *numbers(Index count) {
        void *memory = std::calloc(1, sizeof(Piece) + count * sizeof(double));
        if (!memory) throw OutOfMemory();
        newest = new (memory) Piece{newest, 0};
        return reinterpret_cast<double *>(newest + 1);
    }
#else
    /// Numbers that are not set, at an address that is a multiple of 64.
    double *numbers(Index count) {
        const Index needed = (count + 7) / 8 * 8;
        if (!newest || used + needed > newest->size) grow(needed > MIN ? needed : MIN);
        double *taken = newest->first() + used;
        used += needed;
        return taken;
    }
#endif

    /// A table with so many rows for m columns, none of them set.
    Columns columns(Index rows, Index m) { return {{numbers(rows * padded(m)), rows, padded(m)}}; }

    Columns zeros(Index rows, Index m) {
        Columns taken = columns(rows, m);
        fill(taken, 0.0);
        return taken;
    }

private:
    static constexpr Index MIN = 1 << 15;

    struct Piece {
        Piece *before;
        Index size;

        double *first() {
            const auto address = reinterpret_cast<std::uintptr_t>(this + 1);
            return reinterpret_cast<double *>((address + 63) / 64 * 64);
        }
    };

    Piece *newest = nullptr;
    Index used = 0;

    /// Free all memory, and return how many numbers it held.
    Index release() {
        Index size = 0;
        while (newest) {
            Piece *before = newest->before;
            size += newest->size;
            std::free(newest);
            newest = before;
        }
        return size;
    }

    void grow(Index size) {
        // Zeroed, for columns that do not count are computed with the others.
        void *memory = std::calloc(1, sizeof(Piece) + 64 + size * sizeof(double));
        if (!memory) throw OutOfMemory();
        newest = new (memory) Piece{newest, size};
        used = 0;
    }
};

}  // namespace
