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

/* Units of a panel, and rows whose four sums each stay in registers, beside the weights and an input of every row. An
 * exported controller says for how many units its weights are packed: HYSTMPC_LANES. */
#if defined(__GNUC__) && defined(__AVX512F__) && (!defined(HYSTMPC_LANES) || HYSTMPC_LANES == 16)
#include <immintrin.h>
#define NET_LANES 16
#define NET_ROWS 6
#define NET_FUSED(a, b, c) _mm512_fmadd_ps(a, b, c)
#elif defined(__GNUC__) && defined(__AVX2__) && defined(__FMA__) && (!defined(HYSTMPC_LANES) || HYSTMPC_LANES == 8)
#include <immintrin.h>
#define NET_LANES 8
#define NET_ROWS 3
#define NET_FUSED(a, b, c) _mm256_fmadd_ps(a, b, c)
#elif defined(__GNUC__) && defined(__aarch64__) && defined(__ARM_NEON) && \
    (!defined(HYSTMPC_LANES) || HYSTMPC_LANES == 4)
#include <arm_neon.h>
#define NET_LANES 4
#define NET_ROWS 6
#define NET_FUSED(a, b, c) vfmaq_f32(c, a, b)
#elif defined(HYSTMPC_LANES)
#if HYSTMPC_LANES != 1 && HYSTMPC_LANES != 4 && HYSTMPC_LANES != 8 && HYSTMPC_LANES != 16
#error "hystmpc: HYSTMPC_LANES has to be 1, 4, 8 or 16, the units for which the weights are packed"
#elif HYSTMPC_LANES > 1 && !defined(__GNUC__)
#error "hystmpc: this compiler has no vectors of GNU C: export the controller again with one unit a panel"
#endif
#define NET_LANES HYSTMPC_LANES
#define NET_ROWS 2
#elif defined(__GNUC__)
#define NET_LANES 4
#define NET_ROWS 2
#else
#define NET_LANES 1
#define NET_ROWS 2
#endif

#if NET_LANES > 1
#define NET_INLINE static inline __attribute__((always_inline))
#if !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi" /* vectors wider than the processor's: none leaves this file */
#endif
typedef float net_vec __attribute__((vector_size(4 * NET_LANES)));
typedef float net_vec_anywhere __attribute__((vector_size(4 * NET_LANES), aligned(4), may_alias));
typedef int net_mask __attribute__((vector_size(4 * NET_LANES)));
NET_INLINE net_vec net_load(const float *x) { return *(const net_vec_anywhere *)x; }
NET_INLINE void net_store(float *x, net_vec a) { *(net_vec_anywhere *)x = a; }
NET_INLINE net_vec net_all(float x) { return x - (net_vec){0.0F}; }
NET_INLINE net_vec net_chosen(net_mask which, net_vec a, net_vec b) {
    return (net_vec)((which & (net_mask)a) | (~which & (net_mask)b));
}
#else
#define NET_INLINE static inline
typedef float net_vec;
NET_INLINE net_vec net_load(const float *x) { return *x; }
NET_INLINE void net_store(float *x, net_vec a) { *x = a; }
NET_INLINE net_vec net_all(float x) { return x; }
NET_INLINE net_vec net_chosen(int which, net_vec a, net_vec b) { return which ? a : b; }
#endif

/* a b + c, rounded once. */
NET_INLINE net_vec net_fused(net_vec a, net_vec b, net_vec c) {
#if defined(NET_FUSED)
    return NET_FUSED(a, b, c);
#elif (defined(__FP_FAST_FMAF) || defined(FP_FAST_FMAF)) && NET_LANES > 1
    net_vec sum = c;
    for (int i = 0; i < NET_LANES; i++) sum[i] = fmaf(a[i], b[i], c[i]);
    return sum;
#elif defined(__FP_FAST_FMAF) || defined(FP_FAST_FMAF)
    return fmaf(a, b, c);
#elif NET_LANES > 1
    typedef double wide __attribute__((vector_size(8 * NET_LANES)));
    const wide sum = __builtin_convertvector(a, wide) * __builtin_convertvector(b, wide);
    return __builtin_convertvector(sum + __builtin_convertvector(c, wide), net_vec);
#else
    return (float)((double)a * (double)b + (double)c);
#endif
}

