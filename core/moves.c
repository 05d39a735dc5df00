/* argmin over |m_k| <= reach of 1/2 m'P m - q'm, P positive definite: an active-set method for bounds (Stark and Parker,
 * Computational Statistics 10, 1995). */
#include "moves.h"

#if HYSTMPC_SINGLE
static const real right_sign = R(1e-5);
#else
static const real right_sign = R(1e-10); /* of a multiplier, as a share of the greatest gradient */
#endif

enum { MOVES_CHANGES = 4 }; /* of the active set, per move */

/* Room of one program: P and q; the moves' sides, -1 or 1 at that bound and 0 where free; a solution to go towards. */
typedef struct {
    int size;
    real reach;
    real *hessian, *factor; /* (H, H) */
    real *linear, *side, *wanted, *part; /* (H) */
} bounded;

int hystmpc_first_acting(const real *response, int size) {
    real greatest = R(0.0);
    for (int k = 0; k < size * size; k++) greatest = most(greatest, absolute(response[k]));
    for (int k = 0; k < size; k++)
        for (int j = 0; j <= k; j++)
            if (absolute(response[k * size + j]) > R(1e-6) * greatest) return k;
    return size;
}

/* The minimum with the moves of a side at that bound and the others free, by Cholesky's factors of the latter. */
static void free_optimum(bounded *b) {
    const int size = b->size;
    int count = 0;
    copy(b->linear, b->wanted, size);
    for (int k = 0; k < size; k++) {
        const real at_bound = b->side[k] * b->reach;
        if (b->side[k] == R(0.0)) continue;
        for (int i = 0; i < size; i++) b->wanted[i] -= b->hessian[k * size + i] * at_bound;
    }
    for (int k = 0; k < size; k++) {
        if (b->side[k] != R(0.0)) continue;
        int beside = 0;
        b->part[count] = b->wanted[k];
        for (int i = 0; i <= k; i++)
            if (b->side[i] == R(0.0)) b->factor[count * size + beside++] = b->hessian[k * size + i];
        count++;
    }
    (void)factorise(b->factor, size, count); /* positive definite */
    solve_upper(b->factor, size, count, b->part);
    solve_lower(b->factor, size, count, b->part);
    for (int k = 0, i = 0; k < size; k++)
        b->wanted[k] = b->side[k] == R(0.0) ? b->part[i++] : b->side[k] * b->reach;
}

/* Share of the way from `moves` to the wanted ones where the first free move meets a bound, and which; -1: none. */
static int first_bound(const bounded *b, const real *moves, real *share) {
    int hit = -1;
    *share = R(1.0);
    for (int k = 0; k < b->size; k++) {
        if (b->side[k] != R(0.0) || !(absolute(b->wanted[k]) > b->reach)) continue;
        const real bound = b->wanted[k] > R(0.0) ? b->reach : -b->reach;
        const real part = (bound - moves[k]) / (b->wanted[k] - moves[k]);
        if (hit < 0 || part < *share) {
            *share = part;
            hit = k;
        }
    }
    return hit;
}

/* The held move whose multiplier is the most below `lowest`; -1 where none is. */
static int wrong_side(const bounded *b, const real *moves, real lowest) {
    int worst = -1;
    for (int k = 0; k < b->size; k++) {
        if (b->side[k] == R(0.0)) continue;
        real pull = b->linear[k];
        for (int i = 0; i < b->size; i++) pull -= b->hessian[k * b->size + i] * moves[i];
        if (b->side[k] * pull < lowest) {
            worst = k;
            lowest = b->side[k] * pull;
        }
    }
    return worst;
}

static void lead_moves(bounded *b, real *moves) {
    real greatest = R(0.0), share;
    for (int k = 0; k < b->size; k++) greatest = most(greatest, absolute(b->linear[k]));
    for (int round = 0; round < MOVES_CHANGES * b->size; round++) {
        free_optimum(b);
        const int hit = first_bound(b, moves, &share);
        for (int k = 0; k < b->size; k++)
            moves[k] = clamp(moves[k] + share * (b->wanted[k] - moves[k]), -b->reach, b->reach);
        if (hit >= 0) {
            b->side[hit] = b->wanted[hit] > R(0.0) ? R(1.0) : R(-1.0);
            moves[hit] = b->side[hit] * b->reach;
            continue;
        }
        const int worst = wrong_side(b, moves, -right_sign * greatest);
        if (worst < 0) return;
        b->side[worst] = R(0.0);
    }
}

void hystmpc_bounded_moves(const real *by_move, const real *off, int size, real reach, real weight,
                           real *moves, real *work) {
    bounded b;
    b.size = size;
    b.reach = reach;
    b.hessian = take(&work, size * size);
    b.factor = take(&work, size * size);
    b.linear = take(&work, size);
    b.side = take(&work, size);
    b.wanted = take(&work, size);
    b.part = take(&work, size);
    fill(b.hessian, R(0.0), size * size);
    fill(b.linear, R(0.0), size);
    fill(b.side, R(0.0), size);
    for (int k = 0; k < size; k++) {
        const real *const by = by_move + k * size;
        for (int i = 0; i <= k; i++) {
            b.linear[i] += by[i] * off[k];
            for (int j = 0; j <= i; j++) b.hessian[i * size + j] += by[i] * by[j];
        }
    }
    for (int i = 0; i < size; i++)
        for (int j = 0; j < i; j++) b.hessian[j * size + i] = b.hessian[i * size + j];
    for (int i = 0; i < size; i++)
        for (int j = 0; j < size; j++) b.linear[i] += b.hessian[i * size + j] * moves[j];
    for (int i = 0; i < size; i++) b.hessian[i * size + i] += weight;
    lead_moves(&b, moves);
}
