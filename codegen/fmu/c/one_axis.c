/* What device.c says of a device of one axis. */
@REFERENCES@
enum { TIME = 0, COMMAND = 1, OUTPUT = 2 };             /* value references, as in modelDescription.xml */
@SIGNALS@
    double x[HYSTMPC_STATES];
    double command, output;
@ACCESS@
%INPUTS%
/* At rest, as the Python simulator is after a reset. */
static void device_reset(device_state *s) {
    static const double rest[HYSTMPC_STATES] = HYSTMPC_REST;
    memset(s, 0, sizeof *s);
    memcpy(s->x, rest, sizeof rest);
    s->command = HYSTMPC_REST_COMMAND;
    s->output = HYSTMPC_REST_OUTPUT;
    s->stop_s = INFINITY;
}

static int device_get(const struct instance *d, const device_state *s, const unsigned int *which, size_t count,
                      double *values) {
    for (size_t i = 0; i < count; i++) {
        if (which[i] == TIME) values[i] = device_time(s);
        else if (which[i] == COMMAND) values[i] = s->command;
        else if (which[i] == OUTPUT) values[i] = s->output;
%GET_INPUT%
        else return tell(d, FAILED, "get: unknown value reference, expected 0 (time), 1 (command) or 2 (output)");
    }
    return DONE;
}

static int device_set(const struct instance *d, device_state *s, const unsigned int *which, size_t count,
                      const double *values) {
    for (size_t i = 0; i < count; i++) {
%SET_INPUT%
        if (which[i] != COMMAND) return tell(d, FAILED, "set: only value reference 1, the command, can be set");
        if (!plain_number(values[i])) return tell(d, REFUSED, "set: the command is not a finite number");
        s->command = values[i];
    }
    return DONE;
}

@ADVANCE@
/* One sample with the command held; 0 where the device does not answer with finite numbers. */
static int device_advance(device_state *s) {
    double room[HYSTMPC_ROOM], sum = 0.0;
    s->output = hystmpc_chain_step(device_chain, device_kept, s->x, s->command, (char *)room);
    for (int i = 0; i < HYSTMPC_STATES; i++) sum += fabs(s->x[i]);
    s->samples++;
    return plain_number(sum) && plain_number(s->output);
}