enum {
    NET_GATES = 4,
    NET_LINE = NET_GATES * NET_LANES, /* numbers of one input in a panel */
    NET_FACTORS = 8,
    NET_TOGETHER = 36 /* plans at a time: with a panel of the weights their rows are in the first cache */
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
} net_table;

static int net_units_of(const hystmpc_network *net) {
    const int whole = NET_LANES > 8 ? NET_LANES : 8;
    return (net->hidden + whole - 1) / whole * whole;
}

static int net_height_of(const net_table *t, int layer) { return layer ? 2 * t->units : t->net->inputs + t->units; }

/* A panel's bias, and its weights behind it. */
static const float *net_panel_of(const net_table *t, int layer, int panel) {
    const long count = t->units / NET_LANES, first = (1 + net_height_of(t, 0)) * NET_LINE;
    const long further = (1 + 2 * t->units) * NET_LINE;
    return t->panels + (layer ? count * first + ((layer - 1) * count + panel) * further : panel * first);
}

int hystmpc_network_lanes(void) { return NET_LANES; }

int hystmpc_network_together(void) { return NET_TOGETHER; }

int hystmpc_network_state(const hystmpc_network *network) {
    const int own = network->layers * network->hidden;
    return network->kind == HYSTMPC_GRU ? own : 2 * own + (network->kind == HYSTMPC_GATED ? network->inputs : 0);
}

long hystmpc_network_room(const hystmpc_network *network, int rows) {
    const long units = net_units_of(network), cells = network->layers * units;
    const long floats = rows * (network->inputs + 2 * cells + units + 1) + NET_FACTORS * units + network->inputs;
    return (floats * (long)sizeof(float) + (long)sizeof(real) - 1) / (long)sizeof(real);
}

static net_table net_table_in(const hystmpc_network *net, int rows, real *work) {
    net_table t;
    t.net = net;
    t.panels = (const float *)(net + 1);
    t.units = net_units_of(net);
    t.cells = net->layers * t.units;
    t.width = net->inputs + t.cells;
    t.head = net_panel_of(&t, net->layers, 0);
    t.radii = t.head + t.units + net->inputs;
    t.x = (float *)work;
    t.c = t.x + rows * t.width;
    t.h = t.c + rows * t.cells;
    t.factors = t.h + rows * t.units;
    t.share = t.factors + NET_FACTORS * t.units;
    t.moves = t.share + rows;
    for (int i = 0; i < rows * (t.width + t.cells); i++) t.x[i] = 0.0F; /* x and c */
    return t;
}

/* Sums z (rows, panels, 4) of all inputs, for so many rows and panels, which are constants where this is called. */
NET_INLINE void net_products(int rows, int panels, const float *weights, long size, int inputs, const float *x, int width,
                             net_vec *z) {
    net_vec sums[NET_ROWS > 2 ? NET_ROWS : 2][NET_GATES];
    for (int n = 0; n < rows * panels; n++)
        for (int gate = 0; gate < NET_GATES; gate++) sums[n][gate] = z[n * NET_GATES + gate];
    for (int k = 0; k < inputs; k++)
        for (int panel = 0; panel < panels; panel++)
            for (int gate = 0; gate < NET_GATES; gate++) {
                const net_vec weight = net_load(weights + panel * size + k * NET_LINE + gate * NET_LANES);
                for (int row = 0; row < rows; row++)
                    sums[row * panels + panel][gate] =
                        net_fused(net_all(x[row * width + k]), weight, sums[row * panels + panel][gate]);
            }
    for (int n = 0; n < rows * panels; n++)
        for (int gate = 0; gate < NET_GATES; gate++) z[n * NET_GATES + gate] = sums[n][gate];
}

