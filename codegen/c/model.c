/* Loops around one step of a model: roll-out, exact linearisation, one-step inverse, the lead of a drive.
 * The steps themselves are in the file of the problem, which the export writes from the operators' equations. */
#include "internal.h"

HYSTMPC_LOCAL int all_finite(const real *x, int count) {
    int found = 1;
    for (int i = 0; i < count; i++) found &= is_finite(x[i]);
    return found;
}

HYSTMPC_LOCAL real root(real x) {
    return MATH(sqrt)(x);
}

HYSTMPC_LOCAL void copy(const real *from, real *to, int count) {
    for (int i = 0; i < count; i++) to[i] = from[i];
}

HYSTMPC_LOCAL void fill(real *to, real value, int count) {
    for (int i = 0; i < count; i++) to[i] = value;
}

/* P = G'G in place, G lower triangular and its diagonal stored as its inverse; 0 where P is not positive definite. Of P,
 * whose rows are `width` numbers apart, the lower triangle is read. All inner loops run along rows. */
HYSTMPC_LOCAL int factorise(real *p, int width, int count) {
    for (int j = count - 1; j >= 0; j--) {
        real *row = p + j * width;
        if (!(row[j] > R(0.0))) return 0;
        row[j] = R(1.0) / root(row[j]);
        for (int k = 0; k < j; k++) row[k] *= row[j];
        for (int i = 0; i < j; i++)
            for (int k = 0; k <= i; k++) p[i * width + k] -= row[i] * row[k];
    }
    return 1;
}

/* x <- G'^-1 x. */
HYSTMPC_LOCAL void solve_upper(const real *g, int width, int count, real *x) {
    for (int j = count - 1; j >= 0; j--) {
        x[j] *= g[j * width + j];
        for (int k = 0; k < j; k++) x[k] -= g[j * width + k] * x[j];
    }
}

/* x <- G^-1 x. */
HYSTMPC_LOCAL void solve_lower(const real *g, int width, int count, real *x) {
    for (int k = 0; k < count; k++) {
        x[k] *= g[k * width + k];
        for (int i = k + 1; i < count; i++) x[i] -= g[i * width + k] * x[k];
    }
}

#if HYSTMPC_FRONT || !HYSTMPC_UNITS

/* Angles of one plan; the state is kept. */
HYSTMPC_LOCAL void run_plan(const model *m, const real *x, const real *commands, int samples, real *angles) {
    real now[HYSTMPC_CHAIN], next[HYSTMPC_CHAIN];
    copy(x, now, m->size);
    for (int t = 0; t < samples; t++) {
        m->step(now, commands[t], &angles[t], next);
        copy(next, now, m->size);
    }
}

/* Angles of a plan of H commands, and their Jacobian in the work space, by forward sensitivity. */
HYSTMPC_LOCAL void linearise_plan(hystmpc_work *w, const model *m, const real *x, const real *commands, real *angles) {
    const int size = m->size;
    real now[HYSTMPC_CHAIN], next[HYSTMPC_CHAIN];
    real a[HYSTMPC_CHAIN * HYSTMPC_CHAIN], b[HYSTMPC_CHAIN], c[HYSTMPC_CHAIN], d;
    int old = 0;
    copy(x, now, size);
    for (int t = 0; t < H; t++) {
        real(*moving)[HYSTMPC_HORIZON] = w->moving[old], (*moved)[HYSTMPC_HORIZON] = w->moving[1 - old];
        m->tangent(now, commands[t], &angles[t], next, a, b, c, &d);
        copy(next, now, size);
        for (int j = 0; j < t; j++) { /* only commands already given have a tangent */
            real value = R(0.0);
            for (int i = 0; i < size; i++) value += c[i] * moving[i][j];
            w->jacobian[t][j] = value;
        }
        w->jacobian[t][t] = d;
        for (int j = t + 1; j < H; j++) w->jacobian[t][j] = R(0.0);
        for (int i = 0; i < size; i++) {
            for (int j = 0; j < t; j++) moved[i][j] = R(0.0);
            for (int k = 0; k < size; k++) {
                const real factor = a[i + k * size];
                if (factor == R(0.0)) continue;
                for (int j = 0; j < t; j++) moved[i][j] += factor * moving[k][j];
            }
            moved[i][t] = b[i];
        }
        old = 1 - old;
    }
}

#endif

/* Command that brings the next angle of what is inverted to `wanted`: bracketed Newton on the exact derivative. On a
 * flat branch that already shows it, the command nearest to `last`. Where Newton points outside, the end of the range is
 * looked at once: an angle that it does not reach needs no halving. */
