/* A servo as its firmware runs: a loop in ticks, on counts, that moves the body of body.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 *
 * At each tick the motor takes the force
 *
 *   clip(gain (goal - y) + integral sum(period (goal - y)) - derivative w - tacho v, -limit, limit)
 *
 * until the next tick. y is the position at the nearest count, and w the difference of counts over the period after a
 * low-pass filter, which moves by `share` of its distance at each tick. v is the true velocity. */
#ifndef PMF_TICKS_H
#define PMF_TICKS_H
#include "body.h"

typedef struct {
    double gain, limit, derivative, tacho, share, integral, period, resolution;
} pmf_firmware;

/* Simulate n ticks with goals (n), and times step (n) [s] to the next tick. The body has one interval and no
 * controller. `path` (n, 2) has position and velocity at each tick. theta (w) loses its start state. Returns the number
 * of ticks before the motion overflows. */
int pmf_ticks_run(const pmf_body *body, const pmf_firmware *loop, double *theta, int n, const double *goal,
                  const double *step, double *path, double *work);

#endif