static void net_product(int rows, const float *weights, int inputs, const float *x, int width, net_vec *z) {
    switch (rows) {
    case 1: net_products(1, 1, weights, 0, inputs, x, width, z); break;
    case 2: net_products(2, 1, weights, 0, inputs, x, width, z); break;
#if NET_ROWS >= 3
    case 3: net_products(3, 1, weights, 0, inputs, x, width, z); break;
#endif
#if NET_ROWS >= 6
    case 4: net_products(4, 1, weights, 0, inputs, x, width, z); break;
    case 5: net_products(5, 1, weights, 0, inputs, x, width, z); break;
    case 6: net_products(6, 1, weights, 0, inputs, x, width, z); break;
#endif
    default: break;
    }
}

/* One row of two panels at once: the sums of one alone would wait for each other. */
static void net_product_of_pair(const float *weights, long size, int inputs, const float *x, net_vec *z) {
    net_products(1, 2, weights, size, inputs, x, 0, z);
}

/* tanh(x) = odd(x) / even(x) = x P(x^2) / Q(x^2) within +-LIMIT, and one beyond; not-a-number stays. Fitted: the
 * fraction is off by at most 6e-8 on the whole line, in float by 2.2e-7. 1 < Q < 600: products of three stay far from the
 * ends of float. */
static const float net_limit = 8.50072098F;

NET_INLINE net_vec net_bound(net_vec x) {
    const net_vec high = net_all(net_limit), low = net_all(-net_limit), below = net_chosen(x > high, high, x);
    return net_chosen(below < low, low, below);
}

NET_INLINE net_vec net_odd(net_vec x) {
    const net_vec s = x * x;
    net_vec p = net_fused(net_all(-1.40259228e-11F), s, net_all(4.25241105e-08F));
    p = net_fused(net_fused(p, s, net_all(4.38413517e-05F)), s, net_all(0.00645443471F));
    return x * net_fused(net_fused(p, s, net_all(0.234707922F)), s, net_all(1.7296555F));
}

NET_INLINE net_vec even(net_vec x) {
    const net_vec s = x * x, q = net_fused(net_all(1.91435902e-06F), s, net_all(0.000640153361F));
    const net_vec r = net_fused(net_fused(q, s, net_all(0.0462537706F)), s, net_all(0.811259866F));
    return net_fused(r, s, net_all(1.72965527F));
}

NET_INLINE net_vec net_tangent_of(net_vec x) {
    const net_vec y = net_bound(x);
    return net_odd(y) / even(y);
}

NET_INLINE net_vec net_one_less_square(net_vec a) { return net_fused(-a, a, net_all(1.0F)); }

/* Output of a unit from the sums z of r, z and both parts of n: n = tanh(z_n + r z_own), h' = (1 - z) n + z h, with two
 * divisions. A GRU's output is its own cell. */
NET_INLINE net_vec gru_cell(const net_vec *z, net_vec h) {
    const net_vec half = net_all(0.5F), gate = net_bound(z[1]), p = net_odd(gate), q = even(gate);
    const net_vec new = net_bound(net_fused(net_fused(half, net_tangent_of(z[0]), half), z[3], z[2])), below = even(new);
    const net_vec total = net_fused(q - p, net_odd(new), (q + p) * h * below);
    return half * total / (q * below);
}

/* The same, and derivatives: dh' = f_0 dh + f_1 dz_r + f_2 dz_z + f_3 dz_n + f_4 dz_own. */
NET_INLINE net_vec differentiated_gru_cell(const net_vec *z, net_vec h, net_vec *by) {
    const net_vec half = net_all(0.5F), r = net_tangent_of(z[0]), k = net_tangent_of(z[1]);
    const net_vec opened = net_fused(half, r, half), keep = net_fused(half, k, half), take = net_fused(-half, k, half);
    const net_vec new = net_tangent_of(net_fused(opened, z[3], z[2])), gap = h - new;
    const net_vec fresh = take * net_one_less_square(new);
    by[0] = keep;
    by[1] = fresh * z[3] * (half * net_one_less_square(r));
    by[2] = gap * (half * net_one_less_square(k));
    by[3] = fresh;
    by[4] = fresh * opened;
    return net_fused(keep, gap, new);
}

