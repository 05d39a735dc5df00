/* Recurrent networks: samples, roll-outs, and derivatives by forward sensitivity.
 *
 * Rows of a table are motions, or a motion and derivatives along it. A row of x is [inputs (I), outputs h_1 .. h_L (U
 * each)], so that what a layer reads, the new output of the layer below and its own old one, stands side by side. For
 * one panel of weights, which stays in the first cache, blocks of rows are passed whose sums stay in registers:
 *
 *     for every input k:  sums[row, gate] += x[row, k] weights[k, gate]      (a vector of units each)
 *
 * Products are fused with their sums, and added in the order of the inputs, whatever the vectors' length and the rows
 * beside: equal numbers to the last bit on all processors, and in an exported controller. (Where a processor cannot fuse,
 * by way of double, right but for one rounding in some 10^8.) */
#include "network.h"

#include "real.h"

#if defined(__GNUC__) && defined(__AVX512F__)
#include <immintrin.h>
#define LANES 16
#define ROWS 6 /* whose four sums each are in registers, beside the weights and an input of every row */
#define FUSED(a, b, c) _mm512_fmadd_ps(a, b, c)
#elif defined(__GNUC__) && defined(__AVX2__) && defined(__FMA__)
#include <immintrin.h>
#define LANES 8
#define ROWS 3
#define FUSED(a, b, c) _mm256_fmadd_ps(a, b, c)
#elif defined(__GNUC__) && defined(__aarch64__) && defined(__ARM_NEON)
#include <arm_neon.h>
#define LANES 4
#define ROWS 6
#define FUSED(a, b, c) vfmaq_f32(c, a, b)
#elif defined(__GNUC__)
#define LANES 4
#define ROWS 2
#else
#define LANES 1
#define ROWS 2
#endif

#if LANES > 1
#define ALWAYS static inline __attribute__((always_inline))
typedef float vec __attribute__((vector_size(4 * LANES)));
typedef float vec_anywhere __attribute__((vector_size(4 * LANES), aligned(4), may_alias));
typedef int mask __attribute__((vector_size(4 * LANES)));
ALWAYS vec load(const float *x) { return *(const vec_anywhere *)x; }
ALWAYS void store(float *x, vec a) { *(vec_anywhere *)x = a; }
ALWAYS vec all(float x) { return x - (vec){0.0F}; }
ALWAYS vec chosen(mask which, vec a, vec b) { return (vec)((which & (mask)a) | (~which & (mask)b)); }
#else
#define ALWAYS static inline
typedef float vec;
ALWAYS vec load(const float *x) { return *x; }
ALWAYS void store(float *x, vec a) { *x = a; }
ALWAYS vec all(float x) { return x; }
ALWAYS vec chosen(int which, vec a, vec b) { return which ? a : b; }
#endif

/* a b + c, rounded once. */
ALWAYS vec fused(vec a, vec b, vec c) {
#if defined(FUSED)
    return FUSED(a, b, c);
#elif LANES > 1
    typedef double wide __attribute__((vector_size(8 * LANES)));
    const wide sum = __builtin_convertvector(a, wide) * __builtin_convertvector(b, wide);
    return __builtin_convertvector(sum + __builtin_convertvector(c, wide), vec);
#else
    return (float)((double)a * (double)b + (double)c);
#endif
}

enum {
    GATES = 4,
    LINE = GATES * LANES, /* numbers of one input in a panel */
    FACTORS = 8,
    TOGETHER = 36 /* plans at a time: with a panel of the weights their rows are in the first cache */
};

/* Places and widths of a network and of a table of rows. */
typedef struct {
    const hystmpc_network *net;
    const float *panels, *head, *radii;
    int units, width, cells; /* U; numbers of a row of x, and of c */
    float *x, *c, *h;        /* (R, width), (R, L U) cells, (R, U) outputs of the layer at work */
    float *factors;          /* (FACTORS, U) of the motion, what its derivatives are multiplied with */
    float *share;            /* (R,): of the step, how much a motion takes; its derivative, of a derivative */
    float *moves;            /* (I,): whether the inputs of the motion move with the command */
} table;

static int units_of(const hystmpc_network *net) {
    const int whole = LANES > 8 ? LANES : 8;
    return (net->hidden + whole - 1) / whole * whole;
}

static int height_of(const table *t, int layer) { return layer ? 2 * t->units : t->net->inputs + t->units; }

