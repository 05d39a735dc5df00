/* Bytes that controllers of two axes remember, and that a call of them takes at most; after their engine and numbers. */
#include <stdio.h>

int main(void) {
    const hystmpc_problem *const axes[HYSTMPC_AXES] = {exported_problem.first, exported_problem.second};
    const int samples = hystmpc_reference_samples(axes[0]), horizon = axes[0]->law->horizon;
    long room = hystmpc_axes_room_bytes(&exported_problem);
    for (int i = 0; i < HYSTMPC_AXES; i++)
        if (axes[i]->model) room = longer(room, hystmpc_at_rest_bytes(exported_rest[i], axes[i]->model->predictor));
    room += ROOM_LINE + room_for(exported_states[0] + exported_states[1]) + room_for(HYSTMPC_AXES * samples) +
            room_for((exported_problem.commands + HYSTMPC_AXES) * horizon);
    printf("%ld %ld", hystmpc_axes_bytes(&exported_problem), room);
    return 0;
}
