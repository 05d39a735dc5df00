/* Controller of one device with hysteresis, exported by hystmpc. C99; no heap, no global state.
 *
 *   hystmpc_controller *c = &storage;           HYSTMPC_BYTES bytes, static or in a struct of yours
 *   hystmpc_init(c, angle_deg, held_command);   0, or why it cannot start
 *   hystmpc_set_target(c, 50.0);                a constant reference from the next step on
 *   for (;;) {                                  once every HYSTMPC_SAMPLE_S seconds
 *       hystmpc_command next = hystmpc_step(c, measured_deg, NULL);
 *       send(next.u);
 *   }
 *
 * A step never fails: it answers any measurement (not-a-number: none) and any reference with a finite command within
 * the limits on value and rate. The first HYSTMPC_REMEMBERED bytes of the struct are the whole memory, without pointers: a
 * copy of them is a snapshot. What is behind them is room for one call. Memory that no init has accepted, zeroed or not, is
 * a controller that stands still: every function may be called on it.
 */

/* At rest at a measured angle [deg] under the command that the device holds. The target is that angle. A start that is
 * refused latches the stop: steps go on from the last command sent, or hold that of the refused start, or the admissible
 * one nearest to it, or the least where it is no number. */
int hystmpc_init(hystmpc_controller *c, hystmpc_real angle_deg, hystmpc_real command);

/* One sample. `reference` holds the wanted angles [deg] at the ends of this and the next samples,
 * HYSTMPC_REFERENCE of them; NULL for the target in all of them. */
hystmpc_command hystmpc_step(hystmpc_controller *c, hystmpc_real angle_deg, const hystmpc_real *reference);

/* The angle [deg] wanted from the next step on, where no reference is given. */
void hystmpc_set_target(hystmpc_controller *c, hystmpc_real angle_deg);

/* An angle [deg] in a frame of an intermittent sensor, taken `age` samples before the next step; between frames a step gets
 * not-a-number. 1, or 0 where it cannot be used: it is too old, of the future, no usable angle, or nothing has been started. */
int hystmpc_measure(hystmpc_controller *c, hystmpc_real angle_deg, hystmpc_real age);

/* The present value of a measured input of the model, HYSTMPC_INPUT_NAME: it holds over the preview until the next one;
 * after a start the identified value holds. 1, or 0 where it is no finite number, there is no such input, or nothing has been
 * started: then nothing changes. Values beyond the identified range count as its nearest end. */
int hystmpc_input(hystmpc_controller *c, int input, hystmpc_real value);

/* One sample in which another has sent `command`: the controller looks on, and knows the hysteresis when it takes over.
 * The next command is limited from that one: from the nearest within the limits, or from the last where it is no number.
 * Answers for how many samples the model has failed, 0 where it has not, 1 where nothing has been started. */
int hystmpc_look_on(hystmpc_controller *c, hystmpc_real angle_deg, hystmpc_real command);
