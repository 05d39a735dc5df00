/* Functions of hystmpc.h around the engine's controllers of two axes, on one struct: what is remembered, then room for a
 * call. */
#include "hystmpc.h"

unsigned long hystmpc_memory_bytes(void) { return (unsigned long)sizeof(hystmpc_controller); }

static char *memory_of(hystmpc_controller *c) { return (char *)c->memory.bytes; }
static char *room_of(hystmpc_controller *c) { return (char *)c->memory.bytes + HYSTMPC_REMEMBERED; }

int hystmpc_init(hystmpc_controller *c, const hystmpc_real *angles_deg, const hystmpc_real *commands) {
    const hystmpc_problem *const axes[HYSTMPC_AXES] = {exported_problem.first, exported_problem.second};
    char *room = room_begin(room_of(c));
    hystmpc_real y[HYSTMPC_AXES], w[HYSTMPC_AXES];
    hystmpc_real *const x = room_take(&room, exported_states[0] + exported_states[1]);
    hystmpc_axes_at(&exported_problem, angles_deg, commands, y, w);
    for (int i = 0; i < HYSTMPC_AXES; i++)
        if (axes[i]->model)
            hystmpc_at_rest(exported_rest[i], axes[i]->model->predictor, y[i], w[i], x + i * exported_states[0], room);
    return hystmpc_axes_init(&exported_problem, memory_of(c), x, angles_deg, commands, room);
}

hystmpc_command hystmpc_step(hystmpc_controller *c, const hystmpc_real *angles_deg, const hystmpc_real *reference) {
    const int horizon = exported_problem.first->law->horizon;
    char *room = room_begin(room_of(c));
    hystmpc_real *const wanted = room_take(&room, HYSTMPC_AXES * HYSTMPC_REFERENCE);
    hystmpc_real *const plan = room_take(&room, (HYSTMPC_COMMANDS + HYSTMPC_AXES) * horizon);
    hystmpc_axis_command axis[HYSTMPC_AXES];
    hystmpc_command answer;
    for (int k = 0; reference && k < HYSTMPC_REFERENCE; k++)
        for (int i = 0; i < HYSTMPC_AXES; i++) wanted[i * HYSTMPC_REFERENCE + k] = reference[k * HYSTMPC_AXES + i];
    hystmpc_axes_step(&exported_problem, memory_of(c), angles_deg, reference ? wanted : NULL, answer.u, axis, plan, room);
    const hystmpc_real departures[HYSTMPC_AXES] = {axis[0].departure_deg, axis[1].departure_deg};
    axes_map(exported_problem.frame, HYSTMPC_AXES, HYSTMPC_AXES, departures, 1, answer.departure_deg, 1);
    answer.source = axis[0].source > axis[1].source ? axis[0].source : axis[1].source;
    answer.planned = axis[0].planned < axis[1].planned ? axis[0].planned : axis[1].planned;
    for (int i = 0; i < HYSTMPC_AXES; i++) {
        answer.predicted_deg[i] = plan[(HYSTMPC_COMMANDS + i) * horizon];
        answer.status[i] = axis[i].status;
        answer.fault[i] = axis[i].fault;
        answer.missing[i] = axis[i].missing;
        answer.inverse[i] = axis[i].inverse;
    }
    return answer;
}

void hystmpc_set_target(hystmpc_controller *c, const hystmpc_real *angles_deg) {
    hystmpc_axes_target(&exported_problem, memory_of(c), angles_deg);
}

int hystmpc_measure(hystmpc_controller *c, const hystmpc_real *angles_deg, hystmpc_real age) {
    return hystmpc_axes_measure(&exported_problem, memory_of(c), angles_deg, age);
}

int hystmpc_look_on(hystmpc_controller *c, const hystmpc_real *angles_deg, const hystmpc_real *commands) {
    return hystmpc_axes_look_on(&exported_problem, memory_of(c), angles_deg, commands, room_of(c));
}

void hystmpc_hurry(hystmpc_controller *c) { hystmpc_axes_hurry(&exported_problem, memory_of(c)); }

void hystmpc_stop(hystmpc_controller *c) { hystmpc_axes_stop(&exported_problem, memory_of(c)); }
