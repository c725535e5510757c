/// Which instructions this processor has, and from which sources the library was compiled.

#include "exported.hpp"

#if defined(__x86_64__)
#include <cpuid.h>

/// Whether the processor has AVX2 and fused multiply-add, and the system keeps their registers.
EXPORTED int kreisel_has_avx2() {
    unsigned a, b, c, d;
    const unsigned fma = 1u << 12, osxsave = 1u << 27, avx = 1u << 28, avx2 = 1u << 5;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & (fma | osxsave | avx)) != (fma | osxsave | avx)) return 0;
    unsigned low, high;
    __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    if ((low & 6) != 6) return 0;
    return __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & avx2);
}
#else
EXPORTED int kreisel_has_avx2() { return 0; }
#endif

EXPORTED const char *kreisel_sources() { return SOURCES; }
