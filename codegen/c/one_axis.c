/* Functions of hystmpc.h around the engine's controller, on one struct: what is remembered, then room for a call. */
#include "hystmpc.h"

unsigned long hystmpc_memory_bytes(void) { return (unsigned long)sizeof(hystmpc_controller); }

static char *memory_of(hystmpc_controller *c) { return (char *)c->memory.bytes; }
static char *room_of(hystmpc_controller *c) { return (char *)c->memory.bytes + HYSTMPC_REMEMBERED; }

int hystmpc_init(hystmpc_controller *c, hystmpc_real angle_deg, hystmpc_real command) {
    const hystmpc_model *m = exported_problem.model;
    char *room = room_begin(room_of(c));
    real *x = m ? room_take(&room, m->predictor->states) : NULL;
    if (m) hystmpc_at_rest(exported_rest, m->predictor, angle_deg, command, x, room);
    return hystmpc_controller_init(&exported_problem, memory_of(c), x, angle_deg, command, room);
}

hystmpc_command hystmpc_step(hystmpc_controller *c, hystmpc_real angle_deg, const hystmpc_real *reference) {
    hystmpc_command answer;
    hystmpc_controller_step(&exported_problem, memory_of(c), angle_deg, reference, &answer, NULL, room_of(c));
    return answer;
}

void hystmpc_set_target(hystmpc_controller *c, hystmpc_real angle_deg) {
    hystmpc_controller_target(&exported_problem, memory_of(c), angle_deg);
}

int hystmpc_measure(hystmpc_controller *c, hystmpc_real angle_deg, hystmpc_real age) {
    return hystmpc_controller_measure(&exported_problem, memory_of(c), angle_deg, age);
}

int hystmpc_look_on(hystmpc_controller *c, hystmpc_real angle_deg, hystmpc_real command) {
    return hystmpc_controller_look_on(&exported_problem, memory_of(c), angle_deg, command, room_of(c));
}

int hystmpc_input(hystmpc_controller *c, int input, hystmpc_real value) {
    int taken = 0;
    for (int k = 0; exported_inputs[k][0] >= 0; k++)
        if (exported_inputs[k][0] == input)
            taken |= hystmpc_controller_input(&exported_problem, memory_of(c), exported_inputs[k][1], value);
    return taken;
}

void hystmpc_hurry(hystmpc_controller *c) { hystmpc_controller_hurry(&exported_problem, memory_of(c)); }

void hystmpc_stop(hystmpc_controller *c) { hystmpc_controller_stop(&exported_problem, memory_of(c)); }