HYSTMPC_LOCAL real command_for(const real *x, real wanted, real last) {
    real theta, d, low = HYSTMPC_INVERSE_LOW, high = HYSTMPC_INVERSE_HIGH, u = clamp(last, low, high);
    const real tolerance = HYSTMPC_MISS * most(R(1.0), absolute(wanted));
    int looked[2] = {0, 0};
    for (int round = 0; round < 200; round++) {
        slope_middle(x, u, &theta, &d);
        const real miss = wanted - theta;
        const int up = miss > R(0.0);
        if (absolute(miss) <= tolerance) break;
        if (up) low = u;
        else high = u;
        if (high - low <= HYSTMPC_NARROW * most(R(1.0), absolute(high))) break;
        const real newton = d > R(0.0) ? u + miss / d : high + R(1.0), end = up ? high : low;
        u = R(0.5) * (low + high);
        if (low < newton && newton < high) {
            u = newton;
        } else if (!looked[up] && end == (up ? HYSTMPC_INVERSE_HIGH : HYSTMPC_INVERSE_LOW)) {
            looked[up] = 1;
            u = end;
        }
    }
    return u;
}

#if !HYSTMPC_UNITS

HYSTMPC_LOCAL void model_step(const real *x, real u, real *theta, real *next) { hystmpc_whole.step(x, u, theta, next); }

HYSTMPC_LOCAL void run_model(const real *x, const real *commands, int samples, real *angles) {
    run_plan(&hystmpc_whole, x, commands, samples, angles);
}

HYSTMPC_LOCAL void run_plans(hystmpc_work *w, const real *x, real (*plans)[HYSTMPC_HORIZON], int count,
                             real (*angles)[HYSTMPC_HORIZON]) {
    (void)w;
    for (int n = 0; n < count; n++) run_plan(&hystmpc_whole, x, plans[n], H, angles[n]);
}

HYSTMPC_LOCAL void linearise_model(hystmpc_work *w, const real *x, const real *commands) {
    real angles[HYSTMPC_HORIZON];
    linearise_plan(w, &hystmpc_whole, x, commands, angles);
}

HYSTMPC_LOCAL void middle_step(real *x, real u) {
    real angle, next[HYSTMPC_CHAIN];
    step_middle(x, u, &angle, next);
    copy(next, x, HYSTMPC_BESIDE);
}

HYSTMPC_LOCAL real middle_command(const real *x, real wanted, real last) { return command_for(x, wanted, last); }

#endif

#if HYSTMPC_FRONT || HYSTMPC_BACK

/* The first sample that an input changes: rows of the Jacobian before it are zero. */
HYSTMPC_LOCAL int first_acting(const hystmpc_work *w) {
    real greatest = R(0.0);
    for (int k = 0; k < H; k++)
        for (int j = 0; j < H; j++) greatest = most(greatest, absolute(w->jacobian[k][j]));
    for (int k = 0; k < H; k++)
        for (int j = 0; j <= k; j++)
            if (absolute(w->jacobian[k][j]) > R(1e-6) * greatest) return k;
    return H;
}

/* The minimum with the moves of a side (-1, 1) at that bound and the others free, by Cholesky's factors of the latter. */
static void free_optimum(hystmpc_work *w, const real *linear, const int *side, real reach, real *wanted) {
    real *g = w->jacobian[0], x[HYSTMPC_HORIZON];
    int free[HYSTMPC_HORIZON], count = 0;
    copy(linear, wanted, H);
    for (int k = 0; k < H; k++) {
        if (!side[k]) free[count++] = k;
        else
            for (int i = 0; i < H; i++) wanted[i] -= w->normal[k][i] * ((real)side[k] * reach);
    }
    for (int a = 0; a < count; a++) {
        x[a] = wanted[free[a]];
        for (int b = 0; b <= a; b++) g[a * H + b] = w->normal[free[a]][free[b]];
    }
    (void)factorise(g, H, count); /* positive definite */
    solve_upper(g, H, count, x);
    solve_lower(g, H, count, x);
    for (int k = 0; k < H; k++) wanted[k] = (real)side[k] * reach;
    for (int a = 0; a < count; a++) wanted[free[a]] = x[a];
}

/* Share of the way from `moves` to `wanted` where the first free move meets a bound, and which; -1: none. */
static int first_bound(const real *moves, const real *wanted, const int *side, real reach, real *share) {
    int hit = -1;
    *share = R(1.0);
    for (int k = 0; k < H; k++) {
        if (side[k] || !(absolute(wanted[k]) > reach)) continue;
        const real bound = wanted[k] > R(0.0) ? reach : -reach;
        const real part = (bound - moves[k]) / (wanted[k] - moves[k]);
        if (hit < 0 || part < *share) {
            *share = part;
            hit = k;
        }
    }
    return hit;
}