NET_INLINE net_vec gru_tangent(const net_vec *z, net_vec h, const net_vec *by) {
    const net_vec gates = net_fused(by[2], z[1], net_fused(by[1], z[0], by[0] * h));
    return net_fused(by[4], z[3], net_fused(by[3], z[2], gates));
}

/* Cell and output of a unit from the sums z of the gates i, f, g, o: c' = f c + i g, h' = o tanh(c'), with two
 * divisions. */
NET_INLINE void lstm_cell(const net_vec *z, net_vec *c, net_vec *h) {
    const net_vec half = net_all(0.5F);
    const net_vec i = net_bound(z[0]), f = net_bound(z[1]), g = net_bound(z[2]), o = net_bound(z[3]);
    const net_vec qi = even(i), qf = even(f), qo = even(o), beside = qi * even(g);
    const net_vec kept = (qf + net_odd(f)) * *c * beside;
    const net_vec total = net_fused((qi + net_odd(i)) * net_odd(g), qf, kept);
    *c = half * total / (beside * qf);
    const net_vec shown = net_bound(*c);
    *h = half * (qo + net_odd(o)) * net_odd(shown) / (qo * even(shown));
}

/* The same, and derivatives: dc' = f_0 dc + f_1 dz_i + f_2 dz_f + f_3 dz_g, dh' = f_4 dz_o + f_5 dc'. */
NET_INLINE void differentiated_lstm_cell(const net_vec *z, net_vec *c, net_vec *h, net_vec *by) {
    const net_vec half = net_all(0.5F), i = net_tangent_of(z[0]), f = net_tangent_of(z[1]);
    const net_vec g = net_tangent_of(z[2]), o = net_tangent_of(z[3]);
    const net_vec gain = net_fused(half, i, half), forget = net_fused(half, f, half), out = net_fused(half, o, half);
    by[0] = forget;
    by[1] = half * net_one_less_square(i) * g;
    by[2] = half * net_one_less_square(f) * *c;
    by[3] = gain * net_one_less_square(g);
    *c = net_fused(forget, *c, gain * g);
    const net_vec shown = net_tangent_of(*c);
    by[4] = half * net_one_less_square(o) * shown;
    by[5] = out * net_one_less_square(shown);
    *h = out * shown;
}

NET_INLINE void lstm_tangent(const net_vec *z, net_vec *c, net_vec *h, const net_vec *by) {
    *c = net_fused(by[3], z[2], net_fused(by[2], z[1], net_fused(by[1], z[0], by[0] * *c)));
    *h = net_fused(by[5], *c, by[4] * z[3]);
}

/* A panel's units of one motion: sums z to cells and outputs. */
static void net_finish_motion(const net_table *t, int layer, int unit, int row, const net_vec *z) {
    const int at = layer * t->units + unit;
    float *cell = t->c + row * t->cells + at;
    net_vec c = net_load(cell), h;
    if (t->net->kind == HYSTMPC_GRU) {
        c = h = gru_cell(z, c);
    } else {
        const net_vec c_old = c;
        lstm_cell(z, &c, &h);
        if (t->net->kind == HYSTMPC_GATED) { /* c' = c + m (b - c), h' = h + m (a - h) */
            const net_vec share = net_all(t->share[row]), h_old = net_load(t->x + row * t->width + t->net->inputs + at);
            c = net_fused(share, c - c_old, c_old);
            h = net_fused(share, h - h_old, h_old);
        }
    }
    net_store(cell, c);
    net_store(t->h + row * t->units + unit, h);
}

