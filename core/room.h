/* Memory of a call, part after part; every part begins at an address that 64 divides, where a vector may lie. */
#ifndef HYSTMPC_ROOM_H
#define HYSTMPC_ROOM_H

#include "real.h"

#include <stddef.h>
#include <stdint.h>

/* Bytes that a part of so many bytes takes at most, wherever the memory begins. */
static inline long hystmpc_room_for(long bytes) { return bytes + 64; }

static inline void *hystmpc_part(char **room, long bytes) {
    char *const at = *room + (64 - (uintptr_t)*room % 64) % 64;
    *room = at + bytes;
    return at;
}

static inline real *hystmpc_reals(char **room, long count) {
    return (real *)hystmpc_part(room, count * (long)sizeof(real));
}

static inline long hystmpc_room_for_reals(long count) { return hystmpc_room_for(count * (long)sizeof(real)); }

static inline long hystmpc_longer(long a, long b) { return a > b ? a : b; }

#endif
