/* A recurrent network in the place of operators, and beside it the operators whose inverse stands in for its own.
 * All products are fused and summed in the order of the inputs, as the engine of Python does (core/network.c), in float as
 * there: both then have equal numbers to the last bit. */
#include "internal.h"

#if HYSTMPC_UNITS

enum {
    U = HYSTMPC_UNITS, /* of a layer, filled up to whole panels with units that stay zero */
    LAYERS = HYSTMPC_LAYERS,
    HIDDEN = HYSTMPC_HIDDEN,
    NET = HYSTMPC_NETWORK, /* entries of the state */
    LANES = 16,          /* units of a panel */
    PANEL = 4 * LANES,   /* sums of a panel: four gates */
    WIDTH = HYSTMPC_NETWORK_WIDTH,
    CELLS = HYSTMPC_NETWORK_CELLS,
    PARTS = HYSTMPC_GRU ? 1 : 2 /* numbers a unit that are remembered; a GRU's output is its own cell */
};

/* Sums that stay in registers: rows by columns. With AVX-512 there is room for more. */
#ifdef __AVX512F__
enum { TOGETHER = 6, COLUMNS = PANEL };
#else
enum { TOGETHER = 2, COLUMNS = PANEL / 2 };
#endif

/* a b + c rounded once. Where the processor cannot: by way of double, right but for one rounding in some 10^8. */
#if defined(FP_FAST_FMAF) || defined(__FMA__) || defined(__ARM_FEATURE_FMA)
#define FUSED(a, b, c) fmaf(a, b, c)
#elif HYSTMPC_SINGLE
#define FUSED(a, b, c) ((a) * (b) + (c))
#else
#define FUSED(a, b, c) (float)((double)(a) * (double)(b) + (double)(c))
#endif

/* sums[r][i] += sum over k of x[r][k] weights[k][i], for so many rows. Rows are written out, since a compiler keeps in
 * registers what it need not index. */
#define EACH_1(DO) DO(0)
#define EACH_2(DO) EACH_1(DO) DO(1)
#define EACH_3(DO) EACH_2(DO) DO(2)
#define EACH_4(DO) EACH_3(DO) DO(3)
#define EACH_5(DO) EACH_4(DO) DO(4)
#define EACH_6(DO) EACH_5(DO) DO(5)
#define START(r)                                                             \
    float s##r[COLUMNS];                                                     \
    for (int i = 0; i < COLUMNS; i++) s##r[i] = sums[(r) * PANEL + i];
#define ADD(r)                                                               \
    {                                                                        \
        const float value = x[(r) * WIDTH + k];                              \
        for (int i = 0; i < COLUMNS; i++) s##r[i] = FUSED(value, weights[k * PANEL + i], s##r[i]); \
    }
#define STORE(r) \
    for (int i = 0; i < COLUMNS; i++) sums[(r) * PANEL + i] = s##r[i];
#define PRODUCT(COUNT)                                                                              \
    static void product_##COUNT(const float *restrict weights, int inputs, const float *restrict x, \
                                float *restrict sums) {                                             \
        EACH_##COUNT(START)                                                                         \
        for (int k = 0; k < inputs; k++) {                                                          \
            EACH_##COUNT(ADD)                                                                       \
        }                                                                                           \
        EACH_##COUNT(STORE)                                                                         \
    }

PRODUCT(1)
PRODUCT(2)
#ifdef __AVX512F__
PRODUCT(3)
PRODUCT(4)
PRODUCT(5)
PRODUCT(6)
#endif

/* One row of two panels at once: the sums of one alone would wait for each other. */
static void product_pair(const float *restrict first, const float *restrict second, int inputs, const float *restrict x,
                         float *restrict sums) {
    float a[PANEL], b[PANEL];
    for (int i = 0; i < PANEL; i++) a[i] = sums[i];
    for (int i = 0; i < PANEL; i++) b[i] = sums[PANEL + i];
    for (int k = 0; k < inputs; k++) {
        const float value = x[k];
        for (int i = 0; i < PANEL; i++) a[i] = FUSED(value, first[k * PANEL + i], a[i]);
        for (int i = 0; i < PANEL; i++) b[i] = FUSED(value, second[k * PANEL + i], b[i]);
    }
    for (int i = 0; i < PANEL; i++) sums[i] = a[i];
    for (int i = 0; i < PANEL; i++) sums[PANEL + i] = b[i];
}