/* The held move whose multiplier is the most below `lowest`; -1 where none is. */
static int wrong_side(const hystmpc_work *w, const real *linear, const int *side, const real *moves, real lowest) {
    int worst = -1;
    for (int k = 0; k < H; k++) {
        if (!side[k]) continue;
        real pull = linear[k];
        for (int i = 0; i < H; i++) pull -= w->normal[k][i] * moves[i];
        if ((real)side[k] * pull < lowest) {
            worst = k;
            lowest = (real)side[k] * pull;
        }
    }
    return worst;
}

/* argmin over |m_k| <= reach of 1/2 m'P m - q'm in place, P = `normal` positive definite: an active-set method for
 * bounds (Stark and Parker, Computational Statistics 10, 1995). The Jacobian's place serves for factors. */
static void lead_moves(hystmpc_work *w, const real *linear, real reach, real *moves) {
    int side[HYSTMPC_HORIZON] = {0};
    real wanted[HYSTMPC_HORIZON], greatest = R(0.0), share;
    for (int k = 0; k < H; k++) greatest = most(greatest, absolute(linear[k]));
    for (int round = 0; round < 4 * H; round++) {
        free_optimum(w, linear, side, reach, wanted);
        const int hit = first_bound(moves, wanted, side, reach, &share);
        for (int k = 0; k < H; k++) moves[k] = clamp(moves[k] + share * (wanted[k] - moves[k]), -reach, reach);
        if (hit >= 0) {
            side[hit] = wanted[hit] > R(0.0) ? 1 : -1;
            moves[hit] = (real)side[hit] * reach;
            continue;
        }
        const int worst = wrong_side(w, linear, side, moves, -HYSTMPC_SIGN * greatest);
        if (worst < 0) return;
        side[worst] = 0;
    }
}

/* Inputs of a drive whose outputs come closest to `wanted`, within `reach` a sample:
 *     min_m  sum_k (v_k(u) - w_k)^2 + 1e-3 sum_k m_k^2   s.t.  |m_k| <= reach,  u_k = u_{k-1} + m_k
 * exact for linear dynamics, by Gauss-Newton steps for others. */
HYSTMPC_LOCAL void fit_drive(hystmpc_work *w, const model *m, const real *x, const real *wanted, real u_last,
                             real reach, real *inputs) {
    real moves[HYSTMPC_HORIZON] = {R(0.0)}, found[HYSTMPC_HORIZON], outputs[HYSTMPC_HORIZON];
    real promised[HYSTMPC_HORIZON], linear[HYSTMPC_HORIZON];
    fill(inputs, u_last, H);
    linearise_plan(w, m, x, inputs, outputs);
    for (int round = 0; round < 3; round++) {
        for (int k = 0; k < H; k++) {
            real sum = R(0.0);
            for (int j = H - 1; j >= 0; j--) {
                sum += w->jacobian[k][j];
                w->by_move[k][j] = sum;
            }
        }
        fill(linear, R(0.0), H);
        for (int i = 0; i < H; i++) fill(w->normal[i], R(0.0), H);
        for (int k = 0; k < H; k++) {
            const real *by = w->by_move[k];
            for (int i = 0; i <= k; i++) {
                linear[i] += by[i] * (wanted[k] - outputs[k]);
                for (int j = 0; j <= i; j++) w->normal[i][j] += by[i] * by[j];
            }
        }
        for (int i = 0; i < H; i++)
            for (int j = 0; j < i; j++) w->normal[j][i] = w->normal[i][j];
        for (int i = 0; i < H; i++)
            for (int j = 0; j < H; j++) linear[i] += w->normal[i][j] * moves[j];
        for (int i = 0; i < H; i++) w->normal[i][i] += R(1e-3);
        copy(moves, found, H);
        lead_moves(w, linear, least(reach, R(1e9)), found);
        real u = u_last;
        for (int k = 0; k < H; k++) {
            promised[k] = outputs[k];
            for (int j = 0; j <= k; j++) promised[k] += w->by_move[k][j] * (found[j] - moves[j]);
        }
        for (int k = 0; k < H; k++) {
            moves[k] = found[k];
            u += moves[k];
            inputs[k] = u;
        }
        real before[HYSTMPC_HORIZON], off = R(0.0), changed = R(1.0);
        copy(outputs, before, H);
        linearise_plan(w, m, x, inputs, outputs);
        for (int k = 0; k < H; k++) {
            off = most(off, absolute(outputs[k] - promised[k]));
            changed = most(changed, absolute(outputs[k] - before[k]));
        }
        if (off <= HYSTMPC_LINEAR * changed) break;
    }
}

#endif
