/* The input that leads a drive along a path: Gauss-Newton steps, each a bounded least-squares problem. */
#include "follow.h"
#include "moves.h"

#include <stddef.h>

enum { DRIVE_ROUNDS = 3 };                  /* linearisations */
static const real drive_weight = R(1e-3);   /* eps: of a squared move against a squared deviation of the output */
static const real drive_missed = R(1e-6);   /* share of the outputs' change that the linearisation may miss */
static const real drive_unlimited = R(1e9); /* reach of moves that have no bound */

long hystmpc_lead_drive_bytes(const int *chain, int samples) {
    const long numbers = 2L * samples * samples + 4L * samples + 2L * samples * (samples + 2);
    return hystmpc_chain_linearise_bytes(chain, samples) + numbers * (long)sizeof(real) + 64;
}

void hystmpc_lead_drive(const int *chain, const real *kept, const real *x, const real *wanted, int samples, real last,
                        real reach, real *inputs, real *outputs, char *memory) {
    char *const behind = memory + hystmpc_chain_linearise_bytes(chain, samples);
    real *const response = (real *)(behind + (8 - (size_t)behind % 8) % 8);
    real *const by_move = response + samples * samples, *const moves = by_move + samples * samples;
    real *const next = moves + samples, *const promised = next + samples, *const before = promised + samples;
    real *const work = before + samples;
    for (int k = 0; k < samples; k++) inputs[k] = last, moves[k] = R(0.0);
    hystmpc_chain_linearise(chain, kept, x, inputs, NULL, samples, outputs, response, memory);
    for (int round = 0; round < DRIVE_ROUNDS; round++) {
        for (int i = 0; i < samples; i++) { /* by command -> by move, which lasts */
            real total = R(0.0);
            for (int j = samples - 1; j >= 0; j--) {
                total = j < i ? total + response[i * samples + j] : response[i * samples + j];
                by_move[i * samples + j] = total;
            }
        }
        for (int k = 0; k < samples; k++) next[k] = moves[k], promised[k] = wanted[k] - outputs[k];
        hystmpc_bounded_moves(by_move, promised, samples, least(reach, drive_unlimited), drive_weight, next, work);
        real total = R(0.0), missed = R(0.0), change = R(0.0);
        for (int i = 0; i < samples; i++) {
            promised[i] = before[i] = outputs[i];
            for (int j = 0; j <= i; j++) promised[i] += by_move[i * samples + j] * (next[j] - moves[j]);
        }
        for (int k = 0; k < samples; k++) {
            total += next[k];
            moves[k] = next[k], inputs[k] = last + total;
        }
        hystmpc_chain_linearise(chain, kept, x, inputs, NULL, samples, outputs, response, memory);
        for (int k = 0; k < samples; k++) {
            missed = most(missed, absolute(outputs[k] - promised[k]));
            change = most(change, absolute(outputs[k] - before[k]));
        }
        if (missed <= drive_missed * most(R(1.0), change)) break;
    }
}