static void product(const float *weights, int inputs, int rows, const float *x, float *sums) {
    for (int at = 0; at < PANEL; at += COLUMNS) {
        switch (rows) {
        case 1: product_1(weights + at, inputs, x, sums + at); break;
        case 2: product_2(weights + at, inputs, x, sums + at); break;
#ifdef __AVX512F__
        case 3: product_3(weights + at, inputs, x, sums + at); break;
        case 4: product_4(weights + at, inputs, x, sums + at); break;
        case 5: product_5(weights + at, inputs, x, sums + at); break;
        default: product_6(weights + at, inputs, x, sums + at); break;
#else
        default: break;
#endif
        }
    }
}

/* Numbers within those from where on tanh is one; not-a-number stays. A loop of its own: inside another one a compiler
 * makes branches of it, and no vectors. */
static void bound(const float *x, float *out, int count) {
    const float limit = 8.50072098F;
    for (int i = 0; i < count; i++) {
        const float below = x[i] > limit ? limit : x[i];
        out[i] = below < -limit ? -limit : below;
    }
}

/* tanh(x) = x P(x^2) / Q(x^2) = odd / even within those bounds, off by at most 2.2e-7 in float; the coefficients are
 * those of core/network.c. */
static inline float odd(float x) {
    static const float a[6] = {1.7296555F,      0.234707922F,    0.00645443471F,
                               4.38413517e-05F, 4.25241105e-08F, -1.40259228e-11F};
    const float s = x * x;
    return x * FUSED(FUSED(FUSED(FUSED(FUSED(a[5], s, a[4]), s, a[3]), s, a[2]), s, a[1]), s, a[0]);
}

static inline float even(float x) {
    static const float b[5] = {1.72965527F, 0.811259866F, 0.0462537706F, 0.000640153361F, 1.91435902e-06F};
    const float s = x * x;
    return FUSED(FUSED(FUSED(FUSED(b[4], s, b[3]), s, b[2]), s, b[1]), s, b[0]);
}

/* tanh in place. */
static void tangents_of(float *x, int count) {
    bound(x, x, count);
    for (int i = 0; i < count; i++) x[i] = odd(x[i]) / even(x[i]);
}

static inline float one_less_square(float a) { return FUSED(-a, a, 1.0F); }

#if HYSTMPC_GRU

/* Output of a panel's units from the sums z of r, z and both parts of n, sigmoid gates halved: n = tanh(z_n + r z_own),
 * h' = (1 - z) n + z h, with two divisions. The sums are used up. */
static void cell(float *restrict z, float *restrict c, float *restrict h) {
    float *gate = z + LANES, *new = z + 2 * LANES;
    bound(gate, gate, LANES);
    tangents_of(z, LANES);
    for (int i = 0; i < LANES; i++) new[i] = FUSED(FUSED(0.5F, z[i], 0.5F), z[3 * LANES + i], new[i]);
    bound(new, new, LANES);
    for (int i = 0; i < LANES; i++) {
        const float p = odd(gate[i]), q = even(gate[i]), below = even(new[i]);
        const float total = FUSED(q - p, odd(new[i]), (q + p) * c[i] * below);
        c[i] = 0.5F * total / (q * below);
        h[i] = c[i];
    }
}

