/* Parts of a room that the caller gives as bytes: each begins at a cache line, at which networks want their numbers. */
#ifndef HYSTMPC_ROOM_H
#define HYSTMPC_ROOM_H

#include "real.h"

#include <stddef.h>

enum { ROOM_LINE = 64 };

/* Bytes that so many numbers take of a room, and those that its beginning may lose. */
static inline long room_for(long numbers) {
    return (numbers * (long)sizeof(real) + ROOM_LINE - 1) / ROOM_LINE * ROOM_LINE;
}

/* The first cache line of a room. */
static inline char *room_begin(char *room) {
    return room + (ROOM_LINE - (size_t)room % ROOM_LINE) % ROOM_LINE;
}

/* The next numbers of a room that begins at a cache line. */
static inline real *room_take(char **room, long numbers) {
    real *const taken = (real *)(void *)*room;
    *room += room_for(numbers);
    return taken;
}

static inline long longer(long a, long b) { return a < b ? b : a; }

#endif
