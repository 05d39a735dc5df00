/* The check of a chain's block. It reads no number of the block before it knows that the number is there.
 *
 * Sums are of 64 bits; counts are below CHECK_MOST, so that a count of rows of numbers is an `int`. The work is linear in
 * the block's size. */
#include "check.h"

#include "blocks.h"

#include <stdint.h>

enum { CHECK_MOST = 1 << 20, CHECK_SIGNALS = 4096, CHECK_WORD = 32, CHECK_TABLE = 20, CHECK_SIZES = 10 };

/* A block, and what its stages have taken so far. */
typedef struct {
    const int *chain;
    int size, constants;
    int states, parameters, kept, written;
    uint32_t there[CHECK_SIGNALS / CHECK_WORD]; /* signals that have been written: one bit each */
} check_block;

static int check_inside(const check_block *b, int64_t at, int64_t count) {
    return 0 <= at && 0 <= count && at + count <= (int64_t)b->size;
}

static int check_within(int number, int64_t low, int64_t below) { return low <= number && number < below; }

static int check_is_there(const check_block *b, int signal) {
    return b->there[signal / CHECK_WORD] >> (signal % CHECK_WORD) & 1u;
}

static void check_write(check_block *b, int signal) { b->there[signal / CHECK_WORD] |= (uint32_t)1 << (signal % CHECK_WORD); }

/* Whether the parts of a table lie within the block, so that hystmpc_code_read may read it. A table at rest has the result
 * of no next state. */
static int check_place(const check_block *b, int at, int resting) {
    if (!check_inside(b, at, CHECK_TABLE)) return HYSTMPC_FAULT_PLACE;
    const int *const table = b->chain + at, *const length = table + 1 + CHECK_SIZES;
    if (table[0] != CHECK_TABLE) return HYSTMPC_FAULT_COUNT;
    for (int k = 1; k < CHECK_TABLE; k++)
        if (!check_within(table[k], 0, CHECK_MOST)) return HYSTMPC_FAULT_COUNT;
    const int states = table[1], outputs = table[4], kept = table[5], slopes = table[7], groups = table[8];
    int64_t end = (int64_t)at + CHECK_TABLE + kept + 3 * (int64_t)slopes + states + outputs + 1;
    for (int k = 0; k < PHASES; k++) end += CODE_WORDS * (int64_t)length[k];
    for (int k = 0, grouped = 0; k < groups; k++) {
        if (!check_inside(b, end, 1)) return HYSTMPC_FAULT_PLACE;
        const int members = b->chain[end];
        if (!check_within(members, 1, (int64_t)states - grouped + 1)) return HYSTMPC_FAULT_GROUP;
        grouped += members, end += 1 + (int64_t)members;
    }
    return check_inside(b, end, 1 + (int64_t)outputs + (resting ? 0 : states)) ? HYSTMPC_SOUND : HYSTMPC_FAULT_PLACE;
}

/* Instructions on so many registers. */
static int check_single(const int *code, int length, int registers) {
    for (const int *s = code; s < code + CODE_WORDS * length; s += CODE_WORDS) {
        if (!check_within(s[0], 0, CODE_KINDS)) return HYSTMPC_FAULT_OPERATION;
        for (int k = 1; k < CODE_WORDS; k++)
            if (!check_within(s[k], 0, registers)) return HYSTMPC_FAULT_REGISTER;
    }
    return HYSTMPC_SOUND;
}

/* Instructions on a block's rows. Next states, outputs and room are written, and no result lies where an argument does:
 * the row of a next state is that of the state one sample later, so that the two overlap where `whole` rows are
 * computed. */
