/* What library.py asks before it trusts the library: which sources it was made from, and the layout of arrays. */
#include "arrays.h"
#if defined(__x86_64__)
#include <cpuid.h>
#endif

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

/* Whether this processor and its system run the library that is compiled for AVX2: asked of the processor itself, for
   not every compiler's runtime knows it (Intel's manual, volume 1, 14.3). */
EXPORT int has_avx2(void)
{
#if defined(__x86_64__)
    unsigned a, b, c, d, low, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_OSXSAVE))
        return 0;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return (low & 6) == 6 && __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_AVX2);
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
