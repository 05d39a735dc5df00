/* Bytes that a controller remembers, and that a call of it takes at most; after its engine and its numbers. */
#include <stdio.h>

int main(void) {
    const hystmpc_model *m = exported_problem.model;
    const long states = m ? room_for(m->predictor->states) + ROOM_LINE : 0;
    const long at_rest = m ? hystmpc_at_rest_bytes(exported_rest, m->predictor) : 0;
    const long room = states + longer(at_rest, hystmpc_room_bytes(&exported_problem));
    printf("%ld %ld", hystmpc_bytes_of_memory(&exported_problem), room);
    return 0;
}
