/* What device.c says of a device of two axes, see core/axes.h:
 *
 *     w = M d(u),    y_i = f_i(w_i),    theta = A (y + c(w))
 *
 * d is the drive of every command, f_i the chain of an axis, c what both share. */
@REFERENCES@
enum { AXES = 2 };
enum { TIME = 0, COMMAND = 1, OUTPUT = COMMAND + HYSTMPC_COMMANDS, BEHIND = OUTPUT + AXES };
/* value references, as in modelDescription.xml */
@SIGNALS@
    double x[HYSTMPC_STATES]; /* of each drive, of both axes, of what they share: one behind the other */
    double command[HYSTMPC_COMMANDS], output[AXES];
@ACCESS@
/* At rest, as the Python simulator is after a reset. */
static void device_reset(device_state *s) {
    static const double rest[HYSTMPC_STATES] = HYSTMPC_REST, output[AXES] = HYSTMPC_REST_OUTPUT;
    static const double command[HYSTMPC_COMMANDS] = HYSTMPC_REST_COMMAND;
    memset(s, 0, sizeof *s);
    memcpy(s->x, rest, sizeof rest);
    memcpy(s->command, command, sizeof command);
    memcpy(s->output, output, sizeof output);
    s->stop_s = INFINITY;
}

static int device_get(const struct instance *d, const device_state *s, const unsigned int *which, size_t count,
                      double *values) {
    for (size_t i = 0; i < count; i++) {
        if (which[i] == TIME) values[i] = device_time(s);
        else if (which[i] < OUTPUT) values[i] = s->command[which[i] - COMMAND];
        else if (which[i] < BEHIND) values[i] = s->output[which[i] - OUTPUT];
        else return tell(d, FAILED, "get: unknown value reference, expected one of modelDescription.xml");
    }
    return DONE;
}

static int device_set(const struct instance *d, device_state *s, const unsigned int *which, size_t count,
                      const double *values) {
    char line[100];
    for (size_t i = 0; i < count; i++) {
        if (which[i] < COMMAND || which[i] >= OUTPUT) {
            snprintf(line, sizeof line, "set: only value references 1 to %d, the commands, can be set", OUTPUT - 1);
            return tell(d, FAILED, line);
        }
        if (!plain_number(values[i])) return tell(d, REFUSED, "set: a command is not a finite number");
        s->command[which[i] - COMMAND] = values[i];
    }
    return DONE;
}

@ADVANCE@
/* One sample with the commands held; 0 where the device does not answer with finite numbers. */
static int device_advance(device_state *s) {
    double room[HYSTMPC_ROOM], w[AXES] = {0.0, 0.0}, c[AXES] = {0.0, 0.0}, y[AXES], sum = 0.0, *x = s->x;
    for (int k = 0; k < HYSTMPC_COMMANDS; k++, x += HYSTMPC_DRIVE_STATES) {
#if HYSTMPC_DRIVE_STATES
        const double driven = hystmpc_chain_step(device_drive, device_drive_kept, x, s->command[k], (char *)room);
#else
        const double driven = s->command[k];
#endif
        for (int i = 0; i < AXES; i++) w[i] += device_mix[i * HYSTMPC_COMMANDS + k] * driven;
    }
    y[0] = hystmpc_chain_step(device_x, device_x_kept, x, w[0], (char *)room);
    x += HYSTMPC_X_STATES;
    y[1] = hystmpc_chain_step(device_y, device_y_kept, x, w[1], (char *)room);
    x += HYSTMPC_Y_STATES;
#if HYSTMPC_SHARED_STATES
    hystmpc_cross_run(&device_shared, 1, w, x, c);
#endif
    for (int i = 0; i < AXES; i++)
        s->output[i] = device_frame[i * AXES] * (y[0] + c[0]) + device_frame[i * AXES + 1] * (y[1] + c[1]);
    for (int i = 0; i < HYSTMPC_STATES; i++) sum += fabs(s->x[i]);
    s->samples++;
    return plain_number(sum) && plain_number(s->output[0] + s->output[1]);
}

