/* What Python calls of an observer: its memory laid out, then the functions that a controller has too. */
#include "estimates.h"

#include <string.h>

static hystmpc_observed observing_at(const void *sensing, const void *model, const char *memory) {
    hystmpc_observed o;
    hystmpc_observed_at(sensing, model, (char *)memory, &o);
    return o;
}

long hystmpc_observing_bytes(const void *sensing, const void *model) { return hystmpc_observed_bytes(sensing, model); }

long hystmpc_observing_room(const void *sensing, const void *model) { return hystmpc_observer_bytes(sensing, model); }

int hystmpc_observing_init(const void *sensing, const void *model, char *memory, const real *x, real y, real u,
                           char *room) {
    hystmpc_observed o = observing_at(sensing, model, memory);
    return hystmpc_observer_init(sensing, model, &o, x, y, u, room);
}

void hystmpc_observing_correct(const void *sensing, const void *model, char *memory, real y) {
    hystmpc_observed o = observing_at(sensing, model, memory);
    hystmpc_observer_correct(sensing, model, &o, y);
}

int hystmpc_observing_correct_late(const void *sensing, const void *model, char *memory, real y, real age) {
    hystmpc_observed o = observing_at(sensing, model, memory);
    return hystmpc_observer_correct_late(sensing, model, &o, y, age);
}

void hystmpc_observing_advance(const void *sensing, const void *model, char *memory, real u, char *room) {
    hystmpc_observed o = observing_at(sensing, model, memory);
    hystmpc_observer_advance(sensing, model, &o, u, room);
}

static void observing_copy(const real *from, real *to, int count) {
    if (to) memcpy(to, from, sizeof(real) * (size_t)count);
}

void hystmpc_observing_look(const void *sensing, const void *model, const char *memory, real *numbers, real *x,
                            real *angles, real *moves, real *responsive, real *bank) {
    const hystmpc_observed o = observing_at(sensing, model, memory);
    const hystmpc_extent n = hystmpc_extent_of(sensing, model);
    const hystmpc_known *known = o.now.known;
    const real all[] = {known->command,
                        known->disturbance,
                        known->variance,
                        known->measured,
                        hystmpc_observer_age(&o),
                        known->added,
                        known->forecast_error,
                        hystmpc_observer_sigma(sensing, &o),
                        (real)known->missing,
                        (real)known->stalled};
    observing_copy(all, numbers, (int)(sizeof all / sizeof *all));
    if (x) hystmpc_observer_state(sensing, model, &o, x);
    observing_copy(o.now.angles, angles, n.angles);
    observing_copy(o.now.moves, moves, n.angles);
    observing_copy(o.now.responsive, responsive, n.angles);
    observing_copy(o.now.bank, bank, n.bank);
}