/* A panel's bias, and its weights behind it. */
static const float *panel_of(const table *t, int layer, int panel) {
    const long count = t->units / LANES, first = (1 + height_of(t, 0)) * LINE, further = (1 + 2 * t->units) * LINE;
    return t->panels + (layer ? count * first + ((layer - 1) * count + panel) * further : panel * first);
}

int hystmpc_network_lanes(void) { return LANES; }

int hystmpc_network_together(void) { return TOGETHER; }

int hystmpc_network_state(const hystmpc_network *network) {
    const int own = network->layers * network->hidden;
    return network->kind == HYSTMPC_GRU ? own : 2 * own + (network->kind == HYSTMPC_GATED ? network->inputs : 0);
}

long hystmpc_network_room(const hystmpc_network *network, int rows) {
    const long units = units_of(network), cells = network->layers * units;
    return (rows * (network->inputs + 2 * cells + units + 1) + FACTORS * units + network->inputs + 1) / 2;
}

static table table_in(const hystmpc_network *net, int rows, double *work) {
    table t;
    t.net = net;
    t.panels = (const float *)(net + 1);
    t.units = units_of(net);
    t.cells = net->layers * t.units;
    t.width = net->inputs + t.cells;
    t.head = panel_of(&t, net->layers, 0);
    t.radii = t.head + t.units + net->inputs;
    t.x = (float *)work;
    t.c = t.x + rows * t.width;
    t.h = t.c + rows * t.cells;
    t.factors = t.h + rows * t.units;
    t.share = t.factors + FACTORS * t.units;
    t.moves = t.share + rows;
    for (int i = 0; i < rows * (t.width + t.cells); i++) t.x[i] = 0.0F; /* x and c */
    return t;
}

/* Sums z (rows, panels, 4) of all inputs, for so many rows and panels, which are constants where this is called. */
ALWAYS void products(int rows, int panels, const float *weights, long size, int inputs, const float *x, int width,
                     vec *z) {
    vec sums[ROWS > 2 ? ROWS : 2][GATES];
    for (int n = 0; n < rows * panels; n++)
        for (int gate = 0; gate < GATES; gate++) sums[n][gate] = z[n * GATES + gate];
    for (int k = 0; k < inputs; k++)
        for (int panel = 0; panel < panels; panel++)
            for (int gate = 0; gate < GATES; gate++) {
                const vec weight = load(weights + panel * size + k * LINE + gate * LANES);
                for (int row = 0; row < rows; row++)
                    sums[row * panels + panel][gate] =
                        fused(all(x[row * width + k]), weight, sums[row * panels + panel][gate]);
            }
    for (int n = 0; n < rows * panels; n++)
        for (int gate = 0; gate < GATES; gate++) z[n * GATES + gate] = sums[n][gate];
}

static void product(int rows, const float *weights, int inputs, const float *x, int width, vec *z) {
    switch (rows) {
    case 1: products(1, 1, weights, 0, inputs, x, width, z); break;
    case 2: products(2, 1, weights, 0, inputs, x, width, z); break;
#if ROWS >= 3
    case 3: products(3, 1, weights, 0, inputs, x, width, z); break;
#endif
#if ROWS >= 6
    case 4: products(4, 1, weights, 0, inputs, x, width, z); break;
    case 5: products(5, 1, weights, 0, inputs, x, width, z); break;
    case 6: products(6, 1, weights, 0, inputs, x, width, z); break;
#endif
    default: break;
    }
}

/* One row of two panels at once: the sums of one alone would wait for each other. */
static void product_of_pair(const float *weights, long size, int inputs, const float *x, vec *z) {
    products(1, 2, weights, size, inputs, x, 0, z);
}

/* tanh(x) = odd(x) / even(x) = x P(x^2) / Q(x^2) within +-LIMIT, and one beyond; not-a-number stays. Fitted: the
 * fraction is off by at most 6e-8 on the whole line, in float by 2.2e-7. 1 < Q < 600: products of three stay far from the
 * ends of float. */
static const float LIMIT = 8.50072098F;

ALWAYS vec bound(vec x) {
    const vec high = all(LIMIT), low = all(-LIMIT), below = chosen(x > high, high, x);
    return chosen(below < low, low, below);
}

ALWAYS vec odd(vec x) {
    const vec s = x * x;
    vec p = fused(all(-1.40259228e-11F), s, all(4.25241105e-08F));
    p = fused(fused(p, s, all(4.38413517e-05F)), s, all(0.00645443471F));
    return x * fused(fused(p, s, all(0.234707922F)), s, all(1.7296555F));
}

