/* What library.py asks before it trusts the library: which sources it was made from, and the layout of arrays. */
#include "arrays.h"

EXPORT const char *sources_digest(void) { return SOURCES_DIGEST; }

/* What compiled the library: the bits of its sums are the sources', those of sin, cos, exp and log its library's. */
EXPORT const char *compiler(void)
{
#if defined(__clang__)
    return "clang " __clang_version__;
#else
    return "gcc " __VERSION__;
#endif
}

/* Whether this processor runs the library that is compiled for AVX2. */
EXPORT int has_avx2(void)
{
#if defined(__x86_64__)
    return __builtin_cpu_supports("avx2") != 0;
#else
    return 0;
#endif
}

/* Whether an array of (3, 5) float64 at this address is read as what it is. */
EXPORT int layout_agrees(const array *probe, int64_t address)
{
    bool good = true;
    return reals(probe, 2, &good) == (double *)(intptr_t)address && good && extent(probe, 0) == 3 &&
           extent(probe, 1) == 5 && probe->strides[0] == 40 && probe->strides[1] == 8;
}