/* The same, and derivatives: dh' = f_0 dh + f_1 dz_r + f_2 dz_z + f_3 dz_n + f_4 dz_own. */
static void differentiated_cell(float *restrict z, float *restrict c, float *restrict h,
                                float (*restrict by)[LANES]) {
    float *new = z + 2 * LANES;
    tangents_of(z, 2 * LANES);
    for (int j = 0; j < LANES; j++) new[j] = FUSED(FUSED(0.5F, z[j], 0.5F), z[3 * LANES + j], new[j]);
    tangents_of(new, LANES);
    for (int j = 0; j < LANES; j++) {
        const float r = z[j], k = z[LANES + j];
        const float opened = FUSED(0.5F, r, 0.5F), keep = FUSED(0.5F, k, 0.5F), take = FUSED(-0.5F, k, 0.5F);
        const float fresh = take * one_less_square(new[j]), gap = c[j] - new[j];
        by[0][j] = keep;
        by[1][j] = fresh * z[3 * LANES + j] * (0.5F * one_less_square(r));
        by[2][j] = gap * (0.5F * one_less_square(k));
        by[3][j] = fresh;
        by[4][j] = fresh * opened;
        c[j] = FUSED(keep, gap, new[j]);
        h[j] = c[j];
    }
}

/* Derivatives of the output by one command, from those of the sums. */
static void tangent_cell(const float *restrict z, float *restrict c, float *restrict h,
                         float (*restrict by)[LANES]) {
    for (int j = 0; j < LANES; j++) {
        const float gates = FUSED(by[2][j], z[LANES + j], FUSED(by[1][j], z[j], by[0][j] * c[j]));
        c[j] = h[j] = FUSED(by[4][j], z[3 * LANES + j], FUSED(by[3][j], z[2 * LANES + j], gates));
    }
}

#else

/* Cell c and output h of a panel's units from the sums z of the gates i, f, g, o, sigmoid gates halved:
 * c' = f c + i g, h' = o tanh(c'), with two divisions. The sums are used up. */
static void cell(float *restrict z, float *restrict c, float *restrict h) {
    float shown[LANES];
    bound(z, z, PANEL);
    for (int i = 0; i < LANES; i++) {
        const float zi = z[i], zf = z[LANES + i], zg = z[2 * LANES + i];
        const float qi = even(zi), qf = even(zf), beside = qi * even(zg);
        const float kept = (qf + odd(zf)) * c[i] * beside;
        const float total = FUSED((qi + odd(zi)) * odd(zg), qf, kept);
        c[i] = 0.5F * total / (beside * qf);
    }
    bound(c, shown, LANES);
    for (int i = 0; i < LANES; i++) {
        const float zo = z[3 * LANES + i], q = even(zo);
        h[i] = 0.5F * (q + odd(zo)) * odd(shown[i]) / (q * even(shown[i]));
    }
}

/* The same, and derivatives: dc' = f_0 dc + f_1 dz_i + f_2 dz_f + f_3 dz_g, dh' = f_4 dz_o + f_5 dc'. */
static void differentiated_cell(float *restrict z, float *restrict c, float *restrict h,
                                float (*restrict by)[LANES]) {
    float shown[LANES];
    tangents_of(z, PANEL);
    for (int j = 0; j < LANES; j++) {
        const float i = z[j], f = z[LANES + j], g = z[2 * LANES + j];
        const float gain = FUSED(0.5F, i, 0.5F), forget = FUSED(0.5F, f, 0.5F);
        by[0][j] = forget;
        by[1][j] = 0.5F * one_less_square(i) * g;
        by[2][j] = 0.5F * one_less_square(f) * c[j];
        by[3][j] = gain * one_less_square(g);
        c[j] = FUSED(forget, c[j], gain * g);
        shown[j] = c[j];
    }
    tangents_of(shown, LANES);
    for (int j = 0; j < LANES; j++) {
        const float o = z[3 * LANES + j], out = FUSED(0.5F, o, 0.5F);
        by[4][j] = 0.5F * one_less_square(o) * shown[j];
        by[5][j] = out * one_less_square(shown[j]);
        h[j] = out * shown[j];
    }
}

/* Derivatives of cell and output by one command, from those of the sums. */
static void tangent_cell(const float *restrict z, float *restrict c, float *restrict h,
                         float (*restrict by)[LANES]) {
    for (int j = 0; j < LANES; j++) {
        const float kept = FUSED(by[1][j], z[j], by[0][j] * c[j]);
        c[j] = FUSED(by[3][j], z[2 * LANES + j], FUSED(by[2][j], z[LANES + j], kept));
        h[j] = FUSED(by[5][j], c[j], by[4][j] * z[3 * LANES + j]);
    }
}

