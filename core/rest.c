/* States at rest of one stage, with derivatives. */
#include "blocks.h"

int hystmpc_chain_rest_room(const int *chain, int stage) {
    const int *place = chain + CHAIN_HEAD + chain[6] + CHAIN_STAGE * stage;
    hystmpc_code p;
    hystmpc_code_read(chain + place[1], &p);
    return p.registers + p.rows;
}

void hystmpc_chain_rest(const int *chain, const real *constants, int stage, int rows, const real *u, const real *du,
                        const real *seen, const real *dseen, const real *parameters, int parameter_rows, int directions,
                        const real *seeds, real *x, real *m, real *room) {
    const int *place = chain + CHAIN_HEAD + chain[6] + CHAIN_STAGE * stage;
    hystmpc_code p;
    hystmpc_code_read(chain + place[1], &p);
    real *row = room + p.registers, *shown = row + p.kept + 3;
    for (int n = 0; n < rows; n++) {
        if (n == 0 || parameter_rows > 1)
            hystmpc_code_prepare(&p, constants + place[5] + place[6], place[7], parameters + (parameter_rows > 1 ? n : 0),
                            parameter_rows, R(0.0), row, 1, room);
        row[p.kept] = seen[n];
        row[p.kept + 2] = u[n];
        for (int phase = PHASE_AHEAD; phase <= PHASE_BY_PARAMETERS; phase++)
            hystmpc_code_single(p.code[phase], p.length[phase], row);
        for (int i = 0; i < p.outputs; i++) {
            real *to = m + (i * rows + n) * directions;
            x[i * rows + n] = shown[i];
            for (int q = 0; q < directions; q++) to[q] = R(0.0);
            for (int k = p.first[p.states + i]; k < p.first[p.states + i + 1]; k++) {
                const int *slope = p.slope + 3 * k;
                const real value = row[slope[2]], *by = slope[0] == 0   ? dseen + n * directions
                                                        : slope[0] == 1 ? du + n * directions
                                                                        : seeds + slope[1] * directions;
                for (int q = 0; q < directions; q++) to[q] += value * by[q];
            }
        }
    }
}