static int check_rows(const hystmpc_code *p, enum hystmpc_phase phase) {
    const int next = p->kept + p->states, inputs = next + p->states, outputs = inputs + p->inputs;
    const int whole = phase != PHASE_THROUGH;
    const int fault = check_single(p->code[phase], p->length[phase], p->rows);
    if (fault) return fault;
    for (const int *s = p->code[phase]; s < p->code[phase] + CODE_WORDS * p->length[phase]; s += CODE_WORDS) {
        const int moves = next <= s[1] && s[1] < inputs;
        if (!moves && s[1] < outputs) return HYSTMPC_FAULT_RESULT;
        for (int k = 2; k < CODE_WORDS; k++)
            if (s[k] == s[1] || (whole && moves && s[k] == s[1] - p->states)) return HYSTMPC_FAULT_RESULT;
    }
    return HYSTMPC_SOUND;
}

/* Slopes, the first of each next state and output, and the groups of states. */
static int check_slopes(const hystmpc_code *p) {
    const int entries[3] = {p->states, p->inputs, p->parameters};
    const int *group = p->group;
    int grouped = 0;
    for (const int *s = p->slope; s < p->slope + 3 * p->slopes; s += 3) {
        if (!check_within(s[0], 0, 3) || !check_within(s[1], 0, entries[s[0]])) return HYSTMPC_FAULT_SLOPE;
        if (!check_within(s[2], 0, p->rows)) return HYSTMPC_FAULT_REGISTER;
    }
    for (int k = 0; k <= p->states + p->outputs; k++)
        if (!check_within(p->first[k], k ? p->first[k - 1] : 0, (int64_t)p->slopes + 1)) return HYSTMPC_FAULT_SLOPE;
    for (int k = 0; k < p->groups; grouped += *group, group += 1 + *group, k++)
        for (int i = 1; i <= *group; i++)
            if (!check_within(group[i], 0, p->states)) return HYSTMPC_FAULT_GROUP;
    return grouped == p->states ? HYSTMPC_SOUND : HYSTMPC_FAULT_GROUP;
}

/* A table with so many constants: its place, the room of its rows and registers, and all that indexes them. */
static int check_table(const check_block *b, int at, int constants, int resting, hystmpc_code *p) {
    int fault = check_place(b, at, resting);
    if (fault) return fault;
    hystmpc_code_read(b->chain + at, p);
    const int64_t rows = p->kept + 2 * (int64_t)p->states + p->inputs + p->outputs;
    const int64_t registers = p->parameters + 1 + (int64_t)constants, single = p->kept + (int64_t)p->states + p->inputs;
    int64_t used[3] = {rows, registers + p->length[PHASE_ONCE], single};
    for (int k = PHASE_AHEAD; k <= PHASE_BY_PARAMETERS; k++) used[0] += p->length[k];
    for (int k = PHASE_FIXED; k <= PHASE_REST; k++) used[2] += p->length[k];
    if (p->inputs < 1) return HYSTMPC_FAULT_COUNT;
    if (!check_within(p->rows, rows, used[0] + 1) || !check_within(p->registers, registers, used[1] + 1) ||
        !check_within(p->single, single, used[2] + 1))
        return HYSTMPC_FAULT_ROOM;
    for (int k = 0; k < p->kept; k++)
        if (!check_within(p->keeps[k], 0, p->registers)) return HYSTMPC_FAULT_REGISTER;
    for (int k = 0; k <= p->outputs + (resting ? 0 : p->states); k++)
        if (!check_within(p->results[k], k ? 0 : -1, p->single)) return HYSTMPC_FAULT_REGISTER;
    fault = check_single(p->code[PHASE_ONCE], p->length[PHASE_ONCE], p->registers);
    for (int k = PHASE_AHEAD; k <= PHASE_BY_PARAMETERS && !fault; k++) fault = check_rows(p, (enum hystmpc_phase)k);
    for (int k = PHASE_FIXED; k <= PHASE_REST && !fault; k++)
        fault = check_single(p->code[k], p->length[k], p->single);
    return fault ? fault : check_slopes(p);
}

