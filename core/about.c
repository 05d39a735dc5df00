/* What a library says of itself. */
#include "hystmpc_core.h"

#ifndef HYSTMPC_DIGEST
#define HYSTMPC_DIGEST "unknown"
#endif

const char *hystmpc_digest(void) { return HYSTMPC_DIGEST; }

int hystmpc_level(void) {
#if defined(__x86_64__) && defined(__GNUC__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") &&
        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
        return 4;
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2")) return 3;
#endif
    return 0;
}