ALWAYS vec even(vec x) {
    const vec s = x * x, q = fused(all(1.91435902e-06F), s, all(0.000640153361F));
    return fused(fused(fused(q, s, all(0.0462537706F)), s, all(0.811259866F)), s, all(1.72965527F));
}

ALWAYS vec tangent_of(vec x) {
    const vec y = bound(x);
    return odd(y) / even(y);
}

ALWAYS vec one_less_square(vec a) { return fused(-a, a, all(1.0F)); }

/* Output of a unit from the sums z of r, z and both parts of n: n = tanh(z_n + r z_own), h' = (1 - z) n + z h, with two
 * divisions. A GRU's output is its own cell. */
ALWAYS vec gru_cell(const vec *z, vec h) {
    const vec half = all(0.5F), gate = bound(z[1]), p = odd(gate), q = even(gate);
    const vec new = bound(fused(fused(half, tangent_of(z[0]), half), z[3], z[2])), below = even(new);
    const vec total = fused(q - p, odd(new), (q + p) * h * below);
    return half * total / (q * below);
}

/* The same, and derivatives: dh' = f_0 dh + f_1 dz_r + f_2 dz_z + f_3 dz_n + f_4 dz_own. */
ALWAYS vec differentiated_gru_cell(const vec *z, vec h, vec *by) {
    const vec half = all(0.5F), r = tangent_of(z[0]), k = tangent_of(z[1]);
    const vec opened = fused(half, r, half), keep = fused(half, k, half), take = fused(-half, k, half);
    const vec new = tangent_of(fused(opened, z[3], z[2])), fresh = take * one_less_square(new), gap = h - new;
    by[0] = keep;
    by[1] = fresh * z[3] * (half * one_less_square(r));
    by[2] = gap * (half * one_less_square(k));
    by[3] = fresh;
    by[4] = fresh * opened;
    return fused(keep, gap, new);
}

ALWAYS vec gru_tangent(const vec *z, vec h, const vec *by) {
    const vec gates = fused(by[2], z[1], fused(by[1], z[0], by[0] * h));
    return fused(by[4], z[3], fused(by[3], z[2], gates));
}

/* Cell and output of a unit from the sums z of the gates i, f, g, o: c' = f c + i g, h' = o tanh(c'), with two
 * divisions. */
ALWAYS void lstm_cell(const vec *z, vec *c, vec *h) {
    const vec half = all(0.5F), i = bound(z[0]), f = bound(z[1]), g = bound(z[2]), o = bound(z[3]);
    const vec qi = even(i), qf = even(f), qo = even(o), beside = qi * even(g);
    const vec kept = (qf + odd(f)) * *c * beside;
    const vec total = fused((qi + odd(i)) * odd(g), qf, kept);
    *c = half * total / (beside * qf);
    const vec shown = bound(*c);
    *h = half * (qo + odd(o)) * odd(shown) / (qo * even(shown));
}

/* The same, and derivatives: dc' = f_0 dc + f_1 dz_i + f_2 dz_f + f_3 dz_g, dh' = f_4 dz_o + f_5 dc'. */
ALWAYS void differentiated_lstm_cell(const vec *z, vec *c, vec *h, vec *by) {
    const vec half = all(0.5F), i = tangent_of(z[0]), f = tangent_of(z[1]), g = tangent_of(z[2]), o = tangent_of(z[3]);
    const vec gain = fused(half, i, half), forget = fused(half, f, half), out = fused(half, o, half);
    by[0] = forget;
    by[1] = half * one_less_square(i) * g;
    by[2] = half * one_less_square(f) * *c;
    by[3] = gain * one_less_square(g);
    *c = fused(forget, *c, gain * g);
    const vec shown = tangent_of(*c);
    by[4] = half * one_less_square(o) * shown;
    by[5] = out * one_less_square(shown);
    *h = out * shown;
}

ALWAYS void lstm_tangent(const vec *z, vec *c, vec *h, const vec *by) {
    *c = fused(by[3], z[2], fused(by[2], z[1], fused(by[1], z[0], by[0] * *c)));
    *h = fused(by[5], *c, by[4] * z[3]);
}