/* The same of the motion in row 0; its factors are kept. */
static void net_finish_first(const net_table *t, int layer, int unit, const net_vec *z) {
    const int at = layer * t->units + unit;
    net_vec c = net_load(t->c + at), h, by[NET_FACTORS] = {net_all(0.0F)};
    if (t->net->kind == HYSTMPC_GRU) {
        c = h = differentiated_gru_cell(z, c, by);
    } else {
        const net_vec c_old = c;
        differentiated_lstm_cell(z, &c, &h, by);
        if (t->net->kind == HYSTMPC_GATED) {
            const net_vec share = net_all(t->share[0]), h_old = net_load(t->x + t->net->inputs + at);
            by[6] = c - c_old;
            by[7] = h - h_old;
            c = net_fused(share, by[6], c_old);
            h = net_fused(share, by[7], h_old);
        }
    }
    net_store(t->c + at, c);
    net_store(t->h + unit, h);
    for (int k = 0; k < NET_FACTORS; k++) net_store(t->factors + k * t->units + unit, by[k]);
}

/* The same of derivatives along that motion. */
static void net_finish_tangents(const net_table *t, int layer, int unit, int row, int count, const net_vec *z) {
    const int at = layer * t->units + unit, kind = t->net->kind;
    net_vec by[NET_FACTORS];
    for (int k = 0; k < NET_FACTORS; k++) by[k] = net_load(t->factors + k * t->units + unit);
    for (int n = row; n < row + count; n++, z += NET_GATES) {
        float *cell = t->c + n * t->cells + at;
        const net_vec c_old = net_load(cell);
        net_vec c = c_old, h;
        if (kind == HYSTMPC_GRU) {
            c = h = gru_tangent(z, c, by);
        } else {
            lstm_tangent(z, &c, &h, by);
            if (kind == HYSTMPC_GATED) { /* by the product rule, with the derivative of m */
                const net_vec share = net_all(t->share[0]), by_share = net_all(t->share[n]);
                const net_vec h_old = net_load(t->x + n * t->width + t->net->inputs + at);
                c = net_fused(share, c - c_old, net_fused(by_share, by[6], c_old));
                h = net_fused(share, h - h_old, net_fused(by_share, by[7], h_old));
            }
        }
        net_store(cell, c);
        net_store(t->h + n * t->units + unit, h);
    }
}

/* Outputs of a layer to where the next layer and the next sample read them. */
static void net_show(const net_table *t, int layer, int rows) {
    for (int row = 0; row < rows; row++) {
        float *to = t->x + row * t->width + t->net->inputs + layer * t->units;
        for (int unit = 0; unit < t->units; unit++) to[unit] = t->h[row * t->units + unit];
    }
}

/* One sample of one motion through all layers. */
static void net_move_one(const net_table *t) {
    for (int layer = 0; layer < t->net->layers; layer++) {
        const int inputs = net_height_of(t, layer), panels = t->units / NET_LANES;
        const float *x = t->x + (layer ? t->net->inputs + (layer - 1) * t->units : 0);
        const long size = (1 + inputs) * NET_LINE;
        for (int panel = 0; panel < panels; panel += 2) {
            const float *weights = net_panel_of(t, layer, panel);
            const int pair = panel + 1 < panels;
            net_vec z[2 * NET_GATES];
            for (int gate = 0; gate < NET_GATES; gate++) {
                z[gate] = net_load(weights + gate * NET_LANES);
                z[NET_GATES + gate] = net_load(weights + pair * size + gate * NET_LANES);
            }
            if (pair) net_product_of_pair(weights + NET_LINE, size, inputs, x, z);
            else net_product(1, weights + NET_LINE, inputs, x, 0, z);
            for (int n = 0; n <= pair; n++) net_finish_motion(t, layer, (panel + n) * NET_LANES, 0, z + n * NET_GATES);
        }
        net_show(t, layer, 1);
    }
}

/* One sample of rows through all layers, in blocks as even as can be. `derived`: row 0 is a motion and the rows behind it
 * are derivatives along it; else all are motions. */
