/* Controller of one device with hysteresis that bends in two planes, exported by hystmpc. C99; no heap, no global state.
 *
 *   hystmpc_controller *c = &storage;           HYSTMPC_BYTES bytes, static or in a struct of yours
 *   hystmpc_init(c, angles_deg, held_commands); 0, or why it cannot start
 *   hystmpc_set_target(c, target_deg);          two constant angles from the next step on
 *   for (;;) {                                  once every HYSTMPC_SAMPLE_S seconds
 *       hystmpc_command next = hystmpc_step(c, measured_deg, NULL);
 *       send(next.u);
 *   }
 *
 * Angles are arrays of HYSTMPC_AXES numbers, x and y; commands are arrays of HYSTMPC_COMMANDS numbers, in the order of the
 * model's file. HYSTMPC_LOWEST and HYSTMPC_HIGHEST initialise an array of commands.
 *
 * A step never fails: it answers any measurements (not-a-number: none) and any reference with finite commands within
 * the limits on value and rate. The first HYSTMPC_REMEMBERED bytes of the struct are the whole memory, without pointers: a
 * copy of them is a snapshot. What is behind them is room for one call. Memory that no init has accepted, zeroed or not, is
 * a controller that stands still: every function may be called on it.
 */

/* Answer of a step. */
typedef struct {
    hystmpc_real u[HYSTMPC_COMMANDS];          /* always finite and within the limits */
    hystmpc_real predicted_deg[HYSTMPC_AXES];  /* angles expected at the end of this sample, disturbance included;
                                                  not-a-number where nothing has been started or there is no model */
    hystmpc_real departure_deg[HYSTMPC_AXES];  /* by how much the device is off the model as it was given, as estimated */
    int source;                /* HYSTMPC_MPC ... HYSTMPC_STOP: the worse level of both axes */
    int status[HYSTMPC_AXES];  /* HYSTMPC_OK ... HYSTMPC_FAILED, of each axis of the model */
    int fault[HYSTMPC_AXES];   /* of a planner, of each axis */
    int missing[HYSTMPC_AXES]; /* samples since the last accepted measurement of each axis */
    int planned;               /* entries of the plan, the fewer ones of both axes */
    int inverse[HYSTMPC_AXES]; /* of the fallback: 1 where the inverse answers no finite command, 2 where it has failed */
} hystmpc_command;

/* At rest at measured angles [deg] under the commands that the device holds. The target is these angles. A start that is
 * refused latches the stop: steps go on from the last commands sent, or hold those of the refused start, or the admissible
 * ones nearest to them; a command that is no number counts as that of the model's rest. */
int hystmpc_init(hystmpc_controller *c, const hystmpc_real *angles_deg, const hystmpc_real *commands);

/* One sample. `reference` holds the wanted angles [deg] at the ends of this and the next samples: HYSTMPC_REFERENCE rows of
 * HYSTMPC_AXES angles, x and y of the first sample in front; NULL for the target in all of them. */
hystmpc_command hystmpc_step(hystmpc_controller *c, const hystmpc_real *angles_deg, const hystmpc_real *reference);

/* The angles [deg] wanted from the next step on, where no reference is given. */
void hystmpc_set_target(hystmpc_controller *c, const hystmpc_real *angles_deg);

/* Angles [deg] in a frame of an intermittent sensor, taken `age` samples before the next step; between frames a step gets
 * not-a-numbers. 1, or 0 where the frame cannot be used: it is too old, of the future, one angle is not usable, or nothing
 * has been started. */
int hystmpc_measure(hystmpc_controller *c, const hystmpc_real *angles_deg, hystmpc_real age);

/* One sample in which another has sent `commands`: the controller looks on, and knows the hysteresis when it takes over.
 * The next commands are limited from those: from the nearest within the limits, or from the last where one is no number.
 * Answers for how many samples a model has failed, 0 where none has, 1 where nothing has been started. */
int hystmpc_look_on(hystmpc_controller *c, const hystmpc_real *angles_deg, const hystmpc_real *commands);
