/* Two bending axes of one device: a controller for each, and one program for both where the commands' limits bind.
 *
 *     w = M u,    y_i = f_i(w_i),    theta = A y
 *
 * Of n commands u (tendons or chambers) each axis pulls by its travel w_i; the model of an axis, with drive and
 * hysteresis, answers y_i; the sensor sees both in its frame. In y and w the axes are separate problems, of which each
 * keeps its observer, its learning, its holds and its fallbacks. What they share are the limits of u:
 *
 * The axes propose plans of w. The commands that pull by them with the least distance from the rest u_0 are
 * u = u_0 + N (w - M u_0) with M N = 1. Where all are admissible they are optimal. Where not, one quadratic program in the
 * commands of all, with the Jacobian A dy/dw M, decides between the axes.
 *
 * Of a friction that both axes share, theta = A (y + c), each axis knows c along the plans of the last step: it is taken from
 * the measurements and from what is wanted. So an axis does not know what its own motion changes of c, and both together
 * may oscillate: a motion of one removes the dead band that the other one means to cross. Where an axis is to move, the
 * program for all commands improves the cheaper one of the proposals and of what is left of the last plans, with the
 * Jacobian A (dy/dw + dc/dw) M. Moves cost there by what they are more than those of the reference.
 *
 * A memory is u as sent last (n), the shared friction's state and its last values, then the memories of both axes. */
#ifndef HYSTMPC_AXES_H
#define HYSTMPC_AXES_H

#include "controller.h"
#include "cross_friction.h"

enum {
    HYSTMPC_AXES = 2,
    HYSTMPC_PULLS = 9, /* commands, at most */
    HYSTMPC_PAST = 64  /* samples of the shared friction that are remembered, for late measurements */
};

typedef struct {
    const hystmpc_problem *first, *second; /* in y and w: their limits are those that u allows each alone */
    int commands;         /* n */
    int changes;          /* of the active set in one program */
    const real *mix;      /* M (2, n) */
    const real *unmix;    /* N (n, 2) */
    const real *rest;     /* u_0 (n) */
    const real *frame;    /* A (2, 2) */
    const real *unframe;  /* its inverse */
    const real *lower, *upper, *reach; /* of every command; its greatest change in a sample (n) */
    const hystmpc_cross_friction *cross; /* null: none */
    const hystmpc_law *law; /* of both angles theta and all commands; null: no plans are made */
} hystmpc_axes;

/* Bytes of a memory, and of the room for any call. */
HYSTMPC_API long hystmpc_axes_bytes(const void *axes);
HYSTMPC_API long hystmpc_axes_room_bytes(const void *axes);

/* At rest: angles y (2) by measured angles (2), without what both axes share, not-a-number where one cannot be used; travels
 * w (2) by commands (n), each within the limits of its axis. */
HYSTMPC_API void hystmpc_axes_at(const void *axes, const real *angles_deg, const real *commands, real *y, real *w);

/* What both axes share, at rest under commands (n): call it when each has its start in the memory. */
HYSTMPC_API void hystmpc_axes_begin(const void *axes, char *memory, const real *commands);

/* At rest at measured angles (2) [deg] under the commands (n) that the device holds; x: the states of both predictors at rest
 * there, one behind the other. 0, or why there is no start (observer.h): a start that is refused latches the stop. */
HYSTMPC_API int hystmpc_axes_init(const void *axes, char *memory, const real *x, const real *angles_deg,
                                  const real *commands, char *room);

/* One step. angles_deg (2), not-a-number where one is missing; reference (2, S), null for the target in all samples; u (n):
 * the commands to send; answers: two structs `hystmpc_command`, of which u is the axis's travel w and angles are y. plan (n + 2, H): commands, and
 * angles theta, disturbance included; null for none. Answers how many of the axes say something unusual. */
HYSTMPC_API int hystmpc_axes_step(const void *axes, char *memory, const real *angles_deg, const real *reference,
                                  real *u, void *answers, real *plan, char *room);

/* As the functions of controller.h, for both axes: angles (2), commands (n). A frame in which one angle cannot be used
 * changes nothing. */
HYSTMPC_API void hystmpc_axes_target(const void *axes, char *memory, const real *angles_deg);
HYSTMPC_API int hystmpc_axes_look_on(const void *axes, char *memory, const real *angles_deg, const real *commands,
                                     char *room);
HYSTMPC_API int hystmpc_axes_measure(const void *axes, char *memory, const real *angles_deg, real age);
HYSTMPC_API void hystmpc_axes_held(const void *axes, char *memory, const real *commands);
HYSTMPC_API void hystmpc_axes_hurry(const void *axes, char *memory);
HYSTMPC_API void hystmpc_axes_stop(const void *axes, char *memory);

#endif