static void net_move(const net_table *t, int rows, int derived) {
    const int blocks = (rows + NET_ROWS - 1) / NET_ROWS;
    for (int layer = 0; layer < t->net->layers; layer++) {
        const int inputs = net_height_of(t, layer), column = layer ? t->net->inputs + (layer - 1) * t->units : 0;
        for (int panel = 0; panel < t->units / NET_LANES; panel++) {
            const float *weights = net_panel_of(t, layer, panel);
            const int unit = panel * NET_LANES;
            for (int block = blocks, row = 0; block > 0; block--) {
                const int count = (rows - row + block - 1) / block, first = derived && row == 0;
                net_vec z[NET_ROWS * NET_GATES];
                for (int n = 0; n < count * NET_GATES; n++) {
                    const int moves = !derived || (first && n < NET_GATES);
                    z[n] = moves ? net_load(weights + n % NET_GATES * NET_LANES) : net_all(0.0F);
                }
                net_product(count, weights + NET_LINE, inputs, t->x + row * t->width + column, t->width, z);
                if (!derived) {
                    for (int r = 0; r < count; r++) net_finish_motion(t, layer, unit, row + r, z + r * NET_GATES);
                } else {
                    if (first) net_finish_first(t, layer, unit, z);
                    net_finish_tangents(t, layer, unit, row + first, count - first, z + first * NET_GATES);
                }
                row += count;
            }
        }
        net_show(t, layer, rows);
    }
}

/* Lag and plays of a row in place, w' = v + sign(w - v) max(k |w - v| - e, 0), p' = max(w' - r, min(w' + r, p)); returns
 * the move w' - w. moves (I,): of the lag the share of v that passes at once, of each play whether it moves. */