#endif

/* A panel's bias, then its weights input by input; the first layer has one input below. */
static const float *panel_of(int layer, int panel) {
    const int first = (2 + U) * PANEL, further = (1 + 2 * U) * PANEL;
    if (layer == 0) return hystmpc_weights + panel * first;
    return hystmpc_weights + U / LANES * first + ((layer - 1) * (U / LANES) + panel) * further;
}

/* One sample of one motion through all layers. */
static void move_one(float *x, float *c) {
    float sums[4 * HYSTMPC_UNITS], h[HYSTMPC_UNITS];
    for (int layer = 0; layer < LAYERS; layer++) {
        const float *below = x + (layer ? 1 + (layer - 1) * U : 0);
        const int inputs = layer ? 2 * U : 1 + U;
        for (int panel = 0; panel < U / LANES; panel++)
            for (int i = 0; i < PANEL; i++) sums[panel * PANEL + i] = panel_of(layer, panel)[i];
        for (int panel = 0; panel < U / LANES; panel += 2) {
            const float *weights = panel_of(layer, panel) + PANEL;
            float *at = sums + panel * PANEL;
            if (panel + 1 == U / LANES) product(weights, inputs, 1, below, at);
            else product_pair(weights, panel_of(layer, panel + 1) + PANEL, inputs, below, at);
        }
        for (int panel = 0; panel < U / LANES; panel++)
            cell(sums + panel * PANEL, c + layer * U + panel * LANES, h + panel * LANES);
        for (int unit = 0; unit < U; unit++) x[1 + layer * U + unit] = h[unit];
    }
}

/* One sample of rows through all layers. A row of x is the scaled command, then the outputs of all layers, so that
 * what a layer reads, the new output of the layer below and its own old one, stands side by side. `derived`: row 0 is a
 * motion and the rows behind it are derivatives along it; else all are motions. */
static void move(float (*x)[WIDTH], float (*c)[CELLS], float (*h)[HYSTMPC_UNITS], int rows, int derived) {
    if (rows == 1) {
        move_one(x[0], c[0]);
        return;
    }
    const int blocks = (rows + TOGETHER - 1) / TOGETHER;
    float sums[TOGETHER * PANEL], by[6][LANES];
    for (int layer = 0; layer < LAYERS; layer++) {
        const int column = layer ? 1 + (layer - 1) * U : 0, inputs = layer ? 2 * U : 1 + U;
        for (int panel = 0; panel < U / LANES; panel++) {
            const float *weights = panel_of(layer, panel);
            const int unit = panel * LANES;
            for (int block = blocks, row = 0; block > 0; block--) { /* of rows, as even as can be */
                const int count = (rows - row + block - 1) / block;
                for (int r = 0; r < count; r++) {
                    const int moves = !derived || row + r == 0;
                    for (int i = 0; i < PANEL; i++) sums[r * PANEL + i] = moves ? weights[i] : 0.0F;
                }
                product(weights + PANEL, inputs, count, x[row] + column, sums);
                for (int r = 0; r < count; r++) {
                    float *z = sums + r * PANEL, *at = c[row + r] + layer * U + unit, *out = h[row + r] + unit;
                    if (!derived) cell(z, at, out);
                    else if (row + r == 0) differentiated_cell(z, at, out, by);
                    else tangent_cell(z, at, out, by);
                }
                row += count;
            }
        }
        for (int row = 0; row < rows; row++)
            for (int unit = 0; unit < U; unit++) x[row][1 + layer * U + unit] = h[row][unit];
    }
}