/* A panel's units of one motion: sums z to cells and outputs. */
static void finish_motion(const table *t, int layer, int unit, int row, const vec *z) {
    const int at = layer * t->units + unit;
    float *cell = t->c + row * t->cells + at;
    vec c = load(cell), h;
    if (t->net->kind == HYSTMPC_GRU) {
        c = h = gru_cell(z, c);
    } else {
        const vec c_old = c;
        lstm_cell(z, &c, &h);
        if (t->net->kind == HYSTMPC_GATED) { /* c' = c + m (b - c), h' = h + m (a - h) */
            const vec share = all(t->share[row]), h_old = load(t->x + row * t->width + t->net->inputs + at);
            c = fused(share, c - c_old, c_old);
            h = fused(share, h - h_old, h_old);
        }
    }
    store(cell, c);
    store(t->h + row * t->units + unit, h);
}

/* The same of the motion in row 0; its factors are kept. */
static void finish_first(const table *t, int layer, int unit, const vec *z) {
    const int at = layer * t->units + unit;
    vec c = load(t->c + at), h, by[FACTORS] = {all(0.0F)};
    if (t->net->kind == HYSTMPC_GRU) {
        c = h = differentiated_gru_cell(z, c, by);
    } else {
        const vec c_old = c;
        differentiated_lstm_cell(z, &c, &h, by);
        if (t->net->kind == HYSTMPC_GATED) {
            const vec share = all(t->share[0]), h_old = load(t->x + t->net->inputs + at);
            by[6] = c - c_old;
            by[7] = h - h_old;
            c = fused(share, by[6], c_old);
            h = fused(share, by[7], h_old);
        }
    }
    store(t->c + at, c);
    store(t->h + unit, h);
    for (int k = 0; k < FACTORS; k++) store(t->factors + k * t->units + unit, by[k]);
}

/* The same of derivatives along that motion. */
static void finish_tangents(const table *t, int layer, int unit, int row, int count, const vec *z) {
    const int at = layer * t->units + unit, kind = t->net->kind;
    vec by[FACTORS];
    for (int k = 0; k < FACTORS; k++) by[k] = load(t->factors + k * t->units + unit);
    for (int n = row; n < row + count; n++, z += GATES) {
        float *cell = t->c + n * t->cells + at;
        const vec c_old = load(cell);
        vec c = c_old, h;
        if (kind == HYSTMPC_GRU) {
            c = h = gru_tangent(z, c, by);
        } else {
            lstm_tangent(z, &c, &h, by);
            if (kind == HYSTMPC_GATED) { /* by the product rule, with the derivative of m */
                const vec share = all(t->share[0]), by_share = all(t->share[n]);
                const vec h_old = load(t->x + n * t->width + t->net->inputs + at);
                c = fused(share, c - c_old, fused(by_share, by[6], c_old));
                h = fused(share, h - h_old, fused(by_share, by[7], h_old));
            }
        }
        store(cell, c);
        store(t->h + n * t->units + unit, h);
    }
}

/* Outputs of a layer to where the next layer and the next sample read them. */
static void show(const table *t, int layer, int rows) {
    for (int row = 0; row < rows; row++) {
        float *to = t->x + row * t->width + t->net->inputs + layer * t->units;
        for (int unit = 0; unit < t->units; unit++) to[unit] = t->h[row * t->units + unit];
    }
}

/* One sample of one motion through all layers. */
static void move_one(const table *t) {
    for (int layer = 0; layer < t->net->layers; layer++) {
        const int inputs = height_of(t, layer), panels = t->units / LANES;
        const float *x = t->x + (layer ? t->net->inputs + (layer - 1) * t->units : 0);
        const long size = (1 + inputs) * LINE;
        for (int panel = 0; panel < panels; panel += 2) {
            const float *weights = panel_of(t, layer, panel);
            const int pair = panel + 1 < panels;
            vec z[2 * GATES];
            for (int gate = 0; gate < GATES; gate++) {
                z[gate] = load(weights + gate * LANES);
                z[GATES + gate] = load(weights + pair * size + gate * LANES);
            }
            if (pair) product_of_pair(weights + LINE, size, inputs, x, z);
            else product(1, weights + LINE, inputs, x, 0, z);
            for (int n = 0; n <= pair; n++) finish_motion(t, layer, (panel + n) * LANES, 0, z + n * GATES);
        }
        show(t, layer, 1);
    }
}

/* One sample of rows through all layers, in blocks as even as can be. `derived`: row 0 is a motion and the rows behind it
 * are derivatives along it; else all are motions. */
