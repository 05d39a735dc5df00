/* Loops around one step of a model: roll-out, exact linearisation, one-step inverse, the lead of a drive.
 * The steps themselves are in the file of the problem, which the export writes from the operators' equations. */
#include "internal.h"

HYSTMPC_LOCAL real root(real x) {
    return MATH(sqrt)(x);
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

/* Inputs of a drive whose outputs come closest to `wanted`, within `reach` a sample:
 *     min_m  sum_k (v_k(u) - w_k)^2 + 1e-3 sum_k m_k^2   s.t.  |m_k| <= reach,  u_k = u_{k-1} + m_k
 * exact for linear dynamics, by Gauss-Newton steps for others. */
HYSTMPC_LOCAL void fit_drive(hystmpc_work *w, const model *m, const real *x, const real *wanted, real u_last,
                             real reach, real *inputs) {
    real moves[HYSTMPC_HORIZON] = {R(0.0)}, found[HYSTMPC_HORIZON], outputs[HYSTMPC_HORIZON];
    real promised[HYSTMPC_HORIZON], off[HYSTMPC_HORIZON];
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
        for (int k = 0; k < H; k++) off[k] = wanted[k] - outputs[k];
        copy(moves, found, H);
        hystmpc_bounded_moves(w->by_move[0], off, H, least(reach, R(1e9)), R(1e-3), found, w->program);
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
        real before[HYSTMPC_HORIZON], missed = R(0.0), changed = R(1.0);
        copy(outputs, before, H);
        linearise_plan(w, m, x, inputs, outputs);
        for (int k = 0; k < H; k++) {
            missed = most(missed, absolute(outputs[k] - promised[k]));
            changed = most(changed, absolute(outputs[k] - before[k]));
        }
        if (missed <= HYSTMPC_LINEAR * changed) break;
    }
}

#endif