/* The scaled angle of a row, the bias left out. */
static real head_of(const float *x) {
    real parts[8] = {R(0.0)};
    const float *last = x + WIDTH - U;
    for (int unit = 0; unit < U; unit += 8)
        for (int i = 0; i < 8; i++) parts[i] += (real)hystmpc_head[unit + i] * (real)last[unit + i];
    return ((parts[0] + parts[4]) + (parts[2] + parts[6])) + ((parts[1] + parts[5]) + (parts[3] + parts[7]));
}

static float scaled(real u) { return (float)((u - HYSTMPC_U_OFFSET) / HYSTMPC_U_SCALE); }

static real in_degrees(const float *x) {
    return HYSTMPC_THETA_OFFSET + HYSTMPC_THETA_SCALE * (head_of(x) + HYSTMPC_HEAD_BIAS);
}

static void load(const real *state, float *x, float *c) {
    for (int i = 0; i < WIDTH; i++) x[i] = 0.0F;
    for (int i = 0; i < CELLS; i++) c[i] = 0.0F;
    for (int layer = 0; layer < LAYERS; layer++) {
        for (int unit = 0; unit < HIDDEN; unit++) {
            x[1 + layer * U + unit] = (float)state[PARTS * layer * HIDDEN + unit];
            c[layer * U + unit] = (float)state[(PARTS * layer + PARTS - 1) * HIDDEN + unit];
        }
    }
}

static void unload(real *state, const float *x, const float *c) {
    for (int layer = 0; layer < LAYERS; layer++) {
        for (int unit = 0; unit < HIDDEN; unit++) {
            state[PARTS * layer * HIDDEN + unit] = (real)x[1 + layer * U + unit];
            state[(PARTS * layer + PARTS - 1) * HIDDEN + unit] = (real)c[layer * U + unit];
        }
    }
}

/* One sample of the network, in place; its angle. */
HYSTMPC_LOCAL real network_step(real *state, real u) {
    float x[1][WIDTH], c[1][CELLS], h[1][HYSTMPC_UNITS];
    load(state, x[0], c[0]);
    x[0][0] = scaled(u);
    move(x, c, h, 1, 0);
    unload(state, x[0], c[0]);
    return in_degrees(x[0]);
}

/* The state is that of the network, its angle, that of the operators beside it, their angle. */
HYSTMPC_LOCAL void middle_step(real *x, real u) {
    real next[HYSTMPC_CHAIN], *beside = x + NET + 1;
    x[NET] = network_step(x, u);
    step_middle(beside, u, x + NET + 1 + HYSTMPC_BESIDE, next);
    copy(next, beside, HYSTMPC_BESIDE);
}

/* The operators are asked for the wanted angle and what they are off the network by now. */
HYSTMPC_LOCAL real middle_command(const real *x, real wanted, real last) {
    return command_for(x + NET + 1, wanted + x[NET + 1 + HYSTMPC_BESIDE] - x[NET], last);
}

HYSTMPC_LOCAL void model_step(const real *x, real u, real *theta, real *next) {
    real travel = u;
    copy(x, next, S);
#if HYSTMPC_FRONT
    hystmpc_front.step(x, u, &travel, next);
#endif
    middle_step(next + HYSTMPC_FRONT, travel);
    *theta = next[HYSTMPC_FRONT + NET];
}

/* What the command is behind the drive. */
static void travel_along(const real *x, const real *commands, int samples, real *travel) {
#if HYSTMPC_FRONT
    run_plan(&hystmpc_front, x, commands, samples, travel);
#else
    (void)x;
    copy(commands, travel, samples);
#endif
}

/* Plans that were one row up to this sample and differ in it: each but the first gets a row of its own. How many there
 * are; the scaled commands are set. */
static int part_ways(real (*travel)[HYSTMPC_HORIZON], int count, int k, int *row_of, int used, float (*rows)[WIDTH],
                     float (*cells)[CELLS]) {
    int before[HYSTMPC_CANDIDATES];
    for (int n = 0; n < count; n++) {
        int first = 1, same = 0;
        before[n] = row_of[n];
        for (int m = 0; m < n && !same; m++) {
            if (before[m] != before[n]) continue;
            first = 0;
            same = travel[m][k] == travel[n][k];
            if (same) row_of[n] = row_of[m];
        }
        if (same) continue;
        if (!first) {
            row_of[n] = used++;
            for (int i = 0; i < WIDTH; i++) rows[row_of[n]][i] = rows[before[n]][i];
            for (int i = 0; i < CELLS; i++) cells[row_of[n]][i] = cells[before[n]][i];
        }
        rows[row_of[n]][0] = scaled(travel[n][k]);
    }
    return used;
}

