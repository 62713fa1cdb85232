/* Two masses on a spring, the input on the first one: their motion, and the exact derivatives by every parameter.
 *
 * SPDX-License-Identifier: Apache-2.0
 *
 *   m v' = g - d v - e |v| - F sign(v) - c - p - forces,   p = stiffness (x - x2) + damping (v - v2)
 *   m2 v2' = p - d2 v2 - F2 sign(v2) - forces on the load
 *
 * With play, p acts only where the twist x - x2 is beyond half of the gap, and counts from there.
 *
 * Between stops, starts and switches of the input the motion is linear. Its Taylor series shows the next of them. */
#ifndef PMF_ELASTIC_H
#define PMF_ELASTIC_H

#include "body.h"

/* Places of the further parameters. The sizes of the forces follow, then their free constants. */
enum {
    PMF_ELASTIC_MASS = PMF_BODY_BASE,
    PMF_ELASTIC_VISCOUS,
    PMF_ELASTIC_COULOMB,
    PMF_ELASTIC_STIFFNESS,
    PMF_ELASTIC_DAMPING,
    PMF_ELASTIC_TWIST, /* position of the mass that is not shown at the start, less that of the other one */
    PMF_ELASTIC_SLIP, /* the same for the velocity */
    PMF_ELASTIC_PLAY, /* gap between the masses, >= 0; 0 means none */
    PMF_ELASTIC_BASE
};

/* Simulate as pmf_body_run, with w = PMF_ELASTIC_BASE + forces + shapes, and without a lag. Positions,
 * velocities and the start are those of the mass that body->side shows. `work` has room for 15 w numbers. */
int pmf_elastic_run(const pmf_body *body, const double *theta, double *y, double *v, double *S, double *work);

/* Force of a load on the motor per mass of the load, force (n), at every `parts`-th place of a motor that moves through
 * x (parts (n - 1) + 1) at intervals of `step` [s], to first order in the step. load: square of the rate of spring and
 * load [1/s^2], damping and drag per mass [1/s], and Coulomb friction per mass. */
void pmf_elastic_drive(int n, int parts, double step, const double *x, const double load[4], double *force);

#endif
