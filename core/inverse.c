/* One sample of a chain at a time: its step, its inverse, and the inverse along a preview. */
#include "blocks.h"

/* Stage k of a chain; answers where the next one is described. */
static const int *read_stage(const int *chain, const int *place, hystmpc_program *p) {
    program_read(chain + place[0], p);
    return place + STAGE;
}

int hystmpc_chain_single_room(const int *chain) {
    const int *place = chain + CHAIN_HEAD + chain[6];
    int room = 0;
    for (int k = 0; k < chain[0]; k++) {
        hystmpc_program p;
        place = read_stage(chain, place, &p);
        room += p.single;
    }
    return room;
}

/* Registers of all stages with kept values and states; what the states alone decide is computed. */
static void set_state(const int *chain, const real *kept, const real *x, real *room) {
    const int *place = chain + CHAIN_HEAD + chain[6];
    for (int k = 0; k < chain[0]; k++) {
        const int *here = place;
        hystmpc_program p;
        place = read_stage(chain, place, &p);
        for (int i = 0; i < p.kept; i++) room[i] = kept[here[4] + i];
        for (int i = 0; i < p.states; i++) room[p.kept + i] = x[here[2] + i];
        program_single(p.code[FIXED], p.length[FIXED], room);
        room += p.single;
    }
}

/* The angle at command u and its derivative, in a state that has been set. */
static real angle_at(const int *chain, real u, real *room, real *slope) {
    const int *place = chain + CHAIN_HEAD + chain[6];
    *slope = R(1.0);
    for (int k = 0; k < chain[0]; k++) {
        hystmpc_program p;
        place = read_stage(chain, place, &p);
        room[p.kept + p.states] = u;
        program_single(p.code[MOVING], p.length[MOVING], room);
        *slope = p.results[0] < 0 ? R(0.0) : *slope * room[p.results[0]];
        u = room[p.results[1]];
        room += p.single;
    }
    return u;
}

/* The state one sample after the command at which the angle has been computed last. */
static void move_on(const int *chain, real *x, real *room) {
    const int *place = chain + CHAIN_HEAD + chain[6];
    for (int k = 0; k < chain[0]; k++) {
        const int *here = place;
        hystmpc_program p;
        place = read_stage(chain, place, &p);
        program_single(p.code[REST], p.length[REST], room);
        for (int i = 0; i < p.states; i++) x[here[2] + i] = room[p.results[1 + p.outputs + i]];
        room += p.single;
    }
}

double hystmpc_chain_step(const int *chain, const real *kept, real *x, double u, real *room) {
    real slope;
    set_state(chain, kept, x, room);
    const real angle = angle_at(chain, (real)u, room, &slope);
    move_on(chain, x, room);
    return (double)angle;
}

enum { MOST_ROUNDS = 200 };

/* Numbers of the inverse: the angle may miss by MISS, the bracket shrinks to NARROW. */
#ifdef HYSTMPC_SINGLE
#define MISS R(1e-6)
#define NARROW R(1e-6)
#else
#define MISS R(1e-11)
#define NARROW R(1e-13)
#endif

/* The command of a state that has been set. */
static real command_for(const int *chain, real wanted, real low, real high, real last, real *room) {
    real u = least(most(last, low), high);
    const real tolerance = MISS * most(R(1.0), absolute(wanted));
    for (int round = 0; round < MOST_ROUNDS; round++) {
        real slope;
        const real miss = wanted - angle_at(chain, u, room, &slope);
        if (absolute(miss) <= tolerance) break;
        if (miss > R(0.0)) low = u;
        else high = u;
        if (high - low <= NARROW * most(R(1.0), absolute(high))) break;
        /* At an end of the range that is the answer, Newton points outside: try the end itself before halving. */
        const real newton = slope > R(0.0) ? u + miss / slope : high + R(1.0);
        u = low < newton && newton < high ? newton : R(0.5) * (low + high);
    }
    return u;
}

double hystmpc_chain_command_for(const int *chain, const real *kept, const real *x, double wanted, double low,
                                 double high, double last, real *room) {
    set_state(chain, kept, x, room);
    return (double)command_for(chain, (real)wanted, (real)low, (real)high, (real)last, room);
}