static float net_follow(const net_table *t, float *x, float v) {
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
static float net_command(const net_table *t, int row, real u) {
    const float v = (float)((u - t->net->u_offset) / t->net->u_scale);
    float *x = t->x + row * t->width;
    if (t->net->kind != HYSTMPC_GATED) {
        x[0] = v;
        return 0.0F;
    }
    const float moved = net_follow(t, x, v), rate = t->net->rate;
    t->share[row] = rate < 0.0F ? 1.0F - expf(rate * fabsf(moved)) : 1.0F;
    return moved;
}

/* Inputs of derivatives at sample k: row j is that by command j - 1, which joins at its own sample. */
static void net_command_tangents(const net_table *t, int k, float moved) {
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

/* The scaled angle of a row, the bias left out; in `real`: in double its rounding is not seen. */
static real net_head_of(const net_table *t, int row) {
    real parts[8] = {R(0.0)};
    const float *x = t->x + row * t->width, *last = x + t->width - t->units, *of_inputs = t->head + t->units;
    for (int unit = 0; unit < t->units; unit += 8)
        for (int i = 0; i < 8; i++) parts[i] += (real)t->head[unit + i] * (real)last[unit + i];
    real sum = ((parts[0] + parts[4]) + (parts[2] + parts[6])) + ((parts[1] + parts[5]) + (parts[3] + parts[7]));
    if (t->net->kind == HYSTMPC_GATED)
        for (int i = 0; i < t->net->inputs; i++) sum += (real)of_inputs[i] * (real)x[i];
    return sum;
}

static real net_degrees(const net_table *t, int row) {
    return t->net->theta_offset + t->net->theta_scale * (net_head_of(t, row) + t->net->head_bias);
}

/* Where a state has the inputs of a row, and which of its numbers are a layer's cells. */
static int net_front_of(const hystmpc_network *net) { return net->kind == HYSTMPC_GATED ? net->inputs : 0; }

static int net_parts_of(const hystmpc_network *net) { return net->kind == HYSTMPC_GRU ? 1 : 2; }

static void net_load_state(const net_table *t, int row, const real *state) {
    const int hidden = t->net->hidden, front = net_front_of(t->net), parts = net_parts_of(t->net);
    float *x = t->x + row * t->width, *c = t->c + row * t->cells;
    for (int i = 0; i < front; i++) x[i] = (float)state[i];
    for (int layer = 0; layer < t->net->layers; layer++) {
        const real *h = state + front + parts * layer * hidden, *cell = h + (parts - 1) * hidden;
        for (int unit = 0; unit < hidden; unit++) {
            x[t->net->inputs + layer * t->units + unit] = (float)h[unit];
            c[layer * t->units + unit] = (float)cell[unit];
        }
    }
}

static void net_unload_state(const net_table *t, int row, real *state) {
    const int hidden = t->net->hidden, front = net_front_of(t->net), parts = net_parts_of(t->net);
    const float *x = t->x + row * t->width, *c = t->c + row * t->cells;
    for (int i = 0; i < front; i++) state[i] = (real)x[i];
    for (int layer = 0; layer < t->net->layers; layer++) {
        real *h = state + front + parts * layer * hidden, *cell = h + (parts - 1) * hidden;
        for (int unit = 0; unit < hidden; unit++) {
            h[unit] = (real)x[t->net->inputs + layer * t->units + unit];
            cell[unit] = (real)c[layer * t->units + unit];
        }
    }
}

void hystmpc_network_advance(const hystmpc_network *network, real *motion, int samples) {
    real *plan = motion + hystmpc_network_state(network);
    const net_table t = net_table_in(network, 1, plan + samples);
    net_load_state(&t, 0, motion);
    for (int k = 0; k < samples; k++) {
        net_command(&t, 0, plan[k]);
        net_move_one(&t);
        plan[k] = net_degrees(&t, 0);
    }
    net_unload_state(&t, 0, motion);
}

void hystmpc_network_sample(const hystmpc_network *network, real *states, int rows, const real *u, real *theta,
                            real *work) {
    const int size = hystmpc_network_state(network);
    const net_table t = net_table_in(network, rows, work);
    for (int row = 0; row < rows; row++) {
        net_load_state(&t, row, states + row * size);
        net_command(&t, row, u[row]);
    }
    if (rows == 1) net_move_one(&t);
    else net_move(&t, rows, 0);
    for (int row = 0; row < rows; row++) {
        theta[row] = net_degrees(&t, row);
        net_unload_state(&t, row, states + row * size);
    }
}

void hystmpc_network_rollout(const hystmpc_network *network, const real *state, const real *plans, int count,
                             int samples, real *angles, real *work) {
    const int blocks = (count + NET_ROWS - 1) / NET_ROWS, chunks = (blocks * NET_ROWS + NET_TOGETHER - 1) / NET_TOGETHER;
    const int even = chunks ? (blocks + chunks - 1) / chunks * NET_ROWS : 0, together = even < count ? even : count;
    for (int start = 0; start < count; start += together) {
        const int rows = count - start < together ? count - start : together;
        const net_table t = net_table_in(network, rows, work);
        for (int row = 0; row < rows; row++) net_load_state(&t, row, state);
        for (int k = 0; k < samples; k++) {
            for (int row = 0; row < rows; row++) net_command(&t, row, plans[(long)(start + row) * samples + k]);
            if (rows == 1) net_move_one(&t);
            else net_move(&t, rows, 0);
            for (int row = 0; row < rows; row++) angles[(long)(start + row) * samples + k] = net_degrees(&t, row);
        }
    }
}

void hystmpc_network_linearise(const hystmpc_network *network, const real *state, const real *plan, int samples,
                               real *angles, real *jacobian, real *work) {
    const net_table t = net_table_in(network, 1 + samples, work);
    const real gain = network->theta_scale / network->u_scale;
    net_load_state(&t, 0, state);
    for (int k = 0; k < samples; k++) {
        const float moved = net_command(&t, 0, plan[k]);
        net_command_tangents(&t, k, moved);
        net_move(&t, 2 + k, 1);
        angles[k] = net_degrees(&t, 0);
        for (int j = 0; j <= k; j++) jacobian[(long)k * samples + j] = gain * net_head_of(&t, 1 + j);
    }
}

#undef NET_LANES
#undef NET_ROWS
#undef NET_FUSED
#undef NET_INLINE