/* Signals that a stage reads, which are there, and those that it writes, which are there from now on. */
static int check_wires(check_block *b, int at, const hystmpc_code *p) {
    if (!check_inside(b, at, (int64_t)p->inputs + p->outputs)) return HYSTMPC_FAULT_PLACE;
    const int *const wires = b->chain + at;
    for (int j = 0; j < p->inputs + p->outputs; j++) {
        if (!check_within(wires[j], 0, b->chain[4])) return HYSTMPC_FAULT_WIRE;
        if (check_is_there(b, wires[j]) != (j < p->inputs)) return HYSTMPC_FAULT_WIRE;
        if (j >= p->inputs) check_write(b, wires[j]);
    }
    b->written += p->outputs;
    return HYSTMPC_SOUND;
}

static int check_stage(check_block *b, const int *place) {
    hystmpc_code p, rest;
    for (int k = 2; k < 8; k++)
        if (!check_within(place[k], 0, CHECK_MOST)) return HYSTMPC_FAULT_COUNT;
    if (place[2] != b->states || place[3] != b->parameters || place[4] != b->kept) return HYSTMPC_FAULT_SUM;
    if (place[5] > b->constants - place[6] - place[7]) return HYSTMPC_FAULT_SUM;
    int fault = check_table(b, place[0], place[6], 0, &p);
    if (!fault && p.outputs < 1) fault = HYSTMPC_FAULT_COUNT;
    if (!fault) fault = check_wires(b, place[8], &p);
    if (fault) return fault;
    b->states += p.states, b->parameters += p.parameters, b->kept += p.kept;
    if (b->states > b->chain[1] || b->parameters > b->chain[2] || b->kept > b->chain[3]) return HYSTMPC_FAULT_SUM;
    if (place[1] == -1) return HYSTMPC_SOUND;
    fault = check_table(b, place[1], place[7], 1, &rest);
    if (fault) return HYSTMPC_OF_REST + fault;
    const int fits = rest.states == 1 && rest.inputs == 1 && rest.outputs == p.states && rest.parameters == p.parameters;
    return fits ? HYSTMPC_SOUND : HYSTMPC_OF_REST + HYSTMPC_FAULT_REST;
}

int hystmpc_chain_check(const int *chain, int size, int constants) {
    check_block b = {.chain = chain, .size = size, .constants = constants};
    if (constants < 0 || !check_inside(&b, 0, CHAIN_HEAD)) return HYSTMPC_FAULT_PLACE;
    for (int k = 0; k < CHAIN_HEAD; k++)
        if (!check_within(chain[k], 0, CHECK_MOST)) return HYSTMPC_FAULT_COUNT;
    const int stages = chain[0], signals = chain[4], inputs = chain[5], outputs = chain[6];
    if (inputs < 1 || chain[7] >= inputs || outputs < 1 || signals > CHECK_SIGNALS || inputs > signals) return HYSTMPC_FAULT_COUNT;
    if (!check_inside(&b, CHAIN_HEAD, outputs + CHAIN_STAGE * (int64_t)stages)) return HYSTMPC_FAULT_PLACE;
    for (int j = 0; j < inputs; j++) check_write(&b, j);
    for (int k = 0; k < stages; k++) {
        const int fault = check_stage(&b, chain + CHAIN_HEAD + outputs + CHAIN_STAGE * k);
        if (fault) return fault + HYSTMPC_OF_STAGE * k;
    }
    if (b.states != chain[1] || b.parameters != chain[2] || b.kept != chain[3]) return HYSTMPC_FAULT_SUM;
    if (b.written != signals - inputs) return HYSTMPC_FAULT_WIRE;
    for (int j = 0; j < outputs; j++)
        if (!check_within(chain[CHAIN_HEAD + j], 0, signals) || !check_is_there(&b, chain[CHAIN_HEAD + j]))
            return HYSTMPC_FAULT_WIRE;
    return HYSTMPC_SOUND;
}