/* Angles of plans, of which those whose commands are the same so far are one row. */
static void roll(const real *x, real (*travel)[HYSTMPC_HORIZON], int count, int samples, float (*rows)[WIDTH],
                 float (*cells)[CELLS], float (*out)[HYSTMPC_UNITS], real (*angles)[HYSTMPC_HORIZON]) {
    int row_of[HYSTMPC_CANDIDATES] = {0}, used = 1;
    real found[HYSTMPC_CANDIDATES];
    load(x + HYSTMPC_FRONT, rows[0], cells[0]);
    for (int k = 0; k < samples; k++) {
        used = part_ways(travel, count, k, row_of, used, rows, cells);
        move(rows, cells, out, used, 0);
        for (int n = 0; n < used; n++) found[n] = in_degrees(rows[n]);
        for (int n = 0; n < count; n++) angles[n][k] = found[row_of[n]];
    }
}

HYSTMPC_LOCAL void run_model(const real *x, const real *commands, int samples, real *angles) {
    real travel[1][HYSTMPC_HORIZON], found[1][HYSTMPC_HORIZON];
    float rows[1][WIDTH], cells[1][CELLS], out[1][HYSTMPC_UNITS];
    travel_along(x, commands, samples, travel[0]);
    roll(x, travel, 1, samples, rows, cells, out, found);
    copy(found[0], angles, samples);
}

HYSTMPC_LOCAL void run_plans(hystmpc_work *w, const real *x, real (*plans)[HYSTMPC_HORIZON], int count,
                             real (*angles)[HYSTMPC_HORIZON]) {
    for (int n = 0; n < count; n++) travel_along(x, plans[n], H, angles[n]);
    if (count) roll(x, angles, count, H, w->network_rows, w->network_cells, w->network_outputs, angles);
}

/* Row 0 is the motion, row j the derivative by command j - 1, which joins at its own sample. */
HYSTMPC_LOCAL void linearise_model(hystmpc_work *w, const real *x, const real *commands) {
    float(*rows)[WIDTH] = w->network_rows, (*cells)[CELLS] = w->network_cells;
    const real gain = HYSTMPC_THETA_SCALE / HYSTMPC_U_SCALE;
    real travel[HYSTMPC_HORIZON];
#if HYSTMPC_FRONT
    linearise_plan(w, &hystmpc_front, x, commands, travel);
    for (int k = 0; k < H; k++) copy(w->jacobian[k], w->by_move[k], H);
#else
    copy(commands, travel, H);
#endif
    load(x + HYSTMPC_FRONT, rows[0], cells[0]);
    for (int k = 1; k <= H; k++) {
        for (int i = 0; i < WIDTH; i++) rows[k][i] = 0.0F;
        for (int i = 0; i < CELLS; i++) cells[k][i] = 0.0F;
    }
    for (int k = 0; k < H; k++) {
        rows[k][0] = 0.0F; /* the last command's share has come in */
        rows[k + 1][0] = 1.0F;
        rows[0][0] = scaled(travel[k]);
        move(rows, cells, w->network_outputs, 2 + k, 1);
        for (int j = 0; j < H; j++) w->jacobian[k][j] = j <= k ? gain * head_of(rows[1 + j]) : R(0.0);
    }
#if HYSTMPC_FRONT
    for (int k = 0; k < H; k++) {
        copy(w->jacobian[k], travel, H);
        for (int j = 0; j < H; j++) {
            real sum = R(0.0);
            for (int i = j; i <= k; i++) sum += travel[i] * w->by_move[i][j];
            w->jacobian[k][j] = sum;
        }
    }
#endif
}

#endif