static void move(const table *t, int rows, int derived) {
    const int blocks = (rows + ROWS - 1) / ROWS;
    for (int layer = 0; layer < t->net->layers; layer++) {
        const int inputs = height_of(t, layer), column = layer ? t->net->inputs + (layer - 1) * t->units : 0;
        for (int panel = 0; panel < t->units / LANES; panel++) {
            const float *weights = panel_of(t, layer, panel);
            const int unit = panel * LANES;
            for (int block = blocks, row = 0; block > 0; block--) {
                const int count = (rows - row + block - 1) / block, first = derived && row == 0;
                vec z[ROWS * GATES];
                for (int n = 0; n < count * GATES; n++) {
                    const int moves = !derived || (first && n < GATES);
                    z[n] = moves ? load(weights + n % GATES * LANES) : all(0.0F);
                }
                product(count, weights + LINE, inputs, t->x + row * t->width + column, t->width, z);
                if (!derived) {
                    for (int r = 0; r < count; r++) finish_motion(t, layer, unit, row + r, z + r * GATES);
                } else {
                    if (first) finish_first(t, layer, unit, z);
                    finish_tangents(t, layer, unit, row + first, count - first, z + first * GATES);
                }
                row += count;
            }
        }
        show(t, layer, rows);
    }
}

/* Lag and plays of a row in place, w' = v + sign(w - v) max(k |w - v| - e, 0), p' = max(w' - r, min(w' + r, p)); returns
 * the move w' - w. moves (I,): of the lag the share of v that passes at once, of each play whether it moves. */
static float follow(const table *t, float *x, float v) {
    const float last = x[0], behind = last - v, left = t->net->keep * fabsf(behind) - t->net->settled;
    const int late = t->net->keep > 0.0F && left > 0.0F;
    const float w = late ? v + copysignf(left, behind) : v;
    t->moves[0] = late ? 1.0F - t->net->keep : 1.0F;
    x[0] = w;
    for (int i = 1; i < t->net->inputs; i++) {
        const float pulled = w + t->radii[i - 1], pushed = w - t->radii[i - 1], p = x[i];
        const float held = pulled < p ? pulled : p;
        t->moves[i] = pushed >= held || pulled <= p ? 1.0F : 0.0F;
        x[i] = pushed > held ? pushed : held;
    }
    return w - last;
}

/* Inputs of a motion under the command u; of a gated LSTM the move too. */
static float command(const table *t, int row, double u) {
    const float v = (float)((u - t->net->u_offset) / t->net->u_scale);
    float *x = t->x + row * t->width;
    if (t->net->kind != HYSTMPC_GATED) {
        x[0] = v;
        return 0.0F;
    }
    const float moved = follow(t, x, v), rate = t->net->rate;
    t->share[row] = rate < 0.0F ? 1.0F - expf(rate * fabsf(moved)) : 1.0F;
    return moved;
}

/* Inputs of derivatives at sample k: row j is that by command j - 1, which joins at its own sample. */
static void command_tangents(const table *t, int k, float moved) {
    const int inputs = t->net->inputs;
    const float lag = 1.0F - t->moves[0], sign = (float)((moved > 0.0F) - (moved < 0.0F));
    const float slope = t->net->rate * (t->share[0] - 1.0F) * sign;
    if (t->net->kind != HYSTMPC_GATED) {
        if (k) t->x[k * t->width] = 0.0F; /* the last command's share has come in */
        t->x[(k + 1) * t->width] = 1.0F;
        return;
    }
    for (int row = 1; row <= k + 1; row++) {
        float *x = t->x + row * t->width;
        const float before = x[0];
        x[0] = row == k + 1 ? t->moves[0] : lag * before;
        for (int i = 1; i < inputs; i++)
            if (t->moves[i] > 0.0F) x[i] = x[0];
        t->share[row] = slope * (x[0] - before);
    }
}

/* The scaled angle of a row, the bias left out; in double, since then its rounding is not seen. */
static double head_of(const table *t, int row) {
    double parts[8] = {0.0};
    const float *x = t->x + row * t->width, *last = x + t->width - t->units, *of_inputs = t->head + t->units;
    for (int unit = 0; unit < t->units; unit += 8)
        for (int i = 0; i < 8; i++) parts[i] += (double)t->head[unit + i] * (double)last[unit + i];
    double sum = ((parts[0] + parts[4]) + (parts[2] + parts[6])) + ((parts[1] + parts[5]) + (parts[3] + parts[7]));
    if (t->net->kind == HYSTMPC_GATED)
        for (int i = 0; i < t->net->inputs; i++) sum += (double)of_inputs[i] * (double)x[i];
    return sum;
}

