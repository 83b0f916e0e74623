/* A contact law of feltmb for programs that call C: MATLAB, Julia, Modelica, Unity, Unreal.
 *
 * One handle is one contact: its law and its memory. Compression > 0 when touching [m], time [s],
 * force > 0 pushes apart [N], energy [J]. No function throws; handles share nothing, so that
 * threads may use different ones. Link with libfeltmb_felt. */
#ifndef FELTMB_FELT_H
#define FELTMB_FELT_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct feltmb_felt feltmb_felt;

/* Makes a virgin contact from a text, one entry a line, SI units, # begins a comment:
 *   law NAME                    as in a mechanism file, such as felt_return_point
 *   FIELD VALUE                 a number of the law, such as kappa 0.2
 *   loading a b c               F = a e exp(b e) + c e; unloading likewise
 *   closing_compression VALUE   end of a loop of two curves that do not meet [m]
 *   envelope e loading unloading  a row of a loop as a table [m, N, N], the first one 0 0 0
 * or the text of the file felt.txt of `feltmb felt c`, of the version of this library.
 * NULL if the text is wrong: then `message` (of `size` bytes, may be NULL) says why. */
feltmb_felt* feltmb_felt_create(const char* text, char* message, size_t size);
feltmb_felt* feltmb_felt_copy(const feltmb_felt* felt);
void feltmb_felt_free(feltmb_felt* felt);  /* NULL: nothing */
void feltmb_felt_reset(feltmb_felt* felt); /* virgin again */

/* Moves to `compression` within `duration` > 0, linear in time; returns the force. NaN, and
 * nothing is moved, unless both are finite and the duration is > 0. */
double feltmb_felt_step(feltmb_felt* felt, double compression, double duration);
/* What `step` would return; nothing is moved. */
double feltmb_felt_peek(const feltmb_felt* felt, double compression, double duration);

/* A body of `mass` > 0 [kg] against the felt for one step of an engine, 1/240 s or so: moves
 * `compression` [m] and `speed` [m/s, > 0 into the felt] on, in steps of 4 us of its own. After
 * each call, kinetic energy and energy of the felt together are at most what they were before it,
 * whatever the step and the mass. Returns the mean force [N]; NaN, and nothing is moved, for a
 * number that is not possible. For steps below 0.1 ms, call feltmb_felt_step instead. */
double feltmb_felt_hit(feltmb_felt* felt, double mass, double* compression, double* speed,
                       double duration);

double feltmb_felt_force(const feltmb_felt* felt);  /* after the last step */
double feltmb_felt_energy(const feltmb_felt* felt); /* stored, that can be got back */

/* The memory as numbers: returns how many there are, and writes as many as there is room for. */
size_t feltmb_felt_save(const feltmb_felt* felt, double* numbers, size_t room);
/* 1: done; 0: they are not of this law, and nothing is changed. */
int feltmb_felt_restore(feltmb_felt* felt, const double* numbers, size_t count);

#ifdef __cplusplus
}
#endif
#endif
