/* The inverse of a chain along a preview. */
#include "follow.h"

#include "inverse.h"

#include <stddef.h>

/* What runs beside one another along a preview: the command's memory with and without the rate limit. */
typedef struct {
    real *state, *network; /* of the chain; of the network, if there is one */
    real last, u, off;     /* off: how much the chain's angle exceeds the network's */
} follower;

static long follow_numbers(const hystmpc_network *network) {
    return network ? 2L * hystmpc_network_state(network) + hystmpc_network_room(network, 1) + 4 : 0L;
}

long hystmpc_follow_bytes(const int *chain, const hystmpc_network *network) {
    return hystmpc_chain_single_bytes(chain) + follow_numbers(network) * (long)sizeof(real) + 64;
}

/* One sample under the command f->u. Unless a limit acts, it is the one at which the inverse has ended, and the registers
 * hold its sample. */
static void follow_on(const single_chain *c, const hystmpc_network *network, follower *f, real *work) {
    const single_stage *const first = c->stage, *const end = first + c->stages - 1;
    const int known = c->stages > 0 && first->state[first->p.states] == f->u;
    real slope, theta = R(0.0);
    const real angle = known ? end->registers[end->p.results[1]] : hystmpc_single_angle(c, f->u, &slope);
    hystmpc_single_move(c, f->state);
    f->last = f->u;
    if (!network) return;
    hystmpc_network_sample(network, f->network, 1, &f->u, &theta, work);
    f->off = angle - theta;
}

void hystmpc_follow(const int *chain, const real *kept, const hystmpc_network *network, const real *x,
                    const real *wanted, int samples, real last, const real *bounds, const real *inverted, real *plans,
                    char *memory) {
    single_chain c;
    const int size = chain[1], hidden = network ? hystmpc_network_state(network) : 0;
    const real low = bounds[0], high = bounds[1], reach = bounds[2];
    char *const behind = memory + hystmpc_single_lay_out(&c, chain, kept, memory);
    real *const memories = (real *)(behind + (64 - (size_t)behind % 64) % 64), *const work = memories + 2 * hidden;
    const real *const beside = network ? x + hidden + 1 : x;
    follower f[2];
    int rows = 1;
    f[0].state = c.last, f[1].state = c.last + size, f[0].network = memories, f[1].network = memories + hidden;
    f[0].last = last, f[0].off = network ? beside[size] - x[hidden] : R(0.0);
    for (int i = 0; i < size; i++) f[0].state[i] = beside[i];
    for (int i = 0; i < hidden; i++) f[0].network[i] = x[i];
    for (int k = 0; k < samples; k++) {
        for (int row = 0; row < rows; row++) {
            follower *const now = f + row;
            /* Beyond the rate limit nothing has to be looked for: the angle does not fall with the command. */
            const real near = row ? most(now->last - reach, inverted[0]) : inverted[0];
            const real far = row ? least(now->last + reach, inverted[1]) : inverted[1];
            hystmpc_single_set(&c, now->state);
            const real goal = hystmpc_single_command(&c, wanted[k] + now->off, near, far, now->last);
            now->u = least(most(is_finite(goal) ? goal : now->last, low), high);
            if (rows == 1 && absolute(now->u - now->last) > reach) {
                rows = 2; /* from here on two memories; the second one goes as far as the limit allows */
                for (int i = 0; i < size; i++) f[1].state[i] = f[0].state[i];
                for (int i = 0; i < hidden; i++) f[1].network[i] = f[0].network[i];
                f[1].last = f[0].last, f[1].off = f[0].off;
            }
            if (row) now->u = least(most(now->u, now->last - reach), now->last + reach);
            follow_on(&c, network, now, work);
        }
        plans[k] = f[0].u;
        plans[samples + k] = f[rows - 1].u;
    }
}