static double degrees(const table *t, int row) {
    return t->net->theta_offset + t->net->theta_scale * (head_of(t, row) + t->net->head_bias);
}

/* Where a state has the inputs of a row, and which of its numbers are a layer's cells. */
static int front_of(const hystmpc_network *net) { return net->kind == HYSTMPC_GATED ? net->inputs : 0; }

static int parts_of(const hystmpc_network *net) { return net->kind == HYSTMPC_GRU ? 1 : 2; }

static void load_state(const table *t, int row, const double *state) {
    const int hidden = t->net->hidden, front = front_of(t->net), parts = parts_of(t->net);
    float *x = t->x + row * t->width, *c = t->c + row * t->cells;
    for (int i = 0; i < front; i++) x[i] = (float)state[i];
    for (int layer = 0; layer < t->net->layers; layer++) {
        const double *h = state + front + parts * layer * hidden, *cell = h + (parts - 1) * hidden;
        for (int unit = 0; unit < hidden; unit++) {
            x[t->net->inputs + layer * t->units + unit] = (float)h[unit];
            c[layer * t->units + unit] = (float)cell[unit];
        }
    }
}

static void unload_state(const table *t, int row, double *state) {
    const int hidden = t->net->hidden, front = front_of(t->net), parts = parts_of(t->net);
    const float *x = t->x + row * t->width, *c = t->c + row * t->cells;
    for (int i = 0; i < front; i++) state[i] = (double)x[i];
    for (int layer = 0; layer < t->net->layers; layer++) {
        double *h = state + front + parts * layer * hidden, *cell = h + (parts - 1) * hidden;
        for (int unit = 0; unit < hidden; unit++) {
            h[unit] = (double)x[t->net->inputs + layer * t->units + unit];
            cell[unit] = (double)c[layer * t->units + unit];
        }
    }
}

void hystmpc_network_advance(const hystmpc_network *network, double *motion, int samples) {
    double *plan = motion + hystmpc_network_state(network);
    const table t = table_in(network, 1, plan + samples);
    load_state(&t, 0, motion);
    for (int k = 0; k < samples; k++) {
        command(&t, 0, plan[k]);
        move_one(&t);
        plan[k] = degrees(&t, 0);
    }
    unload_state(&t, 0, motion);
}

void hystmpc_network_sample(const hystmpc_network *network, double *states, int rows, const double *u, double *theta,
                            double *work) {
    const int size = hystmpc_network_state(network);
    const table t = table_in(network, rows, work);
    for (int row = 0; row < rows; row++) {
        load_state(&t, row, states + row * size);
        command(&t, row, u[row]);
    }
    if (rows == 1) move_one(&t);
    else move(&t, rows, 0);
    for (int row = 0; row < rows; row++) {
        theta[row] = degrees(&t, row);
        unload_state(&t, row, states + row * size);
    }
}

void hystmpc_network_rollout(const hystmpc_network *network, const double *state, const double *plans, int count,
                             int samples, double *angles, double *work) {
    const int blocks = (count + ROWS - 1) / ROWS, chunks = (blocks * ROWS + TOGETHER - 1) / TOGETHER;
    const int even = chunks ? (blocks + chunks - 1) / chunks * ROWS : 0, most = even < count ? even : count;
    for (int start = 0; start < count; start += most) {
        const int rows = count - start < most ? count - start : most;
        const table t = table_in(network, rows, work);
        for (int row = 0; row < rows; row++) load_state(&t, row, state);
        for (int k = 0; k < samples; k++) {
            for (int row = 0; row < rows; row++) command(&t, row, plans[(long)(start + row) * samples + k]);
            if (rows == 1) move_one(&t);
            else move(&t, rows, 0);
            for (int row = 0; row < rows; row++) angles[(long)(start + row) * samples + k] = degrees(&t, row);
        }
    }
}

void hystmpc_network_linearise(const hystmpc_network *network, const double *state, const double *plan, int samples,
                               double *angles, double *jacobian, double *work) {
    const table t = table_in(network, 1 + samples, work);
    const double gain = network->theta_scale / network->u_scale;
    load_state(&t, 0, state);
    for (int k = 0; k < samples; k++) {
        const float moved = command(&t, 0, plan[k]);
        command_tangents(&t, k, moved);
        move(&t, 2 + k, 1);
        angles[k] = degrees(&t, 0);
        for (int j = 0; j <= k; j++) jacobian[(long)k * samples + j] = gain * head_of(&t, 1 + j);
    }
}
